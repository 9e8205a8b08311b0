"""`neuroflight fly --blackbox`: the firmware's log of the flight is what its trace says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.main import main
from neuroflight.sim.blackbox.log import Log, floats, list_logs, read_log
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.trace import load_trace
from neuroflight.toolchain.contract import LogEvent, LogGroup
from tests.refusal import refused
from tests.sampling import sampled

pytest.importorskip("orangebox")


@pytest.fixture
def short(host_program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A scenario of a tenth of a second; the command finds the programs of this test run."""
    monkeypatch.setattr(fly_ports, "BUILD", host_program.parent)
    path = tmp_path / "short.toml"
    path.write_text("[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [50, 0, 0]\n")
    return str(path)


def assert_log_is_trace(log: Log, trace: Path) -> None:
    """Row 0 of the trace is the first armed control step, and every value is the log's."""
    flags, motors, gyro = (log.held("flightModeFlags"), log.matrix("motor"), log.matrix("gyroFloat"))
    setpoint = log.matrix("setpointFloat")
    assert flags is not None and motors is not None and gyro is not None and setpoint is not None
    flown = load_trace(trace)
    first = int(np.argmax(np.asarray(flags) & 1))
    rows = slice(first, first + len(flown.t))
    assert first > 0 and (np.diff(log.columns["loopIteration"]) == 1).all()
    assert np.array_equal(motors[rows], flown.dshot)
    assert np.array_equal(floats(gyro)[rows], flown.gyro)
    assert np.array_equal(floats(setpoint)[rows, :3], flown.setpoint)
    assert np.array_equal(floats(setpoint)[rows, 3], flown.throttle)


def run_json(capsys: pytest.CaptureFixture[str], *arguments: object) -> dict[str, Any]:
    """The command's JSON document."""
    assert main(["fly", "--json", *map(str, arguments)]) == 0
    return dict(json.loads(capsys.readouterr().out))


@pytest.mark.parametrize("port", sampled(["reference", "host"], "host"))
def test_the_log_is_the_trace_when_a_flight_is_logged(
    short: str, port: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, trace, unlogged = (tmp_path / name for name in ("new.bbl", "one.npz", "two.npz"))
    arguments = ("--on", port, "--scenario", short, "--gyro-hz", "2000")
    told = run_json(capsys, *arguments, "--blackbox", path, "--trace", trace)["blackbox"]
    log = read_log(path)
    assert_log_is_trace(log, trace)
    assert log.ended and log.lost == 0 and log.events[-1].kind == LogEvent.LOG_END
    assert told == {
        **{"file": str(path), "bytes": path.stat().st_size, "dropped": 0, "ended": True},
        "frames": len(log.columns["time"]),
    }
    assert run_json(capsys, *arguments, "--trace", unlogged).get("blackbox") is None
    assert load_trace(unlogged).same(load_trace(trace))
    assert main(["fly", *arguments, "--blackbox", str(path)]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert f"{path.stat().st_size:,} bytes, {told['frames']} frames, 0 control steps dropped" in words
    assert len(list_logs(path)) == 1, "the file is the last flight's"


@pytest.mark.parametrize("port", sampled(["reference", "host"], "reference"))
def test_logs_of_equal_flights_are_equal_bytes(short: str, port: str, tmp_path: Path) -> None:
    """The firmware lies elsewhere in memory each time. What the control task took is this machine's time."""
    left_out = f"blackbox_disabled_mask={1 << LogGroup.TIMING}"
    one, two = tmp_path / "one.bbl", tmp_path / "two.bbl"
    for path in (one, two):
        arguments = ("--on", port, "--scenario", short, "--gyro-hz", "2000", "--set", left_out)
        assert main(["fly", *arguments, "--blackbox", str(path)]) == 0
    assert one.read_bytes() == two.read_bytes() and one.stat().st_size > 10_000


@pytest.mark.parametrize("port", sampled(["reference", "host"], "host"))
def test_what_came_is_kept_when_the_user_interrupts(
    short: str, port: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*arguments: Any, logged: Any, **options: Any) -> None:
        calls = iter(range(44))  # 4.4 s from power on: armed, and in the middle of a log

        def until() -> bool:
            if next(calls, None) is None:
                raise KeyboardInterrupt
            return bool(logged())

        fly(*arguments, logged=until, **options)

    monkeypatch.setattr("neuroflight.sim.flight.loop.fly", interrupted)
    path = tmp_path / "log.bbl"
    scenario = tmp_path / "long.toml"
    scenario.write_text("[[segment]]\nduration_s = 9\nsetpoint_deg_s = [0, 0, 0]\n")
    options = ("--on", port, "--scenario", str(scenario), "--gyro-hz", "2000", "--jobs", "1")
    assert main(["fly", *options, "--blackbox", str(path)]) != 0
    assert f"{path}: {path.stat().st_size:,} bytes of the log, up to the error" in capsys.readouterr().err
    log = read_log(path)
    assert len(log.columns["time"]) > 1000 and not log.ended
    assert sorted(tmp_path.glob("*.bbl")) == [path]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--on", "betaflight", "--blackbox", "a.bbl"], "--blackbox: Betaflight's own log is none of ours"),
        (["--blackbox", "a.txt"], "a.txt: expected a name that ends in .bbl"),
        (
            ["--blackbox", "a.bbl", "--set", "blackbox_device=none"],
            "got blackbox_device=none, expected a log",
        ),
        (
            ["--on", "emulator", "--blackbox", "a.bbl", "--set", "uart3_function=msp"],
            "--set uart3_function: --blackbox chooses it",
        ),
        (["--on", "emulator", "--card", "c.img", "--blackbox", "a.bbl"], "the log goes to the card"),
        (["--scenario", "roll", "flip", "--blackbox", "a.bbl"], "--blackbox: belongs to one flight"),
    ],
)
def test_it_is_one_line_when_there_can_be_no_such_log(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, ["fly", *arguments])


def test_an_old_file_stays_when_nothing_is_logged(
    short: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "old.bbl"
    path.write_bytes(b"old")
    # The mode BLACKBOX has a range, where its switch never is: nothing but the log's start is due.
    assert main(["fly", "--on", "reference", "--scenario", short, "--set", "mode5=blackbox aux5 1700 2100",
                 "--blackbox", str(path)]) == 0  # fmt: skip
    assert "nothing was logged" in " ".join(capsys.readouterr().out.split())
    assert path.read_bytes() == b"old"
