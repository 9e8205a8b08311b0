"""The host program's --replay: what it is given may be anything."""

from __future__ import annotations

import struct
import subprocess
from pathlib import Path

import pytest

from neuroflight.sim.board.debug.variables import read_variables

MAGIC = 0x5052464E


def replayed(program: Path, stream: bytes, name: str = "-") -> tuple[int, bytes, str]:
    """Exit code, stdout and stderr of the program on `stream`."""
    done = subprocess.run(
        [program, "--gyro-hz=4000", f"--replay={name}"],
        input=stream,
        capture_output=True,
        timeout=30,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr.decode()


@pytest.fixture
def state_bytes(host_program: Path) -> int:
    return read_variables(host_program, "firmware")[0].size


def layout(program: Path, state_bytes: int) -> int:
    """That of the program, which tells it when it gets another."""
    _, _, said = replayed(program, struct.pack("<3I", MAGIC, state_bytes, 0))
    return int(said.split("expected ")[1].split(";")[0])


def test_each_damage_of_a_stream_is_refused_in_a_line(host_program: Path, state_bytes: int) -> None:
    known = layout(host_program, state_bytes)
    head = struct.pack("<3I", MAGIC, state_bytes, known)
    streams = {
        b"": "bytes of its head: got 0",
        head[:7]: "bytes of its head: got 7",
        struct.pack("<3I", MAGIC + 1, state_bytes, known): "the first word",
        struct.pack("<3I", MAGIC, 1 << 31, known): "bytes of the state",
        struct.pack("<3I", MAGIC, state_bytes, known ^ 1): "layout of the state",
        head + b"\0" * 100: "bytes of its state: got 100",
    }
    for stream, words in streams.items():
        code, answers, said = replayed(host_program, stream)
        assert (code, answers) == (1, b"")
        assert words in said and said.count("\n") == 1, said


def test_a_file_that_is_not_there_is_told(host_program: Path, tmp_path: Path) -> None:
    code, _, said = replayed(host_program, b"", str(tmp_path / "none"))
    assert code == 1 and "cannot open" in said and said.count("\n") == 1


def test_it_listens_on_no_port_while_it_replays(host_program: Path, state_bytes: int) -> None:
    first = replayed(host_program, b"")
    other = subprocess.run(
        [host_program, "--state-port=70000", "--replay=-"], input=b"", capture_output=True, check=False
    )
    assert first[0] == 1 and b"--state-port" in other.stderr  # its options are still looked at
