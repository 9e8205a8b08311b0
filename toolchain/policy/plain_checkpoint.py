"""Loads a checkpoint as plain data, after a check that it takes no more memory than allowed for its file.

A small archive may inflate, and a few bytes of pickle may ask torch for gigabytes: a tensor larger than its
storage (which torch then enlarges), one that repeats its storage, a byte array of any length. So before torch
reads the file, its archive and its pickle are read here: entries must be stored uncompressed, the pickle
may build plain containers and call only the two functions that make a tensor, and tensors must lie within
their storages. Nothing in the file is executed by this.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import warnings
import zipfile
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.toolchain import contract
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import file_size
from neuroflight.toolchain.policy.file_kind import TORCH_EXPORT, foreign_kind

ANOTHER_TRAINER = f"if it is of another trainer, {TORCH_EXPORT}"
ENTRIES_MAX = 4096  # of the archive: a storage each; a training has some dozens
OPERATIONS_MAX = 1 << 19  # of the pickle: each makes an object of some 60 bytes at most
OPERATIONS = frozenset(
    {
        *("PROTO", "STOP", "MARK", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "GLOBAL", "REDUCE"),
        *("EMPTY_DICT", "SETITEM", "SETITEMS", "EMPTY_LIST", "APPEND", "APPENDS", "BINPERSID", "BUILD"),
        *("EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2", "TUPLE3", "BINUNICODE", "SHORT_BINUNICODE"),
        *("BININT", "BININT1", "BININT2", "LONG1", "BINFLOAT", "NONE", "NEWTRUE", "NEWFALSE"),
    }
)
ITEM_BYTES = {  # of what a torch storage of that name holds
    "DoubleStorage": 8,
    "FloatStorage": 4,
    "HalfStorage": 2,
    "BFloat16Storage": 2,
    "LongStorage": 8,
    "IntStorage": 4,
    "ShortStorage": 2,
    "CharStorage": 1,
    "ByteStorage": 1,
    "BoolStorage": 1,
}


@dataclass(frozen=True)
class _Storage:
    """A storage that the pickle names."""

    count: int
    item_bytes: int


def load_plain(path: Path) -> Any:  # noqa: ANN401 - plain containers, numbers, text and tensors
    """Return the content of the checkpoint `path`. Raises PolicyError, one line, and OSError."""
    import torch

    if (size := file_size(path)) > contract.CHECKPOINT_FILE_BYTES_MAX:
        raise PolicyError(f"{path} is {size} bytes, expected at most {contract.CHECKPOINT_FILE_BYTES_MAX}")
    data = path.read_bytes()
    if (kind := foreign_kind(data)) is not None:
        raise PolicyError(f"{path} is no checkpoint: it is {kind}")
    try:
        _check(data)
    except PolicyError as error:
        raise PolicyError(f"{path} is no checkpoint: {error}; {ANOTHER_TRAINER}") from error
    except Exception as error:  # what zipfile and pickle raise on damaged data
        raise PolicyError(f"{path} is no checkpoint, or damaged") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of archives that are no checkpoint: they are refused
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except Exception as error:  # torch documents no set of errors for a file that is not its own
        raise PolicyError(f"{path} is no checkpoint: torch cannot load it as plain data") from error


def _check(data: bytes) -> None:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        if len(entries) > ENTRIES_MAX or len(entries) < len(archive.infolist()):
            raise PolicyError(f"{len(entries)} entries in its archive, or two of one name")
        inflated = sum(entry.file_size for entry in entries.values())
        if inflated > len(data) or any(e.compress_type != zipfile.ZIP_STORED for e in entries.values()):
            raise PolicyError(
                f"its {len(data):,} bytes inflate to {inflated:,}, expected entries stored as they are"
            )
        (pickled,) = (name for name in entries if name.count("/") == 1 and name.endswith("/data.pkl"))
        storages = {
            name.removeprefix(pickled[: -len("data.pkl")]): e.file_size for name, e in entries.items()
        }
        content = archive.read(pickled)
    _check_operations(content)
    reader = _Reader(content, storages)
    reader.load()
    if reader.bytes > contract.CHECKPOINT_FILE_BYTES_MAX:
        raise PolicyError(
            f"its tensors take {reader.bytes:,} bytes, expected at most "
            f"{contract.CHECKPOINT_FILE_BYTES_MAX:,}"
        )


def _check_operations(content: bytes) -> None:
    for count, (operation, argument, _) in enumerate(pickletools.genops(content)):
        if operation.name not in OPERATIONS:
            raise PolicyError(f"its pickle does {operation.name}, expected plain data and tensors")
        if count > OPERATIONS_MAX or (
            operation.name == "LONG_BINPUT" and isinstance(argument, int) and argument > OPERATIONS_MAX
        ):
            raise PolicyError(f"its pickle has more than {OPERATIONS_MAX} operations")


class _Reader(pickle.Unpickler):
    """A reader of the pickle that adds up the tensors' bytes without making tensors."""

    def __init__(self, content: bytes, storages: dict[str, int]) -> None:
        super().__init__(io.BytesIO(content))
        self.bytes = 0
        self._storages = storages

    def find_class(self, module: str, name: str) -> Any:  # noqa: ANN401 - as pickle has it
        """Return the few functions that the pickle may call, and names of storage types."""
        if module == "torch" and name in ITEM_BYTES:
            return name
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self._tensor
        raise PolicyError(f"its pickle takes {module[:40]}.{name[:40]}, expected plain data and tensors")

    def persistent_load(self, pid: Any) -> _Storage:  # noqa: ANN401 - as pickle has it
        """Return a storage. Raises PolicyError unless its entry has the size that the pickle gives."""
        _, kind, key, _, count = pid
        item = ITEM_BYTES[kind]
        if type(count) is not int or self._storages.get(f"data/{key}") != count * item:
            raise PolicyError(f"its storage {str(key)[:20]} has another size than its entry in the archive")
        return _Storage(count, item)

    def _tensor(
        self, storage: _Storage, offset: int, sizes: Sequence[int], strides: Sequence[int], *_: object
    ) -> None:
        if not all(type(number) is int and number >= 0 for number in (offset, *sizes, *strides)):
            raise PolicyError("a tensor of it has negative sizes")
        if (count := math.prod(sizes)) == 0:
            return
        last = offset + sum((size - 1) * stride for size, stride in zip(sizes, strides, strict=True))
        if last >= storage.count:
            raise PolicyError(f"a tensor of {count:,} values lies beyond its storage of {storage.count:,}")
        self.bytes += count * storage.item_bytes
