"""The host program behind the port: build/HOST/neuroflight over its real sockets, in strict lockstep.

The packets are Betaflight's (`simulator_link`), and a trace packet of our own for each control step.
"""

from __future__ import annotations

import contextlib
import math
import re
import select
import socket
import struct
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from flash import messages
from flash.client import Client
from flash.transport import TcpPort, TcpTransport
from sim.control.motors import motor_fractions
from sim.ports.port import Reply, Sample, control_divider, setting_changes
from sim.ports.simulator_link import (
    LOOPBACK,
    PACKET_BYTES_MAX,
    RECEIVER,
    SEA_LEVEL_PA,
    SERVO,
    state_packet,
    udp_socket,
)
from toolchain.contract import (
    GYRO_RATE_DEFAULT_HZ,
    SIM_MOTOR_FORMAT,
    SIM_TRACE_FLAG_ARMED,
    SIM_TRACE_FORMAT,
    SIM_TRACE_MAGIC,
    Msp,
)
from toolchain.errors import LinkError

START_S = 10.0  # from start to `ready`
REPLY_S = 5.0  # an answer takes some 10 us; a busy machine may take its time
END_S = 2.0  # from SIGTERM to SIGKILL
LAST_WORDS_S = 0.1  # for the exit status of a program that fails
LISTENING = ("state-port", "receiver-port", "power-port", "msp-port")
SCALE_HEIGHT_M = 8434.5  # of an isothermal atmosphere at 15 degC
MOTOR_PACKET_TOLERANCE = 1e-3  # a microsecond of a servo packet's pulse width

_MOTOR = struct.Struct(SIM_MOTOR_FORMAT)
_TRACE = struct.Struct(SIM_TRACE_FORMAT)


class HostPort:
    """FirmwarePort around a host program of its own, which ends with the port."""

    def __init__(
        self,
        program: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
    ) -> None:
        """Start the program on free loopback ports with these settings, the others at their defaults.

        Raises LinkError when it is missing or does not start.
        """
        if not program.is_file():
            raise LinkError(f"{program}: not built yet; build it with `make host`")
        with contextlib.ExitStack() as undo:
            self._motor, self._servo, self._trace = (
                undo.enter_context(udp_socket(REPLY_S)) for _ in range(3)
            )
            options = {
                "gyro-hz": gyro_rate_hz,
                "motor-port": _port(self._motor),
                "servo-port": _port(self._servo),
                "trace-port": _port(self._trace),
            }
            changes = setting_changes(settings or {})
            self._child = undo.enter_context(_Child(program, options, changes))
            self._state, self._receiver = (undo.enter_context(udp_socket(REPLY_S)) for _ in range(2))
            self._state.connect((LOOPBACK, self._child.ports["state"]))
            self._receiver.connect((LOOPBACK, self._child.ports["receiver"]))
            with self._msp() as msp:
                policy = messages.policy_info(msp.request(Msp.POLICY_INFO))
            self.motor_count = policy.action_count
            self.gyro_rate_hz = gyro_rate_hz
            self.control_rate_hz = policy.control_rate_hz
            self._divider = control_divider(gyro_rate_hz, policy.control_rate_hz)
            self._close = undo.pop_all()
        self._samples = 0
        self._reply: Reply | None = None
        self._fractions = np.zeros(self.motor_count)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort."""
        if channels_us is not None:
            self._send(self._receiver, RECEIVER.pack(sample.time_s, *channels_us))
        self._send(self._state, _state_packet(sample))
        motors = self._read_motors()
        if self._samples % self._divider == 0:
            self._reply = self._read_trace(self._samples // self._divider)
            self._fractions = motor_fractions(self._reply.dshot)
        self._samples += 1
        if np.abs(motors - self._fractions).max() > MOTOR_PACKET_TOLERANCE:
            raise LinkError(
                f"{self._child.name}: its motor packet says {motors.tolist()}, "
                f"its trace {self._fractions.tolist()}: the program is broken"
            )
        assert self._reply is not None  # the first sample is a control step
        return self._reply

    def arming_reasons(self) -> tuple[str, ...]:
        """See FirmwarePort; asked over MSP."""
        with self._msp() as msp:
            return messages.arming_reasons(messages.status_ex(msp.request(Msp.STATUS_EX)).arming_flags)

    def close(self) -> None:
        """See FirmwarePort."""
        self._close.close()

    def _msp(self) -> Client:
        return Client(TcpTransport(TcpPort(LOOPBACK, self._child.ports["msp"])))

    def _send(self, to: socket.socket, packet: bytes) -> None:
        try:
            to.send(packet)
        except OSError as error:
            raise self._child.lost(str(error)) from error

    def _receive(self, source: socket.socket, what: str) -> bytes:
        try:
            return source.recv(PACKET_BYTES_MAX)
        except TimeoutError as error:
            raise self._child.lost(f"no {what} within {REPLY_S:g} s of a state packet") from error
        except OSError as error:
            raise self._child.lost(str(error)) from error

    def _read_motors(self) -> NDArray[np.float64]:
        """Motor fractions (M,) of the one packet that answers a state packet."""
        quad = self.motor_count == _MOTOR.size // 4
        packet = self._receive(self._motor if quad else self._servo, "motor packet")
        layout = _MOTOR if quad else SERVO
        if len(packet) != layout.size:
            raise self._child.lost(f"a motor packet of {len(packet)} bytes, expected {layout.size}")
        if quad:
            return np.array(_MOTOR.unpack(packet))
        count, *widths = SERVO.unpack(packet)
        if count != self.motor_count:
            raise self._child.lost(f"a motor packet of {count} motors, expected {self.motor_count}")
        return (np.array(widths[:count]) - 1000.0) / 1000.0

    def _read_trace(self, step: int) -> Reply:
        """The trace packet of control step number `step`."""
        packet = self._receive(self._trace, "trace packet")
        if len(packet) != _TRACE.size:
            raise self._child.lost(f"a trace packet of {len(packet)} bytes, expected {_TRACE.size}")
        magic, number, *rates, throttle, motors, flags = (fields := _TRACE.unpack(packet))[:11]
        if (magic, number, motors) != (SIM_TRACE_MAGIC, step, self.motor_count):
            raise self._child.lost(
                f"a trace packet 0x{magic:08X} of step {number} with {motors} motors, "
                f"expected 0x{SIM_TRACE_MAGIC:08X}, {step}, {self.motor_count}"
            )
        return Reply(
            dshot=np.array(fields[11 : 11 + motors], np.uint16),
            step=number,
            setpoint=np.array(rates[:3], np.float32),
            gyro=np.array(rates[3:], np.float32),
            throttle=throttle,
            armed=bool(flags & SIM_TRACE_FLAG_ARMED),
        )


class _Child:
    """The running program: started on entering, ended on leaving."""

    def __init__(self, program: Path, options: Mapping[str, int], changes: Sequence[str]) -> None:
        """options: names without dashes to values; ports that are not named are the system's choice.

        changes: of settings, NAME=VALUE.
        """
        self.name = program.name
        self.ports: Mapping[str, int] = {}  # those it listens on, by name, once it runs
        self._program = program
        self._options = {**dict.fromkeys(LISTENING, 0), **options}
        self._changes = changes
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - closed on leaving

    def __enter__(self) -> _Child:
        try:
            self._start()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        process, self._process = self._process, None
        if process is not None:
            process.terminate()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            if process.stdout is not None:
                process.stdout.close()
        self._errors.close()

    def lost(self, what: str) -> LinkError:
        """Error of a failed link: what happened, the exit status if it ended, its error output."""
        ended = ""
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                ended = f"; it ended with {self._process.wait(LAST_WORDS_S)}"
        self._errors.seek(0)
        words = " ".join(self._errors.read(PACKET_BYTES_MAX).decode(errors="replace").split())
        return LinkError(f"host program {self.name}: {what}{ended}{': ' if words else ''}{words}")

    def _start(self) -> None:
        """Start it and wait for `ready state=N receiver=N power=N msp=N`."""
        options = [f"--{name}={value}" for name, value in self._options.items()]
        options += [f"--set={change}" for change in self._changes]
        try:
            self._process = subprocess.Popen(
                [self._program.resolve(), *options, "--with-parent"],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=self._errors,
            )
        except OSError as error:
            raise LinkError(
                f"{self._program}: cannot be started ({error.strerror}); build it with `make host`"
            ) from error
        stdout = self._process.stdout
        assert stdout is not None
        if not select.select([stdout], [], [], START_S)[0]:
            raise self.lost(f"not ready within {START_S:g} s")
        line = stdout.readline().decode(errors="replace")
        said = dict(re.findall(r"(\w+)=(\d+)", line))
        if not line.startswith("ready ") or not {"state", "receiver", "msp"} <= set(said):
            raise self.lost(f"it said {line.strip()!r}, expected its `ready` line")
        self.ports = {name: int(port) for name, port in said.items()}


def _port(sock: socket.socket) -> int:
    return int(sock.getsockname()[1])


def _state_packet(sample: Sample) -> bytes:
    x, y, z = sample.gyro.tolist()
    fx, fy, fz = sample.specific_force.tolist()
    pressure = SEA_LEVEL_PA * math.exp(-float(sample.position[2]) / SCALE_HEIGHT_M)
    return state_packet(sample.time_s, (x, -y, -z), (fx, -fy, -fz), sample, pressure)
