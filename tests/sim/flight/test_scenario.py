from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.control import sticks
from neuroflight.sim.flight.scenario import (
    AT_THROTTLE,
    Scenario,
    Segment,
    load_scenario,
    parse_scenario,
    pulses,
)
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import CHANNEL_THROTTLE
from neuroflight.toolchain.errors import ScenarioError

GOOD = """
name = "left then silence"
mount = "rig"
[[segment]]
duration_s = 0.25
setpoint_deg_s = [0, 0, 120]
throttle = 0.5
[[segment]]
duration_s = 0.5
setpoint_deg_s = [0, 0, 0]
receiver = "lost"
"""


def test_pulse_holds_its_command_when_drawn_from_a_seed() -> None:
    scenario = load_scenario("pulse", seed=7)
    channels, heard = scenario.timeline(1000)
    rates = np.rad2deg(sticks.setpoint(channels))
    assert rates.shape == (4500, 3)
    assert heard.all()
    assert not rates[:500].any()
    assert not rates[2500:].any()
    assert (rates[500:2500] == rates[500]).all()
    assert np.abs(rates[500] - np.random.default_rng(7).normal(0, 100, 3)).max() < 1.01


def test_pulses_repeat_when_the_seed_repeats() -> None:
    assert pulses(3, 20) == pulses(3, 20)
    assert pulses(3, 20) != pulses(4, 20)


def test_pulses_follow_the_stated_distribution_when_many_are_drawn() -> None:
    held = np.array([segment.setpoint_deg_s for segment in pulses(1, 3000).segments[1::3]])
    assert np.abs(held.mean(axis=0)).max() < 6.0
    assert np.abs(held.std(axis=0) - 100.0).max() < 4.0


def test_pulses_have_one_episode_each_when_counted() -> None:
    assert load_scenario("pulses", seed=1).episodes() == 10
    assert load_scenario("pulses", seed=1, count=3).episodes() == 3
    assert load_scenario("roll", seed=1).episodes() == 1


@pytest.mark.parametrize(("name", "axis"), [("roll", 0), ("flip", 1)])
def test_a_turn_goes_once_around_when_flown_by_the_sticks(name: str, axis: int) -> None:
    channels, _ = load_scenario(name, seed=1).timeline(1000)
    turned = np.rad2deg(sticks.setpoint(channels)).sum(axis=0) / 1000
    assert turned[axis] == pytest.approx(360, abs=0.1)
    assert np.delete(turned, axis).tolist() == [0, 0]


def test_a_flight_is_the_commands_of_pulses_and_a_hover() -> None:
    scenario, commands = load_scenario("flight", 4, 7), load_scenario("pulses", 4, 7)
    assert scenario.segments[:-1] == commands.segments
    hover = scenario.segments[-1]
    assert (hover.duration_s, scenario.hover_s, hover.setpoint_deg_s) == (15.0, 15.0, (0.0, 0.0, 0.0))
    assert (scenario.episodes(), commands.episodes()) == (7, 7)


@pytest.mark.parametrize("name", AT_THROTTLE)
def test_the_pilots_throttle_stays_where_he_says(name: str) -> None:
    for throttle in (0.0, 0.4):
        assert {s.throttle for s in load_scenario(name, 1, 3, throttle=throttle).segments} == {throttle}


def test_turns_go_once_around_each_axis_both_ways_at_both_rates() -> None:
    scenario = load_scenario("turns", 0)
    channels, _ = scenario.timeline(1000)
    rates = np.rad2deg(sticks.setpoint(channels))
    ends = np.cumsum(scenario.steps(1000))
    parts = [rates[begin:end] for begin, end in zip([0, *ends[:-1]], ends, strict=True)]
    assert all(not part.any() for part in parts[::2])
    found = set()
    for part in parts[1::2]:
        (axis,) = np.flatnonzero(part.any(axis=0))
        assert abs(part[:, axis].sum() / 1000) == pytest.approx(360, abs=1)
        found.add((int(axis), round(part[0, axis] / 10) * 10))
    assert found == {(axis, rate) for axis in range(3) for rate in (-1000, -720, 720, 1000)}


def test_a_file_is_flown_as_written_when_it_is_good(tmp_path: Path) -> None:
    path = tmp_path / "left.toml"
    path.write_text(GOOD)
    scenario = load_scenario(str(path), seed=1)
    assert (scenario.name, scenario.mount, scenario.duration_s) == ("left then silence", Mount.RIG, 0.75)
    channels, heard = scenario.timeline(2000)
    assert heard.tolist() == [True] * 500 + [False] * 1000
    assert np.rad2deg(sticks.setpoint(channels[0])) == pytest.approx([0, 0, 120])
    assert channels[0, CHANNEL_THROTTLE] == 1500
    assert load_scenario(str(path), 1, mount=Mount.CENTRE).mount is Mount.CENTRE


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("duration_s = 0.25\n", "", "segment[0].duration_s: missing"),
        ("duration_s = 0.25", "duration_s = -1", "segment[0].duration_s: got -1"),
        ("[0, 0, 120]", "[0, 0, 1000.5]", "setpoint_deg_s[2]: got 1000.5, expected -1000 to 1000"),
        ("throttle = 0.5", "throttle = 1.5", "segment[0].throttle: got 1.5, expected 0 to 1"),
        ("throttle = 0.5", "thrust = 0.5", "segment[0].thrust: unknown key; known here: controller"),
        ('"lost"', '"off"', "segment[1].receiver: got 'off', expected one of: on, lost"),
        ('mount = "rig"', 'mount = "table"', "mount: got 'table', expected one of: centre, rig, free"),
        ("[0, 0, 120]", "[0, 0, 120", "not TOML"),
    ],
)
def test_a_file_is_refused_by_key_when_something_is_wrong(old: str, new: str, message: str) -> None:
    with pytest.raises(ScenarioError) as refused:
        parse_scenario(GOOD.replace(old, new).encode(), "scenario file x.toml", "x")
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_an_unknown_name_lists_the_known_ones_when_there_is_no_such_file() -> None:
    with pytest.raises(ScenarioError, match=r"no such file.*pulse, pulses, roll, flip"):
        load_scenario("loop-the-loop", seed=1)


@pytest.mark.parametrize(("seed", "count"), [(-1, 1), (1, 0), (1, 10**6)])
def test_a_seed_or_count_is_refused_when_out_of_range(seed: int, count: int) -> None:
    with pytest.raises(ScenarioError, match=r"seed: got|count: got"):
        load_scenario("pulses", seed, count)


def test_a_timeline_is_refused_when_the_flight_is_shorter_than_a_step() -> None:
    with pytest.raises(ScenarioError, match="shorter than one control step"):
        Scenario("blink", (Segment(0.0001),)).timeline(1000)
