"""What the check names, of twins that are built wrongly and held softly, stiffly or by a hand."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from itertools import permutations

import numpy as np
import pytest

from neuroflight.flash.hold_down.mends import motor_mends
from neuroflight.flash.hold_down.reaction import Record, reactions
from neuroflight.flash.hold_down.wiring import Layout, Rotor, Wiring, find_wiring
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.world import Held
from tests.flights.held_down import SOFT, Build, built_twin
from tests.sampling import sampled

HZ, EVERY = 1000, 10
WHERE = ("rear right", "front right", "rear left", "front left")


@lru_cache
def layout(name: str) -> Layout:
    aircraft = load_aircraft(name)
    return Layout(aircraft.rotor_positions[:, :2], aircraft.spins)


def records(name: str, build: Build, held: Held, fraction: float, hand: float = 0.0) -> list[Record]:
    """Pulses of each motor; hand: [rad/s], standard deviation of what else turns it, about 2 Hz."""
    found, rng = [], np.random.default_rng(7)
    with closing(built_twin(load_aircraft(name), build, HZ, held)) as twin:
        count = twin.aircraft.motor_count
        for motor in range(count):
            levels = [0] * 600
            for _ in range(4):
                levels += [1] * 200 + [0] * int(rng.integers(250, 500))
            motors, rates, shove = np.zeros((1, count)), [], np.zeros(3)
            for step, level in enumerate(levels):
                motors[0, build.order[motor]] = fraction if level else 0.05
                twin.step(motors)
                shove += 0.0125 * (rng.normal(0.0, 9.0 * hand, 3) - shove)
                if step % EVERY == 0:
                    rates.append(twin.live.gyro[0] + shove)
            motors[:] = 0.0
            for _ in range(500):
                twin.step(motors)
            times = np.arange(len(rates)) * EVERY / HZ
            found.append(Record(times, np.array(rates), np.array(levels[::EVERY], float)))
    return found


def wiring(
    build: Build, held: Held = SOFT, fraction: float = 0.1, hand: float = 0.0, name: str = "nf1"
) -> Wiring:
    return find_wiring(layout(name), reactions(records(name, build, held, fraction, hand)))


def true(build: Build) -> tuple[Rotor | None, ...]:
    return tuple(
        None
        if rotor in build.dead
        else Rotor(rotor, -1 if rotor in build.down else 1, rotor not in build.other_way)
        for rotor in build.order
    )


@pytest.mark.parametrize("order", sampled(permutations(range(4)), (3, 2, 1, 0), (1, 2, 3, 0), (2, 0, 1, 3)))
def test_every_order_is_found(order: tuple[int, ...]) -> None:
    build = Build(order=order)
    assert wiring(build) == Wiring(true(build), (None,) * 4, (False,) * 4)


@pytest.mark.parametrize(
    ("order", "other_way", "down", "dead"),
    [
        ((0, 1, 2, 3), (2,), (2,), ()),  # the motor of a right propeller turns the wrong way
        ((0, 1, 2, 3), (), (1,), ()),  # a propeller of the other way
        ((1, 0, 2, 3), (0, 1, 2, 3), (), ()),  # props out, and two outputs swapped
        ((0, 1, 3, 2), (3,), (), ()),
        ((0, 1, 2, 3), (), (), (1,)),
    ],
)
def test_direction_propeller_and_dead_motors_are_found(
    order: tuple[int, ...], other_way: tuple[int, ...], down: tuple[int, ...], dead: tuple[int, ...]
) -> None:
    build = Build(order, other_way, down, dead)
    found = wiring(build)
    assert found.rotors == true(build)
    assert found.nothing == tuple(rotor in dead for rotor in order)
    assert found.instead is None and not any(found.unsure)


@pytest.mark.parametrize(
    ("held", "fraction", "hand"),
    [
        (Held(1.0, 0.1), 0.08, 0.0),
        (Held(2.0, 0.03), 0.08, 0.0),
        (Held(7.0, 0.1), 0.15, 0.0),
        (Held(1.5, 0.5), 0.15, 0.05),
    ],
)
def test_it_is_found_however_the_aircraft_is_held(held: Held, fraction: float, hand: float) -> None:
    build = Build(order=(2, 0, 1, 3), other_way=(0,), down=(0,))
    found = wiring(build, held, fraction, hand)
    assert found.rotors == true(build) and not any(found.unsure)


@pytest.mark.parametrize(("held", "hand"), [(Held(40.0, 0.1), 0.0), (Held(1.5, 0.5), 3.0)])
def test_it_is_not_told_where_it_cannot_be(held: Held, hand: float) -> None:
    found = wiring(Build(), held, hand=hand)
    assert all(found.unsure)
    assert not found.right
    for rotor, right in zip(found.rotors, true(Build()), strict=True):
        assert rotor is None or replace(rotor, right_way=True) == right


def test_all_motors_turned_around_may_as_well_be_another_order() -> None:
    """Four rotors that push down do what four of opposite corners do, turned the other way."""
    everything = (0, 1, 2, 3)
    found = wiring(Build(other_way=everything, down=everything))
    assert found.instead is not None
    assert true(Build(other_way=everything, down=everything)) in (found.rotors, found.instead)


def test_six_motors_are_found() -> None:
    build = Build(order=(1, 0, 2, 3, 5, 4), other_way=(2,), down=(2,))
    found = wiring(build, fraction=0.2, name="hexa")
    assert found.rotors == true(build)


@pytest.mark.parametrize(
    ("build", "reversed", "told", "settings"),
    [
        (
            Build((3, 1, 2, 0)),
            False,
            "output 1 turns the front left rotor",
            {"motor1_output": 4, "motor4_output": 1},
        ),
        (Build(other_way=(0, 1, 2, 3)), False, "propellers out", {"motors_reversed": 1}),
        (Build(other_way=(2,), down=(2,)), False, "rear left rotor turns the wrong way and pushes down", {}),
    ],
)
def test_the_mend_follows(build: Build, reversed: bool, told: str, settings: dict[str, float]) -> None:
    found = reactions(records("nf1", build, SOFT, 0.1))
    mends = motor_mends(find_wiring(layout("nf1"), found), found, (1, 2, 3, 4), WHERE, reversed=reversed)
    assert told in " ".join(mend.fault for mend in mends)
    assert {name: value for mend in mends for name, value in mend.settings.items()} == settings
