"""`neuroflight dyno run`: a rotor on a simulated dynamometer, once or repeatedly."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.dyno.bench import Experiment
from neuroflight.cli.dyno.repeats import print_repeats, repeats_document
from neuroflight.cli.options import Json, picture
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    import numpy as np

    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.bench.quantities import Rig
    from neuroflight.sim.identification.bench.simulated import Measured
    from neuroflight.sim.identification.dyno.bench import Phase, Step
    from neuroflight.sim.identification.dyno.recording import Recording

COLUMNS = "columns time_s, throttle (0..1), rpm, thrust_n, torque_n_m"


@dataclass(frozen=True, kw_only=True)
class Run(Request):
    """A request to simulate a rotor on a dynamometer."""

    aircraft: Annotated[str, Option("NAME|FILE", "whose rotor")] = "nf1"
    experiment: Experiment = "all"
    repeats: Annotated[
        int,
        Option(
            "N",
            "of each experiment, in turns, each with noise of its own; prints means with 95 %% intervals",
            low=1,
            high=99,
        ),
    ] = 1
    hold: Annotated[
        float | None,
        Option(
            "S", "each level, and the rest after it (default 2; Koch 2019: 1)", low=1.0, high=10.0, unit="s"
        ),
    ] = None
    sensors: Annotated[
        bool,
        Option(
            None,
            "record through the bench's sensors, simulated: load cells that are calibrated with masses "
            "first, blades that are counted; prints what they found beside the truth",
        ),
    ] = False
    rate_hz: Annotated[float, Option("HZ", "rows a second", low=10.0, high=2000.0, unit="Hz")] = 500
    noise: Annotated[float, Option("PERCENT", "standard deviation", low=0.0, high=100.0, unit="%")] = 0.0
    noise_of: Annotated[
        str,
        Option(
            None,
            "what the percentage is of: a channel's largest value, or each value",
            choices=("full-scale", "reading"),
        ),
    ] = "full-scale"
    outliers: Annotated[
        float, Option("PERCENT", "of each channel's values, gross", low=0.0, high=50.0, unit="%")
    ] = 0.0
    uneven: Annotated[bool, Option(None, "rows at uneven times, some of them lost")] = False
    seed: Annotated[int, Option("S", "of noise, outliers and uneven rows", low=0, high=2**63)] = 0
    out: Annotated[Path, Option("DATA.csv", COLUMNS, suffix=".csv")]
    plot: Annotated[Path | None, picture("draw what was recorded")] = None
    json: Json = False

    def run(self) -> int:
        """Simulate, write the outputs, print the figures. Returns 0."""
        import numpy as np

        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.identification.bench.plan import joined
        from neuroflight.sim.identification.bench.simulated import Noise, calibrated
        from neuroflight.sim.identification.dyno.bench import KINDS
        from neuroflight.sim.identification.dyno.recording import write_recording

        _check_rows(self)
        aircraft = load_aircraft(self.aircraft)
        rng = np.random.default_rng(self.seed)
        # One run has all experiments in a row; repeats are runs of one experiment each, as on the bench.
        apart = self.repeats > 1 and self.experiment == "all"
        kinds = KINDS if apart else (self.experiment,)
        noise = Noise(self.noise / 100, self.noise_of == "reading", self.outliers / 100)
        rig = calibrated(aircraft.propulsion, noise, rng) if self.sensors else None
        runs: dict[str, list[Measured]] = {kind: [] for kind in kinds}
        for _ in range(self.repeats):
            for kind in kinds:
                runs[kind].append(_measured(self, aircraft, kind, rig, noise, rng))
        groups = {kind: [one.found for one in group] for kind, group in runs.items()}
        in_turns = [one for turn in zip(*groups.values(), strict=True) for one in turn]
        whole = in_turns[0] if len(in_turns) == 1 else joined(in_turns)
        write_recording(self.out, whole)
        if self.plot is not None:
            _draw(self, self.plot, aircraft, groups)
        found = None if rig is None else _found(rig, [one for group in runs.values() for one in group])
        _print(self, aircraft, whole, found)
        return 0


def _check_rows(args: Run) -> None:
    from neuroflight.sim.identification.dyno.bench import duration
    from neuroflight.sim.identification.dyno.recording import ROWS_MAX

    rows = args.repeats * duration(_experiment(args, args.experiment)) * args.rate_hz
    if rows > ROWS_MAX:
        raise NeuroflightError(
            f"{rows:.0f} rows in all, expected at most {ROWS_MAX}; give fewer --repeats or a lower --rate-hz"
        )


def _experiment(args: Run, kind: str) -> tuple[Phase, ...]:
    from neuroflight.sim.identification.dyno.bench import EXPERIMENTS, RAMP, steps_held

    if args.hold is None or kind == "ramp":
        return EXPERIMENTS[kind]
    steps = steps_held(args.hold)
    return steps if kind == "steps" else (*steps, *RAMP)


def _measured(
    args: Run,
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


def _draw(args: Run, path: Path, aircraft: Aircraft, groups: dict[str, list[Recording]]) -> None:
    if args.repeats == 1:
        from neuroflight.sim.identification.dyno.plot import save_recording_plot

        ((recording,),) = groups.values()
        save_recording_plot(path, recording, f"{aircraft.name}: dynamometer, {args.experiment}")
        return
    from neuroflight.sim.identification.bench.plot import save_bench_plot

    save_bench_plot(path, groups, f"{aircraft.name}: simulated dynamometer, {args.repeats} repeats")


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


def _print(args: Run, aircraft: Aircraft, recording: Recording, found: dict[str, Any] | None) -> None:
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
        print_json(document)
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
    from neuroflight.cli.dyno.repeats import HEADINGS

    if not steps:
        print(title)
        return
    rows = [
        (
            f"{100 * step.level:.0f} %",
            f"{1000 * step.rise:.0f}",
            f"{_step(step)['rpm']:,.0f}",
            f"{step.thrust:.3f}",
            f"{step.torque:.5f}",
        )
        for step in steps
    ]
    print_table(title, [("step to", *HEADINGS[1:]), *rows])


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
