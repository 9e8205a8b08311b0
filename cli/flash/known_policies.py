"""Networks of policies by the SHA-256 of their files: those shipped, and those in the current directory."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from toolchain.errors import PolicyError

SHIPPED = Path(__file__).resolve().parents[2] / "training" / "policies"
LOOKED_AT_MAX = 200  # files of a directory


def known_networks(wanted: Iterable[str], folder: Path) -> dict[str, str]:
    """The networks, such as `19-64-64-4 tanh`, of those of the `wanted` SHA-256 whose file is found.

    folder: searched beside the shipped ones. A file that is no policy is passed over.
    """
    from toolchain.policy.model import parse_policy, read_file

    left, found = set(wanted), {}
    for path in _files(folder):
        if not left:
            break
        try:
            data = read_file(path)
            sha256 = hashlib.sha256(data).hexdigest()
            if sha256 in left:
                found[sha256] = parse_policy(data).network.text
                left.discard(sha256)
        except PolicyError:
            continue
    return found


def _files(folder: Path) -> Iterator[Path]:
    yield from sorted(SHIPPED.glob("*/policy.onnx"))
    yield from sorted(folder.glob("*.onnx"))[:LOOKED_AT_MAX]
