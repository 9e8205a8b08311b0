"""`neuroflight dyno run`: a rotor on a simulated dynamometer, once or repeatedly."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.dyno.repeats import print_repeats, repeats_document
from neuroflight.cli.output import check_output
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    import numpy as np

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.bench.quantities import Rig
    from neuroflight.sim.identification.bench.simulated import Measured
    from neuroflight.sim.identification.dyno.bench import Phase, Step
    from neuroflight.sim.identification.dyno.recording import Recording

COLUMNS = "columns time_s, throttle (0..1), rpm, thrust_n, torque_n_m"
RATE_HZ_DEFAULT = 500
REPEATS_MAX = 99
HOLD_MIN, HOLD_MAX = 1.0, 10.0  # [s]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the rotor, the experiment, its disturbances, and the output."""
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="whose rotor")
    parser.add_argument("--experiment", choices=["steps", "ramp", "all"], default="all")
    parser.add_argument(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="of each experiment, in turns, each with noise of its own; prints means with 95 %% intervals",
    )
    parser.add_argument(
        "--hold", type=float, metavar="S", help="each level, and the rest after it (default 2; Koch 2019: 1)"
    )
    parser.add_argument(
        "--sensors",
        action="store_true",
        help="record through the bench's sensors, simulated: load cells that are calibrated with masses "
        "first, blades that are counted; prints what they found beside the truth",
    )
    parser.add_argument("--rate-hz", type=float, default=RATE_HZ_DEFAULT, metavar="HZ", help="rows a second")
    parser.add_argument("--noise", type=float, default=0.0, metavar="PERCENT", help="standard deviation")
    parser.add_argument(
        "--noise-of",
        choices=["full-scale", "reading"],
        default="full-scale",
        help="what the percentage is of: a channel's largest value, or each value",
    )
    parser.add_argument(
        "--outliers", type=float, default=0.0, metavar="PERCENT", help="of each channel's values, gross"
    )
    parser.add_argument("--uneven", action="store_true", help="rows at uneven times, some of them lost")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of noise, outliers and uneven rows")
    parser.add_argument("--out", type=Path, required=True, metavar="DATA.csv", help=COLUMNS)
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw what was recorded")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Simulate, write the outputs, print the figures. Returns 0."""
    import numpy as np

    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.sim.identification.bench.plan import joined
    from neuroflight.sim.identification.bench.simulated import Noise, calibrated
    from neuroflight.sim.identification.dyno.bench import KINDS
    from neuroflight.sim.identification.dyno.recording import write_recording

    _check(args)
    aircraft = load_aircraft(args.aircraft)
    rng = np.random.default_rng(args.seed)
    # One run has all experiments in a row; repeats are runs of one experiment each, as the bench makes them.
    apart = args.repeats > 1 and args.experiment == "all"
    kinds = KINDS if apart else (args.experiment,)
    noise = Noise(args.noise / 100, args.noise_of == "reading", args.outliers / 100)
    rig = calibrated(aircraft.propulsion, noise, rng) if args.sensors else None
    runs: dict[str, list[Measured]] = {kind: [] for kind in kinds}
    for _ in range(args.repeats):
        for kind in kinds:
            runs[kind].append(_measured(args, aircraft, kind, rig, noise, rng))
    groups = {kind: [one.found for one in group] for kind, group in runs.items()}
    in_turns = [one for turn in zip(*groups.values(), strict=True) for one in turn]
    whole = in_turns[0] if len(in_turns) == 1 else joined(in_turns)
    write_recording(args.out, whole)
    if args.plot:
        _draw(args, aircraft, groups)
    found = None if rig is None else _found(rig, [one for group in runs.values() for one in group])
    _print(args, aircraft, whole, found)
    return 0


def _check(args: argparse.Namespace) -> None:
    from neuroflight.sim.identification.dyno.bench import RATE_HZ_MAX, RATE_HZ_MIN, duration
    from neuroflight.sim.identification.dyno.recording import ROWS_MAX

    check_output(args.out, ".csv")
    check_output(args.plot, ".png")
    check_range("--rate-hz", args.rate_hz, RATE_HZ_MIN, RATE_HZ_MAX)
    check_range("--noise", args.noise, 0, 100)
    check_range("--outliers", args.outliers, 0, 50)
    check_range("--seed", args.seed, 0, 2**63)
    check_range("--repeats", args.repeats, 1, REPEATS_MAX)
    if args.hold is not None:
        check_range("--hold", args.hold, HOLD_MIN, HOLD_MAX)
    rows = args.repeats * duration(_experiment(args, args.experiment)) * args.rate_hz
    if rows > ROWS_MAX:
        raise NeuroflightError(
            f"{rows:.0f} rows in all, expected at most {ROWS_MAX}; give fewer --repeats or a lower --rate-hz"
        )


def check_range(name: str, value: float, low: float, high: float) -> None:
    """Raise NeuroflightError where an option lies outside."""
    if not low <= value <= high:  # NaN included
        raise NeuroflightError(f"{name} {value:g}, expected {low:g} to {high:g}")


def _experiment(args: argparse.Namespace, kind: str) -> tuple[Phase, ...]:
    from neuroflight.sim.identification.dyno.bench import EXPERIMENTS, RAMP, steps_held

    if args.hold is None or kind == "ramp":
        return EXPERIMENTS[kind]
    steps = steps_held(args.hold)
    return steps if kind == "steps" else (*steps, *RAMP)


def _measured(
    args: argparse.Namespace,
    aircraft: Aircraft,
    kind: str,
    rig: Rig | None,
    noise: Any,  # noqa: ANN401 - Noise, which is imported where it is used
    rng: np.random.Generator,
) -> Measured:
    """Simulate one run."""
    from neuroflight.sim.identification.bench.simulated import Measured, measured
    from neuroflight.sim.identification.dyno import bench as dyno

    experiment = _experiment(args, kind)
    time = dyno.sample_times(dyno.duration(experiment), args.rate_hz, rng if args.uneven else None)
    if rig is not None:
        return measured(aircraft.propulsion, experiment, time, rig, noise, rng)
    true = dyno.run(aircraft.propulsion, experiment, time)
    return Measured(
        dyno.disturbed(true, rng, noise=noise.noise, of_reading=noise.of_reading, outliers=noise.outliers),
        true,
    )


def _draw(args: argparse.Namespace, aircraft: Aircraft, groups: dict[str, list[Recording]]) -> None:
    if args.repeats == 1:
        from neuroflight.sim.identification.dyno.plot import save_recording_plot

        ((recording,),) = groups.values()
        save_recording_plot(args.plot, recording, f"{aircraft.name}: dynamometer, {args.experiment}")
        return
    from neuroflight.sim.identification.bench.plot import save_bench_plot

    save_bench_plot(args.plot, groups, f"{aircraft.name}: simulated dynamometer, {args.repeats} repeats")


def _found(rig: Rig, runs: Sequence[Measured]) -> dict[str, Any]:
    """Return the figures of the sensors, beside the truth."""
    from neuroflight.sim.identification.bench.simulated import CELLS, scale_errors, speed_found

    errors, speed = scale_errors(rig.cells), speed_found(runs)
    return {
        "cells": {
            name: {
                "unit": cell.unit,
                "counts_a_unit": 1.0 / cell.scale,
                "true_counts_a_unit": CELLS[name].counts,
                "error_percent": 100.0 * errors[name],
                "standard_error_percent": 100.0 * abs(cell.scale_error / cell.scale),
                "hysteresis": cell.hysteresis,
                "residual_max": cell.residual_max,
                "load_max": cell.load_max,
                "loads": cell.loads,
            }
            for name, cell in rig.cells.items()
        },
        "speed": {
            "pulses_a_turn": rig.blades,
            "mean_error_percent": 100.0 * speed.mean,
            "rms_error_percent": 100.0 * speed.rms,
            "largest_error_percent": 100.0 * speed.largest,
        },
    }


def _step(step: Step) -> dict[str, float]:
    return {
        "throttle": round(step.level, 4),
        "rise_0_90_s": step.rise,
        "rpm": step.speed * 30 / math.pi,
        "thrust_n": step.thrust,
        "torque_n_m": step.torque,
    }


def _print(
    args: argparse.Namespace, aircraft: Aircraft, recording: Recording, found: dict[str, Any] | None
) -> None:
    from neuroflight.sim.identification.bench.summary import repeats
    from neuroflight.sim.identification.dyno.bench import HOLD_S, steps

    repeated = repeats(recording)
    if args.json:
        document = {
            "aircraft": aircraft.name,
            "experiment": args.experiment,
            "seed": args.seed,
            "out": str(args.out),
            "rows": len(recording.time),
            "duration_s": float(recording.time[-1]),
            "hold_s": HOLD_S if args.hold is None else args.hold,
            "repeats": args.repeats,
            "steps": [_step(step) for step in steps(recording)] if repeated is None else [],
            "figures": repeats_document(repeated),
            "sensors": found,
        }
        print(json.dumps(document, indent=2))
        return
    title = f"{aircraft.name}: {len(recording.time)} rows in {args.out}"
    if repeated is None:
        _print_steps(title, steps(recording))
    else:
        title += f", {args.repeats} repeats; mean ± 95 % interval"
        print_repeats(title, repeated.steps, repeated.ramp_top)
    if found is not None:
        _print_found(found)


def _print_steps(title: str, steps: tuple[Step, ...]) -> None:
    from rich.console import Console
    from rich.text import Text

    from neuroflight.cli.dyno.repeats import HEADINGS, heading_table

    if not steps:
        Console().print(Text(title))
        return
    table = heading_table(title, "step to", *HEADINGS[1:])
    for step in steps:
        row = _step(step)
        table.add_row(
            f"{100 * step.level:.0f} %",
            f"{1000 * step.rise:.0f}",
            f"{row['rpm']:,.0f}",
            f"{step.thrust:.3f}",
            f"{step.torque:.5f}",
        )
    Console().print(table)


def _print_found(found: dict[str, Any]) -> None:
    for name, cell in found["cells"].items():
        print(
            f"{name}: {cell['counts_a_unit']:,.0f} counts a {cell['unit']} by {cell['loads']} loads, truly "
            f"{cell['true_counts_a_unit']:,.0f}: off by {cell['error_percent']:+.3f} % (standard error "
            f"{cell['standard_error_percent']:.2g} %)"
        )
    speed = found["speed"]
    print(
        f"speed from {speed['pulses_a_turn']} pulses a turn, settled or on a ramp: off by "
        f"{speed['rms_error_percent']:.2g} % of the top speed rms, {speed['largest_error_percent']:.2g} % at "
        f"most"
    )
