"""Policies by the SHA-256 of their files: those shipped, and those in the current directory and its runs/."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from neuroflight.toolchain.errors import PolicyError

SHIPPED = Path(__file__).resolve().parents[2] / "training" / "policies"
LOOKED_AT_MAX = 200  # files of a directory


@dataclass(frozen=True)
class Known:
    """The facts of a policy that its file tells and a board does not."""

    network: str  # such as `19-64-64-4 tanh`
    aircraft_sha256: str  # of the aircraft that it was trained on, see `one_digest`


def known_policies(wanted: Iterable[str], folder: Path) -> dict[str, Known]:
    """Return the facts of those of the `wanted` SHA-256 whose file is found.

    folder: searched beside the shipped ones. A file that is no policy is passed over.
    """
    from neuroflight.toolchain.policy.model import parse_policy, read_file

    left, found = set(wanted), {}
    for path in _files(folder):
        if not left:
            break
        try:
            data = read_file(path)
            sha256 = hashlib.sha256(data).hexdigest()
            if sha256 in left:
                policy = parse_policy(data)
                found[sha256] = Known(policy.network.text, one_digest(policy.aircraft_sha256))
                left.discard(sha256)
        except PolicyError:
            continue
    return found


def one_digest(aircraft_sha256: str) -> str:
    """Return the digest of an aircraft as today's policies hold it, given that of an earlier format."""
    from neuroflight.sim.aircraft.digest import EARLIER

    return EARLIER.get(aircraft_sha256, aircraft_sha256)


def _files(folder: Path) -> Iterator[Path]:
    yield from sorted(SHIPPED.glob("*/policy.onnx"))
    for pattern in ("*.onnx", "runs/*/policy.onnx"):
        yield from sorted(folder.glob(pattern))[:LOOKED_AT_MAX]
