"""Authority, against the twin that turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.control.authority import authority, authority_at
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount

MOTORS, FRACTION = 0.4, 0.002
RATE_HZ = 1000


def settled(aircraft: Aircraft, signs: np.ndarray) -> np.ndarray:
    """The acceleration (3,) [rad/s^2] after 0.9 s in which motors had a fraction more or less."""
    twin = Twin(aircraft, mount=Mount.CENTRE, rate_hz=RATE_HZ, noise=False, rng=np.random.default_rng(1))
    try:
        rates = []
        for _ in range(900):
            twin.step(MOTORS + FRACTION * signs[None])
            rates.append(twin.rate[0].copy())
    finally:
        twin.close()
    return np.asarray((rates[-1] - rates[-2]) * RATE_HZ)


@pytest.mark.parametrize("name", ["nf1", "iris"])
def test_the_twin_turns_by_it(name: str) -> None:
    aircraft = load_aircraft(name)
    # Hubs that are turned through the air brake, and that is not the motors'.
    bare = replace(aircraft.propulsion, drag_coefficient=0.0, rolling_coefficient=0.0)
    aircraft = replace(aircraft, propulsion=bare)
    x, y, _ = aircraft.rotor_positions.T
    known = authority_at(aircraft, MOTORS)
    for axis, signs in enumerate((np.sign(y), -np.sign(x), -aircraft.spins)):
        even = settled(aircraft, np.zeros(4))
        assert settled(aircraft, signs)[axis] - even[axis] == pytest.approx(FRACTION * known[axis], rel=0.01)


def test_over_a_range_it_is_the_mean() -> None:
    aircraft = load_aircraft("nf1")
    values = np.arange(0.105, 0.6, 0.01)
    mean = np.mean([authority_at(aircraft, value) for value in values], axis=0)
    assert authority(aircraft, (0.1, 0.6)) == pytest.approx(mean, rel=1e-3)
    assert np.isfinite(authority_at(aircraft, 1.0)).all() and np.isfinite(authority_at(aircraft, 0.0)).all()
