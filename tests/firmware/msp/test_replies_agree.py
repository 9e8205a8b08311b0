"""What the firmware is and what the Python client reads of it are the same, for a thousand states of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.msp import Decoder, Direction, Message, Version
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    DSHOT_MAX,
    DSHOT_MIN,
    DSHOT_SPAN,
    MOTOR_COUNT_MAX,
    FallbackCause,
    FlightState,
    GyroHealth,
    Msp,
    StopCause,
    Task,
)
from tests.firmware.conftest import Core
from tests.firmware.joined.ground import Ground, Request
from tests.sampling import examples

STATES = examples(1600)
SHORT = (-(2**15), 2**15 - 1)
STRANGE = (0.0, -0.0, 1e-30, 1e9, -1e9, math.inf, -math.inf, math.nan)
RSSI_FULL = 1023
LEVELS = {  # enum battery_level of battery.h: unknown, good, warning, low
    0: messages.BatteryLevel.ABSENT,
    1: messages.BatteryLevel.GOOD,
    2: messages.BatteryLevel.WARNING,
    3: messages.BatteryLevel.CRITICAL,
}


@pytest.fixture(scope="module")
def ground(scripted: Core) -> Ground:
    ground = Ground(scripted)
    ground.run(20)
    return ground


def ask(ground: Ground, command: Msp) -> Any:
    """The client's reading of an answer in one of the versions."""
    version = Version.V1 if command < 255 and ground.ms % 2 else Version.V2
    (said,) = Decoder().feed(ground.send(Request(command).frame(version), port=ground.ms % 2))
    assert isinstance(said, Message) and said.direction is Direction.REPLY
    return messages.DECODERS[command](said.payload)


def number(rng: np.random.Generator, low: float, high: float) -> float:
    """Any, one in twenty strange; as a float of C holds it."""
    value = rng.uniform(low, high) if rng.random() < 0.95 else rng.choice(STRANGE)
    return float(np.float32(value))


def whole(value: float, limits: tuple[int, int] = SHORT) -> float:
    """The value as near as whole numbers within the limits come; of no number, 0."""
    return 0.0 if math.isnan(value) else min(max(value, limits[0]), limits[1])


def states(ground: Ground) -> Iterator[tuple[Any, np.random.Generator]]:
    """The firmware's status, anew many times."""
    rng = np.random.default_rng(18)
    status, trace = ground.firmware.status, ground.firmware.status.trace
    truth = ground.core.new("struct firmware_status *")
    for _ in range(STATES):
        trace.armed = int(rng.integers(2))
        trace.gyro = [number(rng, -40, 40) for _ in range(3)]
        trace.motor_count = int(rng.integers(1, MOTOR_COUNT_MAX + 1))
        values = rng.integers(DSHOT_MIN, DSHOT_MAX + 1, MOTOR_COUNT_MAX) * rng.integers(0, 2, MOTOR_COUNT_MAX)
        trace.dshot = values.tolist()
        status.channels_us = rng.integers(0, 2**16, CHANNEL_COUNT).tolist()
        status.arming_reasons = int(rng.integers(2**contract.ARMING_REASON_COUNT))
        status.attitude_known = bool(rng.integers(2))
        status.airborne = bool(rng.integers(2))
        status.attitude_deg = [number(rng, -180, 180) for _ in range(3)]
        status.accel_g = [number(rng, -16, 16) for _ in range(3)]
        status.temperature_deg_c = number(rng, -40, 125)
        status.idle = number(rng, 0, 0.5)
        status.receiver_quality = int(rng.integers(101))
        for name, kind in (("state", FlightState), ("stop_cause", StopCause), ("gyro_health", GyroHealth)):
            setattr(status, name, int(rng.choice(list(kind))))
        status.fallback_cause, status.refused_cause = rng.choice(list(FallbackCause), 2).tolist()
        for name in ("policy_good", "pid_built_in", "pid_flies"):
            setattr(status, name, bool(rng.integers(2)))
        quaternion = rng.normal(size=4)
        ground.firmware.attitude.q = (quaternion / np.linalg.norm(quaternion)).tolist()
        ground.ms += 1  # the other version, the other port
        ground.lib.background_status(ground.background, truth)
        yield truth, rng


def test_channels_and_motors_are_told_as_they_are(ground: Ground) -> None:
    for status, _ in states(ground):
        roll, pitch, throttle, yaw, *switches = status.channels_us
        assert ask(ground, Msp.RC) == (roll, pitch, yaw, throttle, *switches)
        told = ask(ground, Msp.MOTOR)
        for index, us in enumerate(told):
            value = status.trace.dshot[index]
            share = 1000 + 1000 * (value - DSHOT_MIN) / DSHOT_SPAN if value else 1000
            assert us == (0 if index >= status.trace.motor_count else math.floor(share + 1e-9))


def test_attitude_and_sensors_are_told_as_they_are(ground: Ground) -> None:
    for status, _ in states(ground):
        told = ask(ground, Msp.ATTITUDE)
        roll, pitch, yaw = status.attitude_deg
        assert told.roll_deg * 10 == pytest.approx(whole(roll * 10), abs=0.51)
        assert told.pitch_deg * 10 == pytest.approx(whole(pitch * 10), abs=0.51)
        right = -yaw if -yaw >= 0 or math.isnan(yaw) else -yaw + 360
        assert told.heading_deg == pytest.approx(whole(right), abs=0.51)
        imu = ask(ground, Msp.RAW_IMU)
        assert imu.acceleration == pytest.approx([whole(2048 * g) for g in status.accel_g], abs=0.51)
        counts = [whole(math.degrees(rate) * 16.4 / 4) for rate in status.trace.gyro]
        assert imu.gyro == pytest.approx(counts, abs=0.52)
        assert imu.magnetometer == (0, 0, 0)


def test_safety_is_told_as_it_is(ground: Ground) -> None:
    for status, _ in states(ground):
        told: records.Safety = ask(ground, Msp.SAFETY)
        for name in ("state", "stop_cause", "fallback_cause", "refused_cause", "gyro_health"):
            assert getattr(told, name) == getattr(status, name)
        for name in ("policy_good", "pid_built_in", "pid_flies", "airborne"):
            assert getattr(told, name) is bool(getattr(status, name))
        assert told.arming_flags == status.arming_reasons
        assert told.receiver_percent == status.receiver_quality
        assert told.temperature_deg_c * 100 == pytest.approx(whole(status.temperature_deg_c * 100), abs=0.51)
        assert np.float32(told.idle).tobytes() == np.float32(status.idle).tobytes()


def test_the_status_is_told_as_it_is(ground: Ground) -> None:
    for status, _ in states(ground):
        short, long = ask(ground, Msp.STATUS), ask(ground, Msp.STATUS_EX)
        assert short == long.status
        assert short.armed is bool(status.trace.armed)
        assert short.cycle_time_us == 1000  # the scripted policy runs at 1 kHz
        assert bool(short.sensors & 1) is bool(status.attitude_known)


def test_the_battery_is_told_as_it_is(ground: Ground) -> None:
    battery = ground.background.battery
    held = ground.core.ffi.addressof(ground.background, "battery")
    for status, rng in states(ground):
        battery.volts, battery.amps = number(rng, 0, 36), number(rng, -300, 300)
        battery.cells = int(rng.integers(9))
        analog, state = ask(ground, Msp.ANALOG), ask(ground, Msp.BATTERY_STATE)
        assert state.cells == battery.cells
        assert state.level == LEVELS[held.level]
        drawn = whole(held.mah)
        for told in (analog, state):
            assert told.voltage_v * 100 == pytest.approx(whole(battery.volts * 100) % 2**16, abs=0.51)
            assert told.current_a * 100 == pytest.approx(whole(battery.amps * 100), abs=0.51)
            assert told.drawn_mah == pytest.approx(drawn % 2**16, abs=0.51)
        assert analog.rssi == status.receiver_quality * RSSI_FULL // 100


def test_tasks_are_told_as_they_are(ground: Ground) -> None:
    for _, rng in states(ground):
        for stats in ground.stats:
            stats.runs, stats.misses = rng.integers(2**32, size=2).tolist()
            stats.worst, stats.best = rng.integers(2**32, size=2).tolist()
            stats.rate_hz = int(rng.integers(2**16))
            stats.sum = 0
        told: records.Tasks = ask(ground, Msp.TASKS)
        assert [load.task for load in told.loads] == list(Task)
        for load, stats in zip(told.loads, ground.stats, strict=True):
            assert (load.rate_hz, load.misses) == (stats.rate_hz, stats.misses)
            assert (load.worst_cycles, load.best_cycles) == (stats.worst, stats.best) or load.task == Task.MSP
            assert load.runs in (stats.runs, stats.runs - 1)  # this request is one of MSP's
