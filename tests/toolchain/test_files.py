"""toolchain/files.py: whole files or none, errors that name the file, claims that end with their process."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from neuroflight.toolchain import files
from neuroflight.toolchain.errors import InUseError

KILLED = """
import os, signal, sys
from pathlib import Path
from neuroflight.toolchain.files import claimed
with claimed(Path(sys.argv[1]), "run"):
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_the_old_file_stays_and_the_error_names_it_when_there_is_no_room(tmp_path: Path) -> None:
    path = tmp_path / "result.txt"
    path.write_text("old")
    with pytest.raises(OSError, match="No space left on device") as raised, files.replacing(path) as aside:
        aside.write_text("half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert raised.value.filename == str(path)
    assert [item.name for item in tmp_path.iterdir()] == ["result.txt"]
    assert path.read_text() == "old"


def test_a_file_is_written_when_its_name_is_as_long_as_any(tmp_path: Path) -> None:
    path = tmp_path / ("ä" * 125 + ".json")
    files.write_text(path, "{}")
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("name", ["x" * 5000, "x\0y"])
def test_a_name_that_no_file_can_have_is_an_error_with_that_name(tmp_path: Path, name: str) -> None:
    for use in (files.check_writable, files.file_size, lambda path: files.write_text(path, "x")):
        with pytest.raises(OSError) as raised:
            use(tmp_path / name)
        assert raised.value.filename is not None
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_when_a_place_can_be_written(tmp_path: Path) -> None:
    files.check_writable(tmp_path / "new" / "folder" / "file.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_what_is_no_file_has_no_size(tmp_path: Path, kind: str) -> None:
    path = {"pipe": tmp_path / "pipe", "device": Path("/dev/zero"), "folder": tmp_path}[kind]
    if kind == "pipe":
        os.mkfifo(path)
    with pytest.raises(OSError, match=r"not a file|Is a directory"):
        files.file_size(path)


def test_a_folder_has_one_owner_at_a_time(tmp_path: Path) -> None:
    out = tmp_path / "out"
    with files.claimed(out, "training"):
        with (
            pytest.raises(InUseError, match=f"{out} is in use by another training; wait"),
            files.claimed(out, "training"),
        ):
            raise AssertionError("it has two owners")
        (out / "result").touch()
    with files.claimed(out, "training"):
        pass
    assert [item.name for item in out.iterdir()] == ["result"]


def test_a_folder_is_removed_again_when_nothing_came_into_it(tmp_path: Path) -> None:
    with files.claimed(tmp_path / "new" / "out", "training"):
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_claim_ends_when_its_process_is_killed(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED, tmp_path])
    assert done.returncode == -signal.SIGKILL
    assert (tmp_path / files.LOCK).exists()
    with files.claimed(tmp_path, "training"):
        pass
