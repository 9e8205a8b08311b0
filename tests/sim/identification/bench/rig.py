"""A dynamometer without hardware: the host program turns a rotor of the twin, a sensor on a pty measures it.

Time is the firmware's: it passes only while somebody waits for the sensor, so that a run is the same each
time and takes as long as the machine needs.
"""

from __future__ import annotations

import errno
import fcntl
import os
import select
import struct
import termios
import tty
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType

import numpy as np

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import SerialPort, SerialTransport, TcpPort, TcpTransport
from neuroflight.sim.aircraft.model import RPM, Propulsion
from neuroflight.sim.control.motors import each_fraction
from neuroflight.sim.physics.rotor import next_speed, target_speed, thrust_and_torque
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.port import Sample
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import LinkError

READY_S = 1.1  # boot and the calibration of the gyro
WALL_S = 5.0  # in which what was written to a pty is there to be read
TURN = 2 * np.pi


@dataclass
class SensorKind:
    """How the simulated sensor is built."""

    columns: tuple[str, ...] = (
        *("time_us", "thrust_raw", "torque_left_raw", "torque_right_raw", "pulses", "pulse_us"),
        *("volts", "amps", "temperature_c"),
    )
    rate_hz: float = 250.0
    blades: int = 3
    thrust_counts: float = 21_000.0  # a newton
    torque_counts: float = 900_000.0  # a newton metre
    thrust_zero: float = 84_000.0
    torque_zero: float = -3_000.0
    noise: float = 0.005  # of the largest thrust and torque
    clock_rate: float = 1.003  # sensor seconds a second
    clock_zero_us: float = 2.0**32 - 3e6  # begins anew after some seconds
    pulse_zero: float = 65_500.0
    heading: bool = True
    seed: int = 0


@dataclass
class Faults:
    """What goes wrong from some time on, in seconds of the firmware's time; changed by tests as it runs."""

    silent_after: float = np.inf
    frozen_after: float = np.inf  # the same line again and again
    late_after: float = np.inf  # lines are kept back, and come 2 s late
    scale: dict[str, float] = field(default_factory=dict)  # a column's factor
    blocked_after: float = np.inf  # the rotor stands


class Rig:
    """Host program, rotor and sensor. `clock` is the time that all of them share [s]."""

    def __init__(
        self,
        program: Path,
        propulsion: Propulsion,
        kind: SensorKind | None = None,
        motor: int = 0,
        gyro_rate_hz: int = 1000,
    ) -> None:
        self.kind, self.faults = kind or SensorKind(), Faults()
        self.port = HostPort(program, gyro_rate_hz, {"gyro_stuck_ms": 0})
        self._propulsion, self._motor, self._dt = propulsion, motor, 1 / gyro_rate_hz
        self._rng = np.random.default_rng(self.kind.seed)
        self._sample = Sample(
            0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, GRAVITY])
        )
        self._steps = 0
        self._speed = 0.0
        self._throttles: list[float] = [0.0] * (1 + round(propulsion.delay * gyro_rate_hz))
        self._angle = 0.1  # of the rotor, in pulses
        self._pulse_s = 0.0  # when the last one came
        self._held: list[tuple[float, bytes]] = []
        self._last = b""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.device = os.ttyname(self._slave)
        self.on_step: Callable[[], None] = lambda: None
        self.turned: list[float] = []  # fraction of the motor at every step
        self.others = 0.0  # largest fraction of any other motor
        self.channels: Sequence[int] | None = None
        full = target_speed(1.0, propulsion)
        self._full = tuple(float(value) for value in thrust_and_torque(full, propulsion))
        self._due = 0.0
        self.open = False  # somebody reads the sensor
        self._target = (-1.0, 0.0)  # a fraction and the speed it settles at
        self.advance(READY_S)

    def __enter__(self) -> Rig:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.port.close()
        os.close(self._master)
        os.close(self._slave)

    def clock(self) -> float:
        return self._steps * self._dt

    @property
    def throttle(self) -> float:
        """What the board's motor is given now."""
        return self._throttles[-1]

    @property
    def rpm(self) -> float:
        return self._speed / RPM

    def client(self) -> Client:
        return Client(TcpTransport(TcpPort("127.0.0.1", self.port.msp_port)), self.clock)

    def line(self) -> SensorLine:
        return SensorLine(self)

    def advance(self, seconds: float) -> None:
        """Let time pass, one step at least."""
        for _ in range(max(1, round(seconds / self._dt))):
            self.step()

    def step(self) -> None:
        """One gyro sample, one step of the rotor, and the line that is due."""
        self._sample.time_s = self.clock()
        divider = self.port.gyro_rate_hz // self.port.control_rate_hz
        frame = self.channels if self._steps % (20 * divider) == 0 else None
        fractions = each_fraction(self.port.exchange(self._sample, frame).dshot)
        self.others = max(self.others, *(u for i, u in enumerate(fractions) if i != self._motor))
        self._throttles.append(fractions[self._motor])
        self.turned.append(fractions[self._motor])
        told = self._throttles.pop(0)
        if told != self._target[0]:
            # An ESC that is told to stop does not idle.
            self._target = told, float(target_speed(told, self._propulsion)) if told else 0.0
        target = self._target[1]
        if self.clock() >= self.faults.blocked_after:
            target, self._speed = 0.0, 0.0
        if target or self._speed:
            self._speed = float(next_speed(self._speed, target, self._dt, self._propulsion))
        before = self._angle
        self._angle += self._speed * self._dt * self.kind.blades / TURN
        self._steps += 1
        if int(self._angle) > int(before):
            part = (int(self._angle) - before) / (self._angle - before)
            self._pulse_s = self.clock() - (1 - part) * self._dt
        if self.clock() >= self._due:
            self._due += 1 / self.kind.rate_hz
            if self.open:
                self._send()
        self.on_step()

    def own_us(self, time: float) -> float:
        """The sensor's clock."""
        return (self.kind.clock_zero_us + 1e6 * self.kind.clock_rate * time) % 2.0**32

    def _send(self) -> None:
        kind, now = self.kind, self.clock()
        thrust, torque = (float(value) for value in thrust_and_torque(self._speed, self._propulsion))
        noise = kind.noise * self._rng.standard_normal(3)
        thrust += noise[0] * self._full[0]
        left, right = torque + noise[1] * self._full[1], torque + noise[2] * self._full[1]
        values = {
            "time_s": now * kind.clock_rate,
            "time_us": np.floor(self.own_us(now)),
            "thrust_n": thrust,
            "thrust_raw": np.rint(kind.thrust_zero + kind.thrust_counts * thrust),
            "torque_n_m": left,
            "torque_left_raw": np.rint(kind.torque_zero + kind.torque_counts * left),
            "torque_right_raw": np.rint(kind.torque_zero - kind.torque_counts * right),
            "rpm": self.rpm,
            "pulses": (kind.pulse_zero + int(self._angle)) % 65536,
            "pulse_us": np.floor(self.own_us(self._pulse_s)),
            "volts": 16.2 - 1.5 * self.throttle,
            "amps": 0.3 + 30.0 * self.throttle**2,
            "temperature_c": 25.0 + 20.0 * self.throttle,
        }
        cells = [
            f"{values[name] * self.faults.scale.get(name, 1.0):.10g}" if name in values else "ok"
            for name in kind.columns
        ]
        line = ",".join(cells).encode() + b"\r\n"
        if now >= self.faults.frozen_after:
            line = self._last
        self._last = line
        if now >= self.faults.silent_after:
            return
        if now >= self.faults.late_after:
            self._held.append((now + 2.0, line))
            while self._held and self._held[0][0] <= now:
                self.write(self._held.pop(0)[1])
            return
        self.write(line)

    def write(self, data: bytes) -> None:
        """Put bytes on the sensor's line; they can be read when this returns. A full line loses them."""
        before = self.waiting()
        if before + len(data) > 3000:
            return
        os.write(self._master, data)
        while self.waiting() < before + len(data):
            assert select.select([self._slave], [], [], WALL_S)[0]

    def waiting(self) -> int:
        """Bytes in the line."""
        count = bytearray(4)
        fcntl.ioctl(self._slave, termios.FIONREAD, count)
        return int(struct.unpack("i", count)[0])


class SensorLine:
    """The sensor's serial port: time passes while it waits."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self._serial = SerialTransport(SerialPort(rig.device))
        rig.open = True
        if rig.kind.heading:  # a board that starts anew when its port is opened
            rig.write(",".join(rig.kind.columns).encode() + b"\n")

    @property
    def name(self) -> str:
        return self._serial.name

    def write(self, data: bytes) -> None:
        self._serial.write(data)

    def read(self, timeout: float) -> bytes:
        end = self._rig.clock() + timeout
        while not self._rig.waiting():
            self._rig.step()  # at least once: whoever waits for ever so little sees time pass
            if self._rig.clock() >= end and not self._rig.waiting():
                return b""
        return self._serial.read(WALL_S)

    def close(self) -> None:
        self._serial.close()


def unplugged(*_: object) -> bytes:
    """What a line does that is pulled off."""
    raise LinkError(f"the line is gone ({os.strerror(errno.EIO).lower()})")
