"""Rotors that move along their axes, against numbers computed by hand, and the twin with them."""

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import FOLDER, Aircraft, parse_aircraft
from neuroflight.sim.flight.motion import Motion
from neuroflight.sim.physics.rotor import advance_factors, rotor_geometry, rotor_wrench
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from tests.sim.physics.flying import repeat

TEXT = (FOLDER / "nf1.toml").read_text()
POLYNOMIAL = TEXT.replace("= 9.37e-7 ", "= [9.4e-7, -1e-12] ")


def aircraft(thrust: str = "", torque: str = "[0, 0]", text: str = TEXT) -> Aircraft:
    table = f"\n[propulsion.advance_ratio]\nthrust = {thrust}\ntorque = {torque}\n" if thrust else ""
    return parse_aircraft((text + table).encode(), "own.toml")


PLAIN, REAL = aircraft(), aircraft("[-0.9, -0.1]", "[-0.4, -0.2]")
SPEED = 1000.0  # [rad/s], about the hover
LIFT = 4 * 9.37e-7 * SPEED**2  # [N], of four rotors at rest in the air


def wrench(
    of: Aircraft, velocity: tuple[float, ...] = (0, 0, 0), rate: tuple[float, ...] = (0, 0, 0)
) -> np.ndarray:
    speeds, geometry = np.full((1, 4), SPEED), rotor_geometry(of)
    found: np.ndarray = rotor_wrench(speeds, speeds, 0.001, np.array([velocity]), np.array([rate]), geometry)[
        0
    ]
    return found


def test_thrust_falls_in_a_climb_by_the_formula() -> None:
    # J = 5 m/s / (159.155 1/s x 0.12954 m) = 0.242520; 1 - 0.9 J - 0.1 J^2 = 0.775850
    assert wrench(REAL, (0, 0, 5))[2] == pytest.approx(0.775850 * LIFT, rel=1e-5)
    assert wrench(REAL, (3, -2, 5))[2] == pytest.approx(0.775850 * LIFT, rel=1e-5)
    assert wrench(REAL, (0, 0, 200))[2] == 0.0  # beyond the thrust's end


@pytest.mark.parametrize("velocity", [(0, 0, 0), (4, 0, 0), (0, 0, -8)], ids=["still", "across", "sinking"])
def test_thrust_is_that_at_rest_when_air_does_not_come_from_above(velocity: tuple[float, ...]) -> None:
    assert np.array_equal(wrench(REAL, velocity), wrench(PLAIN, velocity))


def test_torque_follows_its_own_factor() -> None:
    # A fast pair of one direction: what yaws is its drag torque. 1 - 0.4 J - 0.2 J^2 at the J above.
    speeds = np.array([[SPEED, 0.0, 0.0, SPEED]])
    still, climb = np.zeros((1, 3)), np.array([[0.0, 0.0, 5.0]])
    yaw = [rotor_wrench(speeds, speeds, 0.001, v, still, rotor_geometry(REAL))[0, 5] for v in (still, climb)]
    assert yaw[0] == pytest.approx(2 * 8.64e-3 * 9.37e-7 * SPEED**2)
    assert yaw[1] == pytest.approx(0.891229 * yaw[0], rel=1e-5)


def test_a_rolling_aircraft_is_damped_by_the_hubs_that_go_up() -> None:
    # Rolling right, the left hubs go up with 10 rad/s x 0.07 m: J = 0.7 / 20.616970 = 0.033953, factor
    # 0.969327. The right ones go down, where J stays 0.
    more = wrench(REAL, rate=(10, 0, 0)) - wrench(PLAIN, rate=(10, 0, 0))
    assert more[3] == pytest.approx(-0.07 * 0.5 * LIFT * (1 - 0.969327), rel=1e-4)
    left = wrench(REAL, rate=(-10, 0, 0)) - wrench(PLAIN, rate=(-10, 0, 0))
    assert left[3] == pytest.approx(-more[3])
    # In a climb both sides count: -0.9 +- 0.1 J's slope, twice the moment.
    climbing = wrench(REAL, (0, 0, 5), (10, 0, 0)) - wrench(PLAIN, (0, 0, 5), (10, 0, 0))
    assert climbing[3] == pytest.approx(-0.07 * LIFT * (0.9 + 0.2 * 0.242520) * 0.033953, rel=1e-3)
    assert wrench(REAL, rate=(0, 10, 0))[4] < wrench(PLAIN, rate=(0, 10, 0))[4]
    assert np.array_equal(wrench(REAL, rate=(0, 0, 10)), wrench(PLAIN, rate=(0, 0, 10)))


def test_standing_rotors_have_finite_factors() -> None:
    speeds = np.array([[0.0, 5e-324, 1e-9, 1e9]])
    for velocity in (-5.0, 0.0, 5.0):
        factors = advance_factors(
            speeds, np.array([[0.0, 0, velocity]]), np.zeros((1, 3)), rotor_geometry(REAL)
        )
        expected = [0.0, 0.0, 0.0, 1.0] if velocity > 0 else [1.0] * 4
        assert factors[0][0] == pytest.approx(expected, abs=1e-6)
        assert np.isfinite(factors[1]).all()


def test_c_has_the_formula_that_files_are_checked_by() -> None:
    rng = np.random.default_rng(3)
    advance = REAL.propulsion.advance
    assert advance is not None
    speed, velocity = rng.uniform(0, 2600, (500, 4)), rng.uniform(-30, 60, (500, 3))
    rate, hubs = rng.normal(0, 10, (500, 3)), REAL.rotor_positions
    inflow = velocity[:, 2:] + rate[:, :1] * hubs[:, 1] - rate[:, 1:2] * hubs[:, 0]
    ratio = 2 * np.pi * inflow / (speed * 0.12954)
    found = advance_factors(speed, velocity, rate, rotor_geometry(REAL))
    for of, expected in zip(found, advance.factors(ratio), strict=True):
        assert of == pytest.approx(expected, abs=1e-9)


def flown(of: Aircraft, mount: Mount) -> list[np.ndarray]:
    """Everything that a hard flight in gusts, on a battery, leaves."""
    twin = Twin(of, 3, mount=mount, charge=0.9, wind=(3.0, 1.0, -0.5), gust=4.0, rng=np.random.default_rng(4))
    rng, rows = np.random.default_rng(5), []
    for _ in range(40):
        commands = rng.uniform(0.0, 1.0, (3, 4))
        repeat(5, twin.step, commands)
        told = twin.telemetry
        rows += [twin.rate, twin.velocity, twin.rotation, twin.gyro, twin.specific_force, twin.rotor_speed]
        rows += [told.force, told.torque, told.current, twin.draw.power, twin.pack_voltage]
    return rows


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize("text", [TEXT, POLYNOMIAL], ids=["constants", "polynomial"])
def test_zeros_give_the_bits_of_no_table_and_other_numbers_do_not(mount: Mount, text: str) -> None:
    without, zeros = flown(aircraft(text=text), mount), flown(aircraft("[0, 0]", text=text), mount)
    assert all(np.array_equal(one, other) for one, other in zip(without, zeros, strict=True))
    real = flown(aircraft("[-0.9, -0.1]", "[-0.4, -0.2]", text), mount)
    assert not all(np.array_equal(one, other) for one, other in zip(without, real, strict=True))


def test_the_twin_moves_by_the_thrust_and_pays_for_the_torque_that_it_tells() -> None:
    of = replace(REAL, body=None)
    twin = Twin(of, mount=Mount.FREE, noise=False, wash=False, rng=np.random.default_rng(1))
    motion = Motion(twin)
    repeat(1000, twin.step, np.full((1, 4), 0.6))
    motion()
    told = twin.telemetry
    assert twin.velocity[0, 2] > 5.0
    mass = of.mass_properties.mass
    assert told.force.sum() == pytest.approx(mass * twin.specific_force[0, 2], rel=1e-9)
    assert motion.thrust[0] == pytest.approx(told.force.sum() / (mass * 9.80665), rel=1e-4)
    assert told.force.sum() < 0.9 * (9.37e-7 * twin.rotor_speed**2).sum()
    shaft = (told.torque * twin.rotor_speed).sum()
    electronics = of.battery.electronics_power if of.battery else 0.0
    assert twin.draw.power[0] == pytest.approx(shaft / of.propulsion.efficiency + electronics, rel=1e-3)
    twin.reset()
    assert (twin.live.thrust_factor == 1.0).all()


def test_a_held_aircraft_feels_its_rotation_alone() -> None:
    twin = Twin(REAL, mount=Mount.CENTRE, noise=False, rng=np.random.default_rng(1))
    repeat(300, twin.step, np.array([[0.5, 0.5, 0.5, 0.5]]))
    assert (twin.live.thrust_factor == 1.0).all()
    repeat(60, twin.step, np.array([[0.3, 0.3, 0.5, 0.5]]))
    assert twin.rate[0, 0] > 1.0
    factor = twin.live.thrust_factor[0]
    assert (factor[2:] < 1.0).all() and (factor[:2] == 1.0).all()


def upright(of: Aircraft) -> Aircraft:
    """The aircraft with its mass on the axis of thrust, and rotors without drag across: nothing tilts it."""
    known = of.mass_properties
    inertia = np.diag(np.diag(known.inertia))
    own = replace(known, centre=np.array([0.0, 0.0, known.centre[2]]), inertia=inertia)
    smooth = replace(of.propulsion, drag_coefficient=0.0, rolling_coefficient=0.0)
    return replace(of, mass_properties=own, propulsion=smooth)


@pytest.mark.parametrize("slope", [0.0, -1.0])
def test_a_punch_out_ends_where_thrust_left_weight_and_drag_balance(slope: float) -> None:
    of = upright(aircraft(f"[{slope}, 0]")) if slope else upright(PLAIN)
    twin = Twin(of, mount=Mount.FREE, noise=False, wash=False, rng=np.random.default_rng(1))
    repeat(6000, twin.step, np.ones((1, 4)))
    # Full speed is 24,983 rpm = 2616.21 rad/s: 25.6536 N at rest; J = v / 53.9389 m/s; drag area 0.017 m^2.
    thrust, drag = 25.6536, 0.5 * 1.225 * 0.017
    weight = of.mass_properties.mass * 9.80665
    fall = -thrust * slope / 53.9389
    terminal = (np.sqrt(fall**2 + 4 * drag * (thrust - weight)) - fall) / (2 * drag)
    assert twin.velocity[0, 2] == pytest.approx(terminal, rel=2e-3)
    assert twin.rotation[0, 2, 2] > 0.9999
    assert terminal == pytest.approx(28.2 if slope else 45.4, abs=0.8)


def test_a_rotor_gains_thrust_as_it_sinks_down_to_the_least_ratio() -> None:
    # At 5 m/s: J = -0.242520; 1 + 0.9 x 0.242520 - 0.1 x 0.242520^2 = 1.212386. At 20 m/s J would be -0.97.
    text = TEXT + "\n[propulsion.advance_ratio]\nthrust = [-0.9, -0.1]\ntorque = [0, 0]\nratio_least = -0.5\n"
    both = parse_aircraft(text.encode(), "own.toml")
    assert wrench(both, (0, 0, -5))[2] == pytest.approx(1.212386 * LIFT, rel=1e-5)
    assert wrench(both, (0, 0, -20))[2] == pytest.approx((1 + 0.9 * 0.5 - 0.1 * 0.25) * LIFT, rel=1e-5)
    assert wrench(both, (0, 0, 5))[2] == wrench(REAL, (0, 0, 5))[2]
