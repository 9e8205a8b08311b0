"""runtime.c: samples that were lost, the watchdog, and what the battery tells the PID."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.flash.link import records
from neuroflight.toolchain.contract import DEADLINE_MISSES_MAX, FallbackCause, FlightState, Msp, Task
from tests.firmware.joined.field import Field

G = 9.80665


@pytest.fixture
def field(scripted: Any, chip: Callable[..., Any]) -> Field:
    """A board after its boot."""
    made = Field(scripted, chip())
    made.boot()
    return made


def lose(f: Field, count: int) -> None:
    """A sample before which so many were lost; nothing comes by the receiver."""
    sample = f.core.lib.host_board_sample([0.0] * 3, [0.0, 0.0, -G - 0.01 * (f.ms % 2)])
    sample.lost = count
    f.core.lib.runtime_sample(f.runtime, f.core.new("struct imu_sample *", sample))
    f.ms += 1


def misses(f: Field) -> dict[Task, int]:
    return {load.task: load.misses for load in records.tasks(f.ask(Msp.TASKS)).loads}


def test_lost_samples_and_the_step_after_them_are_misses(field: Field) -> None:
    before = misses(field)
    lose(field, 3)
    field.run(50)
    after = misses(field)
    assert after[Task.GYRO] - before[Task.GYRO] == 3
    assert after[Task.CONTROL] - before[Task.CONTROL] == 1


def test_the_pid_takes_over_when_samples_are_lost_before_each_step(field: Field) -> None:
    field.take_off()
    for _ in range(DEADLINE_MISSES_MAX - 1):
        lose(field, 1)
    field.run(50)
    assert not field.safety.pid_flies
    for _ in range(DEADLINE_MISSES_MAX):
        lose(field, 1)
    field.run(50)
    told = field.safety
    assert (told.state, told.pid_flies) == (FlightState.ARMED, True)
    assert told.fallback_cause == FallbackCause.DEADLINE


def test_the_watchdog_is_fed_only_while_samples_come(field: Field) -> None:
    fed: list[int] = []
    feed = field.core.ffi.callback("void(void *)", lambda _: fed.append(field.ms))
    field.hal.watchdog_feed = feed
    field.run(20)
    assert len(fed) == 20
    for _ in range(20):
        field.core.lib.runtime_background(field.runtime)
    assert len(fed) == 20


def test_the_pid_knows_the_battery_when_it_is_known(field: Field) -> None:
    pid = field.fw.control.pid
    assert pid.compensation == 1.0, "nothing is set"
    full = 16.8
    gains = field.core.new("struct pid_gains *", pid.gains[0])
    gains.nominal_voltage = 1.1 * full
    pid.gains = gains
    field.run(100)
    assert pid.compensation == pytest.approx(1.1**2, rel=0.01)

    def nothing(_: object, sample: Any) -> None:
        sample.volts_mv, sample.amps_mv, sample.valid = 0, 0, False

    power = field.core.ffi.callback("void(void *, struct power_sample *)", nothing)
    field.hal.power_read = power
    field.run(100)
    assert pid.compensation == 1.0, "a converter that tells nothing"
