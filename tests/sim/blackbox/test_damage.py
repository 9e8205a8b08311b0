"""Damaged and hostile logs: one line at most, never a traceback, and what could be read is read."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.headers import FILE_BYTES_MAX
from neuroflight.sim.blackbox.log import list_logs, read_log
from neuroflight.sim.blackbox.quality import quality
from neuroflight.toolchain.errors import TraceError
from tests.sim.blackbox import damage
from tests.sim.blackbox.writer import (
    END,
    GROUP,
    PRODUCT,
    Column,
    event,
    fields,
    flight,
    header,
    slow,
)

COLUMNS = [
    *(Column(f"setpoint[{axis}]") for axis in range(4)),
    *(Column(f"debug[{at}]", GROUP) for at in range(5)),
    *(Column(f"gyroADC[{axis}]") for axis in range(3)),
    *(Column(f"motor[{motor}]") for motor in range(4)),
]
LIMIT_S = 60  # of one file; they take some hundredths of a second
STEPS = 400


def good(seed: int) -> bytes:
    """A whole log of STEPS rows with I frames every 32."""
    rng = np.random.default_rng(seed)
    rows = np.cumsum(rng.integers(-3, 4, (STEPS, len(COLUMNS))), axis=0) + 1000
    numbers = header({"I interval": 32, "P interval": "1/1", "gyro_scale": "0x3f800000", "acc_1G": 2048})
    told = fields(COLUMNS, ["flightModeFlags", "stateFlags"])
    frames = flight(COLUMNS, rows.tolist())
    return PRODUCT + numbers + told + event(0, 5_000_000) + slow([1, 0]) + frames + event(15, 4) + END


@contextmanager
def bounded(what: str) -> Iterator[None]:
    """An endless loop is told by what it ran on."""

    def end(*_: object) -> None:
        raise AssertionError(f"still at it after {LIMIT_S} s: {what}")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def check(path: Path, data: bytes, what: str) -> int:
    """Read it; rows that were read. Anything but a TraceError of one line fails."""
    path.write_bytes(data)
    with bounded(what):
        try:
            log = read_log(path)
        except TraceError as error:
            assert "\n" not in str(error) and str(error).isprintable(), what
            return 0
        quality(log)
    assert all(note.isprintable() for note in log.notes), what
    return len(log)


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_damaged_logs_are_read_as_far_as_they_go(tmp_path: Path) -> None:
    logs = [good(1), good(2)]
    read = 0
    for number in range(80):
        what, data = damage.damaged(logs, number)
        read += check(tmp_path / "a.bfl", data, what) > 0
    assert read > 30


@pytest.mark.parametrize(
    ("name", "lost", "wrong"),
    [("inserted", 33, 1), ("deleted", 65, 31), ("blanked", 97, 1), ("twice", 65, 1)],
)
def test_rows_around_damage_are_those_that_were_written(
    tmp_path: Path, name: str, lost: int, wrong: int
) -> None:
    """What is lost reaches to the next I frame; so do wrong values, where what is left is a whole frame."""
    whole = good(3)
    path = tmp_path / "a.bfl"
    path.write_bytes(whole)
    log = read_log(path)
    written = np.stack(list(log.columns.values()), axis=1)
    body = list_logs(path)[0].extent.body
    for seed in range(12):
        hurt = getattr(damage, name)(whole[body:-100], np.random.default_rng(seed)) + whole[-100:]
        path.write_bytes(whole[:body] + hurt)
        read = read_log(path)
        rows = np.stack(list(read.columns.values()), axis=1)
        assert len(rows) >= STEPS - lost
        assert (written[rows[:, 0]] != rows).any(axis=1).sum() <= wrong


def test_file_is_refused_in_one_line_when_it_is_no_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.bfl"
    for content in (b"", b"\0" * 4096, b"\xff" * 4096, b"H " * 5000, b"text\n" * 100, good(1)[-3000:]):
        path.write_bytes(content)
        assert main(["log", "metrics", str(path)]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "expected a Betaflight blackbox log" in err
    with path.open("wb") as file:
        file.truncate(FILE_BYTES_MAX + 1)
    assert main(["log", "metrics", str(path)]) == 1
    assert "expected at most 256 MB" in capsys.readouterr().err
    assert main(["log", "metrics", str(tmp_path / "none.bfl")]) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_damage_is_told_in_one_line_when_a_command_reads_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.bfl"
    whole = good(4)
    path.write_bytes(whole[:4000] + bytes(700) + whole[4700:])
    for words in (["metrics", str(path)], ["quality", str(path)], ["commands", str(path)]):
        assert main(["log", *words]) == 0
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and "damaged at 1 place" in err
    assert main(["log", "plot", str(path), "--out", str(tmp_path / "a.png")]) == 0


def test_nothing_is_written_when_nothing_can_be_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.bfl"
    path.write_bytes(good(4)[:300])
    outputs = ["--csv", str(tmp_path / "a.csv"), "--npz", str(tmp_path / "a.npz")]
    assert main(["log", "decode", str(path), *outputs]) == 1
    assert main(["log", "plot", str(path), "--out", str(tmp_path / "a.png")]) == 1
    assert [one.name for one in tmp_path.iterdir()] == ["a.bfl"]
    assert capsys.readouterr().err.count("\n") == 2


@pytest.mark.slow
@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_all_damaged_logs_get_one_line_at_most(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Through the command, as a user sees it."""
    logs = [good(seed) for seed in range(8)]
    path = tmp_path / "a.bfl"
    read = 0
    for number in range(damage.COUNT):
        what, data = damage.damaged(logs, number)
        path.write_bytes(data)
        action = ("quality", "metrics", "commands", "decode", "list")[number % 5]
        with bounded(f"{number}: {what}"):
            code = main(["log", action, str(path), "--json"])
        out, err = capsys.readouterr()
        assert err.count("\n") <= 1 and (code == 0) == bool(out), f"{number}: {what}: {err}"
        assert code == 0 or err.count("\n") == 1, f"{number}: {what}"
        read += code == 0
    assert read > damage.COUNT / 2
