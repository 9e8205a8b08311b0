"""Pieces of a pilot's recorded commands as episodes, and the errors of invalid recordings."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.flight.trace import Trace, save_trace
from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.config.config_file import load_config
from neuroflight.training.tasks.recorded import RecordedTask

HEADING = "t_s,roll_deg_s,pitch_deg_s,yaw_deg_s"


def trace(setpoint: np.ndarray, rate_hz: int = 1000) -> Trace:
    steps = len(setpoint)
    return Trace(
        t=np.arange(steps) / rate_hz,
        setpoint=setpoint.astype(np.float32),
        rate=np.zeros((steps, 3)),
        gyro=np.zeros((steps, 3), np.float32),
        motors=np.zeros((steps, 4)),
        dshot=np.zeros((steps, 4), np.uint16),
        throttle=np.zeros(steps, np.float32),
    )


@pytest.fixture
def ramp(tmp_path: Path) -> Path:
    """A minute of commands at 50 Hz; the pitch command is the number of the second."""
    path = tmp_path / "ramp.csv"
    rows = [f"{100 + k / 50:.2f}, {-k / 10}, {k / 50}, 7" for k in range(3001)]
    path.write_text("\n".join([HEADING, *rows]) + "\n")
    return path


def test_episodes_are_pieces_of_the_recording_when_it_is_a_table(ramp: Path) -> None:
    task = RecordedTask(str(ramp), length_s=2.0)
    seen = np.rad2deg(task.episodes(500, np.random.default_rng(1), 1000).astype(np.float64))
    assert seen.shape == (500, 2000, 3)
    assert np.abs(seen[:, :, 2] - 7.0).max() < 1e-4
    assert np.abs(seen[:, :, 0] + 5 * seen[:, :, 1]).max() < 1e-3
    steps = np.diff(seen[:, :, 1], axis=1)
    changed = steps > 1e-6
    assert np.abs(steps[changed] - 1 / 50).max() < 1e-4  # each row in its turn
    assert (changed.sum(axis=1) >= 99).all()
    assert (changed.sum(axis=1) <= 100).all()  # 20 ms each
    starts = seen[:, 0, 1]
    assert starts.min() < 1.0
    assert 57.0 < starts.max() <= 58.0
    assert starts.mean() == pytest.approx(29.0, abs=2.5)  # evenly drawn


def test_episodes_are_the_flights_own_steps_when_it_is_a_trace(tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    flown = np.random.default_rng(3).uniform(-5, 5, (3000, 3)).astype(np.float32)
    save_trace(path, trace(flown))
    task = RecordedTask(str(path), length_s=0.5)
    for episode in task.episodes(20, np.random.default_rng(1), 1000):
        [first] = np.flatnonzero((flown == episode[0]).all(axis=1))
        assert np.array_equal(episode, flown[first : first + 500])


def test_a_configuration_keeps_the_recordings_hash_and_rejects_another_file(
    ramp: Path, tmp_path: Path
) -> None:
    config = load_config(None, ["task.name=recorded", f"task.file={ramp}", "task.length_s=1"])
    task = config.task
    assert isinstance(task, RecordedTask)
    assert len(task.sha256) == 64
    assert replace(task, length_s=2.0).sha256 == task.sha256
    record = tmp_path / "training.json"
    record.write_text(json.dumps({"config": config.document(load_aircraft("nf1"))}))
    assert load_config(record) == config
    ramp.write_text(ramp.read_text().replace(", 7", ", 8"))
    with pytest.raises(TrainingError, match=f"expected {task.sha256}: it is another recording"):
        replace(task)


def test_a_recording_must_be_named() -> None:
    with pytest.raises(TrainingError, match=r"task\.file: missing"):
        load_config(None, ["task=recorded"])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.csv", b"", "no heading line with known columns (''); expected t_s, roll_deg_s"),
        ("a.csv", f"{HEADING},t_s\n".encode(), "column t_s stands 2 times"),
        ("a.csv", f"{HEADING}\n0,0,0,0\n".encode(), "1 rows of commands, expected at least 2"),
        ("a.csv", f"{HEADING}\n0,0,0,0\n1,0,x,0\n".encode(), "line 3: pitch_deg_s is 'x', expected a number"),
        ("a.csv", f"{HEADING}\n1,0,0,0\n1,0,0,0\n".encode(), "the time is 1 s after 1 s, expected"),
        ("a.csv", f"{HEADING}\n0,0,0,0\n9,0,0,1500\n".encode(), "yaw is asked to turn at 1500 deg/s"),
        ("a.csv", f"{HEADING}\n0,0,0,0\n0.5,0,0,0\n".encode(), "lasts 0.5 s, expected at least the 1 s"),
        ("a.csv", b"\xff\xfe", "no table of text and commas"),
        ("a.csv", f'{HEADING}\n"0,0'.encode(), "no table of text and commas"),
        ("a.npz", b"not a trace", "damaged or no .npz file"),
        ("a.md", b"", "expected a file of .csv, .npz, .bbl"),
    ],
)  # fmt: skip
def test_an_invalid_recording_is_rejected_in_one_line(
    name: str, content: bytes, message: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(TrainingError) as error:
        RecordedTask(str(tmp_path / name), length_s=1.0)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_a_recording_that_is_too_large_is_rejected_unread(tmp_path: Path) -> None:
    path = tmp_path / "large.csv"
    with path.open("wb") as file:
        file.truncate((256 << 20) + 1)
    with pytest.raises(TrainingError, match="268435457 bytes, expected at most 268435456; cut it"):
        RecordedTask(str(path))


@pytest.mark.parametrize("file", ["", "nowhere.csv", "a\0b.csv"])
def test_a_missing_recording_is_rejected(file: str) -> None:
    with pytest.raises(TrainingError, match="no such file"):
        RecordedTask(file)
