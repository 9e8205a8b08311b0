"""The share of the variance of a flight's rates that an aircraft file, or a fit, predicts.

Rates are compared less their mean over SLOW_S, so that moments that stand or change slowly count for nobody.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.fit.estimate import Data, Wiring, prepare, say
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.model import Layout, layout, turned

SLOW_S = 0.4
HELD_S, HELD_PARTS = (
    5.0,
    8,
)  # length of the stretches, every fourth of which is held back; so many in a short log
HELD_OF = 4


def held_back(flight: Flight, times: Array) -> Flags:
    """Return which rows at `times` [s] of a flight are held back: a quarter of it, in stretches."""
    last = flight.pieces[-1]
    stretch = min(HELD_S, (last.start_s + last.seconds) / HELD_PARTS)
    return np.asarray((times // stretch).astype(int) % HELD_OF == HELD_OF - 1)


def straight(aircraft: Aircraft) -> Wiring:
    """Return the wiring as the file has it."""
    return Wiring(tuple(range(aircraft.motor_count)), tuple(aircraft.spins.tolist()))


def predict(data: Data, laid: Layout, theta: Array, wiring: Wiring) -> tuple[Array, Array]:
    """Return measured and predicted rates (N, 3) [rad/s] of a piece, both behind the fit's high-pass."""
    model, values = data.model, laid.values(theta)
    said, _, _ = say(model, values, wiring)
    return model.measured, data.heard(turned(model.course(said), values))


def explained(
    flights: Sequence[Flight],
    aircraft: Aircraft,
    keep: Callable[[Flight, Array], Flags] | None = None,
    fitted: tuple[Layout, Array, Wiring] | None = None,
) -> Array:
    """Compute the share (3,) of the variance of the rates, less their slow part, that is predicted.

    By an aircraft as its file says, or by the parameters `fitted` of a fit that started there. keep: which
    rows at times (N,) [s] of a flight count, all unless given.
    """
    if fitted is None:
        laid = layout(aircraft, speeds=False)
        fitted = laid, laid.start, straight(aircraft)
    turns: list[Array] = []
    left: list[Array] = []
    for data in prepare(flights, aircraft, keep):
        measured, said = predict(data, *fitted)
        width = round(SLOW_S / data.model.piece.step_s) | 1
        if len(measured) <= width:
            continue
        whole = quick(data.used[:, None].astype(float), width)[1][:, 0] > 1.0 - 1e-9
        turns.append(quick(measured, width)[0][whole])
        left.append(quick(measured - said, width)[0][whole])
    if not sum(map(len, turns)):
        return np.full(3, np.nan)
    total = np.maximum(np.concatenate(turns).var(axis=0), 1e-12)
    return np.asarray(1.0 - np.concatenate(left).var(axis=0) / total)


def quick(rates: Array, width: int) -> tuple[Array, Array]:
    """Return rates (N, K) less their mean over `width` rows around, and that mean, where all are there."""
    sums = np.cumsum(np.vstack([np.zeros(rates.shape[1]), rates]), axis=0)
    mean = (sums[width:] - sums[:-width]) / width
    return rates[width // 2 : width // 2 + len(mean)] - mean, mean
