"""The pybullet world against the rigid-body equations."""

from dataclasses import replace

import numpy as np
import pybullet
import pytest
from scipy.integrate import solve_ivp

from neuroflight.sim.aircraft.model import Body, load_aircraft
from neuroflight.sim.physics.world import COUNT_MAX, Held, Mount, World
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError
from tests.sim.physics.flying import repeat

NF1 = load_aircraft("nf1")
MASS, INERTIA = NF1.mass_properties.mass, NF1.mass_properties.inertia
ARM = NF1.mass_properties.centre - np.array(NF1.centre_of_thrust)  # pivot to centre of mass
RIG_INERTIA = INERTIA + MASS * (ARM @ ARM * np.eye(3) - np.outer(ARM, ARM))


def build(count: int, mount: Mount, gravity: bool = False, dt: float = 0.001) -> World:
    return World(NF1, count, dt, mount, gravity)


def moment(x: float, y: float, z: float, count: int = 1) -> np.ndarray:
    wrench = np.zeros((count, 6))
    wrench[:, 3:] = x, y, z
    return wrench


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize("axis", range(3))
def test_a_moment_accelerates_its_own_axis_by_the_inertia(mount: Mount, axis: int) -> None:
    world = build(1, mount)
    inertia = RIG_INERTIA if mount is Mount.RIG else INERTIA
    push = np.zeros(3)
    push[axis] = 1e-3
    repeat(100, world.step, moment(*push))
    expected = np.zeros(3)
    expected[axis] = 0.1 * 1e-3 / inertia[axis, axis]
    assert world.rate[0] == pytest.approx(expected, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("axis", range(3))
def test_a_held_aircraft_swings_as_a_damped_spring_when_it_is_pushed(axis: int) -> None:
    hz, ratio, seconds = 2.0, 0.1, 0.4
    world = World(NF1, 1, 0.0005, Mount.RIG, False, held=Held(hz, ratio))
    push = np.zeros(3)
    push[axis] = 5e-4
    repeat(round(seconds / 0.0005), world.step, moment(*push))
    slow = 2 * np.pi * hz
    free = slow * np.sqrt(1 - ratio**2)
    rate = (
        push[axis] / RIG_INERTIA[axis, axis] * np.exp(-ratio * slow * seconds) / free * np.sin(free * seconds)
    )
    assert world.rate[0, axis] == pytest.approx(rate, rel=0.02)


def test_rates_stay_body_rates_when_turned_about_a_tilted_axis() -> None:
    """A body moment keeps its axis when the body turns: yaw while rolled by a quarter turn."""
    world = build(1, Mount.CENTRE)
    while world.rotation[0, 2, 2] > 0.0:  # rolls until body z is level
        world.step(moment(5e-3, 0.0, 0.0))
    spin = world.rate[0, 0]
    repeat(20, world.step, moment(0.0, 0.0, 5e-3))
    assert world.rate[0, 2] == pytest.approx(0.020 * 5e-3 / INERTIA[2, 2], rel=0.02)
    assert world.rate[0, 0] == pytest.approx(spin, rel=0.01)


def tumbling(world: World, inertia: np.ndarray, seconds: float, dt: float) -> tuple[float, float, float]:
    """Greatest relative change of momentum and energy, and of pybullet's rate against the world's [rad/s].

    11.6 rad/s about an axis that is no principal one.
    """
    axis = np.array([1.0, 2.0, 1.0]) / np.sqrt(6.0)
    world.reset([0], 11.6 * axis[None])
    start, energy = world.rotation[0] @ inertia @ world.rate[0], world.rate[0] @ inertia @ world.rate[0]
    worst = np.zeros(3)
    for _ in range(round(seconds / dt)):
        world.step(np.zeros((1, 6)))
        rate = world.rate[0]
        lost = np.linalg.norm(world.rotation[0] @ inertia @ rate - start) / np.linalg.norm(start)
        apart = np.abs(pybullet_rate(world) - rate).max()
        worst = np.maximum(worst, [lost, abs(rate @ inertia @ rate / energy - 1), apart])
    return float(worst[0]), float(worst[1]), float(worst[2])


def pybullet_rate(world: World) -> np.ndarray:
    """What pybullet itself says, body axes [rad/s]."""
    body, client = world._bodies[0], world._client
    if world.mount is Mount.RIG:
        spin = pybullet.getLinkState(body, 0, 1, 1, client)[7]
    else:
        spin = pybullet.getBaseVelocity(body, client)[1]
    rate: np.ndarray = np.array(spin) @ world.rotation[0]
    return rate


@pytest.mark.parametrize("mount", list(Mount))
def test_momentum_and_energy_are_kept_when_tumbling_for_ten_seconds(mount: Mount) -> None:
    inertia = RIG_INERTIA if mount is Mount.RIG else INERTIA
    momentum, energy, apart = tumbling(build(1, mount), inertia, 10.0, 0.001)
    assert momentum < 1e-12
    assert energy < 1e-5
    # pybullet's rate is that of the middle of the step: half a millisecond of 100 rad/s^2 away, no more.
    assert apart < 0.1


@pytest.mark.parametrize("mount", [Mount.CENTRE, Mount.FREE])
def test_pybullet_turns_the_body_as_its_momentum_says_after_an_error_of_the_rate(mount: Mount) -> None:
    """Rounding of the rate that pybullet keeps grows tenfold in half a minute: here it has grown to 1e-3."""
    world, rng = build(1, mount), np.random.default_rng(5)
    for step in range(2000):
        world.step(moment(*rng.normal(1e-3, 5e-3, 3)))
        if step == 1000:
            world._inner_rate[0] += 1e-3
    turning = np.array(pybullet.getBaseVelocity(int(world._bodies[0]), physicsClientId=world._client)[1])
    assert np.linalg.norm(world.rate[0]) > 1
    np.testing.assert_allclose(world.rotation[0].T @ turning, world._inner_rate[0], rtol=0, atol=1e-9)
    np.testing.assert_allclose(world._inner_rate[0], world.rate[0], rtol=0, atol=0.05)


def test_lopsided_aircraft_keeps_momentum_too() -> None:
    """Principal axes far from the body's, centre of mass off the axis."""
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    inertia = turn @ INERTIA @ turn.T
    centre = np.array([0.01, 0.02, 0.03])
    lopsided = replace(NF1, mass_properties=replace(NF1.mass_properties, inertia=inertia, centre=centre))
    arm = centre - np.array(NF1.centre_of_thrust)
    about_joint = inertia + MASS * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    for mount in Mount:
        world = World(lopsided, 1, 0.001, mount, False)
        moved = tumbling(world, about_joint if mount is Mount.RIG else inertia, 2.0, 0.001)
        assert moved[0] < 1e-12
        assert moved[1] < 1e-5
        assert moved[2] < 0.1


def test_error_falls_with_the_square_of_the_step_when_a_moment_acts() -> None:
    """A moment about all axes of a turning body, against Euler's equations integrated finely."""
    push, start = np.array([0.004, -0.003, 0.002]), np.array([3.0, -4.0, 8.0])
    exact = solve_ivp(
        lambda _, w: np.linalg.solve(INERTIA, push - np.cross(w, INERTIA @ w)),
        (0.0, 1.0),
        start,
        rtol=1e-11,
        atol=1e-11,
    ).y[:, -1]
    errors = []
    for dt in (0.001, 0.0005):
        world = build(1, Mount.CENTRE, dt=dt)
        world.reset([0], start[None])
        repeat(round(1.0 / dt), world.step, moment(*push))
        errors.append(np.linalg.norm(world.rate[0] - exact))
    assert errors[0] < 1e-3  # of 10 rad/s
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_rig_and_free_flight_turn_alike_when_the_joint_is_the_centre_of_mass() -> None:
    centred = replace(NF1, centre_of_thrust=tuple(NF1.mass_properties.centre.tolist()))
    worlds = [World(centred, 1, 0.001, mount, mount is Mount.FREE) for mount in Mount]
    rng = np.random.default_rng(2)
    for _ in range(2000):
        wrench = rng.normal(0.0, 0.02, (1, 6))
        for world in worlds:
            world.step(wrench)
    rates, attitudes = [[getattr(w, name)[0] for w in worlds] for name in ("rate", "rotation")]
    assert np.linalg.norm(rates[0]) > 0.3
    for rate, attitude in zip(rates[1:], attitudes[1:], strict=True):
        assert rate == pytest.approx(rates[0], abs=1e-9)
        assert attitude == pytest.approx(attitudes[0], abs=1e-9)


def test_pendulum_swings_at_its_own_period_when_the_rig_has_gravity() -> None:
    world = build(1, Mount.RIG, gravity=True)
    repeat(50, world.step, moment(1e-3, 0.0, 0.0))
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


def test_falls_freely_when_loose_and_holds_still_when_not() -> None:
    free, centre, rig = (build(1, mount, gravity=True) for mount in (Mount.FREE, Mount.CENTRE, Mount.RIG))
    repeat(500, free.step, np.zeros((1, 6)))
    repeat(500, rig.step, np.zeros((1, 6)))
    repeat(500, centre.step, np.zeros((1, 6)))
    assert free.velocity[0] == pytest.approx([0.0, 0.0, -GRAVITY * 0.5])
    assert free.position[0, 2] == pytest.approx(-GRAVITY * 0.125, rel=0.01)
    assert centre.position[0] == pytest.approx(np.zeros(3))
    assert rig.rate[0] == pytest.approx(np.zeros(3), abs=1e-6)


def test_aircraft_lands_and_stands_when_there_is_ground() -> None:
    """Dropped tilted and turning, it comes to rest on its feet within its own height."""
    body = Body(size=(0.2, 0.16, 0.06), centre=(0.0, 0.0, 0.03), drag_area=(0.0, 0.0, 0.0))
    world = World(replace(NF1, body=body), 2, 0.001, Mount.FREE, True, ground=True)
    standing = world.position[0, 2]
    lift = np.zeros((2, 6))
    lift[1, 2] = 1.5 * MASS * GRAVITY
    lift[1, 3] = 1e-4
    repeat(300, world.step, lift)
    height, turning = world.position[:, 2].copy(), world.rate[1].copy()
    repeat(3000, world.step, np.zeros((2, 6)))
    position, rate, rotation = world.position.copy(), world.rate.copy(), world.rotation.copy()
    assert standing == pytest.approx(NF1.mass_properties.centre[2], abs=1e-9)
    assert height[0] == pytest.approx(standing, abs=1e-3)  # stands still
    assert height[1] > standing + 0.15  # flew
    assert turning[0] > 0.02
    assert position[1, 2] == pytest.approx(standing, abs=2e-3)
    assert rate == pytest.approx(np.zeros((2, 3)), abs=1e-3)
    assert rotation[1, 2, 2] > 0.999


def test_pushed_off_centre_on_the_ground_it_tips_only_when_the_moment_exceeds_the_weight_s() -> None:
    body = Body(size=(0.2, 0.16, 0.06), centre=(0.0, 0.0, 0.03), drag_area=(0.0, 0.0, 0.0))
    tilts = []
    limit = 0.08 * MASS * GRAVITY  # half the width times the weight
    for share in (0.9, 1.1):
        world = World(replace(NF1, body=body), 1, 0.001, Mount.FREE, True, ground=True)
        repeat(300, world.step, moment(share * limit, 0.0, 0.0))
        tilts.append(np.arccos(min(1.0, world.rotation[0, 2, 2])))
    assert tilts[0] < 0.01
    assert tilts[1] > 0.1


def test_ground_is_refused_when_nothing_could_touch_it() -> None:
    with pytest.raises(ValueError, match="only a free aircraft"):
        World(NF1, 1, 0.001, Mount.RIG, True, ground=True)
    with pytest.raises(AircraftError, match=r"no \[body\] table"):
        World(replace(NF1, body=None), 1, 0.001, Mount.FREE, True, ground=True)


def test_copies_do_not_feel_each_other() -> None:
    quiet, busy = build(5, Mount.CENTRE), build(5, Mount.CENTRE)
    pushes = np.zeros((5, 6))
    pushes[2, 3:] = [2e-3, 1e-3, -1e-3]
    others = pushes.copy()
    others[[0, 1, 3, 4], 3] = [5e-3, 1e-3, -1e-3, 5e-4]
    repeat(200, quiet.step, pushes)
    repeat(200, busy.step, others)
    assert np.array_equal(busy.rate[2], quiet.rate[2])
    assert np.array_equal(busy.rotation[2], quiet.rotation[2])
    assert quiet.rate[0] == pytest.approx(np.zeros(3))


def test_reset_touches_only_the_aircraft_it_names() -> None:
    world = build(3, Mount.CENTRE)
    repeat(50, world.step, moment(1e-3, 2e-3, 3e-3, 3))
    moving = world.rate[2].copy()
    world.reset([0, 1])
    assert world.rate[:2] == pytest.approx(np.zeros((2, 3)))
    assert world.rotation[0] == pytest.approx(np.eye(3))
    assert np.array_equal(world.rate[2], moving)


@pytest.mark.parametrize("count", [0, -1, COUNT_MAX + 1])
def test_refuses_a_count_that_does_not_fit(count: int) -> None:
    with pytest.raises(ValueError, match=f"got {count} aircraft"):
        World(NF1, count, 0.001, Mount.CENTRE, False)
