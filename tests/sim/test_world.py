"""The pybullet world against the rigid-body equations."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from sim.aircraft import load_aircraft
from sim.world import COUNT_MAX, GRAVITY, Mount, World

NF1 = load_aircraft("nf1")
MASS, INERTIA = NF1.mass_properties.mass, NF1.mass_properties.inertia
ARM = NF1.mass_properties.centre - np.array(NF1.centre_of_thrust)  # pivot to centre of mass
RIG_INERTIA = INERTIA + MASS * (ARM @ ARM * np.eye(3) - np.outer(ARM, ARM))

Build = Callable[..., World]


@pytest.fixture
def build() -> Iterator[Build]:
    worlds = []

    def make(count: int, mount: Mount, gravity: bool = False, dt: float = 0.001) -> World:
        worlds.append(World(NF1, count, dt, mount, gravity))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


def moment(x: float, y: float, z: float, count: int = 1) -> np.ndarray:
    wrench = np.zeros((count, 6))
    wrench[:, 3:] = x, y, z
    return wrench


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize("axis", range(3))
def test_a_moment_accelerates_its_own_axis_by_the_inertia(build: Build, mount: Mount, axis: int) -> None:
    world = build(1, mount)
    inertia = RIG_INERTIA if mount is Mount.RIG else INERTIA
    push = np.zeros(3)
    push[axis] = 1e-3
    for _ in range(100):
        world.step(moment(*push))
    expected = np.zeros(3)
    expected[axis] = 0.1 * 1e-3 / inertia[axis, axis]
    assert world.rate[0] == pytest.approx(expected, rel=1e-4, abs=1e-4)


def test_rates_stay_body_rates_when_turned_about_a_tilted_axis(build: Build) -> None:
    """A body moment keeps its axis when the body turns: yaw while rolled by a quarter turn."""
    world = build(1, Mount.CENTRE)
    while world.rotation[0, 2, 2] > 0.0:  # rolls until body z is level
        world.step(moment(5e-3, 0.0, 0.0))
    spin = world.rate[0, 0]
    for _ in range(20):
        world.step(moment(0.0, 0.0, 5e-3))
    assert world.rate[0, 2] == pytest.approx(0.020 * 5e-3 / INERTIA[2, 2], rel=0.02)
    assert world.rate[0, 0] == pytest.approx(spin, rel=0.01)


def test_momentum_is_kept_within_pybullets_own_drift_when_tumbling_freely(build: Build) -> None:
    world = build(1, Mount.CENTRE)
    for _ in range(300):
        world.step(moment(0.01, 0.02, 0.005))
    start = world.rotation[0] @ INERTIA @ world.rate[0]
    for _ in range(1000):
        world.step(np.zeros((1, 6)))
    drift = np.linalg.norm(world.rotation[0] @ INERTIA @ world.rate[0] - start) / np.linalg.norm(start)
    assert drift < 0.005  # 0.24 % a second is known of pybullet at 1 ms


def test_pendulum_swings_at_its_own_period_when_the_rig_has_gravity(build: Build) -> None:
    world = build(1, Mount.RIG, gravity=True)
    for _ in range(50):
        world.step(moment(1e-3, 0.0, 0.0))
    crossings, before = [], world.rate[0, 0]
    for step in range(3000):
        world.step(np.zeros((1, 6)))
        if before < 0 <= world.rate[0, 0]:
            crossings.append(step)
        before = world.rate[0, 0]
    period = 0.001 * float(np.mean(np.diff(crossings)))
    length = float(np.linalg.norm(ARM))
    assert period == pytest.approx(
        2 * np.pi * np.sqrt(RIG_INERTIA[0, 0] / (MASS * GRAVITY * length)), rel=0.01
    )


def test_falls_freely_when_loose_and_holds_still_when_not(build: Build) -> None:
    free, centre, rig = (build(1, mount, gravity=True) for mount in (Mount.FREE, Mount.CENTRE, Mount.RIG))
    for _ in range(500):
        free.step(np.zeros((1, 6)))
        rig.step(np.zeros((1, 6)))
        centre.step(np.zeros((1, 6)))
    assert free.velocity[0] == pytest.approx([0.0, 0.0, -GRAVITY * 0.5])
    assert free.position[0, 2] == pytest.approx(-GRAVITY * 0.125, rel=0.01)
    assert centre.position[0] == pytest.approx(np.zeros(3))
    assert rig.rate[0] == pytest.approx(np.zeros(3), abs=1e-6)


def test_copies_do_not_feel_each_other(build: Build) -> None:
    alone, many = build(1, Mount.CENTRE), build(5, Mount.CENTRE)
    pushes = np.zeros((5, 6))
    pushes[:, 3] = [0.0, 1e-3, 2e-3, -1e-3, 5e-4]
    for _ in range(200):
        alone.step(pushes[2:3])
        many.step(pushes)
    assert np.array_equal(many.rate[2], alone.rate[0])
    assert many.rate[0] == pytest.approx(np.zeros(3))


def test_reset_touches_only_the_aircraft_it_names(build: Build) -> None:
    world = build(3, Mount.CENTRE)
    for _ in range(50):
        world.step(moment(1e-3, 2e-3, 3e-3, 3))
    moving = world.rate[2].copy()
    world.reset([0, 1])
    assert world.rate[:2] == pytest.approx(np.zeros((2, 3)))
    assert world.rotation[0] == pytest.approx(np.eye(3))
    assert np.array_equal(world.rate[2], moving)


@pytest.mark.parametrize("count", [0, -1, COUNT_MAX + 1])
def test_refuses_a_count_that_does_not_fit(count: int) -> None:
    with pytest.raises(ValueError, match=f"got {count} aircraft"):
        World(NF1, count, 0.001, Mount.CENTRE, False)
