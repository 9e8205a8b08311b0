"""An image goes to the host program over a line that spoils frames, stalls or is pulled: the right one."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from neuroflight.flash.image.files import Image
from neuroflight.flash.image.messages import image_info
from neuroflight.flash.image.update import hash_of, write_image
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import open_transport
from neuroflight.toolchain.contract import FLASH_BANK_B, FLASH_BASE, Msp, image_header
from neuroflight.toolchain.errors import LinkError
from tests.firmware.images import make_image
from tests.sampling import sampled

SPEED = 40  # so much faster than the real one is the client's time: silence of 5 s takes 125 ms
FRAME_BYTES = 521  # the longest one
SMALL = 1200  # bytes of an image of three frames
Fault = Callable[[bytes], list[bytes]]


def whole(data: bytes) -> list[bytes]:
    return [data]


class SpoiltLine:
    """A Transport to the host program: what becomes of each piece down and up; its time passes quickly."""

    def __init__(self, port: str, down: Fault = whole, up: Fault = whole) -> None:
        self._inner = open_transport(port)
        self.name, self.close = self._inner.name, self._inner.close
        self._down, self._up = down, up
        self._ready: list[bytes] = []

    def write(self, data: bytes) -> None:
        for piece in self._down(data):
            self._inner.write(piece)

    def read(self, timeout: float) -> bytes:
        if not self._ready:
            data = self._inner.read(max(timeout / SPEED, 0.001))
            self._ready = self._up(data) if data else []
        return self._ready.pop(0) if self._ready else b""

    def clock(self) -> float:
        return SPEED * time.monotonic()


class Receiver:
    """The host program's bank B."""

    def __init__(self, port: str, flash: Path) -> None:
        self.port, self._flash = port, flash
        self._seed = 0

    def image(self, size: int = SMALL) -> Image:
        """One that it has not had."""
        self._seed += 1
        data = make_image(self._seed, size)
        header = image_header(data)
        assert header is not None
        return Image(header, data)

    def send(self, image: Image, down: Fault = whole, up: Fault = whole) -> None:
        line = SpoiltLine(self.port, down, up)
        with Client(line, line.clock) as client:
            write_image(client, image, lambda what, done, total: None, line.clock)

    def holds(self, image: Image) -> bool:
        """Whether its flash has exactly that, and does not start it unasked."""
        with Client(open_transport(self.port)) as client:
            told = image_info(client.request(Msp.IMAGE_INFO)).banks[1]
            right = hash_of(client, 1, time.monotonic) == image.sha256
        at = FLASH_BANK_B.address - FLASH_BASE
        return right and not told.numbered and self._flash.read_bytes()[at:].startswith(image.data)


@pytest.fixture
def receiver(resting_host: str, tmp_path: Path) -> Receiver:
    return Receiver(resting_host, tmp_path / "flash.bin")


class Nth:
    """Spoils the n-th piece that goes through, from 0."""

    def __init__(self, n: int, spoil: Fault) -> None:
        self.left, self._spoil = n, spoil

    def __call__(self, data: bytes) -> list[bytes]:
        self.left -= 1
        return self._spoil(data) if self.left == -1 else [data]


def flipped(at: int, mask: int = 0x55) -> Fault:
    """With one wrong byte, if it has so many."""

    def spoil(data: bytes) -> list[bytes]:
        return [data[:at] + bytes(byte ^ mask for byte in data[at : at + 1]) + data[at + 1 :]]

    return spoil


def check_positions(receiver: Receiver, positions: Iterator[int] | range) -> None:
    """Each byte of a frame with data wrong on its way down, and of a reply on its way up."""
    for at in positions:
        image = receiver.image()
        receiver.send(image, down=Nth(2, flipped(at)))  # behind API_VERSION and IMAGE_BEGIN
        assert receiver.holds(image), f"byte {at} of the frame"
        if at < 16:
            image = receiver.image()
            receiver.send(image, up=Nth(1 + at % 4, flipped(at)))
            assert receiver.holds(image), f"byte {at} of a reply"


def test_the_right_image_arrives_when_any_byte_of_a_frame_is_wrong(receiver: Receiver) -> None:
    check_positions(receiver, iter((*range(14), 100, 263, 516, FRAME_BYTES - 2, FRAME_BYTES - 1)))


@pytest.mark.slow
@pytest.mark.parametrize("mask", [0x01, 0x80, 0xFF])
def test_the_right_image_arrives_when_every_byte_of_a_frame_is_wrong_in_turn(
    receiver: Receiver, mask: int
) -> None:
    for at in range(FRAME_BYTES):
        image = receiver.image()
        receiver.send(image, down=Nth(2, flipped(at, mask)))
        assert receiver.holds(image), f"byte {at} of the frame"


class Shuffled:
    """Drops, doubles, holds back or cuts one piece in six.

    It cuts little off: a board gives half a frame up when its line rests, while the host program, whose TCP
    loses nothing, waits for as many bytes as it was told.
    """

    def __init__(self, seed: int) -> None:
        self._rng = random.Random(seed)
        self._held: list[bytes] = []
        self.spoilt = 0

    def __call__(self, data: bytes) -> list[bytes]:
        held, self._held = self._held, []
        kind = self._rng.randrange(6 * 4)
        self.spoilt += kind < 4
        match kind:
            case 0:
                return held
            case 1:
                return [data, data, *held]
            case 2:
                self._held = [data]
                return held
            case 3:
                return [data[: -self._rng.randrange(1, 6)], *held]
        return [data, *held]  # what was held back comes behind its successor


@pytest.mark.parametrize("seed", sampled(range(3), 1))
def test_the_right_image_arrives_when_frames_are_dropped_doubled_reordered_and_cut(
    receiver: Receiver, seed: int
) -> None:
    image = receiver.image(20_000)
    down, up = Shuffled(seed), Shuffled(100 + seed)
    receiver.send(image, down, up)
    assert receiver.holds(image)
    assert down.spoilt + up.spoilt > 8


def test_it_goes_on_when_the_line_stalls_for_ten_seconds(receiver: Receiver) -> None:
    image = receiver.image(20_000)
    until = SPEED * time.monotonic() + 1e9
    count = 0

    def stall(data: bytes) -> list[bytes]:
        nonlocal count, until
        count += 1
        if count == 20:
            until = SPEED * time.monotonic() + 10.0
        return [data] if count < 20 or SPEED * time.monotonic() > until else []

    before = SPEED * time.monotonic()
    receiver.send(image, stall)
    assert receiver.holds(image)
    assert SPEED * time.monotonic() - before > 10.0


def test_a_pulled_cable_leaves_no_image_and_the_next_try_goes_on_from_there(receiver: Receiver) -> None:
    """At 20 moments, also within a frame."""
    rng = random.Random(5)
    image = receiver.image(60_000)
    sent = 0
    resumed = []

    def send_until(pulled: float) -> None:
        nonlocal sent

        def down(data: bytes) -> list[bytes]:
            nonlocal sent
            if data[4:6] == Msp.IMAGE_WRITE.to_bytes(2, "little"):
                offsets.append(int.from_bytes(data[8:12], "little"))
            if sent + len(data) > pulled:
                raise LinkError("the cable is pulled")
            sent += len(data)
            return [data]

        offsets: list[int] = []
        sent = 0
        try:
            receiver.send(image, down)
        finally:
            resumed.extend(offsets[:1])

    for _ in range(20):
        with pytest.raises(LinkError, match="the cable is pulled"):
            send_until(rng.uniform(600, 4000))
        with Client(open_transport(receiver.port)) as client:
            bank = image_info(client.request(Msp.IMAGE_INFO)).banks[1]
            assert not bank.numbered
    assert resumed == sorted(resumed) and resumed[-1] > 20_000
    send_until(1e9)
    assert receiver.holds(image)
    assert resumed[-1] > 20_000  # not from the beginning
