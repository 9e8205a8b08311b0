"""A FirmwarePort around the emulated board, which runs build/MATEKF722/neuroflight.bin in lockstep.

The board is powered with the port and stands, between two exchanges, one cycle before the edge of the gyro
chip's data-ready line that the firmware reads next. An exchange lets the chip measure, and the board run to
the cycle before the edge after that: motor frames, receiver bytes and everything else take their time in it.
Where the firmware reads at a timer's beat instead, the port stands before the sample that such a read finds:
the chip's samples come LEAD before the beats, and stay there as long as its clock is the processor's.

Once a fault is there, neither edges nor firmware can be relied on. Exchanges keep their times; the chip
measures what each brings, whenever it does, and motors do what their ESCs make of frames that come or not.
"""

from __future__ import annotations

import copy
import hashlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.flash.link.messages import arming_reasons
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ, BoardError
from neuroflight.sim.board.debug.fault_injection import Fault, FaultPlan
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.debug.variables import read_variables
from neuroflight.sim.board.devices.gyro_mount import accel_counts, gyro_counts
from neuroflight.sim.board.devices.log_place import LogChip, open_log_chip
from neuroflight.sim.board.fitted import FULL_VOLTS, Gyro, fitted_gyro, image_lines, image_wiring
from neuroflight.sim.board.peripherals.signals import uart_name
from neuroflight.sim.board.serial.idle_board import configured
from neuroflight.sim.physics.esc import Words
from neuroflight.sim.ports.port import AnsweredPort, Logged, Reply, Sample, control_divider, flight_settings
from neuroflight.sim.ports.receiver_frames import RECEIVERS, Receiver
from neuroflight.toolchain.boards import facts
from neuroflight.toolchain.contract import (
    ESC_WORD_MAX,
    GYRO_EDGE_RATE_HZ,
    GYRO_RATE_DEFAULT_HZ,
    SETTINGS,
    FallbackCause,
    FlightState,
    Setting,
    StopCause,
)
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.elf import read_flashable

BOOT_S = 5.0  # from power to the first sample that the firmware reads
EDGE_CYCLES = TIME_HZ // GYRO_EDGE_RATE_HZ
LEAD = TIME_HZ // 1_000_000  # of a sample before a timed read of it [cycles]
_STATUS, _SAMPLES, _DIVIDER, _RATE = (
    f"firmware.{name}" for name in ("status", "samples", "control_divider", "gyro_rate_hz")
)
_LOG = tuple(f"background.blackbox.{name}" for name in ("phase", "written", "dropped", "bytes"))
_NO_RATES = np.zeros(3, np.float32)

RunTo = Callable[[int], None]  # lets a board run to a cycle


RECEIVER_SETTING, MOTOR_SETTING = (
    next(setting for setting in SETTINGS if setting.name == name)
    for name in ("receiver_protocol", "motor_protocol")
)


@dataclass(frozen=True)
class Event:
    """An event of the firmware."""

    at_s: float  # after the first armed control step; before it negative
    what: str
    stops: bool = False  # the motors, which the firmware let turn until then


@dataclass(frozen=True)
class PortSnapshot:
    """A port between two exchanges, to go on from as often as wanted."""

    board: Snapshot
    port: dict[str, Any]


class EmulatedPort(AnsweredPort):
    """A FirmwarePort around a board of its own. A fault of the board is raised as BoardError, a LinkError."""

    def __init__(
        self,
        image: Path,
        gyro_rate_hz: int = GYRO_RATE_DEFAULT_HZ,
        settings: Mapping[str, float] | None = None,
        *,
        wiring: facts.Board | None = None,
        receiver: int | None = None,
        gyro: Gyro | None = None,
        card: LogChip | Path | None = None,
        dshot: int | None = None,
        faults: Sequence[Fault] = (),
        profile: bool = False,
        attach: Callable[[Board], RunTo] = lambda board: board.run_to,
        on_failure: Callable[[Board], None] = lambda board: None,
    ) -> None:
        """Power a board with `image` in its flash, and boot it; its ELF lies beside it.

        settings: other than the image's own; they and the gyro rate are stored by the image itself before, as
        `configured` does. The receiver speaks what they say.
        wiring: the board's; None: that of the board whose name the image has. receiver: UART that it is
        wired to; None: the one that the image listens to. gyro: what is fitted; None: what boards of that
        name carry.
        card: what keeps logs, or its file (open_log_chip); the port closes it. None: nothing is fitted.
        dshot: the speed that the ESCs are set to, 150, 300 or 600; None: as the setting motor_protocol says.
        profile: keep the tree of calls.
        attach: gets the powered board and returns what makes it run, `Board.run_to` or what stands before it.
        on_failure: gets a board whose image does not boot, before it is closed.
        Raises LinkError when a file is missing, the image refuses a setting, or the firmware does not come to
        read its gyro at that rate, BuildError when image or ELF is none of ours, BoardError for what the
        image does wrong.
        """
        elf = image.with_suffix(".elf")
        if card is None and any(fault.kind.of_card for fault in faults):
            raise LinkError("got a fault of the SD card, but no card; give one (--card IMG)")
        for path in (image, elf):
            if not path.is_file():
                raise LinkError(f"{path}: not built yet; build it with `make firmware TARGET=MATEKF722`")
        flashed = read_flashable(image)
        wiring = wiring or image_wiring(image, flashed)
        gyro = gyro or fitted_gyro(wiring)
        names = (_STATUS, _SAMPLES, _DIVIDER, _RATE, *_LOG)
        self._variables = dict(zip(names, read_variables(elf, *names), strict=True))
        self._alignment, self._to_board = gyro.alignment, gyro.to_board
        self.receiver_uart = uart_name(image_lines(flashed, wiring, receiver).receiver)
        self._plan = FaultPlan(faults, gyro_rate_hz)
        self._begin()
        wanted = _stored(settings, gyro_rate_hz)
        self._receiver = _receiver(wanted)
        self._ask_rotors(wanted)
        self.image_sha256 = hashlib.sha256(flashed).hexdigest()
        try:
            flash = configured(flashed, elf, wanted, gyro, wiring)
        except BoardError:
            flash = flashed  # skip this boot: the boot below has the same result, and is profiled
        self.board = Board(
            flash,
            elf=elf,
            board=wiring,
            chip=gyro.chip,
            profile=profile,
            strict=all(fault.name != "processor-fault" for fault in faults),
            card=open_log_chip(wiring, card) if isinstance(card, Path) else card,
            watchdog_resets=any(not fault.kind.of_card for fault in faults),
            dshot=dshot or _dshot(settings or {}),
        )
        try:
            self._gyro = self.board.hardware.gyro
            self._taken = self._seen(_SAMPLES)
            status = self._seen(_STATUS)  # what of it is read at each control step: views of one row each
            self._state_view, trace = status["state"], status["trace"]
            self._last = {name: trace[name] for name in ("armed", "step", "setpoint", "gyro", "throttle")}
            self.board.hardware.adc.set_battery(FULL_VOLTS, 0.0)
            self._run_to = attach(self.board)
            self._inject()
            self._edge = self._boot()  # the cycle of the edge that the firmware reads next
            self._note_resets()
            self._up = True
            self.gyro_rate_hz = int(self._read(_RATE))
            self.motor_count = int(self._read(_STATUS)["trace"]["motor_count"])
            if self.gyro_rate_hz != gyro_rate_hz:
                raise LinkError(
                    f"{image}: reads its gyro at {self.gyro_rate_hz} Hz, asked for {gyro_rate_hz} Hz: "
                    f"do not set gyro_rate_hz beside"
                )
        except BaseException:
            on_failure(self.board)
            self.board.close()
            raise
        self._divider = int(self._read(_DIVIDER))
        self.control_rate_hz = self.gyro_rate_hz // self._divider
        assert control_divider(self.gyro_rate_hz, self.control_rate_hz) == self._divider
        self._period = TIME_HZ // self.gyro_rate_hz

    def _begin(self) -> None:
        """Reset what changes in a flight."""
        self._edge = 0
        self._samples = 0
        self._announced: list[tuple[int, list[int]]] = []  # number of the sample, channels
        self._reply: Reply | None = None
        self._armed_at: int | None = None  # number of the first armed sample
        self._state, self._armed = FlightState.BOOT, False  # as last read
        self._events: list[tuple[int, str, bool]] = []  # number of the sample, what, stops
        self._up, self._resets = False, 1  # the firmware reads its gyro; resets seen

    _KEPT = (
        "_edge", "_samples", "_announced", "_reply", "_armed_at", "_state", "_armed", "_events", "_up",
        "_resets", "_plan",
    )  # fmt: skip

    def announce(self, channels_us: Sequence[int], samples: int) -> None:
        """See SerialReceiverPort. The frame's last byte ends one gyro period before the sample's edge.

        Half a period where every sample is a control step, or it would be heard by the one before. Raises
        LinkError when it is too late for that.
        """
        before = self._period if self._divider > 1 else self._period // 2
        wanted = self._edge + samples * self._period - before
        sender = self._receiver
        frame, broken = self._plan.damaged(sender.frame(channels_us), sender.format)
        line = self.board.hardware.usarts[self.receiver_uart]
        end = line.feed(frame, sender.format, end=wanted, broken=broken)
        if end > wanted:
            late = 1e6 * (end - wanted) / TIME_HZ
            raise LinkError(f"a receiver frame is announced {late:.0f} us too late for its time on the line")
        self._announced.append((self._samples + samples, list(channels_us)))

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        """See FirmwarePort. A frame must have been announced."""
        if channels_us is not None or self._announced:
            self._validate_announced(channels_us)
        rate, pull = sample.gyro, sample.specific_force
        if self._to_board is not None:
            rate, pull = self._to_board @ rate, self._to_board @ pull
        gyro, force = rate.tolist(), pull.tolist()
        if not math.isfinite(sum(gyro) + sum(force)):
            raise LinkError(f"gyro {sample.gyro}, force {sample.specific_force}: no chip measures that")
        if self._plan.due:
            self._inject()
        turned = self._alignment
        scale = self._gyro.kind.gyro_scale
        self._gyro.measure(accel_counts(force, turned), 0, gyro_counts(gyro, turned, scale))
        self._edge += self._period
        self._run_to(self._edge - 1)
        self._samples += 1
        values = self.board.hardware.obeyed(self.motor_count)  # what each motor's ESC obeys
        if self._plan.begun:
            self._reply = self._reply_in_trouble(values)
            return self._reply
        taken = int(self._taken[0])
        if taken != self._samples:
            resets = ", ".join(self.board.engine.resets[self._resets :])
            raise LinkError(
                f"the firmware has taken {taken} gyro samples, it was given {self._samples}"
                f"{'; it was reset: ' if resets else ''}{resets}"
            )
        reply = self._reply
        if reply is None or (self._samples - 1) % self._divider == 0 or not _same(values, reply.dshot):
            reply = self._reply = self._told(values)
        return reply

    def set_battery(self, volts: float, amps: float) -> None:
        """See BatteryPort: the converter's pins, behind the board's divider and current sensor."""
        self.board.hardware.adc.set_battery(volts, amps)

    def set_rotors(self, words: Words) -> None:
        """See RotorPort: the board's own ESCs answer by them."""
        for esc, word in zip(self.board.hardware.escs, words.tolist(), strict=False):
            esc.answer = word if word <= ESC_WORD_MAX else None

    def arming_reasons(self) -> tuple[str, ...]:
        return arming_reasons(int(self._read(_STATUS)["arming_reasons"])) if self._up else ()

    def refused(self) -> FallbackCause:
        return FallbackCause(int(self._read(_STATUS)["refused_cause"])) if self._up else FallbackCause.NONE

    def logged(self) -> Logged:
        phase, frames, dropped, count = (int(self._read(name)) for name in _LOG)
        return Logged(phase != 0, frames, dropped, count)

    def close(self) -> None:
        self.board.close()

    @property
    def events(self) -> tuple[Event, ...]:
        """Events since the firmware armed, and faults before: states, resets, faults."""
        zero = 0 if self._armed_at is None else self._armed_at
        return tuple(
            Event((number - zero) / self.gyro_rate_hz, what, stops) for number, what, stops in self._events
        )

    @property
    def waiting(self) -> tuple[Fault, ...]:
        """Faults whose time has not come."""
        return self._plan.waiting

    @property
    def running(self) -> bool:
        """True if the firmware has booted and reads the gyro's samples."""
        return self._up

    def save(self) -> PortSnapshot:
        """Save the whole state, between two exchanges."""
        kept = {name: getattr(self, name) for name in self._KEPT}
        return PortSnapshot(take_snapshot(self.board.engine), copy.deepcopy(kept))

    def restore(self, snapshot: PortSnapshot, faults: Sequence[Fault] | None = None) -> None:
        """Go on from `snapshot`, of this port or one like it; `faults`: instead of those it was given."""
        restore_snapshot(self.board.engine, snapshot.board)
        for name, value in copy.deepcopy(snapshot.port).items():
            setattr(self, name, value)
        if faults is not None:
            self._plan = FaultPlan(faults, self.gyro_rate_hz)
            if self._armed_at is not None:
                self._plan.start(self._armed_at)

    # ---- the board ----

    def _boot(self) -> int:
        """Run until the cycle before the first edge that the firmware listens to; return the edge's."""
        board, gyro = self.board, self.board.hardware.gyro
        limit = round(BOOT_S * TIME_HZ)
        while board.cycle < limit:
            edge = gyro.next_sample
            if edge is None:
                self._run_to(board.cycle + EDGE_CYCLES // 2)
            elif board.cycle < edge - 1:
                self._run_to(edge - 1)
            elif self._listens():
                return self._begin_reads(edge)
            else:
                self._run_to(edge + EDGE_CYCLES // 2)
        reasons = arming_reasons(int(self._read(_STATUS)["arming_reasons"]))
        told = "; ".join([", ".join(reasons) or "it names no reason", *(what for _, what, _ in self._events)])
        raise LinkError(f"the firmware reads no gyro sample within {BOOT_S:g} s of its boot: {told}")

    def _listens(self) -> bool:
        """Return True if the firmware has opened the gyro's line or started its beat, last in its boot."""
        return self.board.hardware.hears_gyro or self.board.hardware.gyro_timer is not None

    def _begin_reads(self, edge: int) -> int:
        """Return the cycle of the sample that the firmware reads first, `edge` if it follows the line."""
        hardware = self.board.hardware
        if not hardware.hears_gyro and (timer := hardware.gyro_timer) is not None:
            assert timer.rings is not None
            edge = timer.rings - LEAD
            self._gyro.begin_at(edge)
            self._run_to(edge - 1)
        return edge

    def _validate_announced(self, channels_us: Sequence[int] | None) -> None:
        """Raise LinkError unless these channels were announced for this sample, or None and none were."""
        now = self._announced and self._announced[0][0] == self._samples
        due = self._announced.pop(0)[1] if now else None
        if due != (None if channels_us is None else list(channels_us)):
            raise LinkError("a receiver frame for the board must be announced before its time on the line")

    def _told(self, values: NDArray[np.uint16]) -> Reply:
        """Read the firmware's last control step."""
        told = self._last
        armed = bool(told["armed"][0])
        if armed and self._armed_at is None:
            self._armed_at = self._samples - 1
            self._plan.start(self._armed_at)
        self._note_state(int(self._state_view[0]), armed)
        return Reply(
            dshot=values,
            step=int(told["step"][0]),
            setpoint=told["setpoint"][0].astype(np.float32),
            gyro=told["gyro"][0].astype(np.float32),
            throttle=float(told["throttle"][0]),
            armed=armed,
        )

    def _reply_in_trouble(self, values: NDArray[np.uint16]) -> Reply:
        """Read the last control step of a firmware that may be booting or stopped by a fault."""
        self._note_resets()
        if not self._up and self._listens():
            self._up = True
            self._happened("the firmware has booted and reads its gyro")
        if self._up:
            return self._told(values)
        step = 0 if self._reply is None else self._reply.step
        return Reply(values, step, _NO_RATES, _NO_RATES, 0.0, armed=False)

    def _read(self, name: str) -> Any:  # noqa: ANN401 - a number or a record
        return self._seen(name)[0]

    def _seen(self, name: str) -> NDArray[Any]:
        """Return a variable as it lies in the board's memory, shape (1,)."""
        variable = self._variables[name]
        return np.frombuffer(self.board.engine.view(variable.address, variable.size), variable.dtype)

    # ---- what happens ----

    def _note_state(self, number: int, armed: bool) -> None:
        """Record a change of state; number: of a FlightState."""
        if number == self._state and armed == self._armed:
            return
        state, before = FlightState(number), self._state
        stops, self._state, self._armed = self._armed and not armed, state, armed
        if (state != before or stops) and (self._armed_at is not None or self._plan.begun):
            cause = f": {StopCause(int(self._read(_STATUS)['stop_cause'])).name}" if stops else ""
            self._happened(f"{state.name}{cause}", stops=stops)

    def _note_resets(self) -> None:
        resets = self.board.engine.resets
        while self._resets < len(resets):
            self._happened(f"reset: {resets[self._resets]}", stops=self._armed)
            self._up, self._armed, self._resets = False, False, self._resets + 1
            self._state = FlightState.BOOT

    def _inject(self) -> None:
        for what in self._plan.inject(self.board, self._samples):
            self._events.append((self._samples, what, False))

    def _happened(self, what: str, *, stops: bool = False) -> None:
        self._events.append((max(self._samples - 1, 0), what, stops))


def _same(values: NDArray[np.uint16], before: NDArray[np.uint16]) -> bool:
    """Return True if the motors obey what they obeyed before; most often both are one array."""
    return values is before or values.tobytes() == before.tobytes()


def _stored(settings: Mapping[str, float] | None, gyro_rate_hz: int) -> dict[str, float]:
    """Return settings that the image must have stored for this flight."""
    wanted = flight_settings(settings)
    if gyro_rate_hz != GYRO_RATE_DEFAULT_HZ:
        wanted["gyro_rate_hz"] = gyro_rate_hz
    return wanted


def _choice(setting: Setting, settings: Mapping[str, float]) -> str:
    """Return the name of the choice that `settings` hold for `setting`."""
    return setting.choices[int(settings.get(setting.name, setting.default))]


def _receiver(settings: Mapping[str, float]) -> Receiver:
    """Return the receiver of a board with these settings. Raises LinkError for msp, which has no line."""
    protocol = _choice(RECEIVER_SETTING, settings)
    if protocol not in RECEIVERS:
        raise LinkError(
            f"receiver_protocol: got {protocol}, expected {' or '.join(RECEIVERS)} to be flown by"
        )
    return RECEIVERS[protocol]


def _dshot(settings: Mapping[str, float]) -> int:
    """Return the DShot speed in these settings: "dshot600" is 600."""
    return int(_choice(MOTOR_SETTING, settings).removeprefix("dshot"))
