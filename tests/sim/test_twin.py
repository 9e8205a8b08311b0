"""The twin as a whole: delay, repeatability, refusals, and that each motor turns it the right way."""

from dataclasses import replace

import numpy as np
import pytest

from sim.aircraft import load_aircraft
from sim.twin import Twin
from sim.world import Mount

NF1 = load_aircraft("nf1")


def twin(count: int = 1, seed: int = 1, **options: object) -> Twin:
    return Twin(NF1, count, rng=np.random.default_rng(seed), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("rate_hz", "samples"), [(1000, 2), (4000, 8), (8000, 16)])
def test_a_command_acts_after_the_delay_at_any_rate(rate_hz: int, samples: int) -> None:
    asked, left = (twin(rate_hz=rate_hz, noise=False) for _ in range(2))
    differs = []
    for _ in range(samples + 1):
        asked.step(np.ones((1, 4)))
        left.step(np.zeros((1, 4)))
        differs.append(bool(asked.rotor_speed[0, 0] > left.rotor_speed[0, 0]))
    asked.close()
    left.close()
    assert differs == [False] * samples + [True]


def test_a_command_acts_from_the_next_sample_when_there_is_no_delay() -> None:
    prompt = replace(NF1, propulsion=replace(NF1.propulsion, delay=0.0))
    aircraft = Twin(prompt, rng=np.random.default_rng(0), noise=False)
    aircraft.step(np.ones((1, 4)))
    at_once = aircraft.rotor_speed[0, 0]
    aircraft.step(np.ones((1, 4)))
    later = aircraft.rotor_speed[0, 0]
    aircraft.close()
    assert at_once <= NF1.propulsion.speed_curve[2]
    assert later > 10.0


@pytest.mark.parametrize("mount", list(Mount))
def test_the_same_seed_repeats_a_run_exactly(mount: Mount) -> None:
    runs = []
    for seed in (7, 7, 8):
        aircraft = twin(3, seed, mount=mount)
        commands = np.random.default_rng(0).uniform(0, 1, (50, 3, 4))
        for command in commands:
            aircraft.step(command)
        runs.append((aircraft.rate.copy(), aircraft.gyro.copy()))
        aircraft.close()
    assert np.array_equal(runs[0][0], runs[1][0])
    assert np.array_equal(runs[0][1], runs[1][1])
    assert not np.array_equal(runs[0][1], runs[2][1])


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize(
    ("motor", "signs"),
    [(0, (-1, 1, 1)), (1, (-1, -1, -1)), (2, (1, 1, -1)), (3, (1, -1, 1))],
    ids=["1 rear right cw", "2 front right ccw", "3 rear left ccw", "4 front left cw"],
)
def test_each_motor_turns_the_aircraft_its_own_way(
    motor: int, signs: tuple[int, int, int], mount: Mount
) -> None:
    aircraft = twin(noise=False, mount=mount)
    command = np.full((1, 4), 0.3)
    command[0, motor] = 0.4
    for _ in range(60):
        aircraft.step(command)
    turned = tuple(np.sign(aircraft.rate[0]).astype(int))
    aircraft.close()
    assert turned == signs


def test_hovers_at_the_analytic_throttle_when_free() -> None:
    """Thrust of four rotors at speed H(u) equals the weight: the climb rate stays where it is."""
    aircraft = twin(noise=False, mount=Mount.FREE)
    weight = NF1.mass_properties.mass * 9.80665
    speed = np.sqrt(weight / 4 / NF1.propulsion.thrust_coefficient[0])
    a, b, c = NF1.propulsion.speed_curve
    hover = (-b + np.sqrt(b * b - 4 * a * (c - speed))) / (2 * a)
    for _ in range(600):
        aircraft.step(np.full((1, 4), hover))
    climb = aircraft.velocity[0, 2]
    for _ in range(200):
        aircraft.step(np.full((1, 4), hover))
    settled = aircraft.velocity[0, 2]
    aircraft.close()
    assert aircraft.rotor_speed[0] == pytest.approx([speed] * 4, rel=1e-3)
    assert settled - climb == pytest.approx(0.0, abs=0.005 * 9.80665 * 0.2)


def test_reset_makes_an_aircraft_new_and_leaves_the_others() -> None:
    aircraft = twin(2, noise=False)
    for _ in range(100):
        aircraft.step(np.array([[0.5, 0.2, 0.2, 0.2]] * 2))
    other = aircraft.rate[1].copy()
    aircraft.reset(np.array([0]))
    assert aircraft.rate[0] == pytest.approx(np.zeros(3))
    assert aircraft.rotor_speed[0] == pytest.approx(np.zeros(4))
    assert np.array_equal(aircraft.rate[1], other)
    aircraft.step(np.zeros((2, 4)))
    assert aircraft.rotor_speed[0].max() < 1.0  # no command from before the reset still under way
    aircraft.close()


@pytest.mark.parametrize(
    "motors",
    [np.full((1, 4), np.nan), np.full((1, 4), 1.5), np.full((1, 4), -0.1), np.zeros((1, 3)), np.zeros(4)],
    ids=["nan", "above one", "below zero", "three motors", "flat"],
)
def test_refuses_commands_that_are_no_fractions(motors: np.ndarray) -> None:
    aircraft = twin()
    with pytest.raises(ValueError, match="motor commands"):
        aircraft.step(motors)
    aircraft.close()
