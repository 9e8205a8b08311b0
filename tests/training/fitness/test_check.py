"""Policies in flight: the shipped one is fit, mutilated ones are not. The whole course is slow."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.policy.check_stamp import STAMP_BYTES_MAX, read_stamp, stamp_path
from neuroflight.training.fitness.check import check
from neuroflight.training.fitness.course import THRUSTS, TURN_RATES_DEG_S, course
from neuroflight.training.fitness.flying import CourseFigures
from neuroflight.training.fitness.references import References, fly_references
from tests.sampling import sampled
from tests.training.fitness.mutilated import (
    ALL,
    Mutilation,
    motors_exchanged,
    mutilate,
    other_idle,
    row_negated,
    yaw_unseen,
)

HOVER_TURNS = 6  # of 720 deg/s at the weight
Capture = pytest.CaptureFixture[str]


class Short(References):
    """The PID on a few turns, flown in this process."""

    def __init__(self, aircraft: Aircraft) -> None:
        super().__init__(aircraft, aircraft.name, None, "not asked for")
        self.course = replace(self.course, flights=(), turns=self.course.turns[:HOVER_TURNS])
        self._kept: tuple[CourseFigures, ...] | None = None

    def begin(self) -> None:
        """Nothing flies before it is asked for."""

    def flown(self) -> tuple[tuple[CourseFigures, ...], tuple[str, ...]]:
        """See References."""
        self._kept = self._kept or fly_references(self.aircraft, None, self.course)[0]
        return self._kept, ("not asked for",)


@pytest.fixture(scope="module")
def short() -> Iterator[Short]:
    with Short(load_aircraft("nf1")) as references:
        yield references


def test_the_course_covers_thrusts_and_turns_up_to_what_the_aircraft_lifts() -> None:
    aircraft = load_aircraft("nf1")
    whole, weak = course(aircraft), course(aircraft, 3.0)
    assert [flight.thrust for flight in whole.flights if flight.condition is None] == list(THRUSTS)
    assert [flight.thrust for flight in weak.flights if flight.condition is None] == pytest.approx(
        [0.35, 1.0, 2.0, 2.4]
    )
    turns = {(turn.axis, turn.rate_deg_s) for turn in whole.turns if turn.thrust == 1.0}
    assert turns == {
        (axis, sign * rate) for axis in range(3) for rate in TURN_RATES_DEG_S for sign in (1, -1)
    }
    conditions = [flight.name for flight in whole.flights if flight.condition is not None]
    assert "an empty battery" in conditions and len(conditions) == 6
    varied = whole.variation()
    assert varied.lag[4:6].tolist() == [0.6, 1.5] and varied.charge[-1] == 1.0
    # A hover of 30 s takes 2 % of the pack: it lasts for the flight, and is about empty at its end.
    assert 0.02 < varied.charge[-2] < 0.05
    assert len(whole.nominal().flights) == len(THRUSTS) and len(whole.nominal().turns) == 12


def test_a_good_policy_passes_the_turns(short: Short, shipped_policy: Path) -> None:
    verdict = check(shipped_policy, short.aircraft, short)
    assert verdict.fit, verdict.reasons


@pytest.mark.parametrize("how", sampled([row_negated, motors_exchanged, yaw_unseen, other_idle], row_negated))
def test_a_mutilated_policy_fails_the_turns(
    short: Short, shipped_policy: Path, tmp_path: Path, how: Mutilation
) -> None:
    verdict = check(mutilate(shipped_policy, tmp_path / "policy.onnx", how), short.aircraft, short)
    assert not verdict.fit and verdict.reasons
    document = verdict.document()
    assert document["fit"] is False and document["aircraft_sha256"] == short.aircraft.sha256


def test_an_aircraft_without_any_reference_is_told_the_command() -> None:
    aircraft = replace(load_aircraft("nf1"), pids=())
    with pytest.raises(AircraftError, match=r"run: neuroflight pid tune --aircraft mine\.toml --out"):
        References(aircraft, "mine.toml", None, "Betaflight: not here")


@pytest.mark.slow
def test_references_in_a_process_of_their_own_fly_the_same(short: Short) -> None:
    with References(short.aircraft, "nf1", None, "not asked for") as references:
        references.course = short.course
        (there,), missing = references.flown()
        assert references.flown()[0] == (there,)
    assert (there,) == short.flown()[0] and missing == ("not asked for",)


@pytest.mark.slow
def test_the_shipped_policy_is_fit_and_gets_a_stamp(
    shipped_policy: Path, tmp_path: Path, capsys: Capture
) -> None:
    policy = tmp_path / "policy.onnx"
    policy.write_bytes(shipped_policy.read_bytes())
    assert main(["policy", "check", str(policy), "--aircraft", "nf1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["fit"] is True and told["references"] == ["PID flying", "Betaflight 4.6"]
    assert len(told["cases"]["swing in a turn"]) == 24
    stamp = read_stamp(policy)
    assert stamp is not None and stamp.fit and stamp_path(policy).stat().st_size < STAMP_BYTES_MAX / 50


@pytest.mark.slow
@pytest.mark.parametrize("how", ALL)
def test_every_mutilated_policy_fails_the_whole_course(
    shipped_policy: Path, tmp_path: Path, how: Mutilation, capsys: Capture
) -> None:
    policy = mutilate(shipped_policy, tmp_path / "policy.onnx", how)
    assert main(["policy", "check", str(policy), "--aircraft", "nf1"]) == 1
    assert "is NOT fit to fly nf1" in capsys.readouterr().out
    stamp = read_stamp(policy)
    assert stamp is not None and not stamp.fit
