"""`neuroflight fly`: tables and JSON of flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from neuroflight.cli.fly.blackbox import LogReport, log_rows
from neuroflight.cli.fly.emulator import EMULATOR_HEADINGS, emulator_cells, emulator_document, emulator_rows
from neuroflight.cli.fly.telemetry import telemetry_document
from neuroflight.cli.report import print_table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from neuroflight.cli.fly.options import FlyOptions
    from neuroflight.cli.fly.telemetry import Topics
    from neuroflight.cli.fly.thrust import Thrust
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.analysis.flight_report import Flight
    from neuroflight.sim.analysis.stick_flight import StickFigures
    from neuroflight.sim.flight.scenario import Scenario
    from neuroflight.sim.ports.emulator_report import EmulatedReport

STICK_ROWS = (  # of a flight by eye: heading, figure, digits
    ("height error, m", "height_error_m", 2),
    ("tilt, deg", "tilt_deg", 1),
    ("  largest", "tilt_max_deg", 1),
    ("drift, m", "drift_m", 1),
    ("touchdown, m/s down", "touchdown_m_s", 2),
    ("  and level", "touchdown_level_m_s", 2),
)
# First words of the rows that are printed without --all.
HEADLINES = ("MAE, deg/s", "  mean of the axes", "mean |Δu| in 1 ms")
HOLDING = ("rest late", "drift")  # of a flight with centred sticks for long
COMMANDED = ("rise", "peak")  # of another


@dataclass(frozen=True)
class Flown:
    """A flight, the emulated board's report of it, its log, and its figures if it was flown by eye."""

    flight: Flight
    report: EmulatedReport | None
    log: LogReport | None = None
    sticks: StickFigures | None = None
    esc: Topics | None = None  # what its ESCs told, by topic, if that was asked for
    refused: str | None = None  # why the policy had to leave the flight to the PID


def conditions(args: FlyOptions, scenario: Scenario, thrust: Thrust, refused: str | None = None) -> list[str]:
    """Return the conditions of the flight, in words. refused: why the policy was refused, if it was."""
    words = [f"{scenario.duration_s:g} s", f"mount {scenario.mount.value}", f"gyro {args.gyro_hz} Hz"]
    if thrust.value is not None:
        words.append(f"throttle {thrust.value:g}{', which holds the weight' if thrust.holds else ''}")
    if args.battery is not None:
        words.append(f"battery charged to {100 * args.battery:g} %")
    if any(args.wind):
        words.append(f"wind {', '.join(f'{speed:g}' for speed in args.wind)} m/s")
    if args.gust:
        words.append(f"gusts of a wind of {args.gust:g} m/s")
    if args.ground:
        words.append("over ground")
    if args.on == "betaflight":
        return [*words, "Betaflight 4.6 with its default PID, airmode and idle"]
    flown = "its PID" if args.controller == "pid" else "its policy"
    if refused is not None:
        flown = refusal(refused)
    return [*words, f"firmware on {args.on.said}, {flown}"]


def refusal(cause: str) -> str:
    """Return, in words, what flew where the policy was refused for that cause."""
    return f"its policy until that was REFUSED ({_cause(cause)}), then its PID"


def _cause(name: str) -> str:
    """Return a FallbackCause in words."""
    return name.lower().replace("_", " ")


def document(
    args: FlyOptions, aircraft: Aircraft, scenario: Scenario, thrust: Thrust, flown: list[Flown]
) -> dict[str, Any]:
    """Return the JSON document of one scenario."""
    from neuroflight.cli.output import plain
    from neuroflight.sim.flight.scenario import AT_THROTTLE

    report, log = flown[0].report, flown[0].log
    return {
        "on": args.on.said,
        "controller": args.controller,
        "policy_refused": flown[0].refused,
        "scenario": scenario.name,
        "seed": args.seed,
        "episodes": scenario.episodes(),
        "duration_s": scenario.duration_s,
        "throttle": thrust.value if scenario.name in AT_THROTTLE else None,
        "verdict": sentence(scenario, thrust, flown),
        "mount": scenario.mount.value,
        "gyro_rate_hz": args.gyro_hz,
        "battery": args.battery,
        "wind_m_s": list(args.wind),
        "gust_m_s": args.gust,
        "ground": args.ground,
        "aircraft": aircraft.name,
        "aircraft_sha256": aircraft.sha256,
        "flights": {
            # The first flight is the firmware's, whichever it is: "on" says.
            name: plain(_flight_document(one))
            for name, one in zip(("firmware", "PID"), flown, strict=False)
        },
        **({} if log is None else {"blackbox": asdict(log)}),
        **({} if report is None else {"emulator": emulator_document(report)}),
    }


def _flight_document(one: Flown) -> dict[str, Any]:
    by_eye = {} if one.sticks is None else {"sticks": asdict(one.sticks)}
    held = {} if one.flight.holding is None else {"holding": asdict(one.flight.holding)}
    return {
        "controller": one.flight.name,
        **asdict(one.flight.figures),
        "armed": one.flight.armed,
        **held,
        **by_eye,
        **telemetry_document(one.esc),
    }


def sentence(scenario: Scenario, thrust: Thrust, flown: list[Flown]) -> str:
    """Return the verdict on the firmware's flight, beside the PID's if there is one."""
    from neuroflight.sim.analysis.flight_verdict import verdict

    first, *others = flown
    beside = others[0].flight if others else None
    return verdict(_commanded(scenario, thrust), first.flight, beside, _told(first))


def _commanded(scenario: Scenario, thrust: Thrust) -> str:
    """Return the scenario and its throttle, in words."""
    from neuroflight.sim.flight.scenario import AT_THROTTLE

    where = thrust.where if scenario.name in AT_THROTTLE else ""
    if scenario.episode_s is None:
        return f"the scenario {scenario.name}{where}"
    count = scenario.episodes()
    return f"{count} command{'' if count == 1 else 's'}{where}"


def _told(one: Flown) -> list[str]:
    """Return the faults that are known otherwise than by its trace."""
    told = []
    if one.refused is not None:
        told.append(f"was REFUSED in flight ({_cause(one.refused)}), and the PID flew on")
    if one.sticks is not None and not one.sticks.landed:
        told.append("did not come to stand upright on the ground")
    return told


def _stick_rows(flown: list[Flown]) -> list[tuple[str, ...]]:
    """Return rows about a flight by eye; none of another."""
    all_figures = [one.sticks for one in flown if one.sticks is not None]
    if not all_figures:
        return []
    rows = [("", *(one.flight.name for one in flown))]
    for label, name, digits in STICK_ROWS:
        values = [getattr(figures, name) for figures in all_figures]
        rows.append((label, *("-" if value is None else f"{value:.{digits}f}" for value in values)))
    return [*rows, ("stands at the end", *("yes" if each.landed else "no" for each in all_figures))]


def headlines(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the heading and some five rows of a table of flights; `armed` where one was not to its end."""
    held = HOLDING if any(row[0].startswith(HOLDING) for row in rows) else COMMANDED
    kept = [row for row in rows[1:] if row[0].startswith((*HEADLINES, *held))]
    armed = [row for row in rows if row[0] == "armed" and set(row[1:]) != {"100.0 %"}]
    return [rows[0], *kept, *armed]


def print_flight(title: str, note: str, flown: list[Flown], verdict: str, *, every: bool) -> None:
    """Print a column for each flight, the emulated board's report of the first, and the verdict on it."""
    from neuroflight.sim.analysis.flight_report import table

    report = flown[0].report
    rows = table([one.flight for one in flown])
    print_table(title, rows if every else headlines(rows), note if every else f"{note}; more by --all")
    if by_eye := _stick_rows(flown):
        print_table("", by_eye)
    if rows := [*log_rows(flown[0].log), *([] if report is None else emulator_rows(report))]:
        print_table("", [("", ""), *rows], "", numbers=())
    print(f"\n{verdict}")


def print_several(
    title: str, args: FlyOptions, scenarios: list[Scenario], thrust: Thrust, flown: list[Flown]
) -> None:
    """Print a row for each flight, the part of the emulated board's report that all share, the verdict."""
    from neuroflight.sim.analysis.flight_verdict import verdict_of_several

    report = flown[0].report
    headings = EMULATOR_HEADINGS if report else ("armed",)
    rows: list[tuple[str, ...]] = [("", "length", "MAE, deg/s", *headings)]
    for scenario, one in zip(scenarios, flown, strict=True):
        mae = f"{one.flight.figures.tracking.mae.mean():.2f}"
        armed = (f"{100 * one.flight.armed:.1f} %",)
        told = armed if one.report is None else emulator_cells(one.report)
        rows.append((scenario.name, f"{scenario.duration_s:g} s", mae, *told))
    words = ", ".join(conditions(args, scenarios[0], thrust)[2:])
    for scenario, one in zip(scenarios, flown, strict=True):
        if one.refused is not None:
            words += f"\n{scenario.name}: {refusal(one.refused)}"
    if report is not None:
        words += f"\nflown was the file to be flashed, {report.image}\nsha256 {report.sha256}"
    print_table(title, rows, words)
    flights = [(each.name, one.flight, _told(one)) for each, one in zip(scenarios, flown, strict=True)]
    print(f"\n{verdict_of_several(flights)}")
