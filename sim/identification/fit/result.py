"""Parameters of a fit, with intervals and what speaks for each, and what logs cannot tell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.estimate import Estimate, Wiring
from neuroflight.sim.identification.fit.model import Layout
from neuroflight.toolchain.contract import AXES


@dataclass(frozen=True)
class Parameter:
    """One parameter of the loop."""

    key: str
    words: str
    unit: str
    start: float  # the start file's
    value: float
    low: float  # the 95 % interval
    high: float
    told: bool  # whether the log tells it well enough to be written
    data: str  # what speaks for it
    manoeuvre: str = ""  # that would tell it, or tell it better

    @property
    def text(self) -> str:
        """Its value and interval, as one reads them."""
        return f"{self.value:.4g} ({self.low:.4g} to {self.high:.4g}) {self.unit}".rstrip()


@dataclass(frozen=True, eq=False)
class Fit:
    """A twin's parameters from flights."""

    name: str  # of the logs
    parameters: Mapping[str, Parameter]
    explained: Array  # (3,) share of what the sticks did that is predicted, on data held back; NaN: little
    explained_start: Array  # (3,) by the start file
    order: tuple[int, ...]  # rotor of the start file that each logged motor drives
    spins: tuple[float, ...]  # of these, +1 counter-clockwise
    props_out: bool  # all turn the other way than in the start file
    notes: tuple[str, ...]
    seconds: float  # that were flown and taken
    layout: Layout
    estimate: Estimate
    wiring: Wiring
    theta: Mapping[str, float]
    usual: Array  # (M,) motor values that authority is told at
    volts: float | None  # mean of the flights
    thrust: float | None = None  # K_T over the start's, by the accelerometer and the weight; None: not told

    @property
    def cannot(self) -> tuple[tuple[str, str], ...]:
        """The parameters that these logs cannot tell, each with the manoeuvre that would."""
        return tuple((one.words, one.manoeuvre) for one in self.parameters.values() if not one.told)

    @property
    def rewired(self) -> bool:
        """True if motors are in another order than in the start file."""
        return self.order != tuple(range(len(self.order)))

    def document(self) -> dict[str, Any]:
        """Return the fit as JSON takes it."""
        return {
            "logs": self.name,
            "seconds": self.seconds,
            "parameters": {
                key: {
                    "value": one.value,
                    "range": [one.low, one.high],
                    "start": one.start,
                    "unit": one.unit,
                    "told": one.told,
                    "data": one.data,
                    **({"manoeuvre": one.manoeuvre} if one.manoeuvre else {}),
                }
                for key, one in self.parameters.items()
            },
            "explained": _shares(self.explained),
            "explained_start": _shares(self.explained_start),
            "motor_order": [rotor + 1 for rotor in self.order],
            "props_out": self.props_out,
            "notes": list(self.notes),
        }


def _shares(shares: Array) -> list[float | None]:
    return [None if np.isnan(share) else round(float(share), 4) for share in shares]


def share_words(shares: Array) -> str:
    """Say how much of what the sticks did is predicted, by axis, as a pilot reads it."""
    words = [
        f"{axis} too little to tell" if np.isnan(share) else f"{axis} {100 * max(0.0, float(share)):.0f} %"
        for axis, share in zip(AXES, shares, strict=True)
    ]
    return ", ".join(words)
