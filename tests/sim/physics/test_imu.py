"""The gyro's and the accelerometer's numbers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Accelerometer, Gyro, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.physics.imu import AccelerometerModel, GyroModel, counts, draw_bias, quantised_rate

NF1 = load_aircraft("nf1")
QUIET = Gyro(noise=(0.0, 0.0, 0.0), bias=0.0)
STILL = Accelerometer(noise=(0.0, 0.0, 0.0))
SPEED = np.full((2, 4), 1000.0)


SPEED_MAX = 2000.0


def gyro(settings: Gyro, count: int = 2, dt: float = 1e-3, seed: int = 0) -> GyroModel:
    model = GyroModel(settings, count, dt, np.random.default_rng(seed), SPEED_MAX)
    model.reset(np.arange(count))
    return model


def read(model: GyroModel, rate: Array) -> Array:
    return model.measure(rate, None, np.full((len(rate), 4), 1000.0))


@pytest.mark.parametrize(
    ("deg_s", "expected"),
    [
        (0.0, 0),
        (1.0, 16),  # 16.384
        (2000 / 32768 * 0.499, 0),
        (2000 / 32768 * 0.501, 1),
        (-2000 / 32768 * 2.501, -3),
        (1999.99, 32767),
        (2500.0, 32767),
        (-2500.0, -32768),
    ],
)
def test_counts_round_to_nearest_and_saturate(deg_s: float, expected: int) -> None:
    assert counts(np.deg2rad(np.array([deg_s])))[0] == expected


def test_quantised_rate_is_within_half_a_count() -> None:
    rate = np.random.default_rng(0).uniform(-30, 30, (1000, 3))
    half = np.deg2rad(2000 / 32768) / 2
    rounding = 35 * 2.0**-24  # of float32 at the largest rate, 35 rad/s
    assert np.abs(quantised_rate(rate) - rate).max() <= half + rounding * 2


def test_noise_and_bias_have_the_logged_spread() -> None:
    count, rng = 200_000, np.random.default_rng(1)
    model = GyroModel(replace(NF1.gyro, bias=0.0), count, 1e-3, rng, SPEED_MAX)
    model.reset(np.arange(count))
    seen = np.rad2deg(model.measure(np.zeros((count, 3)), None, np.zeros((count, 4))))
    assert seen.std(axis=0) == pytest.approx([1.3373, 0.9990, 1.4516], rel=0.02)
    bias = np.rad2deg(draw_bias(NF1.gyro, 100_000, rng))
    assert bias.std() == pytest.approx(0.25, rel=0.02)
    assert bias.mean() == pytest.approx(0.0, abs=0.01)


def test_gyro_gives_the_plain_sensors_bits_when_nothing_else_is_set() -> None:
    rng = np.random.default_rng(5)
    model = GyroModel(NF1.gyro, 3, 1e-3, rng, SPEED_MAX)
    other = np.random.default_rng(5)
    bias = np.zeros((3, 3))
    for index in (np.arange(3), np.array([1]), np.array([0, 2])):
        model.reset(index)
        bias[index] = draw_bias(NF1.gyro, len(index), other)
        for _ in range(3):
            rate = other.uniform(-10, 10, (3, 3))
            rng.uniform(-10, 10, (3, 3))
            plain = rate + bias + other.standard_normal((3, 3)) * np.array(NF1.gyro.noise)
            assert model.measure(rate, None, np.zeros((3, 4))).tobytes() == plain.tobytes()
    assert rng.random() == other.random()


def test_gyro_turns_the_rate_into_its_own_axes_when_misaligned() -> None:
    """A chip turned left by a quarter sees a roll to the right as a rate about its own -y."""
    model = gyro(replace(QUIET, misalignment=(0.0, 0.0, math.pi / 2)))
    seen = read(model, np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 3.0]]))
    assert seen == pytest.approx(np.array([[0.0, -1.0, 0.0], [2.0, 0.0, 3.0]]), abs=1e-12)


def test_gyro_keeps_the_length_of_the_rate_when_misaligned_about_all_axes() -> None:
    model = gyro(replace(QUIET, misalignment=(0.02, -0.03, 0.05)))
    rate = np.array([[1.0, 2.0, 3.0], [-4.0, 0.5, 1.0]])
    seen = read(model, rate)
    assert np.linalg.norm(seen, axis=1) == pytest.approx(np.linalg.norm(rate, axis=1), rel=1e-12)
    assert seen[0] - rate[0] == pytest.approx(np.cross(rate[0], [0.02, -0.03, 0.05]), abs=0.01)


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
def test_gyro_follows_a_step_like_a_first_order_lag_when_it_has_a_bandwidth(dt: float) -> None:
    model = gyro(replace(QUIET, bandwidth_hz=50.0), dt=dt)
    assert read(model, np.zeros((2, 3))).tolist() == np.zeros((2, 3)).tolist()
    steps = round(0.01 / dt)
    for _ in range(steps):
        seen = read(model, np.ones((2, 3)))
    assert seen == pytest.approx(np.full((2, 3), 1 - math.exp(-2 * math.pi * 50.0 * 0.01)), rel=1e-9)


def test_gyro_starts_settled_when_reset_in_motion() -> None:
    model = gyro(replace(QUIET, bandwidth_hz=5.0))
    assert read(model, np.full((2, 3), 7.0)).tolist() == np.full((2, 3), 7.0).tolist()
    model.reset(np.array([1]))
    seen = read(model, np.zeros((2, 3)))
    assert (seen[0] > 6.0).all()
    assert seen[1].tolist() == [0.0, 0.0, 0.0]


def test_gyro_noise_stays_white_when_it_has_a_bandwidth() -> None:
    model = gyro(Gyro(noise=(1.0, 1.0, 1.0), bias=0.0, bandwidth_hz=20.0), count=20_000)
    first, second = (read(model, np.zeros((20_000, 3))) for _ in range(2))
    assert first.std() == pytest.approx(1.0, rel=0.02)
    assert abs((first * second).mean()) < 5 / math.sqrt(60_000)


def test_vibration_grows_with_the_square_of_speed_when_a_rotor_turns() -> None:
    model = gyro(replace(QUIET, vibration=(2.0, 3.0, 4.0)), count=1)
    phase = np.linspace(0, 2 * math.pi, 400, endpoint=False)
    for speed, part in ((2000.0, 1.0), (1000.0, 0.25), (0.0, 0.0)):
        turns = [model.measure(np.zeros((1, 3)), np.array([[p]]), np.array([[speed]])) for p in phase]
        seen = np.array(turns)[:, 0]
        assert seen.max(axis=0) == pytest.approx(part * np.array([2.0, 3.0, 4.0]), rel=1e-3)
        assert seen.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
        power = np.abs(np.fft.rfft(seen[:, 0]))
        assert power[1] == pytest.approx(2.0 * part * 200, rel=1e-9, abs=1e-9)  # once a turn, nothing else
        assert power[2:].max() < 1e-9


def test_vibration_has_the_multiples_of_a_turn_that_the_file_says() -> None:
    model = gyro(replace(QUIET, vibration=(2.0, 3.0, 4.0), harmonics=(0.5, 0.25)), count=1)
    phase = np.linspace(0, 2 * math.pi, 400, endpoint=False)
    turns = [model.measure(np.zeros((1, 3)), np.array([[p]]), np.array([[1000.0]])) for p in phase]
    amplitude = np.abs(np.fft.rfft(np.array(turns)[:, 0], axis=0)) / 200
    assert amplitude[1:5, 0] == pytest.approx(0.5 * np.array([1.0, 0.5, 0.25, 0.0]), abs=1e-12)
    assert amplitude[1:5, 2] == pytest.approx([1.0, 0.5, 0.25, 0.0], abs=1e-12)


def test_vibration_adds_up_when_several_rotors_turn() -> None:
    model = gyro(replace(QUIET, vibration=(1.0, 1.0, 1.0)), count=1)
    still, speed = np.zeros((1, 3)), np.array([[2000.0, 1000.0]])
    both = model.measure(still, np.array([[0.4, 1.1]]), speed)
    alone = [
        model.measure(still, np.array([[0.4, 1.1]]), speed * only)
        for only in (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
    ]
    assert both == pytest.approx(alone[0] + alone[1])
    assert not np.allclose(alone[0][0, 0], alone[0][0, 1])  # axes are out of phase


def test_vibration_is_refused_when_phases_are_not_tracked() -> None:
    model = gyro(replace(QUIET, vibration=(1.0, 0.0, 0.0)))
    assert model.vibrates
    assert not gyro(QUIET).vibrates
    with pytest.raises(ValueError, match="phases"):
        read(model, np.zeros((2, 3)))


def test_accelerometer_saturates_when_beyond_full_scale() -> None:
    model = AccelerometerModel(replace(STILL, full_scale=20.0), 1, 1e-3, np.random.default_rng(0), SPEED_MAX)
    model.reset(np.arange(1))
    seen = model.measure(np.array([[25.0, -30.0, 9.8]]), None, SPEED[:1])
    assert seen.tolist() == [[20.0, -20.0, 9.8]]


def test_accelerometer_has_its_noise_bias_and_lag_when_they_are_set() -> None:
    count = 50_000
    settings = Accelerometer(noise=(0.1, 0.2, 0.4), bias=0.3, bandwidth_hz=100.0)
    model = AccelerometerModel(settings, count, 1e-3, np.random.default_rng(4), SPEED_MAX)
    model.reset(np.arange(count))
    speed = np.zeros((count, 4))
    model.measure(np.zeros((count, 3)), None, speed)
    seen = model.measure(np.tile([0.0, 0.0, 10.0], (count, 1)), None, speed)
    assert seen.std(axis=0) == pytest.approx(np.hypot([0.1, 0.2, 0.4], 0.3), rel=0.02)
    assert seen[:, 2].mean() == pytest.approx(10 * (1 - math.exp(-0.2 * math.pi)), abs=0.02)
    again = model.measure(np.tile([0.0, 0.0, 10.0], (count, 1)), None, speed)
    shared = np.cov(seen[:, 0], again[:, 0])[0, 1]  # what two readings share is the bias
    assert shared == pytest.approx(0.09, rel=0.05)
