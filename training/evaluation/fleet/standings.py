"""Standings of controllers over the fleet: ratios of the first one's figures to each rival's, by class."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.training.evaluation.fleet.arena import Figures
from neuroflight.training.evaluation.fleet.unseen import Unseen

MEAN_RATIO_MAX = 0.9  # of MAE and MSE, against each rival that has not seen the aircraft
OWN_RATIO_MAX = 1.25  # against a policy that was trained on it
WORST_RATIO_MAX = 1.3  # on any aircraft
EVERY = "all"  # of the classes

Flown = Mapping[str, Mapping[str, Figures]]  # figures by name of the aircraft and kind of flight


@dataclass(frozen=True)
class Ratios:
    """Ratios of one controller's figures to a rival's, over the aircraft that neither loses."""

    mae: float  # mean of the aircraft's ratios
    mse: float
    change: float  # of the motors'
    worst: float  # largest of both errors' ratios
    worst_on: str  # the aircraft
    count: int  # aircraft
    lost: int  # aircraft that the controller loses
    rival_lost: int

    def document(self) -> dict[str, object]:
        """Return JSON data."""
        return dict(vars(self))


def ratios(own: Flown, rival: Flown, aircraft: Sequence[Unseen], kind: str) -> Ratios | None:
    """Compare two controllers on those of `aircraft` that both flew; None if there are none.

    An aircraft that either loses has no ratio: its errors say nothing but that.
    """
    both = [one.name for one in aircraft if kind in own.get(one.name, {}) and kind in rival.get(one.name, {})]
    if not both:
        return None
    pairs = {name: (own[name][kind], rival[name][kind]) for name in both}
    held = {name: (a, b) for name, (a, b) in pairs.items() if not (a.lost or b.lost)}
    lost, rival_lost = (sum(bool(pair[which].lost) for pair in pairs.values()) for which in (0, 1))
    if not held:
        return Ratios(np.nan, np.nan, np.nan, np.nan, "", 0, lost, rival_lost)
    mae, mse, change = (
        np.array([getattr(a, figure) / max(getattr(b, figure), 1e-9) for a, b in held.values()])
        for figure in ("mae", "mse", "change")
    )
    worst = np.maximum(mae, mse)
    return Ratios(
        mae=float(mae.mean()),
        mse=float(mse.mean()),
        change=float(change.mean()),
        worst=float(worst.max()),
        worst_on=list(held)[int(worst.argmax())],
        count=len(held),
        lost=lost,
        rival_lost=rival_lost,
    )


@dataclass(frozen=True)
class Absolute:
    """Figures of one controller, mean over the aircraft that it does not lose."""

    mae: float  # [deg/s]
    mse: float  # [deg^2/s^2]
    change: float
    standing: float  # [deg/s]
    swing: float  # [deg/s]
    overshoot: float
    full: float
    drift: float  # [deg]
    count: int  # aircraft
    lost: int  # aircraft
    other_thrust: int  # aircraft on which it does not give the thrust that is wanted

    def document(self) -> dict[str, object]:
        """Return JSON data."""
        return dict(vars(self))


def absolute(own: Flown, aircraft: Sequence[Unseen], kind: str, reached: float) -> Absolute | None:
    """Return the figures over those of `aircraft` that it flew; None if there are none.

    reached: largest distance from a wanted thrust that counts as it.
    """
    all_of_it = [own[one.name][kind] for one in aircraft if kind in own.get(one.name, {})]
    held = [figures for figures in all_of_it if not figures.lost]
    if not all_of_it:
        return None
    means = {
        name: float(np.mean([getattr(figures, name) for figures in held])) if held else float("nan")
        for name in ("mae", "mse", "change", "standing", "swing", "overshoot", "full", "drift")
    }
    return Absolute(
        **means,
        count=len(all_of_it),
        lost=len(all_of_it) - len(held),
        other_thrust=sum(figures.off > reached for figures in held),
    )


def worst(own: Flown, rivals: Sequence[Flown], aircraft: Sequence[Unseen], kind: str) -> list[Unseen]:
    """Return the aircraft by the largest ratio of errors to any rival, worst first; lost ones before all."""

    def bad(one: Unseen) -> float:
        figures = own.get(one.name, {}).get(kind)
        if figures is None:
            return 0.0
        if figures.lost:
            return np.inf
        others = [rival[one.name][kind] for rival in rivals if kind in rival.get(one.name, {})]
        found = [max(figures.mae / other.mae, figures.mse / other.mse) for other in others if not other.lost]
        return max(found, default=0.0)

    return sorted(aircraft, key=bad, reverse=True)
