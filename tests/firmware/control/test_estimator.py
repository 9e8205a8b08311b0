"""estimator.c: rotors of a model that is followed on paper. tests/sim/control holds the law to Python's."""

from __future__ import annotations

from typing import Any

import pytest

DELAY = 2
# A command settles at 1000 u + 100 rad/s. Half of the way up, a quarter down, in a step.
MODEL = {
    "model_delay": DELAY,
    "model_rotor": [0.0, 1000.0, 100.0, 0.5, 0.25, 1e9, 1e9, 0.0],
    "model_turn": [0.0] * 24,
    "model_reaction": [2.0**-6] + [0.0] * 23,  # roll by the first motor
}
STILL = [0.0] * 3


MEASURED = [600.0, 610.0, 620.0, 630.0]  # rad/s


class Rotors:
    """An estimator of four motors at rest."""

    def __init__(self, core: Any) -> None:
        self.lib, self.self = core.lib, core.new("struct estimator *")
        self.lib.estimator_init(self.self, core.new("struct nf_policy_blob_header *", MODEL))
        self.silent = 0  # bit field of motors
        self.reset()

    def reset(self) -> None:
        self.lib.estimator_reset(self.self)

    def step(
        self, command: float, *, standing: bool = False, first: bool = False, held: bool = False
    ) -> float:
        """A control step that ends with this command; the speed [rad/s] of the first rotor in it."""
        self.lib.estimator_advance(self.self, MEASURED, self.silent)
        self.lib.estimator_observe(self.self, STILL, STILL, 0.0, first, held)
        self.lib.estimator_command(self.self, [command] * 4, standing)
        return float(self.self.speed[0])


@pytest.fixture
def rotors(scripted: Any) -> Rotors:
    return Rotors(scripted)


def test_a_rotor_follows_its_command_after_the_delay(rotors: Rotors) -> None:
    told = [rotors.step(0.8) for _ in range(DELAY + 3)]
    assert told == [50.0, 75.0, 87.5, 493.75, 696.875]


def test_a_rotor_is_the_measured_one_where_that_is_observed_and_its_esc_tells(rotors: Rotors) -> None:
    assert rotors.step(0.8) == 50.0, "not observed: the model's"
    rotors.self.measures = True
    assert rotors.step(0.8) == MEASURED[0]
    assert list(rotors.self.gained) == [MEASURED[0] - 50.0, *(speed - 50.0 for speed in MEASURED[1:])]
    rotors.silent = 1
    for _ in range(3):
        rotors.step(0.8)
    assert rotors.self.speed[0] not in (MEASURED[0], 50.0)
    assert list(rotors.self.speed)[1:] == MEASURED[1:]


def test_motors_that_stand_are_commanded_nothing_whatever_the_controller_answers(rotors: Rotors) -> None:
    for _ in range(40):
        turning = rotors.step(0.8)
    assert turning == pytest.approx(900.0)
    told = [rotors.step(0.8, standing=True) for _ in range(DELAY + 3)]
    assert told[: DELAY + 1] == pytest.approx([900.0] * (DELAY + 1))
    assert told[DELAY + 1 :] == pytest.approx([900.0 - 0.25 * 800.0, 700.0 - 0.25 * 600.0])


def test_rotors_turn_nothing_while_the_ground_holds_the_aircraft(rotors: Rotors) -> None:
    rotors.step(0.8, first=True)
    for _ in range(DELAY + 3):
        assert rotors.step(0.8, held=True) > 0.0
    assert list(rotors.self.rotor) == [0.0] * 4
    assert list(rotors.self.rate) == STILL
    rotors.step(0.8)
    assert rotors.self.rotor[0] > 0.0 and rotors.self.rate[0] > 0.0, "and after take-off they do"


def test_a_reset_leaves_nothing_of_rotors_that_turned(scripted: Any, rotors: Rotors) -> None:
    for _ in range(7):
        rotors.step(0.8)
    rotors.reset()
    fresh = Rotors(scripted)
    for first in (True, *[False] * 5):
        assert rotors.step(0.3, first=first) == fresh.step(0.3, first=first)
        for name in ("rotor", "rate", "error", "gained"):
            assert list(getattr(rotors.self, name)) == list(getattr(fresh.self, name))
    assert rotors.self.rate[0] != 0.0
