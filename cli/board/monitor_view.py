"""The screen of `neuroflight board monitor`: panels that fit 80 x 24, and grow with the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.layout import Layout
from rich.panel import Panel
from rich.segment import Segment
from rich.style import Style
from rich.table import Table
from rich.text import Text

from neuroflight.cli.board.motor_places import motor_places
from neuroflight.flash.board.hints import words
from neuroflight.flash.link.messages import BatteryLevel
from neuroflight.toolchain.contract import CHANNEL_MAX_US, CHANNEL_MIN_US
from neuroflight.toolchain.errors import AircraftError

if TYPE_CHECKING:
    from neuroflight.flash.board.overview import Overview
    from neuroflight.flash.link.records import Tasks
    from neuroflight.flash.monitoring.snapshot import Snapshot
    from neuroflight.flash.monitoring.watch import Sight

UPPER, UPPER_MAX = 10, 12  # rows of the upper panels, with their frames
LOWER = 18  # of the lower ones, where all channels are seen
WIDE = 100  # columns, from which panels are wider
LOAD_HIGH = 90  # percent
LABEL, WORD = 8, 12  # columns of the labels; of a word that did not fit
FRAME = 4  # columns of a panel's frame with its padding
SPAN_US = CHANNEL_MAX_US - CHANNEL_MIN_US
ARMED = ("ARMED", "FAILSAFE_HOLD", "FAILSAFE_DROP")
OLD = Style(color="grey50")
LEVELS = {BatteryLevel.GOOD: "green", BatteryLevel.WARNING: "yellow", BatteryLevel.CRITICAL: "bold red"}


def view(sight: Sight, port: str, rate_hz: float, width: int, height: int) -> RenderableType:
    """Return the whole screen. Old values are grey, and the last line says why they are old."""
    upper = max(UPPER, min(UPPER_MAX, height - LOWER - 2))
    layout = Layout()
    layout.split_column(
        Layout(_head(sight, port), name="head", size=1),
        Layout(name="upper", size=upper),
        Layout(name="lower"),
        Layout(_foot(sight, rate_hz), name="foot", size=1),
    )
    if sight.snapshot is None:
        layout["upper"].update(Panel(Text(sight.problem or "asking ..."), title="no firmware yet"))
        layout["lower"].update(Text())
        return layout
    snapshot, old = sight.snapshot, bool(sight.problem)
    room, wide = height - upper - 4, width >= WIDE
    right, left, processor = (40, 33, 40) if wide else (33, 23, 34)
    layout["upper"].split_row(
        Layout(_panel("state", _state(snapshot.overview, upper - 2, width - right - FRAME), old), ratio=1),
        Layout(_panel("attitude and supply", _attitude(snapshot), old), size=right),
    )
    motors = _motors(snapshot, sight, room, width - left - processor - FRAME)
    layout["lower"].split_row(
        Layout(_panel("channels", _channels(snapshot, room, cells=15 if wide else 5), old), size=left),
        Layout(_panel("motors", motors, old), ratio=1),
        Layout(_panel("processor", _tasks(snapshot), old), size=processor),
    )
    return layout


def lines(sight: Sight, port: str) -> RenderableType:
    """Return the same facts one below the other, for a file or a pipe."""
    parts: list[RenderableType] = [_head(sight, port)]
    if sight.snapshot is not None:
        snapshot = sight.snapshot
        parts += [Text(), _state(snapshot.overview, 99, 999), Text(), _attitude(snapshot)]
        parts += [Text(), _channels(snapshot, 99, cells=15), Text(), _motors(snapshot, sight, 0, 21)]
        parts += [Text(), _tasks(snapshot)]
    return Group(*parts)


# --- First and last line ---------------------------------------------------------------------------
def _head(sight: Sight, port: str) -> Text:
    told = Text(no_wrap=True, overflow="ellipsis")
    info = sight.info
    if info is None:
        return told.append(port, style="bold")
    told.append(info.name or info.board.name or info.variant, style="bold")
    told.append(f"  {info.board.target or info.board.identifier}, firmware {info.version}")
    flight = sight.snapshot.overview.flight if sight.snapshot is not None else None
    if flight is not None:
        told.append(f", boot {flight.boots}")
    return told.append(f"  {port}", style="cyan")


def _foot(sight: Sight, rate_hz: float) -> Text:
    told = Text(no_wrap=True, overflow="ellipsis")
    if sight.problem:
        told.append(f"NO ANSWER for {sight.silent_s:.0f} s", style="bold white on red")
        return told.append(f" q ends; {sight.problem}")
    told.append(f"{rate_hz:g} Hz, {sight.answer_ms:.0f} ms a look")
    for count, what in (
        (sight.failed, "failed"),
        (sight.corrupt, "corrupt"),
        (sight.restarts, "restarts"),
        (sight.reconnects, "reconnects"),
    ):
        told.append(f", {count} {what}", style="yellow" if count else "none")
    return told.append("; q ends")


# --- Panels ----------------------------------------------------------------------------------------
class _Grey:
    """A grey copy of what stands inside, whose values are old."""

    def __init__(self, inside: RenderableType) -> None:
        self.inside = inside

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for segment in console.render(self.inside, options):
            yield Segment(segment.text, OLD, segment.control)


def _panel(title: str, inside: RenderableType, old: bool) -> Panel:
    shown = _Grey(inside) if old else inside
    told = f"{title} (old)" if old else title
    return Panel(shown, title=told, title_align="left", border_style="blue", padding=(0, 1))


def _facts(rows: Sequence[tuple[str, Text | str]]) -> Table:
    table = Table.grid(padding=(0, 1))
    table.add_column(style="bold", no_wrap=True)
    table.add_column()
    for label, told in rows:  # as Text: what a board says is no markup
        table.add_row(label, Text(told, no_wrap=True, overflow="ellipsis") if isinstance(told, str) else told)
    return table


def _state(told: Overview, room: int, width: int) -> Table:
    """Return the panel of the state, in `room` rows of that width."""
    flight = told.flight
    name = flight.state if flight is not None else "ARMED" if told.armed else "DISARMED"
    style = "bold white on red" if name in ARMED else "bold yellow" if name != "DISARMED" else "bold green"
    state = Text.assemble((f" {words(name)} ", style), no_wrap=True, overflow="ellipsis")
    rows: list[tuple[str, Text | str]] = [("state", state)]
    if flight is not None:
        if told.armed and flight.airborne is not None:
            state.append(" in the air," if flight.airborne else " on the ground,")
        state.append(f" {flight.flies} flies" if told.armed else f" {flight.flies} would fly")
        policy = f"{flight.policy}, {'good' if flight.policy_good else 'BAD'}"
        if flight.refused_cause != "NONE":
            policy += f", refused: {words(flight.refused_cause)}"
        rows.append(("policy", policy))
        rows.append(
            ("last", f"stop: {words(flight.stop_cause)}; PID took over: {words(flight.fallback_cause)}")
        )
        fault = Text("none") if flight.fault is None else Text(words(flight.fault), "bold red")
        fault.append("" if flight.fault is None else "; see `neuroflight board faults`")
        rows.append(("fault", fault))
    rows += _reasons(told.arming_reasons, room - len(rows), width - LABEL)
    return _facts(rows)


def _reasons(held: dict[str, str], room: int, width: int) -> list[tuple[str, Text | str]]:
    """Return the reasons that forbid arming, with remedies: as many as fit, in full where there is room."""
    if not held:
        return [("arming", Text("nothing forbids it", style="green"))]
    told = [
        Text.assemble((words(name), "yellow"), f": {hint}" if hint else "") for name, hint in held.items()
    ]
    spare = room - len(told)
    for text in told:
        more = math.ceil(len(text) / (width - WORD)) - 1  # rows: words are not split, ends may stay empty
        if more > spare:
            text.no_wrap, text.overflow = True, "ellipsis"
        else:
            spare -= more
    if len(told) > room:
        told[room - 1 :] = [Text(f"and {len(told) - room + 1} more; see `board status`", "yellow")]
    return [("held by" if index == 0 else "", text) for index, text in enumerate(told)]


def _attitude(snapshot: Snapshot) -> Table:
    told, attitude, battery = snapshot.overview, snapshot.overview.attitude, snapshot.overview.battery
    roll, pitch, yaw = snapshot.rates_deg_s
    level = Text(words(battery.level.name), style=LEVELS.get(battery.level, "none"))
    cells = f" {battery.cells}S " if battery.cells else " "
    rows: list[tuple[str, Text | str]] = [
        ("roll", f"{attitude.roll_deg:7.1f}° {roll:6d}°/s"),
        ("pitch", f"{attitude.pitch_deg:7.1f}° {pitch:6d}°/s"),
        ("yaw", f"{attitude.heading_deg:7.0f}° {yaw:6d}°/s"),
        ("battery", Text.assemble(f"{battery.voltage_v:7.2f} V{cells}", level)),
        ("current", f"{battery.current_a:7.2f} A, {battery.drawn_mah} mAh"),
        ("receiver", _quality(told.receiver_percent)),
    ]
    if told.flight is not None:
        health = words(told.flight.gyro_health)
        rows.append(("gyro", f"{told.flight.gyro_temperature_deg_c:7.1f}°C, {health}"))
    return _facts(rows)


def _quality(percent: int) -> Text:
    return Text(f"{percent:7d} %", style="green" if percent >= 70 else "yellow" if percent else "red")


def _channels(snapshot: Snapshot, room: int, cells: int) -> Table:
    """Return the panel of the channels, in `room` rows; cells: width of a stick's needle."""
    table = Table.grid(padding=(0, 1))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(justify="right", no_wrap=True)
    table.add_column(no_wrap=True)
    for name, us in list(snapshot.channels_us.items())[: max(1, room)]:
        table.add_row(name, str(us), _needle((us - CHANNEL_MIN_US) / SPAN_US, cells))
    return table


def _needle(share: float, cells: int) -> Text:
    """Return the position of a stick as a mark on a line, from left to right."""
    at = round(max(0.0, min(1.0, share)) * (cells - 1))
    return Text("─" * at + "●" + "─" * (cells - 1 - at), style="cyan")


def _motors(snapshot: Snapshot, sight: Sight, room: int, cells: int) -> RenderableType:
    """Return the panel of the motors, in `room` rows of `cells`; bars are drawn where they fit below."""
    rows: list[RenderableType] = []
    for number, (us, where) in enumerate(zip(snapshot.motors_us, _places(snapshot, sight), strict=True), 1):
        share = max(0.0, (us - CHANNEL_MIN_US) / SPAN_US)
        percent = f"{100 * share:3.0f} %"
        label = Text(f"{number} {where}".ljust(cells - len(percent)), style="bold", no_wrap=True)
        rows.append(label.append(percent, style="bold red" if share > 0 else "none"))
        if room >= 2 * len(snapshot.motors_us):
            rows.append(_bar(share, cells))
    return Group(*rows)


def _places(snapshot: Snapshot, sight: Sight) -> list[str]:
    """Return the position of each motor, as far as a shipped aircraft file tells it."""
    count, policy = len(snapshot.motors_us), sight.info.policy if sight.info is not None else None
    if policy is None:  # another make numbers its motors as it likes
        return [""] * count
    try:
        return [place.where for place in motor_places(None, policy.name, count, reverse=False)]
    except AircraftError:
        return [""] * count


def _bar(share: float, cells: int) -> Text:
    full = round(min(1.0, share) * cells)
    return Text("█" * full + "░" * (cells - full), style=Style(color="red") if share > 0 else OLD)


def _tasks(snapshot: Snapshot) -> RenderableType:
    told = snapshot.overview
    style = "bold red" if told.load_percent >= LOAD_HIGH else "none"
    load = Text(f"load {told.load_percent} %, control each {told.control_period_us} us", style, no_wrap=True)
    return load if snapshot.tasks is None else Group(load, _task_table(snapshot.tasks))


def _task_table(tasks: Tasks) -> Table:
    us = 1e6 / tasks.cycles_hz
    table = Table.grid(padding=(0, 1))
    table.add_column(no_wrap=True)
    for _ in range(3):
        table.add_column(justify="right", no_wrap=True)
    table.add_row("task", "load %", "worst us", "late", style="bold")
    for task in tasks.loads:
        share = task.rate_hz * task.mean_cycles / tasks.cycles_hz
        table.add_row(
            task.task.name.lower(),
            f"{100 * share:.1f}" if task.rate_hz else "when due",
            f"{us * task.worst_cycles:.1f}",
            Text(str(task.misses), "bold red" if task.misses else "none"),
        )
    return table
