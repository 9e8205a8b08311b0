"""Each bar of a check holds, and each can fail: one figure at a time of a policy that is fit."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.analysis import limits as limits_module
from neuroflight.sim.analysis import swing as swing_module
from neuroflight.sim.analysis.swing import change, swing
from neuroflight.toolchain.policy.check_stamp import RULES
from neuroflight.training.fitness import bars as bars_module
from neuroflight.training.fitness import course as course_module
from neuroflight.training.fitness import flying as flying_module
from neuroflight.training.fitness.bars import Bar, bars
from neuroflight.training.fitness.course import CommandFlight, Condition, Turn
from neuroflight.training.fitness.flying import CommandFigures, CourseFigures, TurnFigures

HOVER, SLOW = (
    CommandFlight("1 times the weight", 1.0),
    CommandFlight("slow rotors", 1.0, Condition("slow rotors", lag=1.5)),
)
FLIP = Turn(1, 720.0, 1.0)
LIFT = 6.0
COMMANDS = CommandFigures(1.0, 100.0, (0.2, 0.2, 0.2), (0.2, 0.2, 0.2), (2.0, -2.0, 2.0), 0.0025)
TURN = TurnFigures(0.006, 60.0, 0.003, 0.2, 0.05, 0.2)


def flown(
    label: str = "policy", commands: CommandFigures = COMMANDS, turn: TurnFigures = TURN, **other: object
) -> CourseFigures:
    lift = ((0.0, 0.06), (0.2, 0.8), (0.3, 1.5), (1.0, LIFT))
    found = CourseFigures(label, 0.055, lift, {HOVER: commands, SLOW: commands}, {FLIP: turn}, 0.1, 0.2)
    return replace(found, **other)  # type: ignore[arg-type]


PID = flown("PID flying")


def failed(policy: CourseFigures, *references: CourseFigures) -> list[Bar]:
    return [bar for bar in bars(policy, references or (PID,), LIFT) if not bar.met]


def commands(**figures: object) -> CourseFigures:
    return flown(commands=replace(COMMANDS, **figures))  # type: ignore[arg-type]


def turn(**figures: float) -> CourseFigures:
    return flown(turn=replace(TURN, **figures))


def test_a_policy_like_its_reference_meets_every_bar() -> None:
    found = bars(flown(), [PID], LIFT)
    assert len(found) == 16 and all(bar.met for bar in found)


@pytest.mark.parametrize(
    ("policy", "name", "words"),
    [
        (flown(lift=((0.0, 0.81), (1.0, LIFT))), "lift, throttle closed", "it does not come down"),
        (flown(lift=((0.0, 0.06), (1.0, 5.0))), "lift, full throttle", "lifts 5.00 of its weight"),
        (
            flown(lift=((0.0, 0.06), (0.2, 0.9), (0.3, 0.8), (1.0, LIFT))),
            "lift lost as throttle rises",
            "from 0.2 to 0.3 lowers the lift from 0.90 to 0.80",
        ),
        (
            commands(mae=1.6),
            "MAE of ten commands",
            "worse than PID flying at 1 times the weight: MAE 1.6 deg/s",
        ),
        (commands(mse=160.0), "MSE of ten commands", "MSE 160 (deg/s)²"),
        (
            commands(late=(1.3, 0.2, 0.2), early=(1.0, 0.2, 0.2)),
            "rest, late",
            "turns on in roll by 1.3 deg/s",
        ),
        (
            commands(late=(0.2, 0.2, 0.9)),
            "rest, grown since early",
            "in yaw 0.2 deg/s at rest early, 0.9 late",
        ),
        (commands(drift=(2.0, -13.0, 2.0)), "drift in 10 s", "13 deg in pitch in 10 s of centred sticks"),
        (commands(change=0.0061), "motors' change at rest", "the motors do not rest"),
        (turn(change=0.031), "motors' change in a turn", "at 60 Hz in a forward flip of 720 deg/s"),
        (turn(swing=0.06), "swing in a turn", "up and down by 6.0 % of their range, at most 5.0 %"),
        (turn(held=7.5), "error in a turn", "does not hold a forward flip"),
        (turn(overshoot=0.11), "overshoot of a turn", "by 11 %, at most 10 %"),
        (turn(back=5.3), "error after a turn", "half a second later it is 5.3 deg/s off"),
        (flown(ground_motor=0.33), "motor on the ground", "a motor turns at 33 %, in a hover at 27 %"),
        (flown(ground_turned=5.1), "tilt on the ground", "tips by 5 deg on the ground"),
    ],
)
def test_a_bar_fails_alone_and_says_what_happens(policy: CourseFigures, name: str, words: str) -> None:
    (bar,) = failed(policy)
    assert bar.name == name
    assert words in bar.worst.reason


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_figure_that_is_no_number_fails(value: float) -> None:
    assert {bar.name for bar in failed(commands(mae=value))} == {"MAE of ten commands"}
    assert {bar.name for bar in failed(turn(swing=value))} == {"swing in a turn"}


def test_an_aircraft_that_differs_from_its_file_has_its_own_factor() -> None:
    policy = commands(mae=1.4)
    (bar,) = failed(policy)
    assert [case.where for case in bar.cases if not case.met] == [HOVER.name]


def test_the_better_reference_sets_the_limit_of_errors_and_the_rougher_that_of_motors() -> None:
    better = flown("Betaflight 4.6", commands=replace(COMMANDS, mae=0.5, change=0.01))
    names = {bar.name for bar in failed(commands(mae=1.0), PID, better)}
    assert names == {"MAE of ten commands"}
    assert not failed(commands(mae=0.6, change=0.014), PID, better)


def test_a_reference_that_flew_less_sets_fewer_limits() -> None:
    better = flown("Betaflight 4.6", commands=replace(COMMANDS, mae=0.5))
    better = replace(better, flights={HOVER: better.flights[HOVER]}, turns={})
    (bar,) = failed(commands(mae=1.4), PID, better)
    assert [case.limit for case in bar.cases] == [0.625, 1.5]


def test_swing_is_the_amplitude_of_a_sine_and_tells_its_frequency() -> None:
    t = np.arange(600) / 1000
    slow = 0.3 + 0.2 * t + 0.05 * np.sin(2 * np.pi * 3.0 * t)
    motors = (slow + 0.1 * np.sin(2 * np.pi * 65.0 * t))[:, None].repeat(4, axis=1).astype(np.float32)
    amplitude, frequency = swing(motors, 0.001)
    assert amplitude == pytest.approx(0.1, rel=0.02)
    assert frequency == pytest.approx(65.0, abs=1.7)
    assert swing(slow[:, None].astype(np.float32), 0.001)[0] < 0.002
    assert swing(motors[::2], 0.002)[0] == pytest.approx(0.1, rel=0.02)


def test_change_is_that_of_a_millisecond_at_every_rate() -> None:
    motors = np.linspace(0.0, 1.0, 2001, dtype=np.float32)[:, None]
    assert change(motors, 0.001) == pytest.approx(0.0005)
    assert change(motors, 0.0005) == pytest.approx(0.001)


def test_rules_are_counted_up_when_a_bar_or_the_course_changes() -> None:
    modules = (bars_module, course_module, flying_module, limits_module, swing_module)
    constants = {
        name: repr(value)
        for module in modules
        for name, value in vars(module).items()
        if name.isupper() and not callable(value)
    }
    names = [(bar.name, bar.source) for bar in bars(flown(), [PID], LIFT)]
    digest = hashlib.sha256(repr((sorted(constants.items()), names)).encode()).hexdigest()[:12]
    # Another digest: count RULES up, put both here, and check the shipped policies anew.
    assert (RULES, digest) == (2, "cd675fde57e9")
