"""`neuroflight aircraft inertia`: logs of pendulums whose moment is known."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import GRAVITY
from tests.refusal import refused

Capture = pytest.CaptureFixture[str]
MASS, DISTANCE, LENGTH = 0.4, 0.15, 1.0  # [kg], [m], [m]
BIFILAR = ["--bifilar", str(MASS), str(DISTANCE), str(LENGTH)]
WIRE = 0.03  # [N m/rad]
MOMENTS = (8e-4, 1.1e-3, 1.7e-3)  # [kg m^2] roll, pitch, yaw
RATE_HZ = 200.0


def save(path: Path, axis: int, turn: float, amplitude_deg: float = 4.0, seconds: float = 12.0) -> Path:
    """A log of a swing at `turn` [rad/s], which decays slowly, with bias and noise of the gyro."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    gyro = np.random.default_rng(axis).normal(0.2, 0.3, (len(time), 3))
    gyro[:, axis] -= amplitude_deg * turn * np.exp(-0.02 * time) * np.sin(turn * time)
    np.savetxt(
        path,
        np.column_stack([time, gyro]),
        fmt="%.5f",
        delimiter=",",
        comments="",
        header="t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s",
    )
    return path


def turn_bifilar(inertia: float) -> float:
    """[rad/s] of a bifilar pendulum, from T = (4 pi / d) sqrt(J L / (m g))."""
    return 2 * math.pi / (4 * math.pi / DISTANCE * math.sqrt(inertia * LENGTH / (MASS * GRAVITY)))


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of logs: three hangings on two wires, one on a torsion wire, its reference, one at rest."""
    folder = tmp_path_factory.mktemp("swings")
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        save(folder / f"{name}.csv", axis, turn_bifilar(MOMENTS[axis]))
    save(folder / "wire.csv", 1, math.sqrt(WIRE / MOMENTS[1]))
    save(folder / "reference.csv", 2, math.sqrt(WIRE / 2e-3))
    save(folder / "rest.csv", 0, 5.0, amplitude_deg=0.0)
    save(folder / "far.csv", 0, 5.0, amplitude_deg=30.0)
    save(folder / "short.csv", 0, 2.0)  # four periods
    return folder


def test_three_hangings_tell_the_three_moments(logs: Path, capsys: Capture) -> None:
    names = [str(logs / f"{name}.csv") for name in ("yaw", "roll", "pitch")]
    assert main(["aircraft", "inertia", *names, *BIFILAR, "--aircraft", "nf1", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    filed = np.diag(load_aircraft("nf1").mass_properties.inertia)
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        row = document["axes"][name]
        assert row["log"] == str(logs / f"{name}.csv")
        assert row["inertia_kg_m2"] == pytest.approx(MOMENTS[axis], rel=2e-3)
        assert abs(row["inertia_kg_m2"] - MOMENTS[axis]) < 2 * row["margin_kg_m2"] < 0.01 * MOMENTS[axis]
        assert row["amplitude_deg"] == pytest.approx(4.0, rel=0.05)
        assert row["of_aircraft"] == pytest.approx(MOMENTS[axis] / filed[axis], rel=2e-3)
    told = document["line"].removeprefix("inertia_kg_m2 = [").removesuffix("]").split(", ")
    assert [float(value) for value in told] == pytest.approx(MOMENTS, rel=2e-3)


def test_a_torsion_wire_and_its_reference_tell_the_same(logs: Path, capsys: Capture) -> None:
    found = []
    for wire in (["--stiffness", str(WIRE)], ["--reference", str(logs / "reference.csv"), "2e-3"]):
        assert main(["aircraft", "inertia", str(logs / "wire.csv"), *wire, "--json"]) == 0
        document = json.loads(capsys.readouterr().out)
        assert document["line"] is None and set(document["axes"]) == {"pitch"}
        found.append(document["axes"]["pitch"])
    assert [row["inertia_kg_m2"] for row in found] == pytest.approx([MOMENTS[1]] * 2, rel=3e-3)
    assert found[1]["margin_kg_m2"] > found[0]["margin_kg_m2"]  # the reference's own is in it


def test_moments_are_told_and_drawn(logs: Path, tmp_path: Path, capsys: Capture) -> None:
    plot = tmp_path / "swings.png"
    names = [str(logs / f"{name}.csv") for name in ("roll", "pitch", "yaw")]
    arguments = ["aircraft", "inertia", *names, *BIFILAR, "--plot", str(plot), "--aircraft", "nf1"]
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert "inertia_kg_m2 = [" in out and "nf1's file says" in out and "1 % of the distance" in out
    assert plot.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.csv", *BIFILAR], "none.csv: no such file"),
        (["roll.csv", "--bifilar", "0.4", "0", "1"], "--bifilar 0, expected above 0"),
        (["roll.csv", "--bifilar", "nan", "0.15", "1"], "--bifilar nan, expected above 0"),
        (["wire.csv", "--stiffness", "-1"], "--stiffness -1, expected above 0"),
        (["wire.csv", "--reference", "reference.csv", "heavy"], "expected LOG KG_M2"),
        (["wire.csv", "--reference", "reference.csv", "0"], "expected LOG KG_M2"),
        (["wire.csv", "--reference", "none.csv", "2e-3"], "none.csv: no such file"),
        (["pitch.csv", "wire.csv", *BIFILAR], "2 logs swing about 1 axes"),
        (["roll.csv"] * 4 + BIFILAR, "LOG: 4 values, expected 1 to 3"),
        (["roll.csv", *BIFILAR, "--gyro-unit", "0"], "--gyro-unit 0, expected above 0"),
        (["roll.csv", *BIFILAR, "--plot", "swings.pdf"], "ends in .png"),
        (["roll.csv", *BIFILAR, "--aircraft", "none.toml"], "none.toml"),
        (["rest.csv", *BIFILAR, "--plot", "swings.png"], "rest.csv: "),
        (["far.csv", *BIFILAR, "--plot", "swings.png"], "expected at most 15"),
        (["short.csv", *BIFILAR, "--plot", "swings.png"], "expected at least 5 periods"),
    ],
)
def test_mistake_is_one_line_and_nothing_is_drawn(
    logs: Path, arguments: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(logs)
    before = sorted(logs.iterdir())
    assert message in refused(capsys, ["aircraft", "inertia", *arguments])
    assert sorted(logs.iterdir()) == before


@pytest.mark.parametrize("wires", [[], [*BIFILAR, "--stiffness", "1"]])
def test_wires_are_of_one_kind(logs: Path, wires: list[str], capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["aircraft", "inertia", str(logs / "roll.csv"), *wires])
    assert ended.value.code == 2
    assert "--stiffness" in capsys.readouterr().err
