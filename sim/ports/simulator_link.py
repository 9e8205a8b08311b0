"""Packets of the simulator link, Betaflight's: what the host program and Betaflight's SITL both speak.

Rates and forces are in the axes of the wire: forward, right, down. Attitude is a quaternion w x y z from the
body (x forward, y left, z up) to the world (north, west, up); velocity and position are east, north, up.
"""

from __future__ import annotations

import socket
import struct

from sim.physics.rotation import quaternion
from sim.ports.port import Sample
from toolchain.contract import SIM_RECEIVER_FORMAT, SIM_SERVO_FORMAT, SIM_STATE_FORMAT

LOOPBACK = "127.0.0.1"
PACKET_BYTES_MAX = 2048
SEA_LEVEL_PA = 101325.0
Triple = tuple[float, float, float]

RECEIVER = struct.Struct(SIM_RECEIVER_FORMAT)
SERVO = struct.Struct(SIM_SERVO_FORMAT)
_STATE = struct.Struct(SIM_STATE_FORMAT)


def state_packet(time_s: float, rates: Triple, force: Triple, sample: Sample, pressure: float) -> bytes:
    """The state packet of `sample`. rates [rad/s], force [m/s^2]: wire axes; pressure: of the air [Pa]."""
    north_speed, west_speed, up_speed = sample.velocity.tolist()
    north, west, up = sample.position.tolist()
    motion = (-west_speed, north_speed, up_speed, -west, north, up)
    return _STATE.pack(time_s, *rates, *force, *quaternion(sample.rotation), *motion, pressure)


def udp_socket(timeout: float | None) -> socket.socket:
    """A UDP socket on a free loopback port; timeout: of its calls [s], None: they never wait."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind((LOOPBACK, 0))
    sock.settimeout(0.0 if timeout is None else timeout)
    return sock
