"""Flights in processes of their own: the same flights, errors in one line, no process left behind."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.main import main
from neuroflight.toolchain.errors import LinkError, NeuroflightError
from neuroflight.toolchain.workers import Crew, Show
from tests.sampling import sampled

NEVER = threading.Event()


@pytest.fixture
def scenarios(tmp_path: Path) -> list[str]:
    """Three that differ, each of a tenth of a second."""
    paths = [tmp_path / f"{name}.toml" for name in ("left", "right", "down")]
    for path, rate in zip(paths, (50, -80, 120), strict=True):
        path.write_text(f"[[segment]]\nduration_s = 0.1\nsetpoint_deg_s = [{rate}, 0, 0]\n")
    return [str(path) for path in paths]


def children() -> set[str]:
    return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())


@pytest.mark.parametrize("port", sampled(["reference", "host"], "reference"))
def test_flights_are_the_same_when_they_are_flown_at_a_time(
    port: str,
    scenarios: list[str],
    host_program: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(fly_ports, "BUILD", host_program.parent)
    common = ["fly", "--on", port, "--gyro-hz", "1000", "--json"]
    told, traces = [], []
    for jobs in ("1", "2"):
        assert main([*common, "--jobs", jobs, "--scenario", *scenarios]) == 0
        told.append(json.loads(capsys.readouterr().out))
        trace = tmp_path / f"{jobs}.npz"
        assert main([*common, "--jobs", jobs, "--scenario", scenarios[0], "--trace", str(trace)]) == 0
        told.append(json.loads(capsys.readouterr().out))
        traces.append(trace.read_bytes())
    assert told[:2] == told[2:]
    assert [document["scenario"] for document in told[0]] == ["left", "right", "down"]
    assert set(told[1]["flights"]) == {"firmware", "PID"}
    assert traces[0] == traces[1]


def test_a_flights_error_is_one_line_when_it_comes_from_another_process(
    scenarios: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = children()
    arguments = [
        "fly",
        "--on",
        "reference",
        "--build",
        str(tmp_path),
        "--jobs",
        "2",
        "--scenario",
        *scenarios,
    ]
    assert main(arguments) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "libneuroflight.so: not built yet" in line
    assert children() <= before


def test_less_than_one_flight_at_a_time_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fly", "--jobs", "0"]) == 1
    assert "--jobs 0, expected 1 or more" in capsys.readouterr().err


def test_results_come_in_the_order_of_the_tasks_when_there_are_more_than_processes() -> None:
    def task(number: int) -> Callable[[Show], tuple[int, int]]:
        def run(show: Show) -> tuple[int, int]:
            show(0.5)
            return number, os.getpid()

        return run

    parts: list[list[float]] = [[] for _ in range(7)]
    with Crew([task(number) for number in range(7)], 2) as crew:
        results = crew.results([part.append for part in parts])
    assert [number for number, _ in results] == list(range(7))
    assert os.getpid() not in (processes := {process for _, process in results})
    assert len(processes) <= 2
    assert all(part[-1] == 1.0 for part in parts)


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (NeuroflightError("no wind today"), NeuroflightError, "^no wind today$"),
        (KeyError("gone"), RuntimeError, "a flight's process failed: KeyError: 'gone'"),
    ],
)
def test_an_error_is_raised_here_when_a_task_raises_it(
    error: Exception, kind: type[Exception], message: str
) -> None:
    def fail(show: Show) -> None:
        raise error

    before = children()
    with pytest.raises(kind, match=message), Crew([fail], 1) as crew:
        crew.results([lambda part: None])
    assert children() <= before


def test_it_says_so_when_a_process_is_killed() -> None:
    def die(show: Show) -> None:
        os.kill(os.getpid(), signal.SIGKILL)

    with pytest.raises(LinkError, match="a flight's process ended early"), Crew([die], 1) as crew:
        crew.results([lambda part: None])


def test_all_processes_end_and_close_what_is_open_when_the_first_is_interrupted(tmp_path: Path) -> None:
    def stay(name: str) -> Callable[[Show], None]:
        def run(show: Show) -> None:
            try:
                show(0.1)
                NEVER.wait()
            finally:
                (tmp_path / name).touch()

        return run

    before = children()
    with pytest.raises(KeyboardInterrupt), Crew([stay("a"), stay("b")], 2) as crew:
        while len(crew.poll(None)) < 2:
            pass
        raise KeyboardInterrupt
    assert children() <= before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]
