"""A gateway in lockstep: the host program in its twin, pymavlink on the ground, the clock the firmware's."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

os.environ["MAVLINK20"] = "1"  # of mavutil, which reads it when it is imported
from pymavlink import mavutil
from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import TcpPort, TcpTransport, Transport, open_transport
from neuroflight.flash.mavlink.endpoint import UdpPeer, parse_address
from neuroflight.flash.mavlink.session import Options, Session
from neuroflight.flash.settings.text import RATES, STYLE
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.motors import motor_fractions
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.port import Reply, Sample
from tests.flash.peers import host_board

LOOPBACK = "127.0.0.1"
GYRO_HZ = 1000
RATES_AND_THRUST = 0b1000_0000  # type_mask of SET_ATTITUDE_TARGET
RECEIVER_MSP = {"receiver_protocol": 2.0}
READY_MS = 1400  # from power-on: calibrated, the delay of arming over


class Station:
    """A ground station or companion: pymavlink at a UDP port."""

    def __init__(self, system: int) -> None:
        self.link = mavutil.mavlink_connection(
            f"udpin:{LOOPBACK}:0", source_system=system, source_component=191, dialect="common"
        )
        self.inbox: list[Any] = []

    @property
    def address(self) -> str:
        return f"udp:{LOOPBACK}:{self.link.port.getsockname()[1]}"

    def read(self) -> None:
        """Take what has come."""
        while (message := self.link.recv_msg()) is not None:
            assert message.get_type() != "BAD_DATA"
            self.inbox.append(message)

    def forget(self) -> None:
        """What has come so far."""
        self.read()
        self.inbox.clear()

    def got(self, kind: str) -> list[Any]:
        """Messages of that type so far."""
        self.read()
        return [message for message in self.inbox if message.get_type() == kind]

    def texts(self) -> list[str]:
        """STATUSTEXTs so far, put together."""
        lines: list[str] = []
        for message in self.got("STATUSTEXT"):
            if message.id and message.chunk_seq:
                lines[-1] += message.text
            else:
                lines.append(message.text)
        return lines

    def acks(self, command: int) -> list[int]:
        """Results of that command so far; all are meant for this station."""
        found = [ack for ack in self.got("COMMAND_ACK") if ack.command == command]
        own = (self.link.source_system, self.link.source_component)
        assert all((ack.target_system, ack.target_component) == own for ack in found)
        return [ack.result for ack in found]

    def command(self, command: int, *params: float) -> None:
        """COMMAND_LONG for the aircraft."""
        values = [*params, *[0.0] * 7][:7]
        self.link.mav.command_long_send(1, 1, command, 0, *values)

    def rates(
        self, roll: float, pitch: float, yaw: float, thrust: float, mask: int = RATES_AND_THRUST
    ) -> None:
        """SET_ATTITUDE_TARGET with body rates [rad/s]: right, nose up, clockwise are positive."""
        self.link.mav.set_attitude_target_send(0, 1, 1, mask, [1.0, 0, 0, 0], roll, pitch, yaw, thrust)

    def raw(self, packet: bytes) -> None:
        """Any bytes."""
        self.link.write(packet)

    def close(self) -> None:
        self.link.close()


FLYING = Options(offboard=True, allow_arm=True)


class Lockstep:
    """Twin, host program and gateway, advanced by whole milliseconds of the firmware's time."""

    def __init__(
        self,
        program: Path,
        stack: ExitStack,
        options: Options = FLYING,
        flown: dict[str, float] | None = None,
        stations: int = 1,
        also: Sequence[str] = (),
        through: Callable[[Transport], Transport] = lambda line: line,
    ) -> None:
        """flown: settings that are flown without being stored, as if they had changed since the start.
        also: addresses of other peers. through: what lies on the line to the firmware."""
        self.port = stack.enter_context(closing(HostPort(program, GYRO_HZ, flown)))
        rng = np.random.default_rng(1)
        twin = Twin(load_aircraft("nf1"), rate_hz=GYRO_HZ, mount=Mount.CENTRE, rng=rng)
        self._twin = stack.enter_context(closing(twin))
        self._sample = Sample(0.0, *(np.zeros(3), np.eye(3)), *np.zeros((3, 3)))
        self.samples = 0
        self.tumbling: tuple[float, float, float] | None = None  # at these rates [rad/s], whatever motors do
        self.reply: Reply
        self.step()  # the first sample: the client below is answered from then on
        systems = range(201, 201 + stations)
        self.stations = [stack.enter_context(closing(Station(system))) for system in systems]
        self.station = self.stations[0]
        addresses = [*(station.address for station in self.stations), *also]
        self.peers = [stack.enter_context(closing(UdpPeer(parse_address(address)))) for address in addresses]
        self._through = through
        client = stack.enter_context(Client(self._open()))
        self.lines: list[str] = []
        self._client, self._options = client, options
        self.restart_gateway()
        stack.callback(lambda: self.session.close())
        for station in self.stations:
            station.read()

    def _open(self) -> Transport:
        """Open a line to the firmware."""
        return self._through(TcpTransport(TcpPort(LOOPBACK, self.port.msp_port)))

    def restart_gateway(self) -> None:
        """Another gateway on the same lines; the one before it ends without a word."""
        say = self.lines.append
        self.session = Session(self._client, self.peers, self._options, self.clock, say, self._open)
        self.settle()

    def clock(self) -> float:
        return self.samples / GYRO_HZ

    def step(self) -> None:
        """One gyro sample."""
        live, sample = self._twin.live, self._sample
        sample.time_s = self.samples / GYRO_HZ
        sample.gyro[:] = live.gyro
        if self.tumbling is not None:  # with a gyro's noise, lest it be taken for a stuck one
            sample.gyro[:] = np.array(self.tumbling) + 0.02 * (self.samples % 2)
        sample.specific_force[:] = live.accelerometer
        sample.rotation[:] = live.rotation
        self.reply = self.port.exchange(sample, None)
        self.samples += 1
        if self.reply.armed or self.reply.dshot.any():
            self._twin.step(motor_fractions(self.reply.dshot)[None])
        else:
            self._twin.measure()

    def settle(self) -> None:
        """Let the gateway do all that is due."""
        while self.session.step() == 0.0:
            pass

    def run(self, ms: int, each: Callable[[], None] = lambda: None, every_ms: int = 20) -> None:
        """Fly so long; `each` is what a companion does every so often."""
        for k in range(ms):
            if k % every_ms == 0:
                each()
                for station in self.stations:
                    station.read()  # a socket keeps a few hundred packets
            for _ in range(GYRO_HZ // 1000):
                self.step()
            self.settle()

    @property
    def rate(self) -> tuple[float, ...]:
        """The aircraft's true rate [rad/s] about forward, right, down."""
        x, y, z = self._twin.live.rate[0].tolist()
        return x, -y, -z

    # --- What a companion does step by step ------------------------------------------------------------
    def enable(self, station: Station | None = None) -> int:
        """Setpoints of nothing, then the command; returns its result."""
        one = station or self.station
        one.rates(0, 0, 0, 0)
        one.command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1)
        self.settle()
        return one.acks(mavlink.MAV_CMD_NAV_GUIDED_ENABLE)[-1]

    def arm(self) -> int:
        """Wait until ready, enable, arm; returns the last result."""
        self.run(READY_MS)
        assert self.enable() == mavlink.MAV_RESULT_ACCEPTED
        idle = lambda: self.station.rates(0, 0, 0, 0)  # noqa: E731
        self.run(300, idle)
        self.station.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        self.run(200, idle)
        return self.station.acks(mavlink.MAV_CMD_COMPONENT_ARM_DISARM)[-1]


@cache
def stored_flash(program: Path, settings: tuple[tuple[str, float], ...]) -> tuple[bytes, dict[str, float]]:
    """The flash of a host program that holds these settings, and its rates."""
    with TemporaryDirectory() as folder:
        flash = Path(folder) / "flash.bin"
        with asked(program, flash) as kept:
            kept.change(dict(settings), save=True)
            rates = rates_of(kept)
        return flash.read_bytes(), rates


def rates_of(kept: Settings) -> dict[str, float]:
    """Rates as they are stored: a port would fly those of scenarios."""
    rates = {one.name: float(one.value) for one in kept.read(sorted(RATES))}
    return {STYLE: int(float(kept.get(STYLE))), **rates}


@contextmanager
def asked(program: Path, flash: Path) -> Iterator[Settings]:
    """Settings of a host program that runs with that flash."""
    with host_board(program, flash) as board, Client(open_transport(board.port)) as client:
        yield Settings(client)


class MakeLockstep:
    """Makes gateways in lockstep that end with the test."""

    def __init__(self, program: Path, folder: Path, stack: ExitStack) -> None:
        self._built, self._folder, self._stack = program, folder, stack
        self._program = program

    def __call__(
        self, options: Options = FLYING, *, stored: dict[str, float] | None = None, **more: Any
    ) -> Lockstep:
        """stored: settings beside the MSP receiver; more: of Lockstep."""
        flash = self._folder / f"flash{len(list(self._folder.iterdir()))}.bin"
        content, rates = stored_flash(self._built, tuple((RECEIVER_MSP | (stored or {})).items()))
        flash.write_bytes(content)
        # HostPort's programs keep no flash of their own.
        self._program = flash.with_suffix(".sh")
        self._program.write_text(f'#!/bin/sh\nexec "{self._built}" "--settings={flash}" "$@"\n')
        self._program.chmod(0o755)
        self._flash = flash
        self._last = self._start(options, rates, **more)
        return self._last

    def again(self, options: Options = Options()) -> Lockstep:  # noqa: B008
        """Another start with what the last one stored."""
        self._last.port.close()  # it holds its flash until it has ended
        with asked(self._built, self._flash) as kept:
            rates = rates_of(kept)
        return self._start(options, rates)

    def _start(
        self,
        options: Options,
        rates: dict[str, float],
        *,
        flown: dict[str, float] | None = None,
        **more: Any,
    ) -> Lockstep:
        return Lockstep(self._program, self._stack, options, flown={**rates, **(flown or {})}, **more)


@pytest.fixture
def lockstep(host_program: Path, tmp_path: Path) -> Iterator[MakeLockstep]:
    """A maker of gateways."""
    with ExitStack() as stack:
        yield MakeLockstep(host_program, tmp_path, stack)
