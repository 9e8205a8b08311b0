"""The battery of a flight: what it gives without load, and its resistance, from logged volts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import NORMAL
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.flight import Flight, Piece
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque

BLOCK_S = 0.5  # over which volts and amperes are averaged: ESCs and the firmware filter both
BLOCKS_MIN = 16
CURRENT_SPREAD = 2.0  # [A], least standard deviation of the current that tells a resistance
LEFT_OUT = 0.03  # relative standard deviation of what is left out: how rotors gain speed, the charge's curve
CELL_FULL, CELL_EMPTY = 4.35, 3.3  # [V] of a cell without load, at most and at least


@dataclass(frozen=True)
class Sag:
    """Figures of a pack over a flight."""

    rest: float  # [V] without load at the beginning
    resistance: float  # [ohm]
    low: float  # the 95 % interval of it
    high: float
    current: float  # [A], mean
    current_from: str  # "logged", or "by the file's motors"
    cells: int | None  # in series, as far as `rest` tells; None: it may be several


def find_sag(flights: Sequence[Flight], aircraft: Aircraft) -> Sag | None:
    """Fit volts to amperes and to the charge used; None where a log has no volts, or hardly any sag."""
    rows = [
        each
        for flight in flights
        for piece in flight.pieces
        if (each := _blocks(piece, aircraft)) is not None and flight.has_voltage
    ]
    if not rows or aircraft.battery is None:
        return None
    volts, current, used = (np.concatenate(each) for each in zip(*rows, strict=True))
    if len(volts) < BLOCKS_MIN or current.std() < CURRENT_SPREAD:
        return None
    columns = np.column_stack([np.ones(len(volts)), -used, -current])
    found, *_ = np.linalg.lstsq(columns, volts, rcond=None)
    left = volts - columns @ found
    # Neighbours of a block err alike: the variance is that of sums over four of them.
    inverse = np.linalg.inv(columns.T @ columns)
    scores = columns * left[:, None]
    sums = np.array([part.sum(axis=0) for part in np.array_split(scores, max(4, len(scores) // 4))])
    sigma = float(np.sqrt((inverse @ sums.T @ sums @ inverse)[2, 2]))
    resistance = float(found[2])
    sigma = float(np.hypot(sigma, LEFT_OUT * resistance))
    if not resistance > 0.0:
        return None
    rest = float(found[0])
    cells = {count for count in range(1, 15) if CELL_EMPTY * count <= rest <= CELL_FULL * count}
    return Sag(
        rest=rest,
        resistance=resistance,
        low=resistance - NORMAL * sigma,
        high=resistance + NORMAL * sigma,
        current=float(current.mean()),
        current_from="by the file's motors",
        cells=None if aircraft.battery.cells in cells or not cells else min(cells),
    )


def _blocks(piece: Piece, aircraft: Aircraft) -> tuple[Array, Array, Array] | None:
    """Return volts, amperes and charge used [A s] of each block of a piece in the air."""
    if piece.voltage is None or aircraft.battery is None:
        return None
    propulsion = aircraft.propulsion
    supplied = piece.voltage if propulsion.supply_voltage is not None else None
    speed = target_speed(piece.motors, propulsion, None if supplied is None else supplied[:, None])
    torque = thrust_and_torque(np.ascontiguousarray(speed), propulsion)[1]
    power = (speed * torque).sum(axis=1) / propulsion.efficiency + aircraft.battery.electronics_power
    current = power / np.maximum(piece.voltage, 1.0)
    size = max(1, round(BLOCK_S / piece.step_s))
    count = len(current) // size
    if count < 2:
        return None
    used = np.cumsum(current) * piece.step_s

    def mean(values: Array) -> Array:
        return np.asarray(values[: count * size].reshape(count, size).mean(axis=1))

    flown = mean(piece.flown.astype(float)) > 0.99
    return mean(piece.voltage)[flown], mean(current)[flown], mean(used)[flown]
