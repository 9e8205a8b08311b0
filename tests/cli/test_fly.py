"""`neuroflight fly` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.fly import ports as command
from neuroflight.cli.fly.output import headlines
from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.design.figures import aircraft_figures
from neuroflight.sim.flight.trace import load_trace
from neuroflight.toolchain.image.report import AircraftFacts
from tests.conftest import BUILD, build_kept
from tests.modelled_policy import modelled_policy
from tests.refusal import refused
from tests.sampling import sampled

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def built(host_program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The command finds the programs of this test run."""
    monkeypatch.setattr(command, "BUILD", host_program.parent)


@pytest.fixture
def short(tmp_path: Path) -> str:
    """A scenario of a tenth of a second."""
    path = tmp_path / "short.toml"
    path.write_text("[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [50, 0, 0]\n")
    return str(path)


@pytest.mark.parametrize("port", sampled(["reference", "host"], "host"))
@pytest.mark.usefixtures("built")
def test_it_prints_both_figures_and_writes_the_files_when_all_is_well(
    port: str, short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace, plot, report = (tmp_path / "new" / name for name in ("a.npz", "a.png", "a.html"))
    arguments = ["fly", "--on", port, "--scenario", short, "--gyro-hz", "2000"]
    assert main([*arguments, "--trace", str(trace), "--plot", str(plot), "--report", str(report)]) == 0
    out = capsys.readouterr().out
    heading = out.splitlines()[1]
    assert heading.split("policy nf1")[1].strip() == "PID flying"
    assert "MAE, deg/s" in out
    assert out.splitlines()[-1].startswith("Policy nf1 followed the scenario short with ")
    assert len(load_trace(trace).t) == 100
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert "short" in report.read_text()


@pytest.mark.usefixtures("built")
def test_it_prints_every_figure_when_asked(short: str, capsys: pytest.CaptureFixture[str]) -> None:
    fly = ["fly", "--on", "host", "--scenario", short, "--gyro-hz", "2000"]
    assert main(fly) == 0
    few = capsys.readouterr().out
    assert main([*fly, "--all"]) == 0
    every = capsys.readouterr().out
    assert "MAE, deg/s" in few and "ITSE" not in few and "--all" in few
    assert "ITSE" in every and "--all" not in every and every.splitlines()[-1] == few.splitlines()[-1]


def test_headlines_are_five_rows_and_whether_it_was_armed_to_the_end() -> None:
    labels = ["", "MAE, deg/s", "  mean of the axes", "IAE", "rest early, deg/s", "rest late, deg/s"]
    labels += ["drift in 10 s, deg", "mean |Δu| in 1 ms", "rise, ms", "armed"]
    rows: list[tuple[str, ...]] = [(label, "1", "100.0 %") for label in labels]
    kept = [row[0] for row in headlines(rows)]
    assert kept == [*labels[:3], "rest late, deg/s", "drift in 10 s, deg", "mean |Δu| in 1 ms", "armed"]
    commanded = headlines([row for row in rows if not row[0].startswith(("rest", "drift"))][:-1])
    assert [row[0] for row in commanded] == [*labels[:3], "mean |Δu| in 1 ms", "rise, ms"]


@pytest.mark.usefixtures("built")
def test_a_count_that_says_nothing_is_told(short: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fly", "--on", "library", "--scenario", short, "--count", "300"]) == 0
    assert "--count: of flight and pulses alone" in capsys.readouterr().err


@pytest.mark.usefixtures("built")
def test_it_says_when_the_policy_or_the_pid_is_another_aircrafts(
    short: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["fly", "--on", "reference", "--scenario", short, "--json"]
    assert main(words) == 0
    assert capsys.readouterr().err == ""
    assert main([*words, "--aircraft", "nf1:props-out"]) == 0
    digest = load_aircraft("nf1:props-out").sha256
    assert f"flies the twin of another: nf1-props-out ({digest[:12]})" in capsys.readouterr().err


def test_it_flies_the_aircraft_of_the_build_and_says_that_its_policy_was_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own, story = BUILD / "modelled.toml", tmp_path / "story.toml"  # the build tells where its aircraft lies
    own.write_text((FOLDER / "nf1.toml").read_text().replace('name = "nf1"', 'name = "mine"'))
    story.write_text("[[segment]]\nduration_s = 2.0\nsetpoint_deg_s = [300, -300, 200]\n")
    aircraft = load_aircraft(own)
    known = AircraftFacts(aircraft.name, aircraft.sha256, str(own), own=True)
    folder = build_kept("HOST", modelled_policy(), "modelled", pid_table(aircraft), known)
    monkeypatch.setattr(command, "BUILD", folder)
    for on in ("reference", "host"):
        assert main(["fly", "--on", on, "--scenario", str(story)]) == 0
        told = " ".join(capsys.readouterr().out.split())
        assert "mine: story" in told
        assert "its policy until that was REFUSED (wrong way), then its PID" in told
        assert ", then PID PID flying MAE, deg/s" in told  # the columns
        assert ", but it was REFUSED in flight (wrong way), and the PID flew on" in told
    own.unlink()
    assert main(["fly", "--on", "reference", "--scenario", str(story)]) == 1
    assert f"aircraft '{own}': no such file" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("built")
def test_telemetry_of_each_esc_is_kept_and_drawn_when_asked_for(
    short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, plot = tmp_path / "esc.csv", tmp_path / "esc.png"
    words = ["fly", "--on", "reference", "--scenario", short, "--json"]
    assert main([*words, "--telemetry", str(table), "--telemetry-plot", str(plot)]) == 0
    flights = json.loads(capsys.readouterr().out)["flights"]
    for flight in flights.values():
        assert flight["esc"]["force_n"]["largest"] > flight["esc"]["force_n"]["least"] >= 0.0
        assert flight["esc"]["temperature_c"] is None, "the NF1's file has no windings"
    assert len(table.read_text().splitlines()) == 1 + 100
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert main(words) == 0
    assert "esc" not in json.loads(capsys.readouterr().out)["flights"]["firmware"]


@pytest.mark.usefixtures("built")
def test_json_carries_the_same_flight_when_asked_for(short: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fly", "--on", "reference", "--scenario", short, "--json", "--seed", "5"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["scenario"], document["seed"], document["on"]) == ("short", 5, "reference")
    assert set(document["flights"]) == {"firmware", "PID"}
    for flight in document["flights"].values():
        assert len(flight["tracking"]["mae"]) == 3
        assert flight["armed"] == 1.0


@pytest.mark.slow
@pytest.mark.usefixtures("built")
def test_the_firmwares_pid_flies_as_the_pythons_when_the_pilot_chooses_it(
    short: str, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["fly", "--on", "reference", "--scenario", "pulse", "--gyro-hz", "1000", "--json"]
    assert main([*arguments, "--controller", "pid"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["controller"] == "pid"
    firmware, python = (document["flights"][name] for name in ("firmware", "PID"))
    assert (firmware["controller"], python["controller"]) == ("firmware's PID flying", "PID flying")
    assert firmware["tracking"]["mae"] == pytest.approx(python["tracking"]["mae"], rel=0.02)
    assert firmware["effort"]["change"] == pytest.approx(python["effort"]["change"], rel=0.02)
    assert main(arguments) == 0
    flown = json.loads(capsys.readouterr().out)["flights"]["firmware"]
    assert flown["tracking"]["mae"] != pytest.approx(python["tracking"]["mae"], rel=0.02)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--on", "betaflight", "--controller", "pid"], "Betaflight flies its own PID"),
        (["--scenario", "loop"], "no such file"),
        (["--scenario", "pulse", "--seed", "-3"], "--seed -3, expected 0 or more"),
        (["--scenario", "pulses", "--count", "0"], "count: got 0"),
        (["--aircraft", "nf9"], "nf9"),
        (["--trace", "a.txt"], "expected a name that ends in .npz"),
        (["--report", "a.pdf"], "expected a name that ends in .html"),
        (["--plot", "blocked/a.png"], "is no directory"),
        (["--trace", "folder.npz"], "is a directory"),
        (["--battery", "1.5"], "--battery 1.5, expected 0 to 1"),
        (["--wind", "0", "-60", "0"], "--wind -60, expected -50 to 50 m/s"),
        (["--gust", "nan"], "--gust nan, expected 0 to 50 m/s"),
        (["--throttle", "1.5"], "--throttle 1.5, expected 0 to 1"),
        (["--scenario", "freestyle", "--throttle", "0"], "freestyle has a throttle of its own; leave it out"),
        (["--ground"], "the aircraft hangs in mount centre, expected free; add --mount free"),
    ],
)
def test_it_refuses_in_one_line_before_flying_when_the_input_is_bad(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "BUILD", tmp_path / "never reached")
    monkeypatch.setattr(command, "BETAFLIGHT", tmp_path / "never reached")
    (tmp_path / "blocked").write_text("a file where a folder should be")
    (tmp_path / "folder.npz").mkdir()
    before = sorted(tmp_path.iterdir())
    assert message in refused(capsys, ["fly", *arguments])
    assert sorted(tmp_path.iterdir()) == before


def test_it_says_how_to_build_when_nothing_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "BUILD", tmp_path)
    assert main(["fly", "--trace", str(tmp_path / "a.npz")]) == 1
    assert "build it with `make host`" in capsys.readouterr().err
    assert not (tmp_path / "a.npz").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("built")
def test_a_flight_is_at_hover_unless_the_pilot_says_another_throttle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    traces = {}
    for name, words in {"hover": [], "closed": ["--throttle", "0"]}.items():
        traces[name] = tmp_path / f"{name}.npz"
        told = flown(capsys, "--count", "1", "--trace", str(traces[name]), *words)
        assert (told["scenario"], told["duration_s"], told["episodes"]) == ("flight", 19.5, 1)
        assert np.allclose(load_trace(traces[name]).throttle[100:], told["throttle"], atol=1e-3)
        where = " at hover" if name == "hover" else " with the throttle closed"
        assert told["verdict"].startswith(f"Policy nf1 followed 1 command{where} with ")
        assert len(told["flights"]["firmware"]["holding"]["drift"][0]) == 3
    assert told["throttle"] == 0.0
    motors = load_trace(traces["hover"]).motors[-5000:].mean()
    wanted = aircraft_figures(load_aircraft("nf1")).hover
    assert wanted is not None and motors == pytest.approx(wanted.throttle.mean(), abs=0.01)


@pytest.mark.usefixtures("built")
def test_an_aircraft_that_cannot_hover_wants_a_throttle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    heavy = tmp_path / "heavy.toml"
    text = (FOLDER / "nf1.toml").read_text()
    heavy.write_text(text.replace("mass_kg = 0.194", "mass_kg = 9.0"))
    words = ["fly", "--on", "reference", "--aircraft", str(heavy), "--scenario", "pulse"]
    assert main(words) == 1
    assert "none holds the weight of nf1" in capsys.readouterr().err


def flown(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    """The JSON document of a flight on the library."""
    assert main(["fly", "--on", "reference", "--gyro-hz", "1000", "--json", *arguments]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


@pytest.mark.usefixtures("built")
def test_the_pids_idle_is_no_output_of_its_own_when_its_table_has_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own = load_aircraft("nf1").pids[0][1].idle
    text = (ROOT / "sim" / "aircraft" / "nf1.toml").read_text()
    aircraft = tmp_path / "idling.toml"
    aircraft.write_text(text.replace(f"\nidle = {own}\n", f"\nidle = {own / 2}\n", 1))
    assert load_aircraft(aircraft).pids[0][1].idle == own / 2 > 0.02
    still = tmp_path / "still.toml"
    still.write_text("[[segment]]\nduration_s = 0.3\nsetpoint_deg_s = [0, 0, 0]\n")
    idling = flown(capsys, "--scenario", str(still), "--aircraft", str(aircraft))
    plain = flown(capsys, "--scenario", str(still))
    output = [document["flights"]["PID"]["effort"]["output"] for document in (idling, plain)]
    assert output[0] == pytest.approx(output[1], rel=0.05)  # of some 0.09, all from the gyro's noise


@pytest.mark.usefixtures("built")
def test_the_air_and_the_battery_make_another_flight_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "climb.toml"
    scenario.write_text('mount = "free"\n[[segment]]\nduration_s = 0.5\nsetpoint_deg_s = [80, 0, 0]\n')
    scenario.write_text(scenario.read_text() + "throttle = 0.5\n")
    base = "--scenario", str(scenario)
    calm = flown(capsys, *base)
    assert (calm["battery"], calm["wind_m_s"], calm["gust_m_s"], calm["ground"]) == (
        None,
        [0, 0, 0],
        0,
        False,
    )
    asked = {
        "battery": ["--battery", "0.2"],
        "wind_m_s": ["--wind", "8", "-4", "0"],
        "gust_m_s": ["--gust", "15"],
        "ground": ["--ground"],
    }
    for name, arguments in asked.items():
        other = flown(capsys, *base, *arguments)
        assert other[name] != calm[name]
        mae = [document["flights"]["firmware"]["tracking"]["mae"] for document in (calm, other)]
        assert mae[0] != mae[1]


@pytest.mark.usefixtures("built")
def test_json_carries_the_response_when_a_command_is_held(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "held.toml"
    scenario.write_text("[[segment]]\nduration_s = 1.1\nsetpoint_deg_s = [50, -70, 90]\n")
    flights = flown(capsys, "--scenario", str(scenario))["flights"]
    for flight in flights.values():
        assert flight["response"]["episodes"] == 1
        assert flight["response"]["success"]["count"] == [1, 1, 1]
