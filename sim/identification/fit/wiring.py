"""Motor order from a log: which rotor each logged motor drives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array, Flags
from neuroflight.sim.identification.fit.estimate import Data, Wiring
from neuroflight.sim.identification.fit.held import straight
from neuroflight.sim.identification.fit.model import Layout
from neuroflight.sim.physics.rotor import thrust_and_torque

CHANGE_S = 0.02  # over which a rate's change is compared: shorter holds gyro noise, longer holds drag
MOTORS_MAX = 6  # of which all orders are tried
BETTER = 0.06  # share of the variance that another order has to explain more


def find_wiring(data: Sequence[Data], aircraft: Aircraft, laid: Layout, theta: Array) -> Wiring:
    """Find the order that explains the rates' changes best; the file's where none is better."""
    products, powers = _products(data, aircraft, laid, theta)
    places, spins = aircraft.rotor_positions, aircraft.spins
    usual = straight(aircraft)

    def share(order: Sequence[int]) -> float:
        """Return the explained share of the three axes, -1 where roll or pitch turns backwards."""
        levers = np.stack([places[list(order), 1], -places[list(order), 0], -spins[list(order)]])
        total = 0.0
        for axis in range(3):
            matrix, right = products[axis]
            own = float(levers[axis] @ right)
            if own <= 0.0 and axis < 2:
                return -1.0
            total += own**2 / max(float(levers[axis] @ matrix @ levers[axis]) * powers[axis], 1e-30)
        return total

    order = usual.order
    if len(order) <= MOTORS_MAX:
        best = max(permutations(range(len(order))), key=share)
        if share(best) > share(order) + BETTER:
            order = best
    return Wiring(tuple(order), tuple(spins[list(order)].tolist()))


def _products(
    data: Sequence[Data], aircraft: Aircraft, laid: Layout, theta: Array
) -> tuple[list[tuple[Array, Array]], Array]:
    """Return for each axis the products of the motors' changes with each other and with the rates'."""
    motors = aircraft.motor_count
    found = [(np.zeros((motors, motors)), np.zeros(motors)) for _ in range(3)]
    powers = np.zeros(3)
    for one in data:
        model = one.model
        speeds = model.speeds(laid.values(theta))
        thrust, torque = thrust_and_torque(np.ascontiguousarray(speeds), aircraft.propulsion)
        rows = max(1, round(CHANGE_S / model.piece.step_s))
        whole = one.used[rows:] & one.used[:-rows]

        def changes(course: Array, rows: int = rows, whole: Flags = whole) -> Array:
            level = (course[rows:] - course[:-rows])[whole]
            return np.asarray(level - level.mean(axis=0))

        sources = []
        for load in (thrust, torque):
            sums = 0.5 * model.dt * (load[1:] + load[:-1])
            sources.append(changes(one.heard(model.course(sums))))
        rates = changes(model.measured)
        for axis in range(3):
            source = sources[axis == 2]
            found[axis][0][:] += source.T @ source
            found[axis][1][:] += source.T @ rates[:, axis]
        powers += (rates**2).sum(axis=0)
    return found, powers
