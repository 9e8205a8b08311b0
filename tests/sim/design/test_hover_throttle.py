"""The throttle that `fly` takes for a hover holds the weight in the twin, of any aircraft and idle."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.design.figures import hover_throttle
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY


@pytest.mark.parametrize("name", ["nf1", "hexa", "iris"])
@pytest.mark.parametrize("idle", [0.0, 0.055, 0.12])
def test_the_throttle_at_hover_neither_climbs_nor_sinks(name: str, idle: float) -> None:
    aircraft = load_aircraft(name)
    throttle = hover_throttle(aircraft, idle)
    assert throttle is not None and 0.0 < throttle < 1.0
    fallen = []
    for level in (throttle, 0.9 * throttle):
        motors = np.full((1, aircraft.motor_count), idle + (1.0 - idle) * level)
        with closing(
            Twin(aircraft, rate_hz=1000, mount=Mount.FREE, noise=False, rng=np.random.default_rng(1))
        ) as twin:
            for _ in range(1000):  # the rotors come up to speed
                twin.step(motors)
            before = float(twin.live.velocity[0, 2])
            for _ in range(500):
                twin.step(motors)
            fallen.append((before - float(twin.live.velocity[0, 2])) / (0.5 * GRAVITY))
    assert abs(fallen[0]) < 0.02 < 0.05 < fallen[1]
