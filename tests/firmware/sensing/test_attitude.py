"""attitude.c against the true attitude of the twin and of scipy's rotations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY

RATE_HZ = 1000
SETTLING = RATE_HZ  # steps
Array = NDArray[np.float64]


class Attitude:
    """A filter of its own."""

    def __init__(self, core: Any, rate_hz: int = RATE_HZ) -> None:
        self._lib = core.lib
        self.struct = core.new("struct attitude *")
        self._rate, self._force, self._out = (core.new("float[3]") for _ in range(3))
        self._lib.attitude_init(self.struct, rate_hz)

    def step(self, rate: Any, force: Any) -> None:
        self._rate[0:3] = [float(value) for value in rate]
        self._force[0:3] = [float(value) for value in force]
        self._lib.attitude_step(self.struct, self._rate, self._force)

    def settle(self, force: Any, count: int = SETTLING) -> None:
        for _ in range(count):
            self.step((0, 0, 0), force)

    @property
    def known(self) -> bool:
        return bool(self._lib.attitude_known(self.struct))

    @property
    def up(self) -> Array:
        self._lib.attitude_up(self.struct, self._out)
        return np.array(list(self._out))

    @property
    def tilt_deg(self) -> float:
        x, y, z = self.up
        return float(np.degrees(np.arctan2(np.hypot(x, y), z)))

    @property
    def euler_deg(self) -> list[float]:
        self._lib.attitude_euler_deg(self.struct, self._out)
        return list(self._out)


@pytest.fixture
def make(scripted: Any) -> Callable[..., Attitude]:
    return lambda *args: Attitude(scripted, *args)


@pytest.fixture
def attitude(make: Callable[..., Attitude]) -> Attitude:
    return make()


def apart_deg(a: Array, b: Array) -> float:
    """Angle between two directions [deg]."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def up_at(rotation: Rotation) -> Array:
    """Where up is in the body's axes."""
    up: Array = rotation.inv().apply([0.0, 0.0, 1.0])
    return up


@pytest.mark.parametrize("seconds", [8, pytest.param(60, marks=pytest.mark.slow)])
def test_tilt_stays_true_when_a_noisy_biased_gyro_flies_random_rates(
    make: Callable[..., Attitude], seconds: int
) -> None:
    rng = np.random.default_rng(3)
    # Held at its centre the twin's accelerometer is ideal: noise and offset are those of the aircraft's file.
    aircraft = load_aircraft("nf1")
    assert aircraft.accelerometer is not None
    twin = Twin(aircraft, mount=Mount.CENTRE, rate_hz=RATE_HZ, rng=rng)
    attitude = make()
    bias = np.radians([0.5, -0.5, 0.3])
    offset = 0.5 * aircraft.accelerometer.bias * np.array([1.0, -1.0, 1.0])
    mix = np.array([[-1, 1, 1], [-1, -1, -1], [1, 1, -1], [1, -1, 1]])  # motors from roll, pitch, yaw
    setpoint = np.zeros(3)
    errors, turned = [], 0.0
    for step in range((2 + seconds) * RATE_HZ):
        flying = step >= 2 * RATE_HZ
        if flying and step % 300 == 0:
            setpoint = np.radians(rng.uniform(-400, 400, 3))
        asked = mix @ (np.array([0.01, 0.01, 0.03]) * (setpoint - twin.rate[0]))
        twin.step(np.clip(0.4 + asked, 0, 1)[None] if flying else np.zeros((1, 4)))
        force = twin.accelerometer[0] + rng.normal(offset, aircraft.accelerometer.noise)
        attitude.step(twin.gyro[0] + bias, force)
        if flying:
            errors.append(apart_deg(attitude.up, twin.rotation[0, 2]))
            turned += float(np.linalg.norm(twin.rate[0])) / RATE_HZ
    twin.close()
    assert attitude.known
    assert turned > seconds * 2, "it must have flown"
    assert max(errors) < 3


def test_tilt_is_true_after_a_flip_when_the_accelerometer_feels_only_thrust(attitude: Attitude) -> None:
    attitude.settle((0, 0, GRAVITY), 2 * RATE_HZ)
    rate = np.radians([720.0, 30.0, -20.0])
    truth = Rotation.identity()
    for _ in range(RATE_HZ * 3 // 4):  # one turn and a half
        attitude.step(rate, (0, 0, 2.5 * GRAVITY))
        truth = truth * Rotation.from_rotvec(rate / RATE_HZ)
    assert up_at(truth)[2] < -0.9
    assert apart_deg(attitude.up, up_at(truth)) < 0.2


@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000])
def test_time_passes_as_fast_when_the_control_rate_differs(
    make: Callable[..., Attitude], rate_hz: int
) -> None:
    attitude = make(rate_hz)
    for _ in range(rate_hz // 2):
        attitude.step((0, 0, np.pi / 2), (0, 0, 0))
    assert attitude.euler_deg == pytest.approx([0, 0, 45], abs=0.01)


@pytest.mark.parametrize(
    "angles", [(10, 20, 0), (-170, 40, 0), (179, -5, 0), (90, 0, 0), (0, 89, 0), (-60, -80, 0), (180, 0, 0)]
)
def test_the_start_is_the_accelerometers_when_the_board_lies_tilted(
    make: Callable[..., Attitude], angles: tuple[float, float, float]
) -> None:
    roll, pitch, yaw = angles
    truth = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    attitude = make()
    attitude.step((0, 0, 0), GRAVITY * up_at(truth))
    assert apart_deg(attitude.up, up_at(truth)) < 0.01
    assert attitude.tilt_deg == pytest.approx(apart_deg(up_at(truth), np.array([0, 0, 1])), abs=0.01)


def test_it_starts_upside_down_when_the_board_lies_exactly_so(attitude: Attitude) -> None:
    attitude.settle((0, 0, -GRAVITY), 10)
    assert attitude.tilt_deg == pytest.approx(180, abs=1e-3)
    assert attitude.euler_deg[1] == pytest.approx(0, abs=0.1)


def test_angles_are_scipys_when_the_attitude_is_any(attitude: Attitude) -> None:
    for truth in Rotation.random(300, random_state=4):  # type: ignore[attr-defined]
        x, y, z, w = truth.as_quat()
        attitude.struct.q = [w, x, y, z]
        yaw, pitch, roll = truth.as_euler("ZYX", degrees=True)
        assert attitude.euler_deg == pytest.approx([roll, pitch, yaw], abs=0.02 if abs(pitch) < 85 else 0.5)
        assert attitude.tilt_deg == pytest.approx(apart_deg(up_at(truth), np.array([0, 0, 1])), abs=1e-3)


def test_signs_are_the_houses_when_it_turns_about_one_axis(make: Callable[..., Attitude]) -> None:
    for axis in range(3):
        attitude = make()
        for _ in range(RATE_HZ // 2):
            attitude.step(np.eye(3)[axis] * np.radians(60), (0, 0, 0))
        assert attitude.euler_deg == pytest.approx(30 * np.eye(3)[axis], abs=0.01)


def test_it_is_known_when_the_accelerometer_was_believed_for_a_second(attitude: Attitude) -> None:
    attitude.settle((0, 0, 0))
    attitude.settle((0, 0, 0.84 * GRAVITY))
    attitude.settle((0, 1.16 * GRAVITY, 0))
    assert not attitude.known
    assert attitude.tilt_deg == 0.0, "not believed: level until told otherwise"
    attitude.settle((0, 0, 0.86 * GRAVITY), SETTLING // 2)
    attitude.settle((0, 0, 0), 100)
    attitude.settle((0, 0, 1.14 * GRAVITY), SETTLING // 2 - 1)
    assert not attitude.known
    attitude.step((0, 0, 0), (0, 0, GRAVITY))
    assert attitude.known


def test_noise_is_averaged_when_it_settles(make: Callable[..., Attitude]) -> None:
    rng = np.random.default_rng(5)
    truth = Rotation.from_euler("ZYX", [0, 12, -7], degrees=True)
    attitude = make()
    attitude.step((0, 0, 0), GRAVITY * up_at(truth) + [1.0, 0.5, 0.0])  # the first is 6 degrees off
    for _ in range(SETTLING - 1):
        attitude.step((0, 0, 0), GRAVITY * up_at(truth) + rng.normal(0, 0.5, 3))
    assert apart_deg(attitude.up, up_at(truth)) < 0.5
    assert list(attitude.struct.bias) == [0, 0, 0], "what the start was wrong by is no offset of the gyro"


def test_a_gyros_offset_is_learnt_when_it_stays(attitude: Attitude) -> None:
    attitude.settle((0, 0, GRAVITY), SETTLING)
    for _ in range(120 * RATE_HZ):
        attitude.step(np.radians([1.0, -1.0, 0.0]), (0, 0, GRAVITY))
    assert attitude.tilt_deg < 0.1
    assert np.degrees(list(attitude.struct.bias)) == pytest.approx([-1.0, 1.0, 0.0], abs=0.1)


def test_the_learnt_offset_has_a_limit_when_the_accelerometer_contradicts_the_gyro(
    attitude: Attitude,
) -> None:
    attitude.settle((0, 0, GRAVITY), SETTLING)
    for _ in range(20 * RATE_HZ):
        attitude.step((2.0, 0, 0), (0, 0, GRAVITY))
    assert abs(attitude.struct.bias[0]) <= 0.1
    assert np.linalg.norm(list(attitude.struct.q)) == pytest.approx(1, abs=1e-6)
