"""`neuroflight fly --on board`: the image's log, by UART3 and on the card, is the trace."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.main import main
from neuroflight.sim.blackbox.log import Log, read_log
from neuroflight.sim.flight.trace import load_trace
from neuroflight.toolchain.contract import LogEvent
from tests.cli.test_fly_blackbox import assert_log_is_trace

orangebox = pytest.importorskip("orangebox")
TOOLS = all(map(shutil.which, ("mkfs.vfat", "fsck.vfat", "mcopy")))
needs_tools = pytest.mark.skipif(not TOOLS, reason="needs dosfstools and mtools")
Fly = Callable[..., dict[str, Any]]


@pytest.fixture
def fly(
    board_image: Path,
    host_program: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Fly:
    """Flies some seconds with the trace NAME; the JSON document."""
    monkeypatch.setattr(fly_ports, "built_last", lambda: board_image.parent)
    monkeypatch.setattr(fly_ports, "BUILD", host_program.parent)

    def run(name: str, *options: object, seconds: float = 1.0) -> dict[str, Any]:
        scenario = tmp_path / "scenario.toml"
        scenario.write_text(f"[[segment]]\nduration_s = {seconds}\nsetpoint_deg_s = [90, -60, 30]\n")
        words = ["fly", "--on", "emulator", "--json", "--scenario", scenario, "--trace", tmp_path / name]
        capsys.readouterr()  # what was said before
        code = main([*map(str, (*words, *options))])
        assert code in (0, 3)
        return dict(json.loads(capsys.readouterr().out))

    return run


@pytest.fixture
def card(tmp_path: Path) -> Path:
    """A card as a computer prepares it: formatted, two empty files."""
    path = tmp_path / "card.img"
    with path.open("wb") as file:
        file.truncate(64 << 20)
    subprocess.run(["mkfs.vfat", "-F", "32", "-s", "1", path], check=True, capture_output=True)
    assert main(["log", "card", str(path), "--files", "2", "--size", "8"]) == 0
    return path


def taken_out(card: Path) -> Log:
    """The first log of the card, whose file system is sound."""
    subprocess.run(["fsck.vfat", "-n", card], check=True, capture_output=True)
    path = card.with_name("card.bbl")
    subprocess.run(["mcopy", "-n", "-i", card, "::LOG00001.BBL", path], check=True)
    return read_log(path)


@pytest.mark.slow
def test_the_log_of_uart3_is_the_trace_and_changes_no_motor(fly: Fly, tmp_path: Path) -> None:
    path = tmp_path / "log.bbl"
    told = fly("logged.npz", "--blackbox", path)["blackbox"]
    log = read_log(path)
    assert (told["dropped"], told["ended"], told["bytes"]) == (0, True, path.stat().st_size)
    assert log.ended and log.lost == 0 and told["frames"] == len(log.columns["time"])
    assert_log_is_trace(log, tmp_path / "logged.npz")
    frames = list(orangebox.Parser.load(str(path)).frames())
    assert len(frames) == told["frames"]
    fly("alone.npz", "--set", "blackbox_device=none")
    assert load_trace(tmp_path / "alone.npz").same(load_trace(tmp_path / "logged.npz"))


@pytest.mark.slow
@needs_tools
def test_the_log_on_the_card_is_the_trace(fly: Fly, card: Path, tmp_path: Path) -> None:
    told = fly("card.npz", "--card", card)["blackbox"]
    log = taken_out(card)
    assert (told["dropped"], told["ended"], told["frames"]) == (0, True, len(log.columns["time"]))
    assert log.ended and log.lost == 0
    assert_log_is_trace(log, tmp_path / "card.npz")


@pytest.mark.slow
@needs_tools
def test_a_card_that_stalls_costs_frames_but_no_control_step(fly: Fly, card: Path, tmp_path: Path) -> None:
    stalled = ("--card", card, "--fault", "card-stall=0.5@0.3")
    told = fly("stalled.npz", *stalled, seconds=1.5)["blackbox"]
    fly("alone.npz", seconds=1.5)
    assert load_trace(tmp_path / "alone.npz").same(load_trace(tmp_path / "stalled.npz"))
    log = taken_out(card)
    gaps = np.diff(log.columns["loopIteration"]) - 1
    dropped = log.held("dropped")
    assert dropped is not None
    assert told["dropped"] == gaps.sum() == np.asarray(dropped)[-1]
    assert sum(event.kind == LogEvent.LOGGING_RESUME for event in log.events) == (gaps > 0).sum()
    assert log.ended and log.events[-1].kind == LogEvent.LOG_END
