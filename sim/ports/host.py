"""The host program behind the port: build/HOST/neuroflight over its real sockets, in strict lockstep.

The packets are Betaflight's (`simulator_link`), and a trace packet of our own for each control step. C sends
and receives them; Python reads those that say something new.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import socket
import struct
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import TcpPort, TcpTransport
from neuroflight.sim.arrays import Indices
from neuroflight.sim.control.motors import each_fraction
from neuroflight.sim.ports.port import (
    AnsweredPort,
    AskedPort,
    Reply,
    Sample,
    flight_settings,
    setting_changes,
)
from neuroflight.sim.ports.simulator_link import (
    LOOPBACK,
    PACKET_BYTES_MAX,
    SERVO,
    load_link,
    udp_socket,
)
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    GYRO_RATE_DEFAULT_HZ,
    MOTOR_COUNT_MAX,
    SIM_MOTOR_FORMAT,
    SIM_POWER_FORMAT,
    SIM_POWER_MAGIC,
    SIM_ROTOR_FORMAT,
    SIM_ROTOR_MAGIC,
    SIM_TRACE_FLAG_ARMED,
    SIM_TRACE_FORMAT,
    SIM_TRACE_MAGIC,
)
from neuroflight.toolchain.errors import LinkError

START_S = 10.0  # from start to `ready`
REPLY_S = 5.0  # an answer takes some 10 us; a busy machine may take its time
END_S = 2.0  # from SIGTERM to SIGKILL
LAST_WORDS_S = 0.1  # for the exit status of a program that fails
READY_BYTES_MAX = 200  # of the line that says so
PORT_MAX = 65535
LISTENING = ("state-port", "receiver-port", "power-port", "msp-port")
SPIN_NS = 50_000  # to look for an answer before the thread sleeps, while answers come as fast
MOTOR_PACKET_TOLERANCE = 1e-3  # a microsecond of a servo packet's pulse width

_MOTOR = struct.Struct(SIM_MOTOR_FORMAT)
_POWER = struct.Struct(SIM_POWER_FORMAT)
_ROTORS = struct.Struct(SIM_ROTOR_FORMAT)
_TRACE = struct.Struct(SIM_TRACE_FORMAT)
_TRACE_HEAD = struct.Struct("<II24sfBB")  # setpoint and gyro in one; then _TRACE has DShot values
_TRACE_DSHOT = _TRACE.size - 2 * MOTOR_COUNT_MAX  # where they begin
_PACKETS = ("motor packet", "trace packet")  # in the order of api.h


class HostPort(AskedPort, AnsweredPort):
    """FirmwarePort around a host program of its own, which ends with the port."""

    def __init__(
        self,
        program: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
        blackbox: Path | None = None,
    ) -> None:
        """Start the program on free loopback ports with these settings, the others at their defaults.

        blackbox: file that logs of its flights are appended to.

        Raises LinkError when it is missing or does not start.
        """
        if not program.is_file():
            raise LinkError(f"{program}: not built yet; build it with `make host`")
        library = load_link()
        self._ffi, self._lib = library.ffi, library.lib
        with contextlib.ExitStack() as undo:
            self._motor, self._servo, self._trace = (undo.enter_context(udp_socket()) for _ in range(3))
            options: dict[str, int | str] = {
                "gyro-hz": gyro_rate_hz,
                "motor-port": _port(self._motor),
                "servo-port": _port(self._servo),
                "trace-port": _port(self._trace),
            }
            if blackbox is not None:
                options["blackbox"] = str(blackbox)
            wanted = flight_settings(settings)
            changes = setting_changes(wanted)
            self._child = undo.enter_context(_Child(program, options, changes))
            self._state, self._receiver, self._power = (undo.enter_context(udp_socket()) for _ in range(3))
            self._state.connect((LOOPBACK, self._child.ports["state"]))
            self._receiver.connect((LOOPBACK, self._child.ports["receiver"]))
            self._ask_policy(gyro_rate_hz)
            self._motors_of = _motors_of_outputs(wanted, self.motor_count)  # traces tell motors
            self._close = undo.pop_all()
        self._ask_rotors(wanted)
        self._wire = self._joined()
        self._channels = self._ffi.new("uint16_t[]", CHANNEL_COUNT)
        self._sample: Sample | None = None  # whose values `_values` points to
        self._values: Any = None
        self._samples = 0
        self._reply: Reply | None = None
        self._fractions: list[float] = []  # of the reply

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        if sample is not self._sample:
            self._sample, self._values = sample, self._ffi.from_buffer("double[]", sample.values)
        channels = self._ffi.NULL
        if channels_us is not None:
            channels, self._channels[0:CHANNEL_COUNT] = self._channels, channels_us
        step, after = divmod(self._samples, self._divider)
        rotors = self._rotors()
        if after == 0 and rotors is not None:
            self._send_beside(_ROTORS.pack(SIM_ROTOR_MAGIC, sample.time_s, *rotors.tolist()))
        found = self._lib.link_exchange(self._wire, sample.time_s, self._values, channels, after == 0)
        if found != self._lib.LINK_SAME or self._reply is None:
            self._read(found, step if after == 0 else None)
        self._samples += 1
        assert self._reply is not None  # the first sample is a control step
        return self._reply

    def set_battery(self, volts: float, amps: float) -> None:
        self._send_beside(_POWER.pack(SIM_POWER_MAGIC, self._samples / self.gyro_rate_hz, volts, amps, 0.0))

    def _send_beside(self, packet: bytes) -> None:
        """Send a packet of the power port."""
        try:
            self._power.sendto(packet, (LOOPBACK, self._child.ports["power"]))
        except OSError as error:
            raise self._child.lost(str(error)) from error

    def close(self) -> None:
        self._close.close()

    @property
    def msp_port(self) -> int:
        """The TCP port on this computer at which the program speaks MSP."""
        return self._child.ports["msp"]

    def _msp(self) -> Client:
        return Client(TcpTransport(TcpPort(LOOPBACK, self.msp_port)))

    def _joined(self) -> Any:  # noqa: ANN401 - a struct of api.h
        """Join the sockets for the C code."""
        quad = self.motor_count == _MOTOR.size // 4
        motors = self._motor if quad else self._servo
        sockets = (self._state, self._receiver, motors, self._trace)
        names = ("state", "receiver", "motors", "trace")
        alone = len(os.sched_getaffinity(0)) == 1  # then the program runs only while this process sleeps
        numbers = {
            **{name: sock.fileno() for name, sock in zip(names, sockets, strict=True)},
            "timeout_ms": round(1000 * REPLY_S),
            "spin_ns": 0 if alone else SPIN_NS,
        }
        return self._ffi.new("struct link *", numbers)

    def _read(self, found: int, step: int | None) -> None:
        """Process the result of an exchange. step: number of the control step; None: the sample was none."""
        lib = self._lib
        while found == lib.LINK_AGAIN:
            found = lib.link_await(self._wire)
        if found == lib.LINK_FAILED:
            error = self._wire.error
            raise self._child.lost(str(OSError(error, os.strerror(error))))
        if found == lib.LINK_SILENT:
            what = _PACKETS[self._wire.awaits]
            raise self._child.lost(f"no {what} within {REPLY_S:g} s of a state packet")
        motors = self._motors()
        if step is not None:
            self._reply = self._traced(step)
            self._fractions = each_fraction(self._reply.dshot)
        if not all(
            abs(motor - told) <= MOTOR_PACKET_TOLERANCE
            for motor, told in zip(motors, self._fractions, strict=True)
        ):
            raise LinkError(
                f"{self._child.name}: its motor packet says {motors}, its trace {self._fractions}: "
                f"the program is broken"
            )

    def _packet(self, number: int, packet: Any, size: int) -> bytes:  # noqa: ANN401 - a struct of api.h
        """Return the bytes of a packet. Raises LinkError unless they are `size`."""
        if packet.size != size:
            raise self._child.lost(f"a {_PACKETS[number]} of {packet.size} bytes, expected {size}")
        return bytes(self._ffi.buffer(packet.bytes, size))

    def _motors(self) -> list[float]:
        """Return the motor fractions of the one packet that answers a state packet."""
        quad = self.motor_count == _MOTOR.size // 4
        layout = _MOTOR if quad else SERVO
        packet = self._packet(self._lib.LINK_MOTORS, self._wire.motor_packet, layout.size)
        if quad:
            return list(_MOTOR.unpack(packet))
        count, *widths = SERVO.unpack(packet)
        if count != self.motor_count:
            raise self._child.lost(f"a motor packet of {count} motors, expected {self.motor_count}")
        return [(width - 1000.0) / 1000.0 for width in widths[:count]]

    def _traced(self, step: int) -> Reply:
        """Decode the trace packet of control step number `step`."""
        packet = self._packet(self._lib.LINK_TRACE, self._wire.trace_packet, _TRACE.size)
        magic, number, rates, throttle, motors, flags = _TRACE_HEAD.unpack_from(packet)
        if (magic, number, motors) != (SIM_TRACE_MAGIC, step, self.motor_count):
            raise self._child.lost(
                f"a trace packet 0x{magic:08X} of step {number} with {motors} motors, "
                f"expected 0x{SIM_TRACE_MAGIC:08X}, {step}, {self.motor_count}"
            )
        setpoint_gyro = np.frombuffer(rates, np.float32)
        return Reply(
            dshot=np.frombuffer(packet, np.uint16, motors, _TRACE_DSHOT)[self._motors_of],
            step=number,
            setpoint=setpoint_gyro[:3],
            gyro=setpoint_gyro[3:],
            throttle=throttle,
            armed=bool(flags & SIM_TRACE_FLAG_ARMED),
        )


def _motors_of_outputs(settings: Mapping[str, float], motors: int) -> Indices:
    """Return the motor that is wired to each output."""
    outputs = [settings.get(f"motor{motor}_output", motor) for motor in range(1, motors + 1)]
    return np.argsort(outputs)


class _Child:
    """The running program: started on entering, ended on leaving."""

    def __init__(self, program: Path, options: Mapping[str, int | str], changes: Sequence[str]) -> None:
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
        """Return the error of a failed link: what happened, the exit status if it ended, its error output."""
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
        line = self._first_line()
        said = {name: int(port) for name, port in re.findall(r"(\w+)=(\d{1,9})\b", line)}
        if not line.startswith("ready ") or not {"state", "receiver", "msp"} <= set(said):
            raise self.lost(f"it said {line.strip()!r}, expected its `ready` line")
        if wrong := [f"{name}={port}" for name, port in said.items() if not 1 <= port <= PORT_MAX]:
            raise self.lost(f"it said {line.strip()!r}, expected ports of 1 to {PORT_MAX}, not {wrong[0]}")
        self.ports = said

    def _first_line(self) -> str:
        """Read its first line. Raises LinkError if that does not end in time, or is too long."""
        assert self._process is not None and self._process.stdout is not None
        stdout, said, end = self._process.stdout.fileno(), b"", time.monotonic() + START_S
        while b"\n" not in said and len(said) < READY_BYTES_MAX:
            left = max(0.0, end - time.monotonic())
            if not select.select([stdout], [], [], left)[0]:
                words = f", it said {said.decode(errors='replace')!r}" if said else ""
                raise self.lost(f"not ready within {START_S:g} s{words}")
            if not (data := os.read(stdout, READY_BYTES_MAX - len(said))):
                break
            said += data
        return said.partition(b"\n")[0].decode(errors="replace")


def _port(sock: socket.socket) -> int:
    return int(sock.getsockname()[1])
