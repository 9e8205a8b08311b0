"""`neuroflight aircraft noise`: measure the noise of a real aircraft's gyro for its twin."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli.aircraft.recordings import FORMS, OfGyroLog
from neuroflight.cli.options import Json, picture
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.gyro_noise import Noise, SensorNoise

BIAS_NOTE = (
    "bias_deg_s is the spread of a bias that is drawn anew for each episode, not the mean of this log: that "
    "mean is one day's draw, and a policy would learn it by heart. It is given as the RMS of the three "
    "means, known to about 40 % from one log; logs of several days tell it better."
)


@dataclass(frozen=True, kw_only=True)
class MeasureNoise(OfGyroLog):
    """A request for the noise of a gyro and an accelerometer at rest."""

    log: Annotated[Path, Argument("LOG", "the log")]
    write: Annotated[Path | None, Option("AIRCRAFT.toml", "put noise and bias into this aircraft file")] = (
        None
    )
    plot: Annotated[Path | None, picture("draw Allan deviation and histogram")] = None
    json: Json = False

    more: ClassVar[str] = (
        f": {FORMS}. Record a minute or longer on the ground; armed and idling, without propellers, the "
        f"motors' vibration is in it. {BIAS_NOTE}"
    )

    def run(self) -> int:
        """Measure, write the outputs, print the figures. Returns 0."""
        chosen = self.choice

        from rich.console import Console

        from neuroflight.sim.aircraft.edit import edit_aircraft
        from neuroflight.sim.aircraft.known import SOURCE_MAX, How, Known
        from neuroflight.sim.identification.gyro_noise import (
            aircraft_keys,
            doubts,
            measure_noise,
            resting_part,
        )
        from neuroflight.sim.identification.gyro_noise_plot import draw_noise
        from neuroflight.sim.identification.recording import read_recording
        from neuroflight.sim.plotting import png
        from neuroflight.toolchain.files import write_bytes

        console = Console(stderr=True, quiet=self.json or not sys.stderr.isatty())
        with console.status("reading the log") as status:
            recording = read_recording(self.log, chosen)
            status.update(f"measuring {len(recording.gyro):,} samples")
            noise = measure_noise(recording)
            rest = resting_part(recording) if noise.moved else None
            if self.write and noise.moved:
                raise NeuroflightError(
                    f"{self.log}: the aircraft moved, its figures are not noise alone and are not written to "
                    f"{self.write}; {_part_at_rest(rest, self) or 'record it at rest on the ground'}"
                )
            what = "not at rest" if noise.moved else "noise at rest"
            picture = png(draw_noise(noise, recording, f"{self.log.name}: {what}")) if self.plot else b""
        if self.write:
            mark = Known(How.MEASURED, None, f"{self.log.name} at rest"[:SOURCE_MAX])
            keys = aircraft_keys(noise)
            known = {f"{table}.{key}": mark for table, values in keys.items() for key in values}
            edit_aircraft(self.write, keys, known=known)
        if self.plot:
            write_bytes(self.plot, picture)
        warnings = [*doubts(noise), *recording.notes]
        if hint := _part_at_rest(rest, self):
            warnings.append(hint)
        if self.json:
            print_json(_document(self, noise, warnings))
        else:
            _print(self, noise, warnings)
        return 0


def _part_at_rest(rest: tuple[float, float] | None, args: MeasureNoise) -> str:
    """Return how to choose the part at rest of a log that also has flight; "" if no part is at rest."""
    if rest is None:
        return ""
    first, end = ((args.start or 0.0) + second for second in rest)
    return f"it is at rest from {first:.1f} to {end:.1f} s: --from {first:.1f} --to {end:.1f}"


def _document(args: MeasureNoise, noise: Noise, warnings: list[str]) -> dict[str, Any]:
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


def _print(args: MeasureNoise, noise: Noise, warnings: list[str]) -> None:
    from neuroflight.sim.identification.gyro_noise import aircraft_keys
    from neuroflight.toolchain.contract import AXES

    rows = [("", *(f"{letter}, {axis}" for letter, axis in zip("xyz", AXES, strict=True)))]
    sensors = [("gyro", "deg/s", noise.gyro, math.degrees(1.0))]
    if noise.accelerometer is not None:
        sensors.append(("accelerometer", "m/s²", noise.accelerometer, 1.0))
    for name, unit, sensor, scale in sensors:
        rows.append((f"{name}, {unit}", "", "", ""))
        for label, values in (
            ("sigma of a sample", scale * sensor.sigma),
            ("mean", scale * sensor.mean),
            ("white noise, per √Hz", scale * sensor.density),
            ("neighbours correlate", sensor.lag),
        ):
            rows.append((f"  {label}", *(f"{value:.4f}" for value in values)))
        least = zip(scale * sensor.instability, sensor.floor, strict=True)
        shown = (f"{'' if found else '< '}{value:.4f}" for value, found in least)
        rows.append(("  bias instability", *shown))
        rows.append(("  averaged over, s", *(f"{value:.2g}" for value in sensor.instability_s)))
    rate = f"{noise.duration:.1f} s at {noise.rate_hz:,.1f} a second"
    print_table(f"{args.log.name}: {noise.samples:,} samples, {rate}", rows)
    for doubt in warnings:
        print(f"warning: {doubt}")
    if noise.moved:
        return
    print(f"\n{f'written to {args.write}' if args.write else 'for an aircraft file'}:")
    for table, keys in aircraft_keys(noise).items():
        print(f"  [{table}]")
        for key, value in keys.items():
            print(f"  {key} = {list(value) if isinstance(value, tuple) else value}")
    print(BIAS_NOTE)
