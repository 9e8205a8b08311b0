"""Report of a flight on the emulated board: timing margins, resets, events and notes, beside its trace."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Note
from neuroflight.sim.board.debug.profile import task_counts
from neuroflight.sim.ports.emulator import EmulatedPort, Event

_US = 1e6 / TIME_HZ


@dataclass(frozen=True)
class EmulatedReport:
    """One flight; times in seconds of the flight, from the first armed control step on."""

    image: str  # path of the flashable file
    sha256: str  # of that file, whose bytes were in the board's flash
    board_s: float  # of the board's time, from power to the end
    real_time: float  # that, by the time it took
    instructions: int  # executed
    gyro_wait_us: float  # the longest that a data-ready edge or beat waited for its handler
    gyro_wait_place: str  # what ran then; "" if none ever waited
    watchdog_margin_s: float | None  # the least that was left when it was fed
    card_writes: int | None  # blocks of the card, or pages of the flash chip; None: there is none
    resets: tuple[str, ...]  # their causes, the first one power
    events: tuple[Event, ...]
    stopped_s: float | None  # when the firmware stopped its motors before the end; None: it flew to the end
    running: bool  # at the end: not in a boot, nor stopped for good
    arming_reasons: tuple[str, ...]  # what keeps it disarmed, after the pilot has switched off
    waiting: tuple[str, ...]  # faults whose time did not come
    notes: tuple[Note, ...]  # of the board

    @property
    def outcome(self) -> str:
        if self.stopped_s is None:
            return "flown, disarmed"
        what = next(event.what for event in self.events if event.stops)
        return f"motors stopped at {self.stopped_s:.3f} s: {what}"


def emulated_report(port: EmulatedPort, image: Path, flight_s: float, took_s: float) -> EmulatedReport:
    """Report a flight that is over, on a port that is still open.

    flight_s: length of its scenario; took_s: elapsed real time, with the boot, the twin and all else.
    """
    report = port.board.report()
    interrupt = port.board.hardware.gyro_interrupt
    handler = None if interrupt is None else 16 + interrupt
    edge = next((task for task in task_counts(port.board.engine) if task.exception == handler), None)
    card = port.board.hardware.log_place.chip
    stops = [event.at_s for event in port.events if event.stops]
    return EmulatedReport(
        image=str(image),
        sha256=port.image_sha256,
        board_s=report.cycles / TIME_HZ,
        real_time=report.cycles / TIME_HZ / took_s,
        instructions=report.instructions,
        gyro_wait_us=0.0 if edge is None else edge.latest * _US,
        gyro_wait_place=edge.latest_place if edge is not None and edge.latest else "",
        watchdog_margin_s=report.watchdog_margin_s,
        card_writes=None if card is None else card.writes,
        resets=report.resets,
        events=port.events,
        stopped_s=stops[0] if stops and stops[0] < flight_s else None,
        running=port.running,
        arming_reasons=port.arming_reasons(),
        waiting=tuple(str(fault) for fault in port.waiting),
        notes=report.notes,
    )
