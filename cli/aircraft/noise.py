"""`neuroflight aircraft noise`: measure the noise of a real aircraft's gyro for its twin."""

from __future__ import annotations

import argparse
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.aircraft.recordings import FORMS, add_choice, choice
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.gyro_noise import Noise, SensorNoise

BIAS_NOTE = (
    "bias_deg_s is the spread of a bias that is drawn anew for each episode, not the mean of this log: that "
    "mean is one day's draw, and a policy would learn it by heart. It is given as the RMS of the three "
    "means, known to about 40 % from one log; logs of several days tell it better."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the log, the choice of its parts, and the outputs."""
    parser.description = (
        f"{parser.description}: {FORMS}. Record a minute or longer on the ground; armed and idling, without "
        f"propellers, the motors' vibration is in it. {BIAS_NOTE}"
    )
    parser.add_argument("log", type=Path, metavar="LOG", help="the log")
    add_choice(parser)
    parser.add_argument(
        "--write", type=Path, metavar="AIRCRAFT.toml", help="put noise and bias into this aircraft file"
    )
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="draw Allan deviation and histogram")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Measure, write the outputs, print the figures. Returns 0."""
    from neuroflight.cli.output import check_output

    check_output(args.plot, ".png")
    chosen = choice(args)

    from rich.console import Console

    from neuroflight.sim.aircraft.edit import edit_aircraft
    from neuroflight.sim.identification.gyro_noise import aircraft_keys, doubts, measure_noise, resting_part
    from neuroflight.sim.identification.gyro_noise_plot import draw_noise
    from neuroflight.sim.identification.recording import read_recording
    from neuroflight.sim.plotting import png
    from neuroflight.toolchain.files import write_bytes

    console = Console(stderr=True, quiet=args.json or not sys.stderr.isatty())
    with console.status("reading the log") as status:
        recording = read_recording(args.log, chosen)
        status.update(f"measuring {len(recording.gyro):,} samples")
        noise = measure_noise(recording)
        rest = resting_part(recording) if noise.moved else None
        if args.write and noise.moved:
            raise NeuroflightError(
                f"{args.log}: the aircraft moved, its figures are not noise alone and are not written to "
                f"{args.write}; {_part_at_rest(rest, args) or 'record it at rest on the ground'}"
            )
        what = "not at rest" if noise.moved else "noise at rest"
        picture = png(draw_noise(noise, recording, f"{args.log.name}: {what}")) if args.plot else b""
    if args.write:
        edit_aircraft(args.write, aircraft_keys(noise))
    if args.plot:
        write_bytes(args.plot, picture)
    warnings = [*doubts(noise), *recording.notes]
    if hint := _part_at_rest(rest, args):
        warnings.append(hint)
    if args.json:
        print(json.dumps(_document(args, noise, warnings), indent=2))
    else:
        _print(args, noise, warnings)
    return 0


def _part_at_rest(rest: tuple[float, float] | None, args: argparse.Namespace) -> str:
    """Return how to choose the part at rest of a log that also has flight; "" if no part is at rest."""
    if rest is None:
        return ""
    first, end = (args.start + second for second in rest)
    return f"it is at rest from {first:.1f} to {end:.1f} s: --from {first:.1f} --to {end:.1f}"


def _document(args: argparse.Namespace, noise: Noise, warnings: list[str]) -> dict[str, Any]:
    from neuroflight.sim.identification.gyro_noise import aircraft_keys

    return {
        "log": str(args.log),
        "rate_hz": noise.rate_hz,
        "samples": noise.samples,
        "duration_s": noise.duration,
        "gaps": noise.gaps,
        "moved": noise.moved,
        "warnings": warnings,
        "gyro_deg_s": _figures(noise.gyro, math.degrees(1.0)),
        "accelerometer_m_s2": _figures(noise.accelerometer, 1.0) if noise.accelerometer else None,
        "aircraft": None if noise.moved else aircraft_keys(noise),
        "written": str(args.write) if args.write else None,
    }


def _figures(sensor: SensorNoise, scale: float) -> dict[str, Any]:
    return {
        "mean": (scale * sensor.mean).tolist(),
        "sigma": (scale * sensor.sigma).tolist(),
        "rounded_to": (scale * sensor.step).tolist(),
        "lag_1_autocorrelation": sensor.lag.tolist(),
        "bandwidth_hz": [None if math.isnan(value) else value for value in sensor.bandwidth_hz.tolist()],
        "density_per_sqrt_hz": (scale * sensor.density).tolist(),
        "bias_instability": (scale * sensor.instability).tolist(),
        "bias_instability_at_s": sensor.instability_s.tolist(),
        "bias_instability_is_upper_bound": [not found for found in sensor.floor.tolist()],
        "allan": {"tau_s": sensor.tau.tolist(), "deviation": (scale * sensor.deviation).T.tolist()},
    }


def _print(args: argparse.Namespace, noise: Noise, warnings: list[str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from neuroflight.sim.identification.gyro_noise import aircraft_keys
    from neuroflight.toolchain.contract import AXES

    title = (
        f"{args.log.name}: {noise.samples:,} samples, {noise.duration:.1f} s at {noise.rate_hz:,.1f} a second"
    )
    shown = Table(box=None, pad_edge=False)
    for number, heading in enumerate(
        ("", *(f"{letter}, {axis}" for letter, axis in zip("xyz", AXES, strict=True)))
    ):
        shown.add_column(heading, justify="right" if number else "left")
    sensors = [("gyro", "deg/s", noise.gyro, math.degrees(1.0))]
    if noise.accelerometer is not None:
        sensors.append(("accelerometer", "m/s²", noise.accelerometer, 1.0))
    for name, unit, sensor, scale in sensors:
        rows = (
            ("  sigma of a sample", scale * sensor.sigma),
            ("  mean", scale * sensor.mean),
            ("  white noise, per √Hz", scale * sensor.density),
            ("  neighbours correlate", sensor.lag),
        )
        shown.add_row(Text(f"{name}, {unit}", style="bold"))
        for label, values in rows:
            shown.add_row(label, *(f"{value:.4f}" for value in values))
        least = zip(scale * sensor.instability, sensor.floor, strict=True)
        shown.add_row(
            "  bias instability", *(f"{'' if found else '< '}{value:.4f}" for value, found in least)
        )
        shown.add_row("  averaged over, s", *(f"{value:.2g}" for value in sensor.instability_s))
    console = Console()
    console.print(Text(title))
    console.print(shown)
    for doubt in warnings:
        console.print(Text(f"warning: {doubt}"))
    if noise.moved:
        return
    console.print(Text(f"\n{'written to ' + str(args.write) if args.write else 'for an aircraft file'}:"))
    for table, keys in aircraft_keys(noise).items():
        console.print(Text(f"  [{table}]"))
        for key, value in keys.items():
            console.print(Text(f"  {key} = {list(value) if isinstance(value, tuple) else value}"))
    console.print(Text(BIAS_NOTE))
