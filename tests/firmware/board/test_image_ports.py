"""MSP's two ports of the shipped image on the emulated board: UART1, and UART3 where the pilot has set it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link.msp import Decoder, Direction, Message, Version, encode, request
from neuroflight.flash.settings.values import parse_change
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import code_row
from neuroflight.sim.board.debug.profile import code_counts
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.usart import Format
from neuroflight.sim.board.serial.bridge import MSP_UART, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.toolchain.contract import MSP_VARIANT_BETAFLIGHT, Msp
from neuroflight.toolchain.image.elf import read_flashable
from tests.sampling import sampled

UART3 = "USART3"
BAUDS = {MSP_UART: 115200, UART3: 921600}
RING_BYTES, SEND_BYTES = 4096, 1024
MILLISECOND = TIME_HZ // 1000
API = encode(Message(Version.V1, Direction.REQUEST, Msp.API_VERSION, b""))
API_ANSWER = b"$M>\x03\x01\x00\x01\x2f\x2c"
STATUS = encode(Message(Version.V1, Direction.REQUEST, Msp.STATUS, b""))


@pytest.fixture(scope="module")
def booted(board_image: Path) -> Iterator[tuple[IdleBoard, Snapshot]]:
    changes = dict(parse_change(text) for text in ("uart3_function=msp", f"uart3_baud={BAUDS[UART3]}"))
    flash = configured(read_flashable(board_image.with_suffix(".bin")), board_image, changes)
    idle = IdleBoard(flash, elf=board_image)
    idle.run_to(TIME_HZ)
    yield idle, take_snapshot(idle.board.engine)
    idle.close()


@pytest.fixture
def idle(booted: tuple[IdleBoard, Snapshot]) -> IdleBoard:
    """A second after its boot."""
    restore_snapshot(booted[0].board.engine, booted[1])
    return booted[0]


@pytest.fixture
def line(idle: IdleBoard) -> Callable[[str], UartLine]:
    """The far end of a UART, at the speed that it is set to."""
    return lambda uart: UartLine(idle.board, uart, Format(BAUDS[uart]))


def executions(idle: IdleBoard, function: str) -> int:
    """How often a function of the image has begun."""
    row = code_row(idle.board.symbols[function] & ~1)
    assert row is not None
    enters, leaves = code_counts(idle.board.engine)
    return int(np.cumsum(enters - leaves)[row])


def run(idle: IdleBoard, ms: float) -> None:
    idle.run_to(idle.board.cycle + round(ms * MILLISECOND))


def answer(idle: IdleBoard, line: UartLine, asked: bytes, ms: float = 20.0) -> bytes:
    """What comes within that time."""
    line.send(asked)
    run(idle, ms)
    return line.take()


def test_uart3_is_silent_when_nobody_has_set_it(board_image: Path) -> None:
    idle = IdleBoard(read_flashable(board_image.with_suffix(".bin")), elf=board_image)
    idle.run_to(TIME_HZ)
    assert not idle.board.hardware.usarts[UART3].words["CR1"] & 1
    assert answer(idle, UartLine(idle.board, UART3), API) == b""
    assert answer(idle, UartLine(idle.board), API) == API_ANSWER
    idle.close()


@pytest.mark.slow
def test_each_of_two_peers_gets_its_own_answers_when_they_take_turns_byte_by_byte(
    idle: IdleBoard, line: Callable[[str], UartLine]
) -> None:
    first, second = line(MSP_UART), line(UART3)
    for _ in range(5):
        for one, other in zip_longest(API, encode(request(Msp.FC_VARIANT))):
            for peer, byte in ((first, one), (second, other)):
                if byte is not None:
                    peer.send(bytes([byte]))
            run(idle, 0.2)
        run(idle, 20)
        assert first.take() == API_ANSWER
        (told,) = Decoder().feed(second.take())
        assert isinstance(told, Message)
        assert (told.command, told.payload) == (Msp.FC_VARIANT, MSP_VARIANT_BETAFLIGHT.encode())


@pytest.mark.parametrize(
    ("rude", "polite"), [(MSP_UART, UART3), pytest.param(UART3, MSP_UART, marks=pytest.mark.slow)]
)
@pytest.mark.parametrize(
    "noise",
    [
        pytest.param(b"$X<\x00\x01\x00\xff\x01half", id="half a frame"),
        pytest.param(
            b"$M<\xff\xff\xff\xff\xff" + bytes(range(256)) * 4, id="garbage", marks=pytest.mark.slow
        ),
        pytest.param(b"$M<\x00\x01\x02" * 100, id="wrong checksums", marks=pytest.mark.slow),
    ],
)
def test_one_peer_is_served_when_the_other_sends_what_is_none(
    idle: IdleBoard, line: Callable[[str], UartLine], rude: str, polite: str, noise: bytes
) -> None:
    other, peer = line(rude), line(polite)
    for _ in range(3):
        other.send(noise)
        assert answer(idle, peer, API) == API_ANSWER
    run(idle, 500)
    # After a pause even half a frame is forgotten. Garbage may have opened a command line, which then spoke.
    assert answer(idle, other, API).endswith(API_ANSWER)
    assert answer(idle, other, API) == API_ANSWER


@pytest.mark.slow
def test_all_of_it_is_answered_when_six_kilobytes_are_pasted_and_more_comes_back(
    idle: IdleBoard, line: Callable[[str], UartLine]
) -> None:
    """As a command line does: what is typed is echoed, and each line answered."""
    peer, board_info = line(MSP_UART), encode(Message(Version.V1, Direction.REQUEST, Msp.BUILD_INFO, b""))
    pasted = (API * 3 + board_info) * 256
    assert len(pasted) == 6144
    lost = executions(idle, "runtime_link_lost")
    told = answer(idle, peer, pasted, 1600)
    answers = [message for message in Decoder().feed(told) if isinstance(message, Message)]
    assert [message.command for message in answers] == ([Msp.API_VERSION] * 3 + [Msp.BUILD_INFO]) * 256
    assert len(told) > 2 * len(pasted)
    assert executions(idle, "runtime_link_lost") == lost


PASTED = 1500  # requests, of which the line's answers take six times as long as they do


@pytest.mark.slow
@pytest.mark.parametrize("uart", sampled(BAUDS, MSP_UART))
def test_it_is_known_and_the_next_request_served_when_more_is_pasted_than_the_line_can_answer(
    idle: IdleBoard, line: Callable[[str], UartLine], uart: str
) -> None:
    peer, lost = line(uart), executions(idle, "runtime_link_lost")
    told = answer(idle, peer, STATUS * PASTED, len(STATUS) * PASTED * 1e4 / BAUDS[uart])
    assert executions(idle, "runtime_link_lost") > lost
    run(idle, (RING_BYTES / len(STATUS) * 35 + 2 * SEND_BYTES) * 1e4 / BAUDS[uart])
    told += peer.take()
    answers = Decoder().feed(told)
    assert all(isinstance(one, Message) and one.command == Msp.STATUS for one in answers)  # none is cut
    assert RING_BYTES / len(STATUS) < len(answers) < PASTED
    assert answer(idle, peer, API) == API_ANSWER


@pytest.mark.slow
def test_it_is_known_when_bytes_come_while_flash_is_erased(
    idle: IdleBoard, line: Callable[[str], UartLine]
) -> None:
    first, second = line(MSP_UART), line(UART3)
    lost, operations = executions(idle, "runtime_link_lost"), idle.board.hardware.flash.operations
    first.send(encode(request(Msp.EEPROM_WRITE)))
    second.send(API * 4000)  # 260 ms
    run(idle, 600)
    assert idle.board.hardware.flash.operations > operations
    assert executions(idle, "runtime_link_lost") > lost
    (saved,) = Decoder().feed(first.take())
    assert isinstance(saved, Message) and saved.direction is Direction.REPLY
    assert second.take().replace(API_ANSWER, b"") == b""  # every answer is whole
    assert answer(idle, second, API) == API_ANSWER


@pytest.mark.slow
def test_half_a_request_is_forgotten_when_its_sender_pauses_but_not_while_answers_wait(
    idle: IdleBoard, line: Callable[[str], UartLine]
) -> None:
    peer = line(MSP_UART)
    assert answer(idle, peer, API[:3], 250) == b""
    assert answer(idle, peer, API) == API_ANSWER
    # The line is busy with answers for longer than such a pause, and requests come all the time.
    told = answer(idle, peer, STATUS * 400, 1500)
    assert len(Decoder().feed(told)) == 400


@pytest.mark.parametrize("before", sampled([0, 1, 3], 1))
def test_a_pause_is_none_while_bytes_from_before_it_still_wait(
    idle: IdleBoard, line: Callable[[str], UartLine], before: int
) -> None:
    """What comes after it does not void the request that is half read by then: for some of these one is."""
    peer = line(MSP_UART)
    peer.send(b"x" * before + STATUS * 300 + API[:3])  # 160 ms; answers take 780, 180 of them in buffers
    run(idle, 450)
    peer.send(API[3:])
    run(idle, 500)
    told = peer.take()
    assert told.endswith(API_ANSWER) and len(Decoder().feed(told)) == 301


def test_a_peer_that_says_nothing_is_told_nothing_when_the_board_lies_still(
    idle: IdleBoard, line: Callable[[str], UartLine]
) -> None:
    peers = [line(uart) for uart in BAUDS]
    run(idle, 300)
    assert [peer.take() for peer in peers] == [b"", b""]


def test_the_image_sleeps_between_samples_when_both_ports_are_open(idle: IdleBoard) -> None:
    """The background's rounds do not run on without something to do."""
    rounds = executions(idle, "runtime_background")
    run(idle, 100)
    assert executions(idle, "runtime_background") - rounds <= 100 * 5 * 1.05  # 4 samples and a tick each ms


RESET_WAIT_MS = 2500  # of hal.c
SLOW_BAUD = 9600


@pytest.fixture(scope="module")
def slow(board_image: Path) -> Iterator[tuple[IdleBoard, Snapshot]]:
    """A board whose second port is as slow as can be, its buffers full, and which is asked to start anew."""
    told = ("uart3_function=msp", f"uart3_baud={SLOW_BAUD}")
    changes = dict(parse_change(text) for text in told)
    flash = configured(read_flashable(board_image.with_suffix(".bin")), board_image, changes)
    idle = IdleBoard(flash, elf=board_image)
    idle.run_to(TIME_HZ)
    UartLine(idle.board, UART3, Format(SLOW_BAUD)).send(STATUS * 90)
    run(idle, 500)
    UartLine(idle.board, MSP_UART, Format(BAUDS[MSP_UART])).send(encode(request(Msp.REBOOT)))
    run(idle, 10)
    yield idle, take_snapshot(idle.board.engine)
    idle.close()


def ms_to_reset(idle: IdleBoard) -> int:
    """Milliseconds until the board starts anew."""
    resets = idle.board.engine.resets
    before = len(resets)
    for passed in range(2 * RESET_WAIT_MS):
        if len(resets) > before:
            return passed
        run(idle, 1)
    raise AssertionError("no reset")


@pytest.mark.slow
def test_answers_are_sent_before_a_reset_also_on_the_slowest_line(slow: tuple[IdleBoard, Snapshot]) -> None:
    idle, moment = slow
    restore_snapshot(idle.board.engine, moment)
    peer = UartLine(idle.board, UART3, Format(SLOW_BAUD))
    waited = ms_to_reset(idle)
    sent = len(peer.take())
    assert sent > SEND_BYTES, "more than one buffer was full"
    assert waited == pytest.approx(1e4 * sent / SLOW_BAUD, abs=20)
    assert RESET_WAIT_MS > 2 * 1e7 * SEND_BYTES / SLOW_BAUD / 1000, "two whole buffers"


@pytest.mark.slow
def test_a_reset_does_not_wait_for_ever_for_a_line_that_hardly_sends(
    slow: tuple[IdleBoard, Snapshot],
) -> None:
    idle, moment = slow
    restore_snapshot(idle.board.engine, moment)
    idle.board.hardware.usarts[UART3].words["BRR"] = 0xFFFF  # 824 baud
    assert ms_to_reset(idle) == pytest.approx(RESET_WAIT_MS - 10, abs=5)
