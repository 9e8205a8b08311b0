"""Links in reduced coordinates do not drift, those in maximal ones do; both against the rigid twin."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.identification.link_drift import (
    FORMULATIONS,
    ONSET_M,
    RATE_MAX,
    Drift,
    drift,
    onset,
    worst_by_rate,
)
from neuroflight.sim.identification.link_drift_plot import draw_drift, draw_map
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.errors import AircraftError
from tests.refusal import refused

NF1 = load_aircraft("nf1")
Runs = dict[tuple[str, float], Drift]
STEPS_MS = (4.0, 2.0, 1.0)


@pytest.fixture(scope="module")
def runs() -> Runs:
    """Both formulations; the longest step only where links can drift."""
    steps = {"reduced": STEPS_MS[1:], "maximal": STEPS_MS}
    return {(f, ms): drift(NF1, f, ms / 1e3) for f in FORMULATIONS for ms in steps[f]}


def test_links_stay_where_they_are_when_coordinates_are_reduced(runs: Runs) -> None:
    for ms in STEPS_MS[1:]:
        assert runs["reduced", ms].worst < 1e-6
        assert runs["reduced", ms].rate.max() > 0.95 * RATE_MAX


def test_drift_grows_with_the_step_when_coordinates_are_maximal(runs: Runs) -> None:
    coarse, middle, fine = (runs["maximal", ms] for ms in STEPS_MS)
    assert coarse.worst > 2 * middle.worst > 4 * fine.worst > 1e-5
    # Not only at the fastest: at each rate that all three flew through.
    curves = [dict(zip(*worst_by_rate(run, 5.0), strict=True)) for run in (coarse, middle, fine)]
    rates = set.intersection(*(set(curve) for curve in curves))
    assert len(rates) >= 6
    assert all(curves[0][rate] > curves[1][rate] > curves[2][rate] for rate in rates)


def test_drift_grows_with_the_rate_when_coordinates_are_maximal(runs: Runs) -> None:
    _, worst = worst_by_rate(runs["maximal", 1.0], 7.0)
    assert (np.diff(worst) > 0).all()


def test_links_turn_as_the_twin_does_when_nothing_drifts(runs: Runs) -> None:
    still = replace(NF1.propulsion, drag_coefficient=0.0, rolling_coefficient=0.0, delay=0.001)
    for command in (0b1010, 0b1100, 0b0100):
        motors = np.array([[float(digit) for digit in f"{command:04b}"]])
        twin = Twin(
            replace(NF1, propulsion=still),
            mount=Mount.FREE,
            gravity=False,
            noise=False,
            rng=np.random.default_rng(0),
        )
        flown = runs["reduced", 1.0].rate[runs["reduced", 1.0].flight == command]
        try:
            for _ in range(121):  # the twin takes a command one sample later
                twin.step(motors)
            assert np.linalg.norm(twin.rate) == pytest.approx(flown[120], rel=0.015)
        finally:
            twin.close()


def test_drift_is_the_same_when_flown_again(runs: Runs) -> None:
    again = drift(NF1, "maximal", 0.002)
    assert np.array_equal(again.drift, runs["maximal", 2.0].drift)


def about_roll(rates: list[float], drifts: list[float]) -> Drift:
    """A run of samples [rad/s] about roll, its two links off by `drifts` [m] as a pair in both orders."""
    turned = np.array(rates)[:, None] * [1.0, 0.0, 0.0]
    apart = np.array(drifts)
    return Drift("maximal", 0.001, np.zeros(len(rates), int), turned, apart, 2 * apart)


def test_separation_counts_each_pair_in_both_orders(runs: Runs) -> None:
    for run in runs.values():
        # The propeller that moved most is two of the sum's terms; 5 links make 20.
        assert (run.separation >= 2 * run.drift).all()
        assert run.separation.max() <= 20 * 2 * run.worst
    assert runs["maximal", 1.0].separation.max() > 2.5 * runs["maximal", 1.0].worst


def test_onset_comes_at_higher_rates_when_the_step_is_shorter(runs: Runs) -> None:
    threshold = 0.0002  # [m], which all three steps pass
    found = [onset(runs["maximal", ms], threshold) for ms in STEPS_MS]
    rates = [each.rate for each in found if each is not None]
    assert len(rates) == 3
    assert rates == sorted(rates)
    assert all(onset(runs["reduced", ms], ONSET_M) is None for ms in STEPS_MS[1:])


def test_onset_is_the_slowest_sample_above_the_threshold() -> None:
    run = about_roll([1.0, -2.0, 3.0, 4.0], [0.001, 0.003, 0.002, 0.004])
    found = onset(run, 0.003)
    assert found is not None
    assert found.rates.tolist() == [-2.0, 0.0, 0.0]
    assert (found.rate, found.separation) == (2.0, 0.006)
    assert onset(run, 0.008) is None


def test_rates_are_about_the_axes_of_the_airframe(runs: Runs) -> None:
    run = runs["reduced", 1.0]
    left = run.rates[run.flight == 0b0011][-1]  # motors 3 and 4 are on the left: it rolls to the right
    assert left[0] > 5 * np.abs(left[1:]).max()
    turning = run.rates[run.flight == 0b1001][-1]  # one diagonal: yaw alone
    assert np.abs(turning[2]) > 5 * np.abs(turning[:2]).max()


def test_map_has_a_panel_for_each_run_and_marks_the_onset(runs: Runs) -> None:
    figure = draw_map(list(runs.values()), 0.0002, "title")
    titles = [panel.get_title(loc="left") for panel in figure.axes[:5]]
    assert titles[0] == "reduced, 2 ms\nnever above 0.2 mm"
    assert titles[3].startswith("maximal, 2 ms\nabove 0.2 mm from ")
    assert "sum over all pairs, mm" in figure.axes[5].get_ylabel()


def test_worst_is_taken_in_each_interval_when_rates_are_scattered() -> None:
    run = about_roll([0.5, 0.9, 3.1, -3.9], [4.0, 2, 1, 7])
    rate, worst = worst_by_rate(run, 1.0)
    assert rate.tolist() == [0.5, 3.5]
    assert worst.tolist() == [4.0, 7.0]


def test_plot_names_each_run_when_drawn(runs: Runs) -> None:
    panel = draw_drift(list(runs.values()), "title").axes[0]
    names = [text.get_text() for text in panel.get_legend().get_texts()]  # type: ignore[union-attr]
    assert names == [f"{f}, {ms:g} ms" for f, ms in runs]
    assert panel.get_ylabel() == "drift of a propeller, mm"


def test_aircraft_is_refused_when_its_rotors_have_no_propellers() -> None:
    bare = tuple(part for part in NF1.parts if part.name != "propeller 3")
    with pytest.raises(AircraftError, match="rotor 3 has no propeller part"):
        drift(replace(NF1, parts=bare), "reduced", 0.001)


def tripod() -> Aircraft:
    """Three rotors: eight flights."""
    parts = tuple(part for part in NF1.parts if part.name not in ("motor 4", "propeller 4"))
    return replace(NF1, parts=parts, rotors=NF1.rotors[:3])


def test_every_combination_is_flown_when_there_are_three_rotors() -> None:
    calls: list[None] = []
    run = drift(tripod(), "reduced", 0.002, lambda: calls.append(None))
    assert len(calls) == 8
    assert set(run.flight.tolist()) == set(range(8))


def test_command_prints_one_document_when_asked_for_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rates = tmp_path / "map.png"
    words = ["--threshold-mm", "0.5", "--json", "--map", str(rates)]
    assert main(["aircraft", "stability", "--steps-ms", "4", *words]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (
        document["command"] == "neuroflight aircraft stability --aircraft nf1 --steps-ms 4 --threshold-mm 0.5"
    )
    assert [run["formulation"] for run in document["runs"]] == ["reduced", "maximal"]
    assert document["runs"][0]["drift_m"] < 1e-6 < document["runs"][1]["drift_m"]
    still, apart = document["runs"]
    assert still["onset"] is None
    assert apart["separation_m"] > apart["onset"]["separation_m"] > 0.0005
    assert np.linalg.norm(apart["onset"]["rates_deg_s"]) == pytest.approx(apart["onset"]["rate_deg_s"])
    assert rates.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--steps-ms", "0"], "--steps-ms 0, expected 0.05 to 20 ms"),
        (["--steps-ms", "nan"], "--steps-ms nan"),
        (["--plot", "drift.jpg"], "expected a name that ends in .png"),
        (["--map", "map.jpg"], "expected a name that ends in .png"),
        (["--threshold-mm", "0"], "--threshold-mm 0, expected above 0, at most 1000 mm"),
        (["--aircraft", "nf9"], "no such file"),
    ],
)
def test_command_refuses_in_one_line_when_the_input_is_bad(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, ["aircraft", "stability", *arguments])
