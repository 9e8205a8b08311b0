"""`neuroflight aircraft noise`."""

import json
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.known import How
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from tests.refusal import refused

NF1 = (FOLDER / "nf1.toml").read_bytes()
SIGMA = np.array([0.5, 1.0, 2.0])
COUNT = 20_000


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty seconds at rest, with an accelerometer."""
    path = tmp_path_factory.mktemp("log") / "rest.csv"
    save(path, np.zeros((COUNT, 3)))
    return path


def save(path: Path, rate_deg_s: np.ndarray) -> None:
    rng = np.random.default_rng(1)
    gyro = rate_deg_s + rng.standard_normal((COUNT, 3)) * SIGMA + [0.3, -0.3, 0.3]
    force = rng.standard_normal((COUNT, 3)) * 0.1 + [0.0, 0.0, 9.8]
    np.savetxt(
        path,
        np.column_stack([np.arange(COUNT) / 1000, gyro, force]),
        fmt="%.5f",
        delimiter=",",
        comments="",
        header="t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2",
    )


def test_figures_are_one_document_when_json_is_asked_for(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["aircraft", "noise", str(log), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["gyro_deg_s"]["sigma"] == pytest.approx(SIGMA, rel=0.025)
    assert document["accelerometer_m_s2"]["sigma"] == pytest.approx([0.1] * 3, rel=0.025)
    assert document["gyro_deg_s"]["bandwidth_hz"] == [None] * 3
    assert document["aircraft"]["gyro"]["bias_deg_s"] == pytest.approx(0.3, rel=0.1)
    assert document["warnings"] == []
    assert document["written"] is None


def test_figures_and_what_bias_means_are_printed_when_no_json_is_asked_for(
    log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["aircraft", "noise", str(log)]) == 0
    out = capsys.readouterr().out
    assert "20,000 samples, 20.0 s at 1,000.0 a second" in out
    assert "bias_deg_s is the spread of a bias" in out


@pytest.mark.slow
def test_aircraft_takes_the_noise_and_keeps_the_rest_when_written(log: Path, tmp_path: Path) -> None:
    path, plot = tmp_path / "own.toml", tmp_path / "noise.png"
    path.write_bytes(NF1)
    assert main(["aircraft", "noise", str(log), "--write", str(path), "--plot", str(plot)]) == 0
    aircraft, before = load_aircraft(path), load_aircraft("nf1")
    assert np.rad2deg(aircraft.gyro.noise) == pytest.approx(SIGMA, rel=0.025)
    assert np.rad2deg(aircraft.gyro.bias) == pytest.approx(0.3, rel=0.1)
    assert aircraft.accelerometer is not None
    assert aircraft.accelerometer.noise == pytest.approx([0.1] * 3, rel=0.025)
    assert aircraft.propulsion == before.propulsion
    text, _, marks = path.read_text().partition("\n[known]\n")
    lines = zip(NF1.decode().splitlines(), text.splitlines(), strict=True)
    changed = [old.split(" = ")[0] for old, new in lines if old != new]
    assert changed == ["noise_deg_s", "bias_deg_s", "noise_m_s2"]
    assert marks.count("\n") == len(aircraft.known) == 3
    assert all(mark.how is How.MEASURED and log.name in mark.source for mark in aircraft.known.values())
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_nothing_is_written_when_the_aircraft_moved(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, path = tmp_path / "moved.csv", tmp_path / "own.toml"
    save(log, 20 * np.sin(np.arange(COUNT) / 500)[:, None] * [1.0, 0.0, 0.0])
    path.write_bytes(NF1)
    assert main(["aircraft", "noise", str(log), "--write", str(path)]) == 1
    assert "the aircraft moved" in capsys.readouterr().err
    assert path.read_bytes() == NF1
    assert main(["aircraft", "noise", str(log), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["moved"]
    assert document["aircraft"] is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--plot", "noise.pdf"], "ends in .png"),
        (["--plot", "rest.csv/noise.png"], "rest.csv is no directory"),
        (["--gyro-unit", "0"], "expected above 0"),
        (["--gyro-unit", "nan"], "expected above 0"),
        (["--from", "2", "--to", "1"], "--to 1, expected more than --from, 2"),
        (["--from", "19.5"], "500 samples, expected at least 1000"),
        (["--log", "2"], "log 2 was asked for, but it is no blackbox log"),
        (["--gyro-unit", "0.1"], "leave it out"),
        (["--write", "none.toml"], "none.toml: no such file"),
    ],
)
def test_mistake_is_one_line_when_an_argument_is_wrong(
    log: Path,
    arguments: list[str],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(log.parent)
    assert message in refused(capsys, ["aircraft", "noise", str(log), *arguments])
    assert [item.name for item in log.parent.iterdir()] == ["rest.csv"]


def test_mistake_is_one_line_when_there_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["aircraft", "noise", str(tmp_path / "none.csv")]) == 1
    assert capsys.readouterr().err.endswith("none.csv: no such file\n")
