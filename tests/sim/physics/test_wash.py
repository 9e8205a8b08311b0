"""Prop wash against its sources: where it acts, how much, in which band; and where it must not act.

Statistical bounds are five standard errors: a right model fails one of them in about two million seeds.
"""

from __future__ import annotations

import math
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.analysis.manoeuvre import shake
from neuroflight.sim.arrays import Array
from neuroflight.sim.control.motors import motor_commands
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.physics.air import Wash, wash_band
from neuroflight.sim.physics.library import library, pointer
from neuroflight.sim.physics.rotor import propulsion_struct, target_speed, thrust_and_torque
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from tests.sim.physics.flying import repeat

NF1 = load_aircraft("nf1")
COUNT = 500
THRUST = 1.2  # [N] of each rotor
INDUCED = math.sqrt(THRUST / (2 * 1.225 * math.pi / 4 * 0.12954**2))  # [m/s], by hand
SIGMAS = 5.0


def noise(count: int, steps: int, rate_hz: int, aircraft: Aircraft = NF1) -> tuple[Wash, Array]:
    """A wash, and its noise (steps, rotors) of a share of 1."""
    wash = Wash(aircraft, count, 1 / rate_hz, np.random.default_rng(3))
    rows = np.empty((steps, count * aircraft.motor_count))
    for row in rows:
        row[:] = wash.noise.ravel()
        library().lib.wash_step(wash.state, count, aircraft.motor_count)
    return wash, rows


def shaken(wash: Wash, velocity: Array, thrust: float = THRUST) -> Array:
    """Factors (COUNT, 4) of the thrust of rotors that give `thrust` [N] and move at `velocity` (3,) [m/s]."""
    speed = np.full((COUNT, 4), math.sqrt(thrust / NF1.propulsion.thrust_coefficient[0]))
    assert thrust_and_torque(speed, NF1.propulsion)[0] == pytest.approx(thrust)
    moving, loads, factor = np.tile(velocity, (COUNT, 1)), np.ones((COUNT, 6)), np.ones((COUNT, 4))
    given: list[Any] = [pointer(rows) for rows in (speed, moving, loads, factor)]
    library().lib.wash_shake(wash.state, propulsion_struct(NF1.propulsion), COUNT, 4, *given)
    return factor


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_the_noise_has_unit_variance_and_half_its_density_at_the_ends_of_the_band(rate_hz: int) -> None:
    low, high = wash_band(NF1)
    assert (low, high) == pytest.approx((3.16, 75.8), rel=0.02), "by hand: 42.1 Hz times 0.075 and 1.8"
    _, rows = noise(100, 2 * rate_hz, rate_hz)
    power = np.abs(np.fft.rfft(rows * np.hanning(len(rows))[:, None], axis=0)) ** 2
    density = power.mean(axis=1)  # lines of 0.5 Hz
    peak = density[30:50].mean()  # 15 to 25 Hz
    for frequency, part in ((low, 0.5), (high, 0.5), (3 * high, 0.1)):
        at = round(2 * frequency)
        # 400 rotors, three lines that a window makes two: five standard errors are less than a fifth.
        assert density[at - 1 : at + 2].mean() / peak == pytest.approx(part, rel=0.2)
    # Values in a second that are independent, of a density as flat: pi (f2 - f1) of each rotor.
    free = 400 * 2 * math.pi * (high - low)
    assert rows.var() == pytest.approx(1.0, abs=SIGMAS * math.sqrt(2 / free))


def test_rotors_shake_each_for_itself() -> None:
    wash, _ = noise(COUNT, 1, 1000)
    together: Array = np.asarray(np.corrcoef(shaken(wash, np.array([0.0, 0.0, -INDUCED])).T))
    assert np.abs(together[np.triu_indices(4, 1)]).max() < SIGMAS / math.sqrt(COUNT)


@pytest.mark.parametrize(
    ("sink", "share"),
    [(0.3, 0.056), (0.6, 0.116), (1.05, 0.15), (1.5, 0.116), (1.9, 0.030)],
)
def test_the_thrust_fluctuates_as_the_sink_rate_over_the_induced_velocity_says(
    sink: float, share: float
) -> None:
    wash, _ = noise(COUNT, 1, 1000)
    factor = shaken(wash, np.array([0.0, 0.0, -sink * INDUCED]))
    assert factor.std() == pytest.approx(share, rel=SIGMAS / math.sqrt(2 * 4 * COUNT))
    assert factor.mean() == pytest.approx(1.0, abs=SIGMAS * share / math.sqrt(4 * COUNT))
    # Four times the thrust induces twice the velocity.
    deeper = shaken(wash, np.array([0.0, 0.0, -2 * sink * INDUCED]), 4 * THRUST)
    assert deeper == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize(
    "velocity",
    [(0, 0, 0), (0, 0, 9), (0, 0, -0.1), (0, 0, -2.001), (0.68, 0.68, -1.05), (9, 0, -1)],
    ids=["hover", "climb", "hardly sinking", "windmill brake", "sideways", "fast"],
)
def test_the_thrust_is_steady_outside_the_vortex_ring_state(velocity: tuple[float, ...]) -> None:
    wash, _ = noise(COUNT, 1, 1000)
    assert (shaken(wash, np.array(velocity) * INDUCED) == 1.0).all()
    assert (shaken(wash, np.array([0.0, 0.0, -1.0]), thrust=0.0) == 1.0).all()


def flown(seed: int = 1, mount: Mount = Mount.FREE, *, wash: bool, gravity: bool, command: float) -> Array:
    """Rates and speed (6,) after a second at one motor command, without noise."""
    rng = np.random.default_rng(seed)
    twin = Twin(NF1, mount=mount, gravity=gravity, noise=False, wash=wash, rng=rng)
    with closing(twin):
        repeat(1000, twin.step, np.full((1, 4), command))
        return np.concatenate([twin.rate[0], twin.velocity[0]])


def test_a_climb_and_a_held_aircraft_fly_as_without_wash_to_the_bit() -> None:
    climb = [flown(wash=wash, gravity=False, command=0.4) for wash in (False, True)]
    assert climb[0][5] > 10.0
    assert climb[0].tobytes() == climb[1].tobytes()
    held = [flown(mount=Mount.CENTRE, wash=wash, gravity=True, command=0.2) for wash in (False, True)]
    assert held[0].tobytes() == held[1].tobytes()


def test_a_descent_is_shaken_as_the_seed_says() -> None:
    # Thrust of 0.8 of the weight.
    command = next(
        u
        for u in np.arange(0.0, 1.0, 0.001)
        if 4 * thrust_and_torque(target_speed(u, NF1.propulsion), NF1.propulsion)[0] > 0.8 * 0.391 * 9.81
    )
    first, same, other = (flown(seed, wash=True, gravity=True, command=command) for seed in (1, 1, 2))
    calm = flown(wash=False, gravity=True, command=command)
    assert first.tobytes() == same.tobytes()
    assert np.abs(first - other).max() > 0.01
    assert np.abs(calm[:2]).max() < 1e-3 < 0.02 < np.abs(first[:2]).max()


def test_the_pid_catches_a_fall_and_its_gyro_shows_the_band() -> None:
    """A second of hover, 0.9 s of closed throttle, then the catch, which is shaken."""
    settings = pid_settings(NF1, "flying")
    pid = aircraft_pid(NF1, 1, 1000, "flying")
    twin = Twin(NF1, mount=Mount.FREE, noise=False, rng=np.random.default_rng(4))
    legs = ((1.0, 0.27), (0.9, 0.0), (0.6, 0.37))  # throttles of 1, little and 2 times the weight
    gyro: list[Array] = []
    with closing(twin):
        for duration_s, throttle in legs:
            thrust = np.full(1, throttle, np.float32)
            for _ in range(round(duration_s * 1000)):
                gyro.append(np.rad2deg(twin.gyro[0]))
                output = pid.step(np.zeros((1, 3), np.float32), twin.gyro.astype(np.float32), thrust)
                twin.step(motor_commands(output, thrust, settings.idle, settings.mix))
    rows = np.array(gyro)
    hover, catch = rows[500:1000], rows[1900:]
    assert shake(hover, 1e-3) < 0.1
    assert shake(catch, 1e-3) > 2.0
    power = (np.abs(np.fft.rfft(catch[:, :2] * np.hanning(len(catch))[:, None], axis=0)) ** 2).mean(axis=1)
    frequency = np.fft.rfftfreq(len(catch), 1e-3)
    inside = power[(frequency >= 20.0) & (frequency <= 80.0)].mean()
    assert inside > 20.0 * power[(frequency >= 120.0) & (frequency <= 300.0)].mean()
    yaw = np.abs(catch[:, 2]).mean()
    assert yaw < 0.3 * np.abs(catch[:, :2]).mean(), "thrust turns about the level axes"
