"""Controllers and tuners of a user's own file, by the names that a command line gives them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.evaluation.controllers import Conditions, load_controller
from neuroflight.training.evaluation.users_controller import load_users_controller, values_text
from neuroflight.training.pid_tuning import users_tuning
from neuroflight.training.pid_tuning.cma_es import CmaEs
from neuroflight.training.pid_tuning.trial import Tuning
from neuroflight.training.pid_tuning.tuner import MakeTuner, load_tuner
from neuroflight.training.pid_tuning.users_tuning import Values, tune_users
from neuroflight.training.tasks.task import PulseTask

NF1 = load_aircraft("nf1")
Capture = pytest.CaptureFixture[str]

WRAPPED = """
from neuroflight.sim.control.pid import aircraft_pid

class Wrapped:
    idle = 0.23

    def __init__(self, aircraft, count, rate_hz):
        self.pid = aircraft_pid(aircraft, count, rate_hz, "tuned")
        self.reset, self.step = self.pid.reset, self.pid.step

    def reset(self): ...
    def step(self, setpoint, gyro, throttle): ...
"""
RATES = """
import numpy as np

class Rates:
    mix, idle = "centred", 0.055
    parameters = {"p": (0.001, 0.0001, 0.01), "d": (1e-5, 1e-6, 1e-4)}

    def __init__(self, aircraft, count, rate_hz, *, p, d):
        x, y = aircraft.rotor_positions[:, :2].T
        self.turns = np.stack([np.sign(y), -np.sign(x), -aircraft.spins])
        self.p, self.d, self.rate_hz, self.before = p, d, rate_hz, np.zeros((count, 3))

    def reset(self):
        self.before[:] = 0.0

    def step(self, setpoint, gyro, throttle):
        rate = np.rad2deg(gyro)
        slope, self.before = (rate - self.before) * self.rate_hz, rate
        return 0.5 + (self.p * (np.rad2deg(setpoint) - rate) - self.d * slope) @ self.turns
"""
GRID = """
import numpy as np

class Grid:
    def __init__(self, start, spread, population, rng):
        self.start, self.spread, self.told = start, spread, 0

    def ask(self):
        at = np.linspace(-1.0, 2.0, 4)[:, None]
        return self.start + at * self.spread

    def tell(self, points, costs):
        assert points.shape == (4, 1) and costs.shape == (4,)
"""


def written(folder: Path, text: str, name: str = "mine.py") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def test_it_flies_as_the_same_controller_of_ours(tmp_path: Path) -> None:
    path = written(tmp_path, WRAPPED)
    mine = load_controller(f"{path}:Wrapped", NF1)
    assert (mine.label, mine.idle, mine.mix, mine.control_rate_hz) == (
        "mine:Wrapped",
        0.23,
        Mix.ATTITUDE_FIRST,
        1000,
    )
    flown = Conditions(NF1, PulseTask(idle_s=0.05, command_s=0.2, rest_s=0.1), 4, 1)
    ours = load_controller("pid:tuned", NF1)
    assert (flown.fly(mine, 0.3).rate == flown.fly(ours, 0.3).rate).all()


def test_values_come_from_a_file_within_their_ranges(tmp_path: Path) -> None:
    path, values = written(tmp_path, RATES), tmp_path / "gains.toml"
    values.write_text("p = 0.002\n")
    mine = load_users_controller(f"{path}:Rates:{values}")
    assert mine.values == {"p": 0.002, "d": 1e-5}
    spec = load_controller(f"{path}:Rates:{values}", NF1)
    assert spec.label == "mine:Rates:gains"
    assert spec.facts["parameters"] == "p=0.002, d=1e-05"
    for text, message in (
        ("p = 2.0\n", r"gains\.toml: p: got 2\.0, expected 0\.0001 to 0\.01"),
        ("q = 1\n", r"gains\.toml: q: unknown key"),
        ("p = ", r"gains\.toml: not TOML"),
    ):
        values.write_text(text)
        with pytest.raises(TrainingError, match=message):
            load_users_controller(f"{path}:Rates:{values}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("class Rates", "class Other"), r"expected .*mine\.py:CLASS, a class of that file: Other"),
        (("def step", "def fly"), r"has no step\(\), expected reset\(\) and step\(\)"),
        (
            ("(0.001, 0.0001, 0.01)", "0.001"),
            r"parameters\['p'\] 0\.001, expected \(start, least, greatest\)",
        ),
        (("(0.001, 0.0001, 0.01)", "(0.001, 0.1, 0.01)"), "expected .* in order"),
        (("import numpy as np", "import nothing_like_it"), r"line 2: ModuleNotFoundError"),
        (("*, p, d):", "*, p):"), r"TypeError: .*unexpected keyword argument 'd'"),
        (("@ self.turns", "@ self.turns[:, :3]"), r"step\(\): returned shape \(2, 3\), expected \(2, 4\)"),
        (("return 0.5 +", "return np.nan *"), r"step\(\): returned nan, expected finite numbers"),
        (("return 0.5 +", "return 0 // 0 +"), r"mine\.py, line 19: ZeroDivisionError"),
    ],
)
def test_what_is_wrong_with_it_is_said_in_one_line(
    change: tuple[str, str], message: str, tmp_path: Path
) -> None:
    path = written(tmp_path, RATES.replace(*change))
    flown = Conditions(NF1, PulseTask(idle_s=0.0, command_s=0.01, rest_s=0.01), 2, 1)
    with pytest.raises(TrainingError, match=message) as caught:
        flown.fly(load_controller(f"{path}:Rates", NF1), 0.0)
    assert "\n" not in str(caught.value)


def test_outputs_are_limited_and_inputs_are_its_own(tmp_path: Path) -> None:
    text = RATES.replace("return 0.5 +", "setpoint[:] = 9; return 3 * self.turns.mean() +")
    controller = load_users_controller(f"{written(tmp_path, text)}:Rates").build(NF1, 2)
    setpoint = np.ones((2, 3), np.float32)
    outputs = controller.step(setpoint, np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    assert (setpoint == 1.0).all()
    assert outputs.dtype == np.float32
    assert (outputs.min(), outputs.max()) == (0.0, 0.0) or 0.0 <= outputs.min() <= outputs.max() <= 1.0


def tuned(
    path: Path, monkeypatch: pytest.MonkeyPatch, budget: int, names: Sequence[str], tuner: MakeTuner = CmaEs
) -> Tuning[Values]:
    """Return what a short search finds: on a third of the commands."""
    monkeypatch.setattr(users_tuning, "COMMANDS", 4)
    mine = load_users_controller(f"{path}:Rates")
    return tune_users(
        mine, NF1, 0.06, names=names, seed=1, budget=budget, progress=lambda flown, best: None, tuner=tuner
    )


def test_its_parameters_are_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, RATES)
    found = tuned(path, monkeypatch, 12, ["p", "d"])
    assert len(found.trials) == 12
    assert found.start.settings == {"p": 0.001, "d": 1e-5}
    assert found.best.cost < 0.9 * found.start.cost
    assert found.best.mae < found.start.mae
    assert all(0.0001 <= trial.settings["p"] <= 0.01 for trial in found.trials)
    # Each flies as it would alone: the candidates of a generation do not touch each other.
    values = tmp_path / "gains.toml"
    values.write_text(values_text(found.best.settings, "found"))
    assert load_users_controller(f"{path}:Rates:{values}").values == found.best.settings
    assert found.best in found.trials


def test_a_tuner_of_the_users_searches_some_parameters(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    grid = load_tuner(f"{written(tmp_path, GRID, 'grid.py')}:Grid")
    found = tuned(written(tmp_path, RATES), monkeypatch, 4, ["p"], grid)
    assert {trial.settings["d"] for trial in found.trials} == {1e-5}
    tried = [0.0001 * 100 ** (0.5 + 0.2 * at) for at in (-1.0, 0.0, 1.0, 2.0)]
    assert np.allclose([trial.settings["p"] for trial in found.trials], tried, rtol=1e-3)


@pytest.mark.slow
def test_what_was_found_is_written_and_flown(tmp_path: Path, capsys: Capture) -> None:
    path, out = written(tmp_path, RATES), tmp_path / "gains.toml"
    words = ["pid", "tune", "--of", f"{path}:Rates", "--budget", "12", "--check", "5", "--max-change", "0.06"]
    assert main([*words, "--write", str(out), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["parameters"] == tomllib.loads(out.read_text())
    assert "Found by `neuroflight pid tune --of mine.py:Rates" in out.read_text()
    found = told["figures"]
    assert np.mean(found["tuned"]["thrust 1"]["mae"]) < np.mean(found["defaults"]["thrust 1"]["mae"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--parameters", "q"], r"no parameter q; its attribute `parameters` has: p, d"),
        (["--terms", "dissertation"], "--terms dissertation: of a PID's search"),
        (["--name", "x"], "--name: of a PID's search; leave it out"),
        (["--tuner", "nothing.py:Grid"], r"nothing\.py: no such file"),
    ],
)
def test_a_wrong_tuning_is_refused(words: list[str], message: str, tmp_path: Path, capsys: Capture) -> None:
    path = written(tmp_path, RATES)
    assert main(["pid", "tune", "--of", f"{path}:Rates", *words]) == 1
    assert message.replace("\\", "") in capsys.readouterr().err
    assert main(["pid", "tune", "--of", "nothing"]) == 1
    assert "--of nothing, expected pid, betaflight or FILE.py:CLASS" in capsys.readouterr().err


def test_points_that_are_none_are_refused(tmp_path: Path) -> None:
    for text, message in (
        (
            GRID.replace("return self.start", "return at +").replace("at * self.spread", "0"),
            r"returned shape \(4, 1\), expected",
        ),
        (GRID.replace("self.start + at", "np.nan * self.start + at"), "numbers that are not finite"),
    ):
        path = written(tmp_path, text, f"grid{len(text)}.py")
        made = load_tuner(f"{path}:Grid")(np.zeros(2), np.ones(2), 12, np.random.default_rng(1))
        with pytest.raises(TrainingError, match=message):
            made.ask()
