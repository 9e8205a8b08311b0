"""The dissertation's rows on the page of results, from its quoted figures; rates in deg/s."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from neuroflight.training.dissertation.quotes import Axes, quotes
from neuroflight.training.results_page.stored_results import Interval

Known = tuple[float | None, float | None, float | None]  # None: nothing to average


@dataclass(frozen=True)
class ControllerRow:
    """One controller on one task; unknown figures are missing or None."""

    label: str
    episodes: int
    tracking: Mapping[str, Axes] = field(default_factory=dict)  # mae, mse and the sums
    means: Mapping[str, float] = field(default_factory=dict)  # of the axes, where they are printed
    mae_margin: Axes | None = None
    output: float | None = None
    change: float | None = None
    smoothness: float | None = None  # Sm
    response: Mapping[str, Known] = field(default_factory=dict)
    in_band: Mapping[str, float] = field(default_factory=dict)  # % of time or commands, over all axes
    against: str = ""  # label of the row that is subtracted
    difference: Mapping[str, Interval] = field(default_factory=dict)  # from it, on the same commands
    printed: bool = False  # from the dissertation, with its digits


@dataclass(frozen=True)
class Timing:
    """Durations on the dissertation's board, a MATEKF722 at 216 MHz."""

    label: str
    work: str  # as `policy time` and `image time` name it
    worst_us: float
    best_us: float


METRICS = ("mae", "mse", "iae", "ise", "itae", "itse")
AIRCRAFT = "nf1"  # that both tasks were flown with
FIRMWARES = {"neuroflight": "policy 6-32-32-4", "betaflight": "Betaflight"}
DRIFTS = {("maximal", 2.0): "5/drift_2", ("maximal", 1.0): "5/drift_1", ("maximal", 0.5): "5/drift_05"}
DRIFTS |= {("reduced", 1.0): "5/drift_reduced_1"}  # the only step that DART ran at


def printed_rows(task: str, aircraft: str) -> Sequence[ControllerRow]:
    """Return the dissertation's rows of a task of chapter 5; none for an aircraft other than its own.

    Those of chapter 3's episodic task stand beside its own experiments (`neuroflight reproduce`).
    """
    of_task = {"pulse": _pulses, "envelope": _envelope}.get(task)
    return of_task() if of_task is not None and aircraft == AIRCRAFT else ()


def printed_timing(work: str) -> Sequence[Timing]:
    """Return the timing of the "control algorithm" or "control task": both firmwares, armed and disarmed."""
    table = {"control algorithm": "4.4", "control task": "4.5"}.get(work)
    if table is None:
        return ()
    worst, best = (
        {row: quotes().number(f"{table}/{row}/{end}") for row in _states()} for end in ("worst", "best")
    )
    return [Timing(f"dissertation, {label}", work, worst[row], best[row]) for row, label in _states().items()]


def printed_drift_mm(formulation: str, step_ms: float) -> float | None:
    """Return the largest drift of a link [mm], None where the dissertation shows no such run."""
    name = DRIFTS.get((formulation, step_ms))
    return None if name is None else quotes().number(name)


def _states() -> dict[str, str]:
    """Return the rows of the tables of timing and their labels."""
    return {
        f"{firmware}-{state}": f"{label}, {state}"
        for firmware, label in FIRMWARES.items()
        for state in ("armed", "disarmed")
    }


def _pulses() -> Sequence[ControllerRow]:
    known = quotes()
    return [
        ControllerRow(
            f"dissertation, {label}",
            int(known.number("5/commands")),
            tracking={name: known.axes(f"{table}/{name}") for name in METRICS},
            means={name: known.number(f"{table}/{name}/mean") for name in METRICS},
            output=known.number(f"5/{key}_output"),
            change=known.number(f"5/{key}_change"),
            printed=True,
        )
        for table, key, label in (("5.6", "policy", "policy"), ("5.7", "pid", "PID"))
    ]


def _envelope() -> Sequence[ControllerRow]:
    """Return the shares of trials that remained in the band: beside our share of whole trials."""
    known = quotes()
    return [
        ControllerRow(
            f"dissertation, {label}",
            int(known.number("5/envelope_setpoints")),
            in_band={"steady": known.number(f"5/envelope_{key}_500")},
            printed=True,
        )
        for key, label in (("policy", "policy"), ("pid", "PID"))
    ]
