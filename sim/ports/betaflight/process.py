"""A running Betaflight SITL in simulated time.

The program is started with sim/ports/betaflight/clock.c between it and the system: it runs up to a time
that the simulator chooses and waits there, so that a flight depends neither on the computer's speed nor on
its load, and repeats exactly. Its servers get free ports on loopback, so that several can run at a time.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import struct
import subprocess
import tempfile
import time
from pathlib import Path
from typing import IO

from neuroflight.flash.link.transport import TcpPort, TcpTransport
from neuroflight.sim.ports.betaflight.build import Betaflight
from neuroflight.sim.ports.simulator_link import LOOPBACK, PACKET_BYTES_MAX, SERVO
from neuroflight.toolchain.contract import MSP_TCP_PORT, SIM_RECEIVER_PORT, SIM_STATE_PORT
from neuroflight.toolchain.errors import LinkError

START_NS = 3_000_000_000  # of simulated time, for its servers to stand
STEP_NS = 1_000_000  # of simulated time, between two checks of its output
ANSWER_S = 10.0  # real; a millisecond of its time takes some 50 us, on a busy machine longer
END_S = 30.0  # real, from its decision to restart to its end
LAST_WORDS_S = 0.1  # real, for the exit status of one that fails
SPIN_NS = 200_000  # real, of polling for an answer before the process sleeps, because a wake-up takes longer
POLL_S = 0.0005  # real, for its TCP thread to carry bytes
EEPROM = "eeprom.bin"  # its settings, in its working directory

# struct report and struct permit of clock.c, before the packets that follow
_REPORT = struct.Struct("<IIQ")
_PERMIT = struct.Struct("<QIIII")
_PARKED, _BOUND = 1, 2


class BetaflightProcess:
    """A Betaflight that stands at `now_ns` of its own time; use it in a `with`, or close it."""

    def __init__(self, betaflight: Betaflight, settings: bytes | None = None) -> None:
        """Start it and wait for its servers. settings: of an EEPROM file, its defaults without.

        Raises LinkError when it cannot be started or ends before that.
        """
        self.now_ns = 0
        self.ports: dict[int, int] = {}  # those it serves, by the number it asked for
        self._state = self._receiver = b""  # packets to be taken in before the next run
        self._alone = len(os.sched_getaffinity(0)) == 1  # then the program runs only while this one sleeps
        self._spins = False
        self._servo: list[bytes] = []  # packets since they were last asked for
        with contextlib.ExitStack() as undo:
            folder = tempfile.TemporaryDirectory(prefix="neuroflight-betaflight-")
            self._folder = Path(undo.enter_context(folder))
            if settings is not None:
                (self._folder / EEPROM).write_bytes(settings)
            self._errors: IO[bytes] = undo.enter_context(tempfile.TemporaryFile())
            self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            undo.enter_context(self._control)
            with theirs:
                self._process = self._start(betaflight, theirs)
            undo.callback(self._end)
            # Not settimeout(), which asks the system once more before each answer.
            self._control.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval(ANSWER_S))
            self._await_parked()
            while {SIM_STATE_PORT, SIM_RECEIVER_PORT, MSP_TCP_PORT} - set(self.ports):
                if self.now_ns >= START_NS:
                    raise self.lost(f"its servers do not stand {START_NS / 1e9:g} s after its start")
                self.run(STEP_NS)
            self._close = undo.pop_all()

    def __enter__(self) -> BetaflightProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it and forget its folder. May be called twice."""
        self._close.close()

    def run(self, ns: int) -> None:
        """Let it run for `ns` of its time, once it has taken in all packets sent so far. Raises LinkError."""
        limit = self.now_ns + ns
        with contextlib.suppress(OSError):  # its end shows in the answer
            permit = _PERMIT.pack(limit, bool(self._state), bool(self._receiver), 0, 0)
            self._control.send(permit + self._state + self._receiver)
        self._state = self._receiver = b""
        self._await_parked()
        self.now_ns = limit

    def send_state(self, packet: bytes) -> None:
        """Send a state packet, which is processed before the next run; one for each run."""
        self._state = packet

    def send_receiver(self, packet: bytes) -> None:
        """Send a receiver packet, which is processed before the next run; one for each run."""
        self._receiver = packet

    @property
    def pid(self) -> int:
        """Its number; that of the group that its copies belong to as well."""
        return self._process.pid

    def copy(self) -> socket.socket:
        """Copy the process at its present state; returns the simulator's end of the copy's own socket.

        The child has run to `now_ns` like it and has no serial ports; it ends with its socket. Raises
        LinkError.
        """
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with contextlib.ExitStack() as undo:
            undo.enter_context(ours)
            with theirs:
                with contextlib.suppress(OSError):  # its end shows in the answer
                    self._control.send(_PERMIT.pack(self.now_ns, 0, 0, 1, 0))
                    socket.send_fds(self._control, [b"c"], [theirs.fileno()])
                self._await_parked()
            ours.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, timeval(ANSWER_S))
            try:
                answer = ours.recv(PACKET_BYTES_MAX)
            except OSError as error:
                raise self.lost(f"a copy of it does not start ({error})") from error
            if len(answer) < _REPORT.size:
                raise self.lost("the system does not let it be copied")
            undo.pop_all()
        return ours

    def servo_packets(self) -> list[bytes]:
        """Return the servo packets sent since the last call, oldest first."""
        packets, self._servo = self._servo, []
        return packets

    def open_line(self) -> BetaflightLine:
        """Open its first serial port: MSP and, after a `#`, the command line. Raises LinkError."""
        return BetaflightLine(self)

    def restarted(self) -> bytes:
        """Wait until it ends by itself, as it does to restart; return its settings. Raises LinkError."""
        deadline = time.monotonic() + END_S
        while self._process.poll() is None and time.monotonic() < deadline:
            with contextlib.suppress(LinkError):
                self.run(STEP_NS)
        if self._process.poll() != 0:
            raise self.lost("it did not restart when asked to save its settings")
        return (self._folder / EEPROM).read_bytes()

    def lost(self, what: str) -> LinkError:
        """Return the error of a failure: what happened, the exit status, the last line of its errors."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            what += f"; it ended with {self._process.wait(LAST_WORDS_S)}"
        end = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, end - PACKET_BYTES_MAX))
        lines = self._errors.read().decode(errors="replace").split("\n")
        words = next((" ".join(line.split()) for line in reversed(lines) if line.strip()), "")
        return LinkError(f"Betaflight: {what}{': ' if words else ''}{words}")

    def _start(self, betaflight: Betaflight, control: socket.socket) -> subprocess.Popen[bytes]:
        # The loader splits a list of libraries at blanks: the name must have none.
        shutil.copyfile(betaflight.clock, self._folder / "clock.so")
        environment = {
            **os.environ,
            "LD_PRELOAD": "./clock.so",
            "NEUROFLIGHT_CONTROL": str(control.fileno()),
        }
        try:
            return subprocess.Popen(
                [betaflight.program.resolve()],
                cwd=self._folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                pass_fds=(control.fileno(),),
                start_new_session=True,
            )
        except OSError as error:
            raise LinkError(
                f"{betaflight.program}: cannot be started ({error.strerror}); "
                f"delete {betaflight.program.parent} to have it built anew"
            ) from error

    def _await_parked(self) -> None:
        while True:
            try:
                report = self._next_report()
            except BlockingIOError as error:
                raise self.lost(f"it does not come back within {ANSWER_S:g} s") from error
            except OSError as error:
                raise self.lost(str(error)) from error
            if len(report) < _REPORT.size:
                raise self.lost("it is gone")
            kind, port, value = _REPORT.unpack_from(report)
            ends = range(_REPORT.size, len(report), SERVO.size)
            self._servo += [report[at : at + SERVO.size] for at in ends]
            if kind == _PARKED:
                return
            if kind == _BOUND:
                self.ports[port] = value

    def _next_report(self) -> bytes:
        """Return the next report.

        The processor is kept busy while reports come within SPIN_NS, and otherwise left to others.
        """
        began = time.perf_counter_ns()
        while self._spins and time.perf_counter_ns() - began < SPIN_NS:
            try:
                return self._control.recv(PACKET_BYTES_MAX, socket.MSG_DONTWAIT)
            except BlockingIOError:
                os.sched_yield()
        report = self._control.recv(PACKET_BYTES_MAX)
        self._spins = not self._alone and time.perf_counter_ns() - began < SPIN_NS
        return report

    def _end(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()


def timeval(seconds: float) -> bytes:
    return struct.pack("ll", int(seconds), round(seconds % 1 * 1e6))


class BetaflightLine:
    """A Transport to a Betaflight whose time goes on while the other end waits."""

    def __init__(self, process: BetaflightProcess) -> None:
        self._process = process
        self._tcp = TcpTransport(TcpPort(LOOPBACK, process.ports[MSP_TCP_PORT]))

    def __enter__(self) -> BetaflightLine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        return self._tcp.name

    def read(self, timeout: float) -> bytes:
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            self._process.run(STEP_NS)
            if data := self._tcp.read(POLL_S):
                return data
        return b""

    def write(self, data: bytes) -> None:
        self._tcp.write(data)

    def close(self) -> None:
        self._tcp.close()
