"""yamspy as it is: what it reads, and one question to it."""

from __future__ import annotations

import inspect
import re
from collections.abc import Sequence
from dataclasses import dataclass

from yamspy import MSPy

WAIT_S = 5.0  # how long an answer may take before the test fails
NOTHING = -1  # what yamspy makes of a refusal


@dataclass(frozen=True)
class Heard:
    """What yamspy made of an answer."""

    refused: bool
    size: int  # bytes of payload
    left: int  # of them, that it has no field for; below 0: it could not read them


def new_peer() -> MSPy:
    """A peer without a line; `conn` is to be set."""
    return MSPy(device="", logfilename=None, loglevel="WARNING")


def readers() -> dict[str, int]:
    """Each request that yamspy takes the answer of apart, and its number."""
    return {
        name: code
        for name, code in MSPy.MSPCodes.items()
        if "_SET_" not in name and (reader := MSPy.__dict__.get(f"process_{name}")) and _takes(reader)
    }


def _takes(reader: object) -> bool:
    """Does the function look at the payload, or only say that a request was carried out?"""
    assert callable(reader)
    return re.search(r"\bdata\b", inspect.getsource(reader).split("\n", 1)[1]) is not None


def ask(peer: MSPy, name: str, data: Sequence[int] = ()) -> Heard:
    """Request and answer; what yamspy read of it stands in its own fields."""
    peer.conn.reset_input_buffer()  # it leaves the payload of a refusal on the line
    peer.send_RAW_msg(MSPy.MSPCodes[name], data)
    return hear(peer)


def hear(peer: MSPy) -> Heard:
    """The answer to what was sent."""
    told = peer.receive_msg()
    size = len(told["dataView"] or b"")
    return Heard(bool(told["unsupported"]), size, peer.process_recv_data(told))
