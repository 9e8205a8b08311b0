"""Constants of the model of its aircraft that a policy may observe by: rotor speeds and rates it predicts.

A policy's metadata holds them (`neuroflight.model`) and its blob carries them into the firmware, so that twin
and board estimate with the same numbers, whatever aircraft is flown. What is computed from them in a control
step stands in sim/control/estimator.py and firmware/src/control/estimator.c.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np

from neuroflight.toolchain import contract

Rows = tuple[tuple[float, ...], tuple[float, ...], tuple[float, ...]]
UNLIMITED = contract.MODEL_NUMBER_MAX  # [rad/s], of a rotor whose speed may change by anything in a step
NUMBER_MAX = contract.MODEL_NUMBER_MAX
DELAY_STEPS_MAX = contract.ESTIMATOR_DELAY_MAX


@dataclass(frozen=True)
class ModelConstants:
    """Model constants of one control step at the policy's rate; every number is exactly a float32."""

    delay_steps: int  # control steps from an output to the rotor
    speed_curve: tuple[float, float, float]  # a, b, c [rad/s]: a command u settles at (a u + b) u + c
    rise: float  # share of the way to that speed that a rotor goes in a step when it gains speed
    fall: float  # and when it loses speed
    gain_max: float  # [rad/s], most speed that it gains in a step; UNLIMITED
    loss_max: float  # [rad/s], and loses
    correction: float  # share of gyro less prediction that the rate's prediction takes over in a step
    turn: Rows  # roll, pitch, yaw by motor [s/rad]: change of rate in a step for a rotor's speed squared
    reaction: Rows  # likewise [1]: for the speed that it gained in the step

    def __post_init__(self) -> None:
        """Raise ValueError, one line, on a number that no aircraft has."""
        if not 1 <= self.delay_steps <= DELAY_STEPS_MAX:
            raise ValueError(f"delay_steps is {self.delay_steps}, expected 1 to {DELAY_STEPS_MAX}")
        for name in ("rise", "fall", "correction"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected above 0 and at most 1")
        for name in ("gain_max", "loss_max"):
            if not 0.0 < getattr(self, name) <= UNLIMITED:
                raise ValueError(f"{name} is {getattr(self, name)}, expected above 0, at most {UNLIMITED:g}")
        if not 1 <= self.motor_count <= contract.MOTOR_COUNT_MAX:
            raise ValueError(
                f"turn is for {self.motor_count} motors, expected 1 to {contract.MOTOR_COUNT_MAX}"
            )
        if any(len(row) != self.motor_count for row in (*self.turn, *self.reaction)):
            raise ValueError(
                "turn and reaction have rows of other lengths than each other, expected a value a motor"
            )
        numbers = (*self.speed_curve, *(value for row in (*self.turn, *self.reaction) for value in row))
        if not all(math.isfinite(number) and abs(number) <= NUMBER_MAX for number in numbers):
            raise ValueError(f"a number is not finite or beyond {NUMBER_MAX:g}")

    @property
    def motor_count(self) -> int:
        """Number of motors M."""
        return len(self.turn[0])

    @property
    def rotor(self) -> tuple[float, ...]:
        """The numbers of the rotor model and the correction, in the order of the blob."""
        return (*self.speed_curve, self.rise, self.fall, self.gain_max, self.loss_max, self.correction)

    def document(self) -> dict[str, object]:
        """Return the constants as JSON data."""
        return asdict(self)

    @staticmethod
    def of(document: Mapping[str, object]) -> ModelConstants:
        """Build the constants from JSON data, rounded to float32. Raises ValueError, one line."""
        names = [field.name for field in fields(ModelConstants)]
        if unknown := sorted(set(document) ^ set(names)):
            raise ValueError(
                f"keys {', '.join(unknown)[:60]} unknown or missing, expected {', '.join(names)}"
            )
        delay = document["delay_steps"]
        if type(delay) is not int:
            raise ValueError("delay_steps is no whole number")
        numbers = {
            name: _number(name, document[name])
            for name in ("rise", "fall", "gain_max", "loss_max", "correction")
        }
        a, b, c = _row("speed_curve", document["speed_curve"], 3)
        return ModelConstants(
            delay_steps=delay,
            speed_curve=(a, b, c),
            turn=_rows("turn", document["turn"]),
            reaction=_rows("reaction", document["reaction"]),
            **numbers,
        )


def _number(name: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= 3e38:
        raise ValueError(f"{name} holds {str(value)[:40]!r}, expected a number")
    return float(np.float32(value))


def _row(name: str, value: object, count: int | None = None) -> tuple[float, ...]:
    if not isinstance(value, list | tuple) or (count is not None and len(value) != count):
        raise ValueError(f"{name} holds {str(value)[:40]!r}, expected a list of {count or 'a value a motor'}")
    return tuple(_number(name, number) for number in value)


def _rows(name: str, value: object) -> Rows:
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise ValueError(f"{name} holds {str(value)[:40]!r}, expected a list each for roll, pitch and yaw")
    roll, pitch, yaw = (_row(name, row) for row in value)
    return roll, pitch, yaw
