"""The window, played without one: pybullet's own bodies, no display."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.bullet import pybullet
from neuroflight.sim.viewing import window
from neuroflight.sim.viewing.scene import recorded
from neuroflight.sim.viewing.shapes import reach
from neuroflight.toolchain.errors import NeuroflightError
from tests.sim.viewing.test_view import rolling, rolling_trace


class Hand:
    """A clock that moves when somebody waits, and a hand that closes the window after some waits."""

    def __init__(self, waits: int, clients: list[int]) -> None:
        self._clients = clients
        self.now = 0.0
        self.left = waits
        self.seen: list[tuple[float, ...]] = []  # orientation of body 0 at each wait

    def clock(self) -> float:
        """Seconds."""
        return self.now

    def wait(self, seconds: float) -> None:
        """Look at the aircraft, let the time pass, close the window at last."""
        self.seen.append(pybullet.getBasePositionAndOrientation(0, self._clients[-1])[1])
        self.now += seconds
        self.left -= 1
        if self.left == 0:
            pybullet.disconnect(self._clients[-1])


@pytest.fixture
def clients(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the worlds that were opened in place of a window."""
    connect = pybullet.connect
    opened: list[int] = []

    def instead(mode: int, options: str) -> int:
        client: int = connect(pybullet.DIRECT)
        opened.append(client)
        return client

    monkeypatch.setattr(pybullet, "connect", instead)
    return opened


def test_the_window_plays_in_time_until_it_is_closed(clients: list[int]) -> None:
    hand = Hand(90, clients)
    window.play(recorded("roll", load_aircraft("nf1"), rolling_trace()), 2.0, hand.clock, hand.wait)
    rolls = [2 * np.arctan2(seen[0], seen[3]) for seen in hand.seen]
    assert len(rolls) == 90
    assert rolls[15] == pytest.approx(np.pi / 4, abs=0.02)  # 0.25 s at twice the speed: half of it
    assert rolls[45] == pytest.approx(np.pi / 4, abs=0.05)  # it begins anew after 0.5 s


def test_the_camera_begins_near_the_aircraft_and_follows_it(
    clients: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    put: list[tuple[float, list[float]]] = []
    reset = pybullet.resetDebugVisualizerCamera

    def kept(distance: float, yaw: float, pitch: float, place: list[float], **client: int) -> None:
        put.append((distance, place))
        reset(distance, yaw, pitch, place, **client)

    monkeypatch.setattr(pybullet, "resetDebugVisualizerCamera", kept)
    aircraft, trace = load_aircraft("nf1"), rolling_trace()
    still = recorded("roll", aircraft, trace)
    hand = Hand(3, clients)
    ticks = itertools.count(5.0, 0.01)
    window.play(still, 1.0, lambda: next(ticks), hand.wait)  # time passes before the first frame
    assert [distance for distance, _ in put] == pytest.approx([2.4 * reach(aircraft)])  # the mouse is free
    put.clear()
    climb = np.linspace([0.0, 0.0, 0.0], [0.0, 0.0, 10.0], len(trace.t))
    hand = Hand(30, clients)
    window.play(replace(still, position=climb), 1.0, hand.clock, hand.wait)
    assert put[-1][1][2] == pytest.approx(10 * 29 / 60, abs=0.02)


def test_the_floor_lies_under_the_whole_flight() -> None:
    trace = rolling_trace()
    fall = np.linspace([0.0, 0.0, 0.0], [400.0, -3.0, -2.0], len(trace.t))
    scene = replace(recorded("roll", load_aircraft("nf1"), trace), position=fall)
    corners = np.concatenate([face.corners for face in window.floor_faces(scene, 0.2)])
    assert (corners[:, 2] < -2.0).all()
    assert (corners.min(axis=0)[:2] <= [0, -3]).all() and (corners.max(axis=0)[:2] >= [400, 0]).all()
    assert len(corners) / 4 <= window.CELLS_MAX**2 / 2 + window.CELLS_MAX


def test_a_window_that_does_not_open_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pybullet, "connect", lambda mode, options: -1)
    hand = Hand(1, [])
    with pytest.raises(NeuroflightError, match=r"--out FILE\.html"):
        window.play(recorded("roll", load_aircraft("nf1"), rolling_trace()), 1.0, hand.clock, hand.wait)


def test_with_a_display_and_no_file_the_window_is_played(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played: list[float] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "play", lambda scene, speed, clock, wait: played.append(speed))
    assert main(["view", str(rolling(tmp_path / "roll.npz")), "--speed", "0.5"]) == 0
    assert played == [0.5] and "level at 0.00 s" in capsys.readouterr().out
