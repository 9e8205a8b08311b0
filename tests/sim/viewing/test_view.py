"""Pictures of a flight: attitude by integration, files, refusals."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image, ImageSequence

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.sim.viewing.pictures import draw_pose
from neuroflight.sim.viewing.poses import attitudes
from tests.refusal import refused
from tests.sim.blackbox.own import log_of, trace

QUARTER = np.pi / 2


def rolling_trace(steps: int = 201) -> Trace:
    """1 s at a constant roll rate of a quarter turn a second."""
    rate = np.tile([QUARTER, 0.0, 0.0], (steps, 1))
    motors = np.full((steps, 4), 0.3)
    single = rate.astype(np.float32)
    dshot = np.full((steps, 4), 648, np.uint16)
    t = np.arange(steps) / (steps - 1)
    return Trace(t, single, rate, single, motors, dshot, np.zeros(steps, np.float32))


def rolling(path: Path) -> Path:
    """The trace of it as a file."""
    save_trace(path, rolling_trace())
    return path


def test_attitude_is_that_of_constant_rates_about_body_axes() -> None:
    t = np.linspace(0.0, 1.0, 11)
    rolled = attitudes(t, np.tile([QUARTER, 0.0, 0.0], (11, 1)))
    assert rolled[-1] == pytest.approx(np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), abs=1e-12)
    # Yaw left, then roll right: the second turn is about the aircraft's own x, which now points along y.
    rates = np.array([[0, 0, 2 * QUARTER], [0, 0, 0], [2 * QUARTER, 0, 0], [0, 0, 0]])
    both = attitudes(np.arange(4.0), rates - [[0, 0, 0], [0, 0, 0], [QUARTER, 0, 0], [0, 0, 0]])
    assert both[1] @ [1, 0, 0] == pytest.approx([0, 1, 0], abs=1e-12)
    assert both[-1] @ [0, 0, 1] == pytest.approx([1, 0, 0], abs=1e-12)


def test_the_drawn_aircraft_tilts() -> None:
    def height(rotation: Array) -> float:
        view = Figure().add_subplot()
        draw_pose(view, load_aircraft("nf1"), rotation, [0.3] * 4)
        points = np.concatenate([path.vertices for path in view.collections[0].get_paths()])
        return float(np.ptp(points[:, 1]))

    level, rolled = attitudes(np.array([0.0, 1.0]), np.tile([QUARTER, 0.0, 0.0], (2, 1)))
    assert height(rolled) > 1.3 * height(level)


def test_a_gif_has_its_frames_which_differ(tmp_path: Path) -> None:
    out = tmp_path / "roll.gif"
    flight = rolling(tmp_path / "roll.npz")
    assert main(["view", str(flight), "--out", str(out), "--speed", "5"]) == 0
    with Image.open(out) as image:
        frames = [frame.convert("RGB").tobytes() for frame in ImageSequence.Iterator(image)]
    assert len(frames) == len(set(frames)) == 5  # 0, 0.25 ... 1 s


def test_poses_stand_side_by_side(tmp_path: Path) -> None:
    flight, out = rolling(tmp_path / "roll.npz"), tmp_path / "roll.png"
    widths = []
    for count in ("3", "6"):
        assert main(["view", str(flight), "--out", str(out), "--strip", count]) == 0
        with Image.open(out) as image:
            widths.append(image.width)
    assert widths[1] == pytest.approx(2 * widths[0], abs=2)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.npz", "--out", "a.png"], "no such file"),
        (["roll.txt.gz", "--out", "a.png"], "expected a trace"),
        (["roll.npz", "--out", "a.txt"], "ends in .html, .gif, .png"),
        (["roll.npz", "--out", "a.html", "--aircraft", "hexa"], "4 motors, hexa has 6"),
        (["roll.npz", "--out", "a.html", "--from", "2"], "no row from 2 s"),
        (["roll.npz", "--out", "a.html", "--from", "0.5", "--to", "0.5"], "--to 0.5"),
        (["roll.npz"], "no display for a window"),
        (["roll.npz", "--out", "a.png", "--at", "9"], "0 to 1.000 s"),
        (["roll.npz", "--out", "a.gif", "--strip", "2"], "of a .png"),
        (["roll.npz", "--out", "a.png", "--strip", "0"], "expected 1 to 12"),
        (["roll.npz", "--out", "a.gif", "--speed", "nan"], "--speed"),
        (["roll.npz", "--out", "a.gif", "--speed", "0.01"], "frames"),
    ],
)
def test_a_mistake_is_one_line_and_no_file(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    rolling(tmp_path / "roll.npz")
    assert said in refused(capsys, ["view", *words])
    assert [file.name for file in tmp_path.iterdir()] == ["roll.npz"]


def test_a_flight_of_now_shows_where_the_twin_is(tmp_path: Path) -> None:
    falling = tmp_path / "fall.toml"
    falling.write_text(
        'name = "fall"\nmount = "free"\n[[segment]]\nduration_s = 0.5\nsetpoint_deg_s = [0, 0, 0]\n'
    )
    out = tmp_path / "fall.html"
    words = ["pid", "--scenario", str(falling), "--from", "0.1", "--to", "0.4", "--out", str(out)]
    assert main(["view", *words]) == 0
    found = re.search(r'"place":\[([^]]*)\]', out.read_text())
    assert found is not None
    height = np.array(found[1].split(","), np.float64).reshape(-1, 3)[:, 2]
    assert len(height) == 15  # 0.10, 0.12 ... 0.38 s
    assert (np.diff(height) < 0).all()  # throttle closed
    assert main(["view", *words, "--mount", "centre"]) == 0
    assert '"place":null' in out.read_text()


def test_a_cut_log_is_drawn_and_its_damage_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = log_of(trace(600))
    broken = tmp_path / "broken.bbl"
    broken.write_bytes(data[: int(0.8 * len(data))])
    assert main(["view", str(broken), "--out", str(tmp_path / "x.png"), "--strip", "1"]) == 0
    said = capsys.readouterr()
    assert "broken.bbl: log 1: " in said.err and "no end of the log" in said.err
    assert "1 pose of" in said.out
