"""The section about the timing of an image on the emulated board on the page of results."""

from __future__ import annotations

from textwrap import fill

from neuroflight.training.results_page.dissertation import Timing, printed_timing
from neuroflight.training.results_page.markdown import number, table
from neuroflight.training.results_page.stored_results import Stored

PAGE_WIDTH = 108
NAMES = {"policy": "policy", "pid": "PID"}


def timing_section(stored: Stored) -> str:
    """Return a table for each kind of work, worst / best, beside the dissertation's measurements."""
    core_hz = stored.number("core_hz")
    tables: dict[str, list[tuple[str, ...]]] = {}
    for entry in stored.entries("board_timing"):
        tables.setdefault(entry.text("work"), []).append(_row(stored, entry, core_hz))
    if stored.get("model") is None:
        cycles = f"No cycles: {stored.text('predicted_cycles_reason')}."
    else:
        device = f"{stored.number('device_cycles'):.0f}"
        cycles = ABOUT_CYCLES.format(model=stored.text("model"), device=device)
    about = ABOUT.format(
        count=f"{stored.number('count'):.0f}",
        image=stored.text("image_sha256")[:12],
        cycles=cycles,
        mhz=f"{core_hz / 1e6:g}",
        interruptions=f"{stored.number('interruptions'):,.0f}",
        edge=f"{stored.number('edge_instructions', 'worst'):.0f}",
    )
    parts = [f"## Timing on the board, {stored.text('aircraft')}", fill(about, PAGE_WIDTH)]
    headings = ("runs", "instructions", "predicted cycles", "µs", "variability, %")
    for work, rows in tables.items():
        printed = [_printed(timing) for timing in printed_timing(work)]
        parts.append(table((f"{work}, worst / best", *headings), [*rows, *printed]))
    return "\n\n".join(parts)


def _row(stored: Stored, entry: Stored, core_hz: float) -> tuple[str, ...]:
    state = "armed" if entry.get("armed") else "disarmed"
    controller = entry.get("controller")
    name = NAMES.get(entry.text("controller"), entry.text("controller")) if controller else ""
    if controller == "policy":
        name += f" {stored.text('network')}"
    has_cycles = entry.get("predicted_cycles") is not None
    cycles = [entry.number("predicted_cycles", end) for end in ("worst", "best")] if has_cycles else []
    return (
        ", ".join(filter(None, (name, state))),
        number(entry.number("runs"), 0),
        _both([entry.number("instructions", end) for end in ("worst", "best")], 0),
        _both(cycles, 0),
        _both([1e6 * count / core_hz for count in cycles], 1),
        number(100 * entry.number("variability"), 1),
    )


def _printed(timing: Timing) -> tuple[str, ...]:
    varies = 100 * (timing.worst_us - timing.best_us) / timing.worst_us
    return timing.label, "", "", "", _both([timing.worst_us, timing.best_us], 0), number(varies, 1)


def _both(values: list[float], digits: int) -> str:
    return " / ".join(number(value, digits) for value in values)


ABOUT = """Every run of the control task of image `{image}` in flight on the emulated board: {count}
`pulses` with its policy, {count} with its PID. The control algorithm is the controller's own function; it
does not run while disarmed. The control task is the interrupt of a gyro sample that is a control step, up to
its return: sample, filters, receiver, attitude, safety, controller, mixer, motors' frame. Samples between
control steps are only filtered and not counted. Variability is (worst - best) / worst. Instructions are
exact. {cycles} µs are at {mhz} MHz. Not included are other interrupts in between, which came {interruptions}
times, 22 cycles of entering and leaving the interrupt, and the interrupt before it that starts the chip's
read, of {edge} instructions at most. No board has confirmed the cycles yet. The dissertation's figures were
measured on a MATEKF722 at 216 MHz, with another firmware and a smaller network."""
ABOUT_CYCLES = """Cycles are predicted by {model}'s model of the Cortex-M7, with {device} more for each
access to a peripheral's register and for each barrier ([timing.md](explanation/timing.md))."""
