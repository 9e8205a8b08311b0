"""The simulator link, Betaflight's packets: what the host program and Betaflight's SITL both speak.

Rates and forces are in the axes of the wire: forward, right, down. Attitude is a quaternion w x y z from the
body (x forward, y left, z up) to the world (north, west, up); velocity and position are east, north, up.
State packets are made in C (c/state_packet.c), and so are exchanges with the host program (c/link.c).
"""

from __future__ import annotations

import socket
import struct
from functools import cache
from pathlib import Path

from neuroflight.sim.compiled import Library, Source, load
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.contract import SIM_RECEIVER_FORMAT, SIM_SERVO_FORMAT, SIM_STATE_FORMAT

LOOPBACK = "127.0.0.1"
PACKET_BYTES_MAX = 2048
SEA_LEVEL_PA = 101325.0
Triple = tuple[float, float, float]

RECEIVER = struct.Struct(SIM_RECEIVER_FORMAT)
SERVO = struct.Struct(SIM_SERVO_FORMAT)
STATE = struct.Struct(SIM_STATE_FORMAT)


@cache
def load_link() -> Library:
    """Load the C of this folder. Raises BuildError if it is not built and cannot be."""
    library = load(Source("link", "the simulator link", (Path(__file__).parent / "c",)))
    assert STATE.size == 8 * library.lib.LINK_STATE_VALUES
    return library


def state_packet(time_s: float, rates: Triple, force: Triple, sample: Sample, pressure: float) -> bytes:
    """Encode the state packet of `sample`. rates [rad/s], force [m/s^2]: wire axes; pressure [Pa]."""
    link = load_link()
    packet = link.ffi.new("double[]", link.lib.LINK_STATE_VALUES)
    values = link.ffi.from_buffer("double[]", sample.values)
    link.lib.link_state(time_s, rates, force, values, pressure, packet)
    return bytes(link.ffi.buffer(packet))


def udp_socket(*, waits: bool = True) -> socket.socket:
    """Open a UDP socket on a free loopback port; waits: True for blocking calls."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind((LOOPBACK, 0))
    sock.setblocking(waits)
    return sock
