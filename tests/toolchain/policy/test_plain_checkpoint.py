"""Checkpoints that would take more memory than their file may are refused before torch reads them."""

from __future__ import annotations

import io
import json
import pickle
import struct
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from neuroflight.toolchain.errors import PolicyError, TrainingError
from neuroflight.toolchain.policy.plain_checkpoint import load_plain
from neuroflight.training.runs.checkpoint import load_learned, load_run
from tests.conftest import ROOT

HUGE = 1 << 30  # bytes that each of the files asks for
ALLOWED_KB = 160 << 10  # more than at rest, of a file of any kind: it is read once, parsed twice

MEASURE = """
import json, resource, sys
import torch
from pathlib import Path
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.plain_checkpoint import load_plain
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
words = []
for name in sys.argv[1:]:
    try:
        load_plain(Path(name))
        words.append("loaded")
    except PolicyError as error:
        words.append(str(error))
print(json.dumps([resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before, words]))
"""


def archive(entries: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> bytes:
    """Return an archive in torch's layout."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression, compresslevel=1) as made:
        for name, content in entries.items():
            made.writestr(f"archive/{name}", content)
    return file.getvalue()


def saved(content: object) -> dict[str, bytes]:
    """Return the archive's entries that torch writes for `content`."""
    file = io.BytesIO()
    torch.save(content, file)
    with zipfile.ZipFile(file) as made:
        return {name.partition("/")[2]: made.read(name) for name in made.namelist()}


def inflating() -> bytes:
    """Return a checkpoint with a large storage of zeros, which compresses to little."""
    return archive({**saved({"a": torch.zeros(3)}), "data/0": bytes(HUGE // 4)}, zipfile.ZIP_DEFLATED)


def expanded() -> bytes:
    """Return a checkpoint with one value that a stride of 0 repeats."""
    return archive(saved({"a": torch.zeros(1).expand(HUGE // 4)}))


def beyond() -> bytes:
    """Return a checkpoint with a tensor larger than its storage, which torch would enlarge."""
    entries = saved({"a": torch.zeros(100)})
    pickled = entries["data.pkl"]
    whole = b"K\x64\x85q"  # the one size, 100
    assert pickled.count(whole) == 1
    return archive(
        {**entries, "data.pkl": pickled.replace(whole, b"J" + struct.pack("<i", HUGE // 4) + b"\x85q")}
    )


def storage_of_another_size() -> bytes:
    """Return a checkpoint whose pickle gives a storage a larger size than its entry has."""
    entries = saved({"a": torch.zeros(100)})
    told = b"K\x64tq"  # the end of the storage's name, its 100 values
    assert entries["data.pkl"].count(told) == 1
    larger = entries["data.pkl"].replace(told, b"J" + struct.pack("<i", HUGE // 4) + b"tq")
    return archive({**entries, "data.pkl": larger})


def calling(call: bytes) -> bytes:
    """Return a checkpoint whose pickle calls a function."""
    return archive({**saved({}), "data.pkl": b"\x80\x02" + call + b"."})


def byte_array() -> bytes:
    """Return a checkpoint that creates a large byte array, with a function that torch allows."""
    return calling(b"c__builtin__\nbytearray\nJ" + struct.pack("<i", HUGE) + b"\x85R")


def far_memo() -> bytes:
    """Return a checkpoint that stores at a very high index of the unpickler's memo."""
    return calling(b"}r" + struct.pack("<I", 0xF0000000))


def repeated_entry() -> bytes:
    """Return a checkpoint whose entries all refer to the same bytes of the archive."""
    entries = saved({"a": torch.zeros(1 << 16)})
    data = bytearray(archive(entries))
    with zipfile.ZipFile(io.BytesIO(data)) as made:
        start = made.start_dir
        names = made.namelist()
    directory = bytes(data[start : data.index(b"PK\x05\x06")])
    first = next(i for i, name in enumerate(names) if name.endswith("data/0"))
    parts = directory.split(b"PK\x01\x02")[1:]
    twin = parts[first].replace(b"archive/data/0", b"archive/data/9")
    parts += [twin]
    joined = b"".join(b"PK\x01\x02" + part for part in parts)
    end = struct.pack("<4sHHHHIIH", b"PK\x05\x06", 0, 0, len(parts), len(parts), len(joined), start, 0)
    return bytes(data[:start]) + joined + end


def old_form() -> bytes:
    """Return a checkpoint in the format before torch 1.6, in which the pickle alone gives storage sizes."""
    file = io.BytesIO()
    torch.save({"a": torch.zeros(3)}, file, _use_new_zipfile_serialization=False)
    return file.getvalue()


KINDS: dict[Callable[[], bytes], str] = {
    inflating: "inflate to 268,",
    expanded: "its tensors take 1,073,741,824 bytes, expected at most 67,108,864",
    beyond: "a tensor of 268,435,456 values lies beyond its storage of 100",
    storage_of_another_size: "its storage 0 has another size than its entry in the archive",
    byte_array: "its pickle takes __builtin__.bytearray, expected plain data and tensors",
    far_memo: "its pickle has more than 524288 operations",
    repeated_entry: "inflate to",
    old_form: "a torch file of the form before torch 1.6",
}


def test_no_memory_is_taken_when_a_checkpoint_would_inflate(tmp_path: Path) -> None:
    paths = []
    for make in KINDS:
        paths.append(tmp_path / f"{make.__name__}.pt")
        paths[-1].write_bytes(make())
        assert paths[-1].stat().st_size < 8 << 20
    command = [sys.executable, "-c", MEASURE, *map(str, paths)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=True)
    kilobytes, words = json.loads(done.stdout)
    for make, told in zip(KINDS, words, strict=True):
        assert KINDS[make] in told, make.__name__
        assert "\n" not in told
    assert kilobytes < ALLOWED_KB


def test_checkpoint_is_loaded_when_it_holds_plain_data_and_tensors(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    base = torch.arange(24, dtype=torch.float64).reshape(4, 6)
    content: dict[str, Any] = {
        "a": [1, 2.5, "word", None, True, (), (1, 2), -(2**40)],
        "views": [base[1:, ::2], base.T, torch.zeros(0), torch.tensor(3)],
        "kinds": [
            torch.zeros(2, dtype=kind) for kind in (torch.int64, torch.bool, torch.uint8, torch.float16)
        ],
        "modules": torch.nn.Linear(3, 2).state_dict(),
    }
    torch.save(content, path)
    loaded = load_plain(path)
    assert loaded["a"] == content["a"]
    for ours, theirs in zip(loaded["views"], content["views"], strict=True):
        np.testing.assert_array_equal(ours.numpy(), theirs.numpy())
    assert [tensor.dtype for tensor in loaded["kinds"]] == [tensor.dtype for tensor in content["kinds"]]
    assert list(loaded["modules"]) == ["weight", "bias"]


@pytest.mark.parametrize("load", [lambda path: load_run(path, {}), load_learned])
def test_training_refuses_a_checkpoint_that_would_inflate(
    tmp_path: Path, load: Callable[[Path], object]
) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(expanded())
    with pytest.raises(TrainingError, match="its tensors take 1,073,741,824 bytes"):
        load(path)


def test_nothing_is_run_when_a_checkpoint_is_a_bare_pickle(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(pickle.dumps(Path.touch, protocol=2))
    with pytest.raises(PolicyError, match="a Python pickle, which could run any code and is not opened"):
        load_plain(path)
