"""The control path around a Python controller, compared with the firmware's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.control import sticks
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import RECEIVER_HOLD_MS, RECEIVER_LOST_MS, Mix
from neuroflight.toolchain.policy.gyro_filters import MEAN

Array = NDArray[np.float32]
RATE_HZ = 1000  # gyro and control alike, for short tests
BOOT = 1001  # samples until arming is allowed
OFF = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False).tolist()
ON = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=True).tolist()


class Echo:
    """A controller that answers the throttle and counts its resets."""

    def __init__(self, y: list[float] | None = None) -> None:
        self.resets = 0
        self._y = y

    def reset(self) -> None:
        self.resets += 1

    def step(self, setpoint: Array, gyro: Array, throttle: Array) -> Array:
        return np.array([self._y or [0.1, 0.2, 0.3, 0.4]], np.float32)


def sample(gyro: NDArray[np.float64] | None = None) -> Sample:
    zero = np.zeros(3)
    return Sample(0.0, zero if gyro is None else gyro, np.eye(3), zero, zero, zero)


def run(port: ControllerPort | ReferencePort, channels: list[int] | None, count: int) -> Reply:
    """Send the channels every 10 ms for `count` samples; None: silence."""
    for k in range(count):
        reply = port.exchange(sample(), channels if k % 10 == 0 else None)
    return reply


def armed_port(controller: Echo) -> ControllerPort:
    port = ControllerPort(controller, 4, RATE_HZ)
    run(port, OFF, BOOT)
    assert run(port, ON, 1).armed
    return port


def test_gyro_is_the_firmwares_bits_when_both_hear_the_same_noise(reference_library: Path) -> None:
    rng = np.random.default_rng(1)
    ours, theirs = (
        ControllerPort(Echo(), 4, gyro_filters=MEAN),
        ReferencePort(reference_library),
    )
    for k in range(4400):  # a second of calibration, then a tenth of motion as fast as a gyro tells
        noise = rng.normal((0.1, -0.05, 0.02), 0.02)
        gyro = noise if k < 4000 else noise + 33.0 * np.sin(0.3 * (k - 4000)) * np.array([1.0, -0.8, 0.6])
        a, b = ours.exchange(sample(gyro), OFF), theirs.exchange(sample(gyro), OFF)
        assert a.gyro.tolist() == b.gyro.tolist()  # a zero's sign is the chip's alignment's
        assert (a.step, a.armed) == (b.step, b.armed)


def test_motors_are_mixed_and_encoded_when_armed() -> None:
    port = armed_port(Echo())
    low = port.exchange(sample(), ON).dshot
    assert low.tolist() == [48 + round(1999 * y) for y in (0.1, 0.2, 0.3, 0.4)]
    half = sticks.channels((0.0, 0.0, 0.0), 0.5, armed=True).tolist()
    lifted = port.exchange(sample(), half).dshot
    assert lifted.tolist() == [48 + round(1999 * (y + 0.3)) for y in (0.1, 0.2, 0.3, 0.4)]


def test_values_stay_in_range_when_the_controller_saturates() -> None:
    port = armed_port(Echo([0.0, 1.0, 1.0, 0.5]))
    full = sticks.channels((0.0, 0.0, 0.0), 1.0, armed=True).tolist()
    assert port.exchange(sample(), full).dshot.tolist() == [48, 2047, 2047, 1048]


def test_idle_lifts_the_motors_when_given() -> None:
    port = ControllerPort(Echo([0.0, 0.0, 0.0, 1.0]), 4, RATE_HZ, idle=0.1)
    run(port, OFF, BOOT)
    assert run(port, ON, 1).dshot.tolist() == [248, 248, 248, 2047]


def test_the_mix_is_the_controllers_when_given() -> None:
    port = ControllerPort(Echo(), 4, RATE_HZ, mix=Mix.CENTRED)
    run(port, OFF, BOOT)
    assert run(port, ON, 1).dshot.tolist() == [48 + round(1999 * y) for y in (0.0, 0.1, 0.2, 0.3)]
    half = sticks.channels((0.0, 0.0, 0.0), 0.5, armed=True).tolist()
    level = port.exchange(sample(), half).dshot
    assert level.tolist() == [48 + round(1999 * u) for u in (0.35, 0.45, 0.55, 0.65)]


def test_the_controller_sees_the_mean_of_the_samples_since_its_last_step_when_asked() -> None:
    port = ControllerPort(Echo(), 4, 4000, gyro_filters=MEAN)
    replies = [port.exchange(sample(np.full(3, (k + 1) / 10)), None) for k in range(9)]
    count = float(np.deg2rad(2000 / 32768))
    assert replies[0].gyro == pytest.approx(0.1, abs=count)  # the first stands for those before it
    assert replies[4].gyro == pytest.approx(0.35, abs=count)
    assert replies[8].gyro == pytest.approx(0.75, abs=count)


def test_it_does_not_arm_when_the_switch_was_left_on() -> None:
    port = ControllerPort(Echo(), 4, RATE_HZ)
    assert not run(port, ON, 2 * BOOT).armed
    run(port, OFF, 1)
    assert run(port, ON, 1).armed


def test_it_does_not_arm_when_the_throttle_is_high_or_the_second_not_over() -> None:
    port = ControllerPort(Echo(), 4, RATE_HZ)
    run(port, OFF, 900)
    assert not run(port, ON, 1).armed
    run(port, OFF, 200)
    high = sticks.channels((0.0, 0.0, 0.0), 0.2, armed=True).tolist()
    assert not run(port, high, 1).armed


def test_motors_stop_when_the_switch_goes_off() -> None:
    port = armed_port(Echo())
    reply = run(port, OFF, 1)
    assert not reply.armed
    assert reply.dshot.tolist() == [0, 0, 0, 0]


def test_sticks_centre_and_then_motors_stop_when_the_receiver_is_lost() -> None:
    port = armed_port(Echo())
    turning = sticks.channels((100.0, 0.0, 0.0), 0.0, armed=True).tolist()
    port.exchange(sample(), turning)
    for silence in range(1, RECEIVER_LOST_MS + 50):
        reply = port.exchange(sample(), None)
        assert bool(reply.setpoint.any()) == (silence < RECEIVER_HOLD_MS)
        assert reply.armed == (silence < RECEIVER_LOST_MS)


def test_the_controller_starts_afresh_when_armed_again() -> None:
    controller = Echo()
    port = armed_port(controller)
    assert controller.resets == 1
    run(port, OFF, 1)
    run(port, ON, 1)
    assert controller.resets == 2


def test_commands_are_held_when_the_gyro_is_faster_than_the_control() -> None:
    port = ControllerPort(Echo(), 4, 4000)
    replies = [port.exchange(sample(np.full(3, k / 10)), None) for k in range(8)]
    assert [reply.step for reply in replies] == [0, 0, 0, 0, 1, 1, 1, 1]
    assert replies[3].gyro.tolist() == replies[0].gyro.tolist() != replies[4].gyro.tolist()
