"""The PID that stands beside the policy in an image: the aircraft's gains as C.

`sim.control.pid_table` reads them from an aircraft; this room only knows the numbers. The twin's PIDs
(`sim.control.pid`) are given the same ones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.rendering.jinja import render

SCALE = 1e-3  # motor fraction of one unit of the sum in deg/s; Koch 2019, ch. 5, after Betaflight's mixer
INTEGRAL_OUTPUT_MAX = 1.0  # motor fraction that the integral alone may ask for


@dataclass(frozen=True)
class PidTable:
    """A PID as an aircraft file has it."""

    aircraft: str
    name: str  # of the PID in that file
    gains: NDArray[np.float64]  # (3, 3): roll, pitch, yaw by K_P, K_I, K_D, on the error in deg/s
    derivative_cutoff_hz: float | None
    idle: float
    mixer: NDArray[np.float64]  # (M, 3): share of each motor in roll, pitch, yaw
    tpa_rate: float = 0.0  # part of K_D that full throttle takes away
    tpa_breakpoint: float = 0.0  # throttle where that begins, 0..1
    nominal_voltage: float | None = None  # [V] that the gains were found with; None: not compensated
    mix: Mix = Mix.ATTITUDE_FIRST  # of its outputs with the pilot's thrust

    @property
    def motor_count(self) -> int:
        """Number of motors M."""
        return len(self.mixer)


def render_pid_table(table: PidTable | None, motors: int, control_rate_hz: int) -> str:
    """Render pid_table.c for a firmware of `motors` motors; table None: no PID is built in.

    Raises ValueError if the table is another aircraft's.
    """
    if table is not None and table.motor_count != motors:
        raise ValueError(f"the PID of {table.aircraft} drives {table.motor_count} motors, expected {motors}")
    if table is None:
        return render("pid_table.c.j2", table=None)
    numbers = pid_gains(table, control_rate_hz)
    shares = numbers.pop("mixer")
    return render(
        "pid_table.c.j2",
        table={
            "aircraft": table.aircraft,
            "name": table.name,
            "motor_count": table.motor_count,
            "mix": f"NF_MIX_{table.mix.name}",
            "numbers": {name: _written(value) for name, value in numbers.items()},
            "mixer": [_written(share) for share in shares],
        },
    )


def pid_gains(table: PidTable, control_rate_hz: int) -> dict[str, NDArray[np.float32]]:
    """Return the float members of struct pid_gains, rounded once: radians where the file has degrees."""
    p, i, d = table.gains.T * SCALE * math.degrees(1.0)
    with np.errstate(divide="ignore"):
        integral_max = np.where(i > 0, INTEGRAL_OUTPUT_MAX / i, 0.0)
    cutoff = table.derivative_cutoff_hz
    numbers = {
        "idle": table.idle,
        "p": p,
        "i": i,
        "d": d,
        "integral_max": integral_max,
        "period_s": 1.0 / control_rate_hz,
        "smoothing": 1.0 if cutoff is None else -math.expm1(-math.tau * cutoff / control_rate_hz),
        "tpa_breakpoint": table.tpa_breakpoint,
        "tpa_slope": table.tpa_rate / (1.0 - table.tpa_breakpoint),
        "nominal_voltage": table.nominal_voltage or 0.0,
        "mixer": table.mixer,
    }
    return {name: np.asarray(value, np.float32) for name, value in numbers.items()}


def _written(value: NDArray[np.float32]) -> str:
    """Return a number or a row of numbers so that C reads the same ones."""
    texts = [f"{number!r}f" for number in value.ravel().tolist()]
    return "{ " + ", ".join(texts) + " }" if value.ndim else texts[0]
