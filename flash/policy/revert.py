"""Return to the policy that was flown before."""

from __future__ import annotations

from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.policy_errors import policy_error
from neuroflight.flash.policy.slots import Policies, Slot
from neuroflight.flash.policy.swap import Board, restarted
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

UNTOUCHED = "nothing was changed"


def plan(policies: Policies, *, other_aircraft: bool) -> tuple[Slot, Slot]:
    """Return the policy that a revert gives up, and the one that is flown after it.

    Raises LinkError if there is none to return to, if a newer one waits for its first start, or if the one \\
    before is for another aircraft and `other_aircraft` is False.
    """
    flown = policies.flown
    if flown is None:
        raise LinkError(f"the board flies no policy; {UNTOUCHED}: flash one with --policy FILE")
    if (waiting := policies.after_start()) is not flown and waiting is not None:
        raise LinkError(
            f"{waiting.text} is flown from the next start on in place of the one that would be given up; "
            f"{UNTOUCHED}: start the board anew first (`neuroflight board reboot --port PORT`)"
        )
    before = policies.after_start(without=flown)
    if before is None:
        raise LinkError(
            f"the board flies {flown.text} and has no other good one; {UNTOUCHED}: "
            "flash one with --policy FILE"
        )
    if before.aircraft != flown.aircraft and not other_aircraft:
        raise LinkError(
            f"the policy before, in {before.name}, is for the aircraft {before.aircraft!r}, the one that the "
            f"board flies for {flown.aircraft!r}; {UNTOUCHED}: give --other-aircraft if that is meant"
        )
    return flown, before


def revert(client: Client) -> None:
    """Empty the flown slot; repeating it changes nothing. Raises LinkError."""
    try:
        client.request(Msp.POLICY_SLOT_REVERT)
    except NoAnswerError as error:
        raise LinkError(
            f"{error}; whether the flown slot was given up is not known: `neuroflight board policy list` "
            "tells"
        ) from error


def start(client: Client, flown: Slot, before: Slot, board: Board) -> Client:
    """Restart the firmware and check that it flies `before`. Returns a client of the new start.

    Raises LinkError, the client closed.
    """
    return restarted(client, board, lambda name, now: check_reverted(name, now, flown, before))


def check_reverted(name: str, policies: Policies, flown: Slot, before: Slot) -> None:
    """Raise LinkError unless the board flies `before` and no longer `flown`; name: the board's line."""
    info = policies.info
    if (info.source, info.sha256) == (before.source, before.sha256) and info.good:
        return
    now = next(each for each in policies.slots if each.source is before.source)
    why = "" if now.good else f" ({now.name}: {policy_error(now.found)})"
    raise LinkError(
        f"{name}: the board flies {policies.flown_text}, expected {before.text}{why} after "
        f"{flown.text} was given up; `neuroflight board policy list` tells what each slot holds"
    )
