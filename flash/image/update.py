"""Writes an image into a board's spare bank and makes it the one that is started next.

The board goes on flying the image that it runs. Requests are sent one at a time, each once the board has
answered the one before: the line, not the waiting, takes the time. A request whose answer is lost is sent
again; where that does not help, IMAGE_BEGIN tells where the board is, and the writing goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from neuroflight.flash.image.files import Image, bank_name
from neuroflight.flash.image.messages import (
    DATA_BYTES_MAX,
    image_begun,
    image_ended,
    image_hash,
    image_hashed,
    image_info,
    image_switch,
    image_switched,
    image_write,
)
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.errors import LinkError

Progress = Callable[[str, int, int], None]  # action ("erase", "write", "check"), done, in all
Clock = Callable[[], float]

FLASH_TIMEOUT_S = 5.0  # for one answer: erasing a bank stalls the board for up to 2 s
PATIENCE_S = 30.0  # without progress until the update is given up
ANEW = 2  # times that a damaged image is written again


Reply = TypeVar("Reply")


def patiently(client: Client, ask: Callable[[], Reply], clock: Clock) -> Reply:
    """Repeat `ask` while nobody answers and return its result. Late replies to earlier requests are discarded
    first. Raises LinkError after PATIENCE_S of silence."""
    deadline = clock() + PATIENCE_S
    while True:
        try:
            client.settle()
            return ask()
        except NoAnswerError:
            if clock() > deadline:
                raise


def write_image(client: Client, image: Image, progress: Progress, clock: Clock) -> None:
    """Write `image` into the spare bank and have the board check it, CRC and SHA-256.

    Whether it is started is not changed. Goes on where an update with the same image was under way.
    Raises LinkError where the board refuses, the line is gone, or nothing arrives for PATIENCE_S.
    """
    for left in reversed(range(ANEW)):
        _send(client, image, progress, clock)
        progress("check", 0, 1)
        try:
            _check(client, image, clock)
        except RefusedError as error:
            if left == 0 or error.reason not in (Refusal.IMAGE, Refusal.ORDER):
                raise
            continue
        progress("check", 1, 1)
        return


def _send(client: Client, image: Image, progress: Progress, clock: Clock) -> None:
    """Write all bytes of the image, in order."""
    size = len(image.data)
    at, moved = _begin(client, image, progress, clock), clock()
    while at < size:
        data = image.data[at : at + DATA_BYTES_MAX]
        try:
            client.request(Msp.IMAGE_WRITE, image_write(at, data), timeout=FLASH_TIMEOUT_S)
            at, moved = at + len(data), clock()
        except (NoAnswerError, RefusedError) as error:
            lost = isinstance(error, NoAnswerError) or error.reason == Refusal.ORDER
            if not lost or clock() - moved > PATIENCE_S:
                raise
            at = _begin(client, image, progress, clock)
        progress("write", at, size)


def _begin(client: Client, image: Image, progress: Progress, clock: Clock) -> int:
    """Begin or resume the update; returns the offset to continue from [bytes]."""

    def ask() -> int:
        try:
            return image_begun(client.request(Msp.IMAGE_BEGIN, image.header.raw, timeout=FLASH_TIMEOUT_S))
        except RefusedError as error:
            if error.reason is not Refusal.ORDER:
                raise
            raise RefusedError(
                f"{client.name}: the running image has not proven itself yet, and {bank_name(image.bank)} "
                "holds the one that the board would go back to, expected a proven image to run; wait some "
                "seconds, or see what holds it up with `neuroflight board status --port PORT`",
                error.reason,
            ) from None

    progress("erase", 0, 1)
    at = patiently(client, ask, clock)
    progress("erase", 1, 1)
    if at > len(image.data) or at % 4:
        raise LinkError(
            f"{client.name}: the board would go on from byte {at} of {len(image.data)}, expected one within "
            "the image; start the board anew and try again"
        )
    return at


def _check(client: Client, image: Image, clock: Clock) -> None:
    """Raise LinkError unless flash has exactly the image's bytes, as the board reads them."""

    def ask() -> int:
        return image_ended(client.request(Msp.IMAGE_END, timeout=FLASH_TIMEOUT_S))

    crc = patiently(client, ask, clock)
    if crc != image.header.crc:
        raise LinkError(
            f"{client.name}: {bank_name(image.bank)} reads back with the CRC {crc:08x}, expected "
            f"{image.header.crc:08x}; try again, and if that stays so the board's flash is worn"
        )
    sha256 = hash_of(client, image.bank, clock)
    if sha256 != image.sha256:
        raise LinkError(
            f"{client.name}: {bank_name(image.bank)} reads back with the SHA-256 {sha256.hex()[:16]}..., "
            f"expected {image.sha256.hex()[:16]}...; try again"
        )


def hash_of(client: Client, bank: int, clock: Clock) -> bytes:
    """Return the SHA-256 of a bank's image, which the board computes from flash. Raises LinkError."""

    def ask() -> bytes:
        return image_hashed(client.request(Msp.IMAGE_HASH, image_hash(bank), timeout=FLASH_TIMEOUT_S))

    return patiently(client, ask, clock)


def switch(client: Client, image: Image, clock: Clock) -> int:
    """Make the spare bank's image the one that the next boot starts. Returns its number. Raises LinkError."""
    payload = image_switch(image.sha256)

    def ask() -> int:
        return image_switched(client.request(Msp.IMAGE_SWITCH, payload, timeout=FLASH_TIMEOUT_S))

    sequence = patiently(client, ask, clock)
    bank = patiently(client, lambda: image_info(client.request(Msp.IMAGE_INFO)), clock).banks[image.bank]
    if not bank.numbered or bank.sequence != sequence or bank.crc != image.header.crc:
        raise LinkError(
            f"{client.name}: {bank_name(image.bank)} is not marked as the one to start, expected the number "
            f"{sequence}; try again"
        )
    return sequence
