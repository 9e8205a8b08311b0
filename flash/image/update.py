"""Writes an image into a board's spare bank and makes it the one that is started next.

The board goes on flying the image that it runs. Requests are sent one at a time, each once the board has
answered the one before: the line, not the waiting, takes the time. A request whose answer is lost is sent
again; where that does not help, IMAGE_BEGIN tells where the board is, and the writing goes on from there.
"""

from __future__ import annotations

from collections.abc import Callable

from neuroflight.flash.image.files import Image, bank_name
from neuroflight.flash.image.messages import (
    DATA_BYTES_MAX,
    image_hashed,
    image_info,
    image_write,
    number,
)
from neuroflight.flash.link.client import PATIENCE_S, Client, NoAnswerError, RefusedError, patiently
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.errors import LinkError

Progress = Callable[[str, int, int], None]  # action ("erase", "write", "check"), done, in all
Clock = Callable[[], float]

FLASH_TIMEOUT_S = 5.0  # for one answer: erasing a bank stalls the board for up to 2 s
ANEW = 2  # times that a damaged image is written again


def _number(client: Client, message: Msp, payload: bytes = b"") -> int:
    """Ask for what takes the time of an erasure at most, and is answered with a number."""
    return number(message, client.request(message, payload, timeout=FLASH_TIMEOUT_S))


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
            return _number(client, Msp.IMAGE_BEGIN, image.header.raw)
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
    crc = patiently(client, lambda: _number(client, Msp.IMAGE_END), clock)
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
    asked = Msp.IMAGE_HASH, bytes([bank])
    told = patiently(client, lambda: client.request(*asked, timeout=FLASH_TIMEOUT_S), clock)
    return image_hashed(told)


def switch(client: Client, image: Image, clock: Clock) -> int:
    """Make the spare bank's image the one that the next boot starts. Returns its number. Raises LinkError."""
    sequence = patiently(client, lambda: _number(client, Msp.IMAGE_SWITCH, image.sha256), clock)
    bank = patiently(client, lambda: image_info(client.request(Msp.IMAGE_INFO)), clock).banks[image.bank]
    if not bank.numbered or bank.sequence != sequence or bank.crc != image.header.crc:
        raise LinkError(
            f"{client.name}: {bank_name(image.bank)} is not marked as the one to start, expected the number "
            f"{sequence}; try again"
        )
    return sequence
