"""The page that plays a flight: data, nothing from elsewhere, and its projection where node is there."""

from __future__ import annotations

import html
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.main import main
from sim.aircraft.model import load_aircraft
from sim.flight.trace import save_trace
from sim.viewing.page import FRAMES_MAX, page_data, save_page
from sim.viewing.scene import Scene, recorded
from tests.sim.viewing.test_view import QUARTER, rolling_trace

NODE = shutil.which("node")


def rolling_scene() -> Scene:
    """A quarter roll in a second, from 0 s, in place."""
    return recorded("a quarter </script> roll", load_aircraft("nf1"), rolling_trace())


def data_of(page: Path) -> dict[str, Any]:
    """What the page's script reads."""
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page.read_text(), re.S)
    assert found is not None
    read: dict[str, Any] = json.loads(found[1])
    return read


def test_the_page_holds_the_flight_fifty_times_a_second(tmp_path: Path) -> None:
    save_page(tmp_path / "roll.html", rolling_scene(), 0.3)
    data = data_of(tmp_path / "roll.html")
    assert data["frames"] == 51 and data["step"] == 0.02 and data["place"] is None
    turns = np.array(data["attitude"]).reshape(-1, 4) / 1e4
    half = QUARTER * 0.02 * np.arange(51) / 2
    assert turns == pytest.approx(np.column_stack([np.cos(half), np.sin(half), 0 * half, 0 * half]), abs=1e-4)
    assert np.array(data["flown"]).reshape(-1, 3)[7] == pytest.approx([900, 0, 0])
    assert data["motors"] == [300] * 204


def test_the_page_loads_nothing_and_its_texts_are_no_markup(tmp_path: Path) -> None:
    save_page(tmp_path / "roll.html", rolling_scene(), 1.0)
    text = (tmp_path / "roll.html").read_text()
    assert not re.search(r"https?:|//[a-z]+\.|\bsrc=|\bhref=|@import|url\(|fetch\(|XMLHttp|WebSocket", text)
    assert text.count("</script>") == 2  # of the two scripts, none from the title
    assert f"<h1>{html.escape('a quarter </script> roll')}</h1>" in text


def test_a_place_that_is_known_is_in_the_page(tmp_path: Path) -> None:
    still = rolling_scene()
    climb = np.linspace([0.0, 0.0, 0.0], [1.0, 0.0, -2.0], len(still.trace.t))
    data = page_data(replace(still, position=climb))
    place = np.array(data["place"]).reshape(-1, 3)
    assert place[-1] == pytest.approx([1000, 0, -2000]) and place[25] == pytest.approx([500, 0, -1000])
    assert float(str(data["floor"])) < -2.0  # the grid lies under the flight


def test_a_flight_too_long_for_a_page_names_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    rolling_file = tmp_path / "roll.npz"
    trace = rolling_trace()
    save_trace(rolling_file, replace(trace, t=trace.t * 0.021 * FRAMES_MAX))
    out = tmp_path / "long.html"
    assert main(["view", str(rolling_file), "--out", str(out)]) == 1
    assert "--from and --to" in capsys.readouterr().err and not out.exists()
    assert main(["view", str(rolling_file), "--out", str(out), "--from", "100", "--to", "110"]) == 0
    assert data_of(out)["start"] == 100


@pytest.mark.skipif(NODE is None, reason="needs node to run the page's script")
def test_the_script_draws_the_turned_aircraft(tmp_path: Path) -> None:
    save_page(tmp_path / "roll.html", rolling_scene(), 1.0)
    script = (tmp_path / "roll.html").read_text().split("<script>")[1].split("</script>")[0]
    asked = """
    const data = JSON.parse(require("fs").readFileSync(0, "utf8"));
    const eye = camera(0, 0, 10, 1000, 200, 100);  // behind, looking along x: left of the picture is y
    const at = (k, point) => project(eye, rotate(pose(data, k).attitude, point));
    console.log(JSON.stringify([at(0, [0, 1, 0]), at(50, [0, 1, 0]), at(0, [5, 0, 1]), at(12.5, [0, 1, 0])]));
    """
    program = tmp_path / "page.js"
    program.write_text(script + asked)
    data = json.dumps(page_data(rolling_scene()))
    assert NODE is not None
    run = subprocess.run([NODE, program], input=data, capture_output=True, text=True, check=True, timeout=60)
    level, rolled, ahead, between = json.loads(run.stdout)
    assert level == pytest.approx([0, 50, 10], abs=0.1)  # the left wing, 100 pixels left of the middle
    assert rolled == pytest.approx([100, -50, 10], abs=0.1)  # after a quarter roll to the right it is up
    assert ahead == pytest.approx([100, 50 - 1000 / 15, 15], abs=0.1)  # further away, smaller
    eighth = 100 * np.array([np.cos(QUARTER / 4), np.sin(QUARTER / 4)])  # between two frames
    assert between[:2] == pytest.approx([100 - eighth[0], 50 - eighth[1]], abs=0.2)
