"""Waits for a new image to prove itself, or for the board to go back to the one that it had."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, auto

from neuroflight.flash.board.hints import FAULTS
from neuroflight.flash.board.info import version_of
from neuroflight.flash.board.restart import opened
from neuroflight.flash.image.files import Image, bank_name
from neuroflight.flash.image.messages import Banks, image_info
from neuroflight.flash.image.update import Clock, hash_of
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError, patiently
from neuroflight.flash.link.messages import PolicyInfo
from neuroflight.flash.link.transport import Transport
from neuroflight.toolchain.contract import Msp
from neuroflight.toolchain.errors import LinkError

WAIT_S = 30.0  # until an image has proven itself, or has failed all its starts
ASK_S = 0.5  # for one answer
POLL_S = 0.1


class Ending(Enum):
    """Outcomes of a trial."""

    KEPT = auto()  # the new image runs and has proven itself
    POLICY_BAD = auto()  # likewise, but its policy failed the self-test: motors stay stopped
    OTHER = auto()  # the right bank runs, and what runs there is not the image that was sent
    UNPROVEN = auto()  # the new image runs and has not confirmed itself in time
    WENT_BACK = auto()  # the old image runs again


@dataclass(frozen=True)
class Trial:
    """The image that runs after the restart, and the outcome of its trial."""

    ending: Ending
    why: str  # one sentence for the pilot
    version: str
    policy: PolicyInfo


def await_image(
    client: Client,
    image: Image,
    reopen: Callable[[], Transport],
    clock: Clock,
    sleep: Callable[[float], None],
) -> tuple[Client, Trial]:
    """Ask until the board has decided. `client`: of a board that was started anew. Returns a client that
    answers. Raises LinkError where nobody answers any more; then the client is closed."""
    deadline = clock() + WAIT_S
    banks: Banks | None = None
    while clock() < deadline:
        try:
            banks = image_info(client.request(Msp.IMAGE_INFO, timeout=ASK_S, retries=0))
        except NoAnswerError:  # it may be starting once more
            continue
        except RefusedError:
            raise
        except LinkError:  # the line is gone
            client.close()
            client = opened(client, reopen, sleep)
            continue
        if banks.running != image.bank or banks.now.confirmed:
            break
        sleep(POLL_S)
    if banks is None:
        client.close()
        raise LinkError(
            f"{client.name}: nobody answers within {WAIT_S:g} s after the restart; look at the board"
        )
    return client, _judge(client, image, banks, clock)


def _judge(client: Client, image: Image, banks: Banks, clock: Clock) -> Trial:
    policy = patiently(client, lambda: messages.policy_info(client.request(Msp.POLICY_INFO)), clock)
    version = patiently(client, lambda: version_of(client), clock)

    def ended(ending: Ending, why: str) -> Trial:
        return Trial(ending, why, version, policy)

    if banks.running != image.bank:
        return ended(
            Ending.WENT_BACK,
            f"the board went back to {bank_name(banks.running)}, version {version}: the new image "
            f"{_failure(client, banks, image.bank)}",
        )
    if banks.now.build != image.header.build or hash_of(client, image.bank, clock) != image.sha256:
        return ended(
            Ending.OTHER,
            f"{bank_name(image.bank)} runs build {banks.now.build.hex()}, expected "
            f"{image.header.build.hex()}; did somebody else flash meanwhile?",
        )
    if version != image.header.version:
        return ended(
            Ending.OTHER,
            f"the image tells version {version}, expected {image.header.version} as its header says",
        )
    if not policy.good:
        return ended(
            Ending.POLICY_BAD,
            "the new image runs and its policy failed the self-test: the motors stay stopped; flash another "
            "policy or image, or see `neuroflight board status --port PORT`",
        )
    if not banks.now.confirmed:
        return ended(
            Ending.UNPROVEN,
            f"the new image runs and did not confirm itself within {WAIT_S:g} s: the board may go back at "
            "the next start; see `neuroflight board status --port PORT`",
        )
    return ended(Ending.KEPT, "the new image runs and has proven itself")


def _failure(client: Client, banks: Banks, bank: int) -> str:
    """Explain why the image in that bank does not run, as far as the board tells."""
    tried = banks.banks[bank]
    fault = records.faults(client.request(Msp.FAULTS)).pending
    why = (
        f"; the last fault logged: {FAULTS[fault.kind.name]}, see `neuroflight board faults`" if fault else ""
    )
    if not tried.fits:
        return f"is not there any more{why}"
    if tried.rejected:
        return f"was started and failed{why}"
    if tried.starts:
        return f"was started {tried.starts} time(s) and did not come up{why}"
    return f"was not started{why}"
