"""A check that a program is the one that flew a log."""

from __future__ import annotations

from pathlib import Path

from neuroflight.sim.board.debug.variables import constant
from neuroflight.sim.replay.inputs import Flight
from neuroflight.toolchain.errors import LinkError, TraceError

_SHA256 = "policy_blob.header.policy_sha256"
SHOWN = 16  # digits of a hash


def check_policy(flight: Flight, elf: Path) -> None:
    """Raise TraceError unless the program `elf` has the policy that the log says flew.

    Raises LinkError where the program is missing, BuildError where it is none of ours.
    """
    if not elf.is_file():
        raise LinkError(f"{elf}: not built yet; build it with `make host` or `make firmware`")
    words = flight.header.get("nf_policy", "").split(",")
    if len(words) < 4:
        raise TraceError(
            f"{flight.path}: its header names no policy that flew (nf_policy:{','.join(words)[:SHOWN]}), "
            "expected one; a firmware without a good policy cannot be replayed"
        )
    flew, ours = words[3].strip().lower(), constant(elf, _SHA256).hex()
    if flew != ours:
        raise TraceError(
            f"{flight.path}: policy {flew[:SHOWN]}.. flew, {elf} has {ours[:SHOWN]}..: build that one, "
            "or ask another with --policy"
        )


def image_note(flight: Flight) -> str:
    """Name the image that flew, as a hint at the reason of a difference."""
    return f"the image that flew: {flight.header.get('nf_image', 'not told')}"
