"""Durations of control tasks as the real image tells them over its UART."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.flash.monitoring.stream import Sample
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.board.serial.told_times import (
    StreamListener,
    ToldTimes,
    told_of_samples,
    told_while_idle,
)
from neuroflight.toolchain.contract import MSP_BAUD_DEFAULT
from neuroflight.toolchain.errors import LinkError

STEP = Sample(
    sequence=0,
    step=0,
    cycles=100,
    state="ARMED",
    armed=True,
    pid_flies=False,
    setpoint=(0.0,) * 3,
    gyro=(0.0,) * 3,
    throttle=0.0,
    dshot=(48,) * 4,
    observation=(),
    action=(),
)


def test_single_runs_are_within_what_the_counters_tell_when_a_board_lies_idle(board_image: Path) -> None:
    image = board_image.with_suffix(".bin").read_bytes()
    told = told_while_idle(image, 600)
    assert 600 <= told.runs < 700
    assert (told.armed, told.controller, told.missed) == (False, "", 0)
    assert 0 < told.best <= told.mean <= told.worst < TIME_HZ / 1000
    idle = IdleBoard(image)
    try:
        idle.boot()
        listener = StreamListener(idle.board, MSP_BAUD_DEFAULT)
        listener.begin()
        idle.run_to(idle.board.cycle + TIME_HZ // 5)
        samples = listener.samples()
    finally:
        idle.close()
    assert len(samples) > 20
    assert all(told.best <= sample.cycles <= told.worst for sample in samples)
    assert told_of_samples(samples) == {}  # nobody armed it


def test_an_image_that_never_answers_is_told_in_one_line() -> None:
    with pytest.raises(LinkError) as raised:
        told_while_idle(b"\xff" * 1024, 10)
    assert len(str(raised.value).splitlines()) == 1


def test_armed_runs_are_told_apart_by_who_flew() -> None:
    samples = [
        replace(STEP, armed=False, cycles=9_999),
        STEP,
        replace(STEP, cycles=300),
        replace(STEP, cycles=50, pid_flies=True),
    ]
    assert told_of_samples(samples) == {
        "policy": ToldTimes(True, "policy", 2, 300, 100, 200.0, None),
        "pid": ToldTimes(True, "pid", 1, 50, 50, 50.0, None),
    }
    assert told_of_samples(samples)["policy"].variability == pytest.approx(2 / 3)
