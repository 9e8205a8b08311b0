"""A transfer as text is detected by missing bytes, and never reported for a log without such a transfer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.blackbox.log import list_logs, read_log
from neuroflight.sim.blackbox.transfer import text_transfer
from tests.sim.blackbox.encoder import encode
from tests.sim.blackbox.test_encoded import few_and_all, fields_of, written
from tests.sim.blackbox.writer import END, PRODUCT, Column, fields, flight, header

TRANSFERS: dict[str, Callable[[bytes], bytes]] = {
    "0x0D: line ends": lambda data: data.replace(b"\r\n", b"\n").replace(b"\r", b"\n"),
    "no byte 0x0D": lambda data: data.replace(b"\r", b""),
    "0x0A has 0x0D before it": lambda data: data.replace(b"\n", b"\r\n"),
    "no byte 0x0A:": lambda data: data.replace(b"\n", b"\r"),
    "XON/XOFF": lambda data: data.translate(None, b"\x11\x13"),
    "no byte 0x00": lambda data: data.replace(b"\0", b""),
    "they are UTF-8": lambda data: bytes(byte & 0x7F for byte in data),
    "(they are UTF-8)": lambda data: data.decode("latin-1").encode(),
    "above 0x7F are replaced": lambda data: data.decode(errors="replace").encode(),
}
AXES = [Column(f"{name}[{axis}]") for name in ("gyroADC", "setpoint", "motor") for axis in range(3)]


def noisy(seed: int, rows: int) -> bytes:
    """Write a flight whose values change by some ten from row to row."""
    rng = np.random.default_rng(seed)
    values = np.rint(np.cumsum(rng.normal(0, 9, (rows, len(AXES))), axis=0) % 1000).astype(int)
    told = header({"I interval": 32, "P interval": "1/1"}) + fields(AXES)
    return PRODUCT + told + flight(AXES, values.tolist()) + END


def body(path: Path, data: bytes) -> bytes:
    path.write_bytes(data)
    one = list_logs(path)[0].extent
    return data[one.body : one.end]


@pytest.mark.parametrize("words", TRANSFERS)
def test_transfer_is_told_in_one_note(tmp_path: Path, words: str) -> None:
    frames = body(tmp_path / "a.bfl", noisy(1, 4000))
    assert words in text_transfer(TRANSFERS[words](frames))
    assert not text_transfer(frames)


def test_each_command_tells_it_in_its_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = noisy(2, 4000)
    path = tmp_path / "a.bfl"
    start = len(data) - len(body(path, data))
    path.write_bytes(data[:start] + TRANSFERS["0x0D: line ends"](data[start:]))
    for action in ("decode", "quality"):
        assert main(["log", action, str(path)]) == 0
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and err.count("as text (no byte 0x0D: line ends were changed)") == 1
    whole = data.replace(b"\n", b"\r\n")
    path.write_bytes(whole)
    assert any("header lines end in CR LF" in note for note in read_log(path).notes)
    path.write_bytes(data[:start] + TRANSFERS["they are UTF-8"](data[start:]))
    assert "nothing of them can be relied on" in read_log(path).notes[0]


@few_and_all("healthy")
def test_no_log_that_came_whole_is_accused(tmp_path: Path, cases: range) -> None:
    """Draw logs of any fields and any length: random values, walks, constants, limits."""
    for case in cases:
        rng = np.random.default_rng((42, case))
        made = written(rng)
        lengths = int(rng.choice([1, 3, 30])) if case % 10 else 300
        frames = made.frames * lengths
        assert not text_transfer(frames), case
        assert not text_transfer(frames[: int(rng.integers(1, len(frames)))]), case
        fields_here = fields_of(rng)
        quiet = [[step, 5_000_000 + 500 * step, *[step % 7 for _ in fields_here[2:]]] for step in range(300)]
        assert not text_transfer(encode(fields_here, quiet, (32, 1, 1), rng).frames), case
        assert not text_transfer(noisy(case, 50 + 10 * (case % 50))[500:]), case
