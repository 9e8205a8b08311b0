"""The fleet: real aircraft, what hides them, the PID scaled for each, and who is told to fly better."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.design.figures import aircraft_figures
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.evaluation.controllers import ControllerSpec
from neuroflight.training.evaluation.fleet import contest
from neuroflight.training.evaluation.fleet.answered import answered
from neuroflight.training.evaluation.fleet.arena import NEAR, Figures, Plan, levels, meet
from neuroflight.training.evaluation.fleet.builds import builds, kinds
from neuroflight.training.evaluation.fleet.contest import Entrant, fly_all
from neuroflight.training.evaluation.fleet.scaled_pid import SCALED, authority, scaled_pid
from neuroflight.training.evaluation.fleet.standings import ratios
from neuroflight.training.evaluation.fleet.unseen import MOTORS_DIFFER, Unseen, fleet

QUICK = Plan(pulses=2, flights=("pulses",))
FIGURES = Figures(
    mae=2.0, mse=80.0, axes=(2.0, 2.0, 2.0), change=0.004, standing=0.1, swing=0.1, overshoot=0.1, full=0.0,
    lost=0, count=8, by_thrust=(), off=0.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def aircraft() -> list[Unseen]:
    return list(fleet(len(builds()), 1, answered))


def test_rows_are_of_all_classes_and_say_where_they_are_from() -> None:
    counts = {kind: sum(build.kind == kind for build in builds()) for kind in kinds()}
    assert len(kinds()) == 8
    assert min(counts.values()) >= 3
    assert all(len(build.source) > 20 for build in builds())
    assert len({build.name for build in builds()}) == len(builds())
    assert min(build.weight_kg for build in builds()) < 0.03
    assert max(build.weight_kg for build in builds()) >= 3.0


def test_every_aircraft_lifts_itself_with_room_to_steer(aircraft: list[Unseen]) -> None:
    lifts = [aircraft_figures(one.truth).thrust_to_weight for one in aircraft]
    assert min(lifts) > 2.0
    assert max(lifts) < 25.0
    assert all(max(levels(one)) < 0.7 * lift for one, lift in zip(aircraft, lifts, strict=True))


def test_an_aircraft_depends_on_seed_and_number_alone(aircraft: list[Unseen]) -> None:
    few, other = list(fleet(3, 1, answered)), next(iter(fleet(1, 2, answered)))
    assert [one.text for one in few] == [one.text for one in aircraft[:3]]
    assert [one.shares for one in few] == [one.shares for one in aircraft[:3]]
    assert other.text != few[0].text


def test_what_is_hidden_is_off_by_as_much_as_is_said(aircraft: list[Unseen]) -> None:
    """A hundred draws of one aircraft: known weight and places, the rest off by its spread, none absurd."""
    build = aircraft[0].build
    drawn = [next(iter(fleet(1, seed, lambda _, name: answered(build, name)))) for seed in range(100)]
    told = authority(drawn[0].told)
    off = np.log([authority(one.truth) / told for one in drawn])
    assert off.std(axis=0) == pytest.approx([0.3, 0.3, 0.4], abs=0.08)
    assert np.abs(off.mean(axis=0)) == pytest.approx([0.0, 0.0, 0.0], abs=0.12)
    assert drawn[7].truth.mass_properties.mass == pytest.approx(build.weight_kg, rel=1e-4)
    assert all(1.0 - MOTORS_DIFFER <= share <= 1.0 for one in drawn for share in one.shares)
    assert all(0.3 <= one.charge <= 1.0 for one in drawn)


def test_scaled_pid_of_the_nf1_is_its_own() -> None:
    nf1 = load_aircraft("nf1")
    given = [np.array(part, np.float32) for part in (np.full((1, 3), 0.3), np.zeros((1, 3)), [0.3])]
    own, scaled = aircraft_pid(nf1, 1, 1000, "flying"), scaled_pid(nf1).build(1)
    assert scaled.step(*given) == pytest.approx(own.step(*given), abs=1e-6)


def test_scaled_pid_of_twice_the_inertia_has_twice_the_gains() -> None:
    nf1 = load_aircraft("nf1")
    mass = nf1.mass_properties
    heavy = replace(nf1, mass_properties=replace(mass, inertia=2 * mass.inertia))
    assert authority(heavy) == pytest.approx(authority(nf1) / 2)
    given = [np.array(part, np.float32) for part in ([[0.02, 0.0, 0.0]], np.zeros((1, 3)), [0.3])]
    once, twice = (np.ptp(scaled_pid(one).build(1).step(*given)) for one in (nf1, heavy))
    assert twice == pytest.approx(2 * once, rel=1e-3)


def test_all_fly_at_equal_thrust_with_the_motors_of_the_aircraft(aircraft: list[Unseen]) -> None:
    one = next(each for each in aircraft if each.build.kind == "5 inch racing")
    alike = replace(one, shares=(1.0,) * 4)
    apart = replace(one, shares=(0.9, 1.0, 1.0, 1.0))
    figures, other = (meet(scaled_pid(one.truth), each, QUICK)["pulses"] for each in (alike, apart))
    assert max(figures.off, other.off) <= NEAR
    assert [level for level, _ in figures.by_thrust] == list(levels(one))[:2]
    assert other.standing > figures.standing + 0.2  # the weak motor turns it; the PID's integral is slow
    assert figures.lost == other.lost == 0


def test_a_controller_that_does_nothing_is_lost(aircraft: list[Unseen]) -> None:
    class Nothing:
        def __init__(self, count: int) -> None:
            self._y = np.zeros((count, 4), np.float32)

        def reset(self) -> None:
            pass

        def step(self, *_: object) -> np.ndarray:
            return self._y

    one = aircraft[0]
    spec = replace(scaled_pid(one.truth), build=Nothing, standing=None)
    assert meet(spec, one, QUICK)["pulses"].lost == 2


@pytest.mark.slow
def test_a_minute_tells_the_drift_and_the_wash_is_of_free_flight(aircraft: list[Unseen]) -> None:
    one = aircraft[0]
    found = meet(scaled_pid(one.truth), one, Plan(pulses=2, flights=("minute", "wash")))
    assert found["minute"].count == found["wash"].count == 1
    assert 0.5 < found["minute"].drift < 90.0
    assert 0.0 < found["wash"].mae < 10.0
    assert found["wash"].overshoot == found["wash"].drift == 0.0


def test_ratios_leave_out_what_either_loses_and_count_it(aircraft: list[Unseen]) -> None:
    three = aircraft[:3]
    names = [one.name for one in three]
    own = {name: {"pulses": FIGURES} for name in names}
    worse = replace(FIGURES, mae=4.0, mse=100.0, change=0.008)
    rival = {names[0]: {"pulses": worse}, names[1]: {"pulses": replace(worse, lost=1)}}
    found = ratios(own, rival, three, "pulses")
    assert found is not None
    assert (found.mae, found.mse, found.change) == pytest.approx((0.5, 0.8, 0.5))
    assert found.worst == pytest.approx(0.8)
    assert found.worst_on == names[0]
    assert (found.count, found.lost, found.rival_lost) == (1, 0, 1)
    assert ratios(own, {}, three, "pulses") is None


def test_kept_figures_are_not_flown_again(
    aircraft: list[Unseen], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flown = []

    def fly(controller: ControllerSpec, *_: object) -> dict[str, Figures]:
        flown.append(controller.name)
        return {"pulses": FIGURES}

    monkeypatch.setattr(contest, "meet", fly)
    entrants = [Entrant.of(SCALED)]

    def again(plan: Plan = QUICK) -> object:
        return fly_all(entrants, aircraft[0], plan, None, tmp_path, lambda _: None)

    assert again() == again() == {SCALED: {"pulses": FIGURES}}
    assert flown == [SCALED]
    again(replace(QUICK, seed=1))
    assert flown == [SCALED, SCALED]
    for file in tmp_path.iterdir():
        file.write_text('{"pulses": {"mae": 1}}')
    with pytest.raises(TrainingError, match=r"holds no figures of a flight .* delete it"):
        again()


def test_any_is_told_what_its_name_says(aircraft: list[Unseen]) -> None:
    one = aircraft[0]
    facts = [Entrant.of(f"any@{told}").facts(one) for told in ("exact", "new", "nothing")]
    shas = [each["told"] for each in facts if each is not None]
    assert shas == [one.truth.sha256, one.told.sha256, load_aircraft("nf1").sha256]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("any@all", "expected one of @exact, @new, @nothing"),
        ("pid", "fly pid:scaled"),
        ("betaflight:tuned", "its defaults; fly betaflight"),
        ("own:nowhere", "no folder 'nowhere'"),
    ],
)
def test_other_controllers_are_refused(name: str, words: str) -> None:
    with pytest.raises(TrainingError, match=words):
        Entrant.of(name)
