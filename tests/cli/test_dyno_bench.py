"""`neuroflight dyno bench` and `calibrate`: from a motor test to a fitted rotor, without hardware."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.flash.link.transport import Transport, open_transport
from neuroflight.sim.aircraft.model import RPM, TorqueResponse, load_aircraft
from neuroflight.sim.identification.bench.load_cell import write_load_cells
from neuroflight.sim.identification.dyno.recording import read_recordings
from neuroflight.sim.identification.dyno.signal import commanded
from tests.refusal import refused
from tests.sim.identification.bench.conftest import rig_cells
from tests.sim.identification.bench.rig import Rig, SensorKind

QUICK = ("--bench-clear", "--repeats", "1")


@pytest.fixture
def rig_of(host_program: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Rig]]:
    """Build a rig; commands then open its ports, and their time is its time."""
    rigs: list[Rig] = []

    def make(kind: SensorKind | None = None, motor: int = 0) -> Rig:
        rig = Rig(host_program, load_aircraft("nf1").propulsion, kind, motor)
        rigs.append(rig)

        def opened(text: str) -> Transport:
            return rig.line() if text == rig.device else open_transport(text)

        monkeypatch.setattr("neuroflight.flash.link.transport.open_transport", opened)
        monkeypatch.setattr("neuroflight.cli.dyno.bench.monotonic", rig.clock)
        monkeypatch.setattr("neuroflight.cli.dyno.calibrate.monotonic", rig.clock)
        return rig

    yield make
    for rig in rigs:
        rig.__exit__(None, None, None)


def ports(rig: Rig) -> list[str]:
    return ["--port", f"tcp:127.0.0.1:{rig.port.msp_port}", "--sensor", rig.device]


def bench(rig: Rig, out: Path, *words: str) -> list[str]:
    """The command; load cells stand beside `out`."""
    cells = out.with_name("cells.toml")
    if not cells.exists():
        write_load_cells(cells, rig_cells(rig.kind))
    counted = ["--cells", str(cells)] if any("raw" in name for name in rig.kind.columns) else []
    counted += ["--blades", str(rig.kind.blades)] if "pulses" in rig.kind.columns else []
    return ["dyno", "bench", *ports(rig), *counted, "--out", str(out), *words]


def fitted(capsys: pytest.CaptureFixture[str], out: Path) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["dyno", "fit", str(out), "--aircraft", "nf1", "--json"]) == 0
    document: dict[str, Any] = json.loads(capsys.readouterr().out)
    return document


def check_rotor(document: dict[str, Any], limit: float) -> None:
    """The NF1's rotor within: speed 1 %, thrust and torque 1 %, response 3 %."""
    propulsion = load_aircraft("nf1").propulsion
    a, b, c = (term["value"] * RPM for term in document["speed_curve_rpm"])
    for throttle in np.linspace(0.2, 1.0, 9) * limit:
        true = np.polyval(propulsion.speed_curve, throttle)
        assert (a * throttle + b) * throttle + c == pytest.approx(true, rel=0.01)
    (thrust,), (torque,) = document["thrust_coefficient"], document["torque_ratio_m"]
    assert thrust["value"] == pytest.approx(propulsion.thrust_coefficient[0], rel=0.01)
    assert torque["value"] == pytest.approx(propulsion.torque_ratio[0], rel=0.01)
    response, model = document["response"], propulsion.response
    assert isinstance(model, TorqueResponse) and response["kind"] == "torque"
    assert response["gain"]["value"] == pytest.approx(model.gain, rel=0.03)
    assert response["torque_up_n_m"]["value"] == pytest.approx(model.torque_up, rel=0.03)
    assert response["torque_down_n_m"]["value"] == pytest.approx(model.torque_down, rel=0.03)
    assert response["delay_s"]["value"] < 0.01


# --- From the bench to the rotor ----------------------------------------------------------------------
@pytest.mark.slow
def test_the_rotor_is_found_again_when_it_was_driven_at_full_throttle(
    rig_of: Callable[..., Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, out, plot = rig_of(motor=2), tmp_path / "nf1.csv", tmp_path / "nf1.png"
    words = [*QUICK, "--full", "--motor", "3", "--ramp", "6", "--json"]
    assert main(bench(rig, out, *words, "--plot", str(plot), "--max-rpm", "30000", "--max-amps", "40")) == 0
    document = json.loads(capsys.readouterr().out)
    assert rig.throttle == 0.0 and max(rig.turned) == 1.0 and rig.others == 0.0
    assert [step["level"] for step in document["steps"]] == [0.25, 0.5, 0.75, 1.0]
    top = document["steps"][3]
    assert top["count"] == 1 and top["rpm"]["mean"] == pytest.approx(24_983, rel=0.005)
    assert top["rise_s"]["mean"] == pytest.approx(0.21, abs=0.01)
    assert document["ramp_top"]["thrust_n"]["mean"] == pytest.approx(6.36, rel=0.01), "a quick ramp lags"
    assert document["unreadable_lines"] == 0
    recording = read_recordings([out])
    assert len(recording.starts) == 2 and len(recording.time) == document["rows"]
    assert plot.read_bytes().startswith(b"\x89PNG")
    check_rotor(fitted(capsys, out), 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "kind",
    [
        SensorKind(("thrust_n", "torque_n_m", "rpm"), noise=0.002),
        SensorKind(("pulses", "time_s", "torque_n_m", "other", "thrust_n"), blades=2, clock_rate=0.997),
    ],
    ids=["no-clock", "counts-without-stamps"],
)
def test_the_rotor_is_found_again_when_the_sensor_is_a_plain_one(
    rig_of: Callable[..., Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: SensorKind
) -> None:
    """Half throttle, steps only, columns said on the command line."""
    kind.heading = False
    rig, out = rig_of(kind), tmp_path / "half.csv"
    words = [*QUICK, "--experiment", "steps", "--columns", ",".join(kind.columns)]
    assert main(bench(rig, out, *words)) == 0
    assert "± 0" in capsys.readouterr().out
    assert max(rig.turned) == pytest.approx(0.5, abs=1e-3)
    document = fitted(capsys, out)
    assert any("extrapolated" in note for note in document["notes"])
    a, b, c = (term["value"] for term in document["speed_curve_rpm"])
    true = np.polyval(load_aircraft("nf1").propulsion.speed_curve, 0.5) / RPM
    assert (a * 0.5 + b) * 0.5 + c == pytest.approx(true, rel=0.01)
    assert document["thrust_coefficient"][0]["value"] == pytest.approx(9.37e-7, rel=0.02)
    assert document["response"]["delay_s"]["value"] < 0.02


@pytest.mark.slow
def test_the_dissertations_experiment_gives_the_rotor_when_it_is_repeated(
    rig_of: Callable[..., Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, out = rig_of(SensorKind(noise=0.02)), tmp_path / "nf1.csv"
    assert main(bench(rig, out, "--full", "--repeats", "5", "--bench-clear", "--json")) == 0
    steps = json.loads(capsys.readouterr().out)["steps"]
    for step in steps:
        true = np.polyval(load_aircraft("nf1").propulsion.speed_curve, step["level"]) / RPM
        assert step["rpm"]["mean"] == pytest.approx(true, rel=0.005)
    check_rotor(fitted(capsys, out), 1.0)


# --- Interrupted and resumed --------------------------------------------------------------------------
@pytest.mark.slow
def test_finished_runs_stay_and_the_others_follow_when_it_was_interrupted(
    rig_of: Callable[..., Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig, out = rig_of(), tmp_path / "a.csv"
    words = ["--experiment", "steps", "--repeats", "2", "--bench-clear", "--limit", "0.4"]
    runs = out.with_suffix(".runs")

    def interrupt() -> None:
        if (runs / "steps-01.csv").exists() and rig.throttle > 0.3:
            rig.on_step = lambda: None
            raise KeyboardInterrupt

    rig.on_step = interrupt
    assert main(bench(rig, out, *words)) == 130
    rig.advance(0.01)
    assert rig.throttle == 0.0 and not out.exists()
    assert {path.name for path in runs.iterdir()} == {
        *("plan.json", "steps-01.csv", "steps-01.sensor.csv", "steps-01.commands.csv")
    }
    first, turned = (runs / "steps-01.csv").read_bytes(), len(rig.turned)
    assert main(bench(rig, out, *words)) == 1
    assert "holds 1 finished runs; go on with --resume" in capsys.readouterr().err
    assert main(bench(rig, out, *words, "--resume", "--limit", "0.3")) == 1
    assert "limit was 0.4, is 0.3" in capsys.readouterr().err
    assert max(rig.turned[turned:]) == 0.0, "no refusal turns a motor"
    assert main(bench(rig, out, *words, "--resume", "--json")) == 0
    (*_, top) = json.loads(capsys.readouterr().out)["steps"]
    assert top["count"] == 2 and 0 < top["thrust_n"]["margin"] < 0.3, "t of one degree of freedom is 12.7"
    assert (runs / "steps-01.csv").read_bytes() == first
    recording = read_recordings([out])
    assert len(recording.starts) == 2
    assert commanded(recording).max() == pytest.approx(0.4)
    commands = np.loadtxt(runs / "steps-02.commands.csv", delimiter=",", skiprows=1)
    assert np.diff(commands[:, 0]).max() < 0.03 and commands[-1, 1] == 0.0


# --- Refusals: nothing turns, nothing is written ------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--limit", "0.6", "--bench-clear"], "expected at most 0.5 without --full"),
        (["--limit", "1.1", "--full", "--bench-clear"], "--top-throttle 1.1, expected 0.1 to 1"),
        (["--limit", "nan", "--full", "--bench-clear"], "--top-throttle nan"),
        ([], "no motor was turned"),
        (["--bench-clear", "--time-limit", "100"], "40 runs take 1040 s, expected at most 100 s"),
        (["--bench-clear", "--motor", "5", "--repeats", "1"], "motor 5, expected 1 to 4"),
        (["--bench-clear", "--max-thrust", "-1"], "--max-thrust -1, expected"),
        (["--bench-clear", "--blades", "0"], "--blades 0, expected 1 to 12"),
        (["--bench-clear", "--columns", "rpm,foo"], "expected one of thrust_n, thrust_raw too"),
        (["--bench-clear", "--resume"], "no run to resume"),
        (["--bench-clear", "--out", "x.txt"], "ends in .csv"),
    ],
)
def test_nothing_turns_and_nothing_is_written_when_the_command_is_refused(
    rig_of: Callable[..., Rig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    says: str,
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("bench clear\n"))  # no terminal: nobody is there
    rig, out = rig_of(), tmp_path / "a.csv"
    assert says in refused(capsys, bench(rig, out, *words))
    assert max(rig.turned) == 0.0 and not out.exists()
    rig.advance(0.1)
    assert max(rig.turned) == 0.0


class Terminal(io.StringIO):
    """Somebody who types."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("typed", ["\n", "yes\n", "clear\n", "BENCH CLEAR\n", ""])
def test_nothing_turns_when_something_else_is_typed(
    rig_of: Callable[..., Rig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    typed: str,
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal(typed))
    rig = rig_of()
    assert main(bench(rig, tmp_path / "a.csv")) == 1
    error = capsys.readouterr().err
    assert 'Type "bench clear"' in error and "No limit is set for: rotor speed, thrust" in error
    assert "up to 50% throttle" in error
    assert max(rig.turned) == 0.0


def test_the_rotor_turns_when_the_words_are_typed(
    rig_of: Callable[..., Rig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("bench clear\n"))
    rig, out = rig_of(), tmp_path / "a.csv"
    assert main(bench(rig, out, "--repeats", "1", "--experiment", "steps", "--limit", "0.2")) == 0
    assert max(rig.turned) == pytest.approx(0.2, abs=1e-3) and out.exists()


def test_the_way_out_is_said_when_a_sensor_does_not_fit(
    rig_of: Callable[..., Rig], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = rig_of(SensorKind(("time_s", "thrust_raw", "torque_n_m", "pulses")))
    out = str(tmp_path / "a.csv")
    plain = ["dyno", "bench", *ports(rig), "--out", out, "--bench-clear"]
    for words, says in (
        ([], "give --blades N"),
        (["--blades", "2"], "sends thrust_raw, for which there is no load cell"),
        (["--blades", "2", "--cells", str(tmp_path / "none.toml")], "no such file"),
    ):
        assert main([*plain, *words]) == 1
        assert says in capsys.readouterr().err
    assert main(bench(rig, Path(out), "--bench-clear", "--max-amps", "10")) == 1
    assert "the sensor sends no amps" in capsys.readouterr().err
    rig.faults.silent_after, rig.kind.heading = 0.0, False
    assert main([*plain, "--columns", "time_s,thrust_n,torque_n_m,rpm"]) == 1
    assert "the sensor sent nothing" in capsys.readouterr().err
    assert max(rig.turned) == 0.0


# --- Calibration --------------------------------------------------------------------------------------
class Hands:
    """Puts on what was asked for, each time Enter is pressed; `ask` is the prompt so far."""

    def __init__(
        self, rig: Rig, prompts: Callable[[], str], column: str, counts: float, lever: float
    ) -> None:
        self._rig, self._prompts, self._column = rig, prompts, column
        self._counts, self._lever = counts, lever
        self._zero = rig.kind.thrust_zero if column == "thrust_raw" else rig.kind.torque_zero

    def readline(self) -> str:
        prompt = self._prompts()
        found = re.findall(r"Put ([\d.]+) g on(, on the lever's other side)?", prompt)
        kg = float(found[0][0]) / 1000 * (-1 if found[0][1] else 1) if found else 0.0
        assert found or "Take every mass off" in prompt
        reading = self._zero + self._counts * kg * 9.80665 * self._lever
        self._rig.faults.scale[self._column] = reading / self._zero
        return "\n"


@pytest.mark.parametrize(
    ("column", "words", "lever"),
    [
        ("thrust_raw", ["--masses-g", "200,400,600,800"], 1.0),
        ("torque_right_raw", ["--masses-g", "200,400,-200,-400", "--lever-mm", "130"], 0.13),
    ],
)
def test_a_cell_is_calibrated_when_masses_are_put_on_as_asked(
    rig_of: Callable[..., Rig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    column: str,
    words: list[str],
    lever: float,
) -> None:
    rig, out = rig_of(SensorKind(noise=0.0)), tmp_path / "cells.toml"
    counts = 21_000.0 if lever == 1.0 else -900_000.0
    hands = Hands(rig, lambda: capsys.readouterr().err.split("Enter: ")[-2], column, counts, lever)
    monkeypatch.setattr("sys.stdin", hands)
    command = ["dyno", "calibrate", "--sensor", rig.device, "--cell", column, *words, "--seconds", "0.2"]
    assert main([*command, "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["scale"] == pytest.approx(1 / counts, rel=1e-4)
    assert document["unit"] == ("N" if lever == 1.0 else "N m")
    assert len(document["points"]) == 9
    assert f"[{column}]" in out.read_text()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--cell", "rpm", "--masses-g", "1,2"], "expected one of: thrust_raw"),
        (["--cell", "torque_raw", "--masses-g", "1,2"], "give the length of the lever"),
        (["--cell", "thrust_raw", "--masses-g", "1,2", "--lever-mm", "5"], "leave it out"),
        (["--cell", "thrust_raw", "--masses-g", "1"], "expected 2 to 40 masses"),
        (["--cell", "thrust_raw", "--masses-g", "1,x"], "expected 2 to 40 masses"),
        (["--cell", "thrust_raw", "--masses-g", "1,0"], "expected 2 to 40 masses"),
        (["--cell", "thrust_raw", "--masses-g", "100,200"], "the input ended"),
    ],
)
def test_nothing_is_written_when_a_calibration_is_refused(
    rig_of: Callable[..., Rig],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    words: list[str],
    says: str,
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    rig, out = rig_of(), tmp_path / "cells.toml"
    assert main(["dyno", "calibrate", "--sensor", rig.device, *words, "--out", str(out)]) == 1
    assert says in capsys.readouterr().err
    assert not out.exists()
