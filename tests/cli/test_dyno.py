"""`neuroflight dyno`: simulate a bench, fit its log, write the fit into a file."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path
from typing import Any

import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, RPM, TorqueResponse, load_aircraft
from tests.refusal import refused


def command(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, Any]:
    assert main(["dyno", *map(str, words), "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The NF1's steps as a poor bench logs them; not to be changed."""
    path = tmp_path_factory.mktemp("dyno") / "bench.csv"
    words = ["--experiment", "steps", "--rate-hz", "300", "--noise", "2", "--outliers", "1", "--uneven"]
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["dyno", "run", *words, "--seed", "4", "--out", str(path), "--json"]) == 0
    return path


def test_run_writes_the_log_and_prints_each_step_when_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "a.csv", tmp_path / "a.png"
    document = command(capsys, "run", "--experiment", "steps", "--out", out, "--plot", plot)
    assert out.read_text().startswith("time_s,throttle,rpm,thrust_n,torque_n_m\n")
    assert document["rows"] == len(out.read_text().splitlines()) - 1 == 8500
    assert [step["throttle"] for step in document["steps"]] == [0.25, 0.5, 0.75, 1.0]
    assert document["steps"][3]["rise_0_90_s"] == pytest.approx(0.21, abs=0.01)
    assert document["steps"][3]["rpm"] == pytest.approx(25042, rel=0.005)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_run_repeats_itself_when_the_seed_is_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "--experiment", "steps", "--noise", "2", "--outliers", "1", "--uneven"]
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        command(capsys, *words, "--seed", seed, "--out", tmp_path / f"{name}.csv")
    one, same, other = ((tmp_path / f"{name}.csv").read_bytes() for name in "abc")
    assert one == same != other


@pytest.mark.slow
def test_repeats_are_runs_of_one_log_with_intervals_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "a.csv", tmp_path / "a.png"
    words = ["--repeats", "3", "--hold", "1", "--rate-hz", "100", "--noise", "1"]
    document = command(capsys, "run", *words, "--out", out, "--plot", plot)
    figures = document["figures"]
    assert (document["repeats"], document["hold_s"], document["steps"]) == (3, 1.0, [])
    assert [step["count"] for step in figures["steps"]] == [3, 3, 3, 3]
    top = figures["ramp_top"]
    assert figures["runs"] == 6 and top["count"] == 3
    assert top["thrust_n"]["mean"] == pytest.approx(6.39, rel=0.01) and 0 < top["thrust_n"]["margin"] < 0.1
    assert document["rows"] == 3 * (900 + 4300) and document["sensors"] is None
    assert plot.read_bytes().startswith(b"\x89PNG")
    fitted = command(capsys, "fit", out)["repeats"]
    assert fitted["runs"] == 6 and fitted["ramp_top"]["count"] == 3
    assert fitted["ramp_top"]["thrust_n"]["mean"] == pytest.approx(top["thrust_n"]["mean"], abs=1e-4)
    assert main(["dyno", "fit", str(out)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "6 runs: mean ± 95 % interval" in shown and "at the ramp's top K_T = 9.3" in shown


def test_sensors_are_calibrated_and_told_beside_the_truth_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "--sensors", "--experiment", "steps", "--rate-hz", "250", "--noise", "1"]
    found = command(capsys, *words, "--out", tmp_path / "a.csv")["sensors"]
    assert set(found["cells"]) == {"thrust_raw", "torque_left_raw", "torque_right_raw"}
    for cell in found["cells"].values():
        assert 0 < abs(cell["error_percent"]) < 0.3 and 0 < cell["standard_error_percent"] < 0.1
        assert cell["counts_a_unit"] == pytest.approx(cell["true_counts_a_unit"], rel=3e-3)
    assert found["speed"]["pulses_a_turn"] == 3 and 0 < found["speed"]["rms_error_percent"] < 0.2
    assert main(["dyno", *words, "--out", str(tmp_path / "b.csv")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "counts a N by 21 loads, truly 21,000" in shown and "3 pulses a turn" in shown
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_fit_recovers_the_aircraft_and_writes_it_when_asked(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target, plot = tmp_path / "mine.toml", tmp_path / "fit.png"
    document = command(capsys, "fit", log, "--aircraft", "nf1", "--write", target, "--plot", plot)
    assert document["response"]["kind"] == "torque"
    assert document["response"]["torque_up_n_m"]["value"] == pytest.approx(0.05, rel=0.1)
    assert document["thrust_coefficient"][0]["value"] == pytest.approx(9.37e-7, rel=0.02)
    assert 0 < document["thrust_coefficient"][0]["standard_error"] < 1e-8
    assert [part["throttle"] for part in document["speed_errors_percent"]] == [0.25, 0.5, 0.75, 1.0, None]
    assert all(part["mae"] < 2 and part["model_rms"] < 1 for part in document["speed_errors_percent"])
    propulsion = load_aircraft(target).propulsion
    assert propulsion.speed_max / RPM == pytest.approx(document["speed_max_rpm"], rel=1e-5)
    assert isinstance(propulsion.response, TorqueResponse)
    assert propulsion.response.gain == pytest.approx(1e-4, rel=0.1)
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_fit_gives_accelerations_only_when_no_inertia_is_known(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    response = command(capsys, "fit", log)["response"]
    assert response["up_per_inertia"]["value"] == pytest.approx(0.05 / 4.24e-6, rel=0.1)
    assert "torque_up_n_m" not in response
    assert main(["dyno", "fit", str(log)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "a bench shows torques only divided by the rotor's inertia" in shown
    assert "step to 100 %" in shown and "K_T" in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "--out", "a.txt"], "expected a name that ends in .csv"),
        (["run", "--out", "a.csv", "--rate-hz", "1"], "--rate-hz 1, expected 10 to 2000"),
        (["run", "--out", "a.csv", "--noise", "nan"], "--noise nan, expected 0 to 100"),
        (["run", "--out", "a.csv", "--seed", "-1"], "--seed -1, expected 0"),
        (["run", "--out", "a.csv", "--repeats", "0"], "--repeats 0, expected 1 to 99"),
        (["run", "--out", "a.csv", "--hold", "0.5"], "--hold 0.5, expected 1 to 10"),
        (["run", "--out", "a.csv", "--repeats", "99", "--rate-hz", "2000"], "expected at most 1000000"),
        (["run", "--out", "a.csv", "--aircraft", "kite"], "'kite': no such file"),
        (["fit", "none.csv"], "none.csv: no such file"),
        (["fit", "bench.csv", "--write", "none.toml"], "none.toml: no such file, expected an aircraft"),
        (["fit", "bench.csv", "--delay", "2"], "--delay 2, expected 0 to 0.1"),
        (["fit", "bench.csv", "--plot", "a.jpg"], "expected a name that ends in .png"),
        (["fit", "short.csv"], "short.csv: 10 rows, expected at least 50"),
    ],
)
def test_command_says_one_line_and_leaves_nothing_when_it_cannot(
    log: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.csv").write_text("\n".join(log.read_text().splitlines()[:11]))
    before = sorted(tmp_path.iterdir())
    assert message in refused(capsys, ["dyno", *words])
    assert sorted(tmp_path.iterdir()) == before


def test_aircraft_file_stays_when_the_fit_fails(
    log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "mine.toml"
    target.write_bytes((FOLDER / "nf1.toml").read_bytes())
    rows = log.read_text().splitlines()
    short = tmp_path / "first_step.csv"
    short.write_text("\n".join(rows[: len(rows) // 6]))
    assert main(["dyno", "fit", str(short), "--write", str(target)]) == 1
    assert "expected at least three levels" in capsys.readouterr().err
    assert target.read_bytes() == (FOLDER / "nf1.toml").read_bytes()
