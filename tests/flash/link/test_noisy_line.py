"""Real serial devices (ptys) on the way to the host program, with what happens on real lines."""

from __future__ import annotations

import random
import time
from collections.abc import Callable

import pytest

from neuroflight.flash.board.info import read_info
from neuroflight.flash.link import messages
from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.contract import SETTINGS, Msp
from tests.sampling import sampled

LayLine = Callable[..., str]
STRAY = encode(Message(Version.V2, Direction.REPLY, 0x4E41, bytes(range(100))))
# Of a request: a false one makes the host program wait for what never comes. A board stops waiting when its
# line rests; a TCP connection, which corrupts nothing, has no such rest.
SIZES = frozenset({3, 6, 7})
HALF = b"$X>\x00\x41\x4e\xff\x01half of one"  # announces 511 bytes


def read_all(client: Client, count: int = len(SETTINGS)) -> list[object]:
    """That many settings, each with requests of its own."""
    settings = Settings(client)
    return [settings.get(setting.name) for setting in SETTINGS[:count]]


def test_a_serial_device_is_as_good_as_tcp_when_a_firmware_is_behind_it(
    resting_host: str, pty_line: LayLine
) -> None:
    with Client(open_transport(resting_host)) as client:
        over_tcp = read_info(client)
    with Client(open_transport(f"serial:{pty_line(resting_host)}:921600")) as client:
        assert read_info(client) == over_tcp


@pytest.mark.parametrize(
    "before",
    [STRAY, b"# \r\nUnknown command, try 'help'\r\n# ", b"$$$M<$X>", HALF, STRAY[:50]],
    ids=["stray-sample", "command-line", "dollars", "half-a-frame", "cut-sample"],
)
def test_every_reply_is_found_when_something_else_comes_before_it(
    resting_host: str, pty_line: LayLine, before: bytes
) -> None:
    with fast_client(pty_line(resting_host, up=lambda data: before + data)) as client:
        for _ in range(3):
            assert messages.api_version(client.request(Msp.API_VERSION)).minor == 47
            assert client.request(Msp.FC_VERSION) == b"\x19\x0c\x00\x092025.12.0"


def test_the_lines_own_echo_is_no_reply_when_it_comes_first(resting_host: str, pty_line: LayLine) -> None:
    sent: list[bytes] = []

    def down(data: bytes) -> bytes:
        sent.append(data)
        return data

    def up(data: bytes) -> bytes:
        echo, sent[:] = b"".join(sent), []
        return echo + data

    with fast_client(pty_line(resting_host, down=down, up=up)) as client:
        settings = Settings(client)
        settings.set("deadband_us", 7)
        assert settings.get("deadband_us") == 7


@pytest.mark.parametrize("seed", sampled(range(3), 1))
def test_all_values_are_right_when_bytes_are_corrupted_both_ways(
    resting_host: str, pty_line: LayLine, seed: int
) -> None:
    rng = random.Random(seed)
    count = 0

    def corrupt(data: bytes, spared: frozenset[int] = frozenset()) -> bytes:
        nonlocal count
        if rng.random() > 0.02:
            return data
        count += 1
        at = rng.choice([at for at in range(len(data)) if at not in spared])
        return data[:at] + bytes([data[at] ^ rng.randrange(1, 256)]) + data[at + 1 :]

    with Client(open_transport(resting_host)) as client:
        Settings(client).change({"deadband_us": 7, "roll_expo": 0.1, "craft_name": "quad"})
        expected = read_all(client)
    device = pty_line(resting_host, down=lambda data: corrupt(data, SIZES), up=corrupt)
    with fast_client(device) as client:
        assert read_all(client) == expected
    assert count > 5


class FastTransport:
    """A serial device on which time passes twenty times faster, so that a test need not wait for silence."""

    def __init__(self, device: str) -> None:
        self._inner = open_transport(device)
        self.name = self._inner.name
        self.write, self.close = self._inner.write, self._inner.close

    def read(self, timeout: float) -> bytes:
        return self._inner.read(timeout / 20)

    def clock(self) -> float:
        return 20 * time.monotonic()


def fast_client(device: str) -> Client:
    line = FastTransport(device)
    return Client(line, line.clock)


def test_silence_is_told_when_the_line_swallows_everything(resting_host: str, pty_line: LayLine) -> None:
    device = pty_line(resting_host, up=lambda data: b"")
    told = "got silence, expected a reply to MSP STATUS"
    with fast_client(device) as client, pytest.raises(NoAnswerError, match=told):
        client.request(Msp.STATUS, timeout=0.05)


def test_late_replies_are_not_mixed_up_when_the_line_holds_them_back(
    resting_host: str, pty_line: LayLine
) -> None:
    """Each third piece that comes up waits until the next one."""
    held: list[bytes] = []
    count = 0

    def hold(data: bytes) -> bytes:
        nonlocal count
        count += 1
        if count % 3 == 0:
            held.append(data)
            return b""
        before, held[:] = b"".join(held), []
        return before + data

    with Client(open_transport(resting_host)) as client:
        expected = read_all(client, 20)
    with fast_client(pty_line(resting_host, up=hold)) as client:
        assert read_all(client, 20) == expected
