"""Digests of an aircraft: of what the twin flies, and of its file as it is written."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

# Tables and keys of the file that do not change the twin's flight.
NOT_FLOWN = ("name", "description", "pid", "known", "logged")

# Old policies hold the digest of the aircraft file's bytes. Here: the digest of a shipped file's bytes, and
# that of the aircraft it describes. The first two files gave the NF1's battery as 1.55 Ah instead of 1.5; the
# weights do not depend on it, since no episode was long enough to drain it.
_NF1 = "ce4df4597b3cf15151988670e59e159896222ce832a9dd98dcd3e5666ec0524b"
_HEXA = "5b3820e09ca43cf058794d2d02e0b5cd59735ef218c70d2288832eb0db01827f"
_IRIS = "cb833ee28ce2891d24e8157a478953408e3424b72edb8135064175a34665b255"
EARLIER = {
    "b03824433c72da92960945f0246e4cfae3c844851b3adaeccf1926b045579682": _NF1,
    "8debce7f1a7728dd0945bd45a62465323971476277d451705e789c51bfe3eca7": _NF1,
    "75064e0225c8cf6d1f7f401d65998328462b44fe2dff344fe2469a3297108eca": _NF1,
    "abd095ab500b8246403b562ba092109ecb85e565c25de68be8920d9b7f0f44d4": _HEXA,
    "40ba74835823cca271991043a678f8d45b31ad991edf4abeb4f67b46c3594af2": _IRIS,
}


def flown_sha256(document: Mapping[str, Any], mesh: Callable[[str], bytes]) -> str:
    """Compute a digest of what the twin flies: the file without names, marks, comments and PIDs, its meshes.

    Order of keys, layout and how a number is written do not count; a key written out counts, even with the
    value that it has when left out. document: of a valid aircraft. mesh: returns a mesh's bytes by its name.
    """
    flown = {key: value for key, value in document.items() if key not in NOT_FLOWN}
    flown["part"] = [{key: value for key, value in part.items() if key != "name"} for part in flown["part"]]
    text = json.dumps(_canonical(flown, mesh), sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def file_sha256(data: bytes, meshes: Iterable[bytes]) -> str:
    """Compute a digest of the file's bytes and of the meshes, in the order they were named."""
    digest = hashlib.sha256(data)
    for content in meshes:
        digest.update(hashlib.sha256(content).digest())
    return digest.hexdigest()


def _canonical(value: Any, mesh: Callable[[str], bytes]) -> Any:  # noqa: ANN401
    """Return `value` with every number as a float, and a mesh's name replaced by its content's digest."""
    if isinstance(value, Mapping):
        return {
            key: hashlib.sha256(mesh(each)).hexdigest() if key == "mesh" else _canonical(each, mesh)
            for key, each in value.items()
        }
    if isinstance(value, list):
        return [_canonical(each, mesh) for each in value]
    return value + 0.0 if isinstance(value, int | float) else value  # -0.0 becomes 0.0
