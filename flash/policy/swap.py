"""Another policy into the slot that is not flown, and a start with it.

    begin   the firmware erases the slot that is not flown, and names a sequence number
    write   the blob with that number, block after block; its first word stays in memory
    end     the firmware checks all of it, then programs the first word: from here on it counts
    start   the firmware takes the newest good policy that passes its self-test

Before `end` the slot holds none, so that whatever ends the swap early leaves the policy that is flown. The
last block and the end may be sent again when their reply was lost; anything else starts over at `begin`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from neuroflight.flash.board.restart import restart
from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.flash.link.messages import PolicySource
from neuroflight.flash.link.policy_errors import policy_error
from neuroflight.flash.link.transport import Transport
from neuroflight.flash.policy.candidate import Candidate
from neuroflight.flash.policy.slots import OTHER_IMAGE, Policies, Slot, read_patiently
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.errors import LinkError

ATTEMPTS = 3  # of a whole swap
RESENDS = 2  # of a block or the end whose reply did not come
REOPEN_S = 10.0  # for a lost line to come back
PAUSE_S = 0.2  # between two attempts to open it
# Answers that a damaged frame may cause whose 8-bit checksum happens to match.
DAMAGE = frozenset({Refusal.ORDER, Refusal.PAYLOAD, Refusal.SEQUENCE, Refusal.BLOB})

# Times of erasing and programming: STM32F722 datasheet, 32 bits at a time, typical.
ERASE_S = {PolicySource.SLOT_A: 0.55, PolicySource.SLOT_B: 1.0}
PROGRAM_S = 16e-6 / 4  # a byte
LINE_BITS = 10  # of a byte on a serial line
TURN_S = 0.001  # of a block, from its last byte to the reply's
START_S = 1.0  # until the firmware answers again

Progress = Callable[[int, int], None]  # bytes written, of so many


@dataclass(frozen=True)
class Board:
    """The line to a firmware, with the clock and sleep used on it."""

    reopen: Callable[[], Transport]
    clock: Callable[[], float] = field(default=time.monotonic)
    sleep: Callable[[float], None] = field(default=time.sleep)


class Blob(Protocol):
    """A policy that can be written to a slot."""

    @property
    def file(self) -> str: ...  # as the user wrote it

    @property
    def sha256(self) -> str: ...  # of its ONNX file

    @property
    def size(self) -> int: ...  # bytes

    @property
    def build(self) -> bytes: ...  # of the image that it comes with; zeros: for any of its architecture

    @property
    def blob(self) -> Callable[[int], bytes]: ...  # its bytes with that sequence number


def target(policies: Policies) -> PolicySource:
    """Return the slot that a swap erases, as `policy_slots_to_be_written` does: the one not flown."""
    kept = policies.flown or policies.after_start()
    return PolicySource.SLOT_B if kept is policies.slots[0] else PolicySource.SLOT_A


def seconds(size: int, slot: PolicySource, baud: int | None, *, start: bool) -> float:
    """Estimate the seconds for `size` bytes. baud: of a serial line or None. start: include the restart."""
    blocks = -(-size // requests.SLOT_BYTES_MAX)
    line = size * LINE_BITS / baud if baud else 0.0
    return ERASE_S[slot] + line + size * PROGRAM_S + blocks * TURN_S + (START_S if start else 0.0)


def write(client: Client, candidate: Blob, board: Board, progress: Progress) -> tuple[Client, Slot]:
    """Write it into the slot that is not flown. Returns the client, a new one if the line was opened again,
    and the slot.

    Raises LinkError, `client` closed, after ATTEMPTS, and at once where the firmware refuses for good: then
    the board goes on with the policy that it flies.
    """
    ending = False  # the end was sent; it is unknown whether it arrived
    for attempt in range(1, ATTEMPTS + 1):
        try:
            sequence, size = _begin(client, candidate)
            ending = False
            _write_blocks(client, candidate.blob(sequence), progress)
            ending = True
            client.request(Msp.POLICY_SLOT_END, retries=RESENDS)
            slot = read_patiently(client, board.clock).holding(candidate.sha256, sequence)
            if slot is not None and _arrived(candidate, slot):
                return client, slot
            failure = LinkError(
                f"{client.name}: the slot of {size} bytes reads otherwise than it was written"
            )
        except RefusedError as error:
            ending, failure = False, error
            if error.reason not in DAMAGE:
                break
        except NoAnswerError as error:
            failure = error
        except LinkError as error:
            failure = error
            if attempt < ATTEMPTS and (again := _reopened(client, board)) is not None:
                client = again
                continue
            break
        except BaseException:
            client.close()
            raise
    client.close()
    raise LinkError(f"{failure}; {_left(candidate, ending)}") from failure


def _arrived(candidate: Blob, slot: Slot) -> bool:
    """Return True if the slot holds it whole; it may be for another image than the running one."""
    return slot.build == candidate.build.hex() and (
        slot.good or (any(candidate.build) and slot.found == OTHER_IMAGE)
    )


def _begin(client: Client, candidate: Blob) -> tuple[int, int]:
    size = candidate.size
    reply = client.request(Msp.POLICY_SLOT_BEGIN, requests.slot_begin(size), retries=RESENDS)
    return requests.slot_begun(reply), size


def _write_blocks(client: Client, blob: bytes, progress: Progress) -> None:
    for offset in range(0, len(blob), requests.SLOT_BYTES_MAX):
        block = blob[offset : offset + requests.SLOT_BYTES_MAX]
        progress(offset, len(blob))
        client.request(Msp.POLICY_SLOT_WRITE, requests.slot_write(offset, block), retries=RESENDS)
    progress(len(blob), len(blob))


def _reopened(client: Client, board: Board) -> Client | None:
    """Open the line again and return a client on it; None if that fails for REOPEN_S."""
    client.close()
    deadline = board.clock() + REOPEN_S
    while board.clock() < deadline:
        try:
            return Client(board.reopen(), board.clock)
        except LinkError:
            board.sleep(PAUSE_S)
    return None


def _left(candidate: Blob, ending: bool) -> str:
    if ending:
        return (
            f"whether {candidate.file} was written to its end is not known: the board flies it from its next "
            "start on, or the policy that it flew: `neuroflight board policy list` tells"
        )
    return f"{candidate.file} was not written: the board goes on with the policy that it flew"


def start(client: Client, candidate: Candidate, slot: Slot, board: Board) -> Client:
    """Restart the firmware and check that it flies the policy in `slot`. Returns a client of the new start.

    Raises LinkError, the client closed, when the board does not come back, and when it flies another policy.
    """
    waits = (
        f"; {candidate.file} stands in {slot.name} and is flown from the next start on if it passes its "
        "self-test: `neuroflight board policy list` tells"
    )
    return restarted(client, board, lambda name, now: check_flown(name, now, candidate, slot), waits)


def restarted(
    client: Client, board: Board, check: Callable[[str, Policies], None], waits: str = ""
) -> Client:
    """Restart the firmware and `check` what it flies then. Returns a client of the new start.

    waits: said behind the reason where the firmware does not come back. Raises LinkError, the client closed.
    """
    try:
        client = restart(client, board.reopen, board.clock, board.sleep)
    except LinkError as error:
        raise LinkError(f"{error}{waits}") from error
    try:
        check(client.name, read_patiently(client, board.clock))
    except BaseException:
        client.close()
        raise
    return client


def check_flown(name: str, policies: Policies, candidate: Candidate, slot: Slot) -> None:
    """Raise LinkError unless the board flies the policy in `slot`; name: the board's line."""
    now = next(each for each in policies.slots if each.source is slot.source)
    info = policies.info
    told = (info.source, info.sequence, info.sha256)
    if now.flown and info.good and told == (slot.source, slot.sequence, candidate.sha256):
        return
    if not now.good:
        why = f"the one in {slot.name} {_was(now.found)}"
    elif now.flown and not info.good:
        why = "its self-test failed"
    else:
        why = f"{slot.name} holds the policy number {now.sequence}, expected {slot.sequence}"
    raise LinkError(
        f"{name}: the board flies {policies.flown_text} and not {candidate.file}: {why}; "
        "the policies before it are untouched"
    )


def _was(found: int) -> str:
    words = policy_error(found)
    return words if words.startswith("fails") else f"is {words}"
