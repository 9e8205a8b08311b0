"""What serves what on a board: nothing twice, collisions refused by name, less important parts left alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from neuroflight.toolchain.boards.allocation import Allocation, allocate
from neuroflight.toolchain.boards.description import BOARD_BYTES, pack, unpack
from neuroflight.toolchain.boards.facts import Board, Chip, GyroPlace, Pin, Uart
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.contract import BOARD_NO_PIN, BoardLog
from neuroflight.toolchain.errors import WiringError

MATEK = find_board("MATEKF722")
GYRO, BUS, UARTS = MATEK.gyros[0], MATEK.buses[1], MATEK.uarts


def served() -> list[Allocation]:
    """The boards of the table that can be served."""
    found = []
    for board in boards().values():
        try:
            found.append(allocate(board))
        except WiringError:
            continue
    return found


def test_no_pin_and_no_stream_serves_two_parts_of_any_board() -> None:
    for one in served():
        table = unpack(pack(one))
        lines = [table[name] for name in ("msp", "second", "receiver")]
        pins = [
            *table["motor_pins"],
            *(bus[signal] for bus in table["buses"] for signal in ("sck", "miso", "mosi")),
            *(
                chip[pin]
                for chip in (*table["gyros"], table["log_chip"], table["osd"])
                for pin in ("select", "ready")
            ),
            *(line[signal] for line in lines for signal in ("tx", "rx")),
            *(table[name] for name in ("led", "beeper", "usb_supply", "volts", "amps")),
        ]
        used = [pin for pin in pins if pin != BOARD_NO_PIN]
        assert len(used) == len(set(used)), one.board.name
        streams = [
            table["adc_dma"],
            *(part[side] for part in (*table["buses"], *lines) for side in ("dma_rx", "dma_tx")),
            *(port["dma"] for port in table["motor_ports"]),
        ]
        places = [stream >> 4 for stream in streams if stream]
        assert len(places) == len(set(places)), one.board.name


def test_motors_are_written_through_the_ports_they_are_on() -> None:
    for one in served():
        assert {port.port for port in one.ports} == {pin.port for pin in one.motors}
        assert all(port.stream.controller == 2 for port in one.ports), "only DMA2 reaches the ports"
        assert len(one.motors) >= min(4, len(one.board.motors))


def test_a_description_is_read_back_when_packed() -> None:
    told = unpack(pack(allocate(MATEK)))
    assert (told["name"], told["maker"], told["log_kind"]) == ("MATEKF722", "MTKS", BoardLog.CARD)
    assert told["motor_pins"][:4] == [0x26, 0x27, 0x28, 0x29]
    assert told["gyros"][0] == {"spi": 1, "select": 0x22, "ready": 0x23, "alignment": 2}
    assert told["buses"][1] == {**told["buses"][1], "sck": BOARD_NO_PIN, "dma_rx": 0}, (
        "nothing drives the OSD's"
    )
    assert told["buses"][2]["dma_tx"] == 0x170


@pytest.mark.parametrize("damage", [b"", b"\0", b"\xff" * BOARD_BYTES, bytes(BOARD_BYTES)])
def test_bytes_that_describe_no_board_are_refused(damage: bytes) -> None:
    with pytest.raises(WiringError, match="description"):
        unpack(damage)


@pytest.mark.parametrize(
    ("board", "words"),
    [
        (replace(MATEK, gyros=()), "where its gyro is wired to is not told"),
        (replace(MATEK, gyros=(replace(GYRO, spi=4),)), "its gyro is on SPI4, whose pins are not told"),
        (replace(MATEK, gyro_kinds=("L3GD20",)), "not one that the firmware knows: L3GD20"),
        (replace(MATEK, gyro_kinds=()), "not one that the firmware knows: none"),
        (replace(MATEK, motors=()), "no motor output is told"),
        (replace(MATEK, motors=(Pin("C", 6),) * 4), "motor 2: PC6 serves motor 1"),
        (replace(MATEK, motors=(GYRO.select,)), "motor 1: PC2 serves the gyro's chip select"),
        (replace(MATEK, motors=(Pin("A", 12),)), "motor 1: PA12 serves USB"),
        (replace(MATEK, motors=(Pin("C", 5),)), "motor 1: the STM32F722 in 64 pins has no PC5"),
        (
            replace(MATEK, motors=tuple(map(Pin.of, ("PA8", "PB1", "PC6", "PD2")))),
            "its first 4 motors are on 4 ports, A, B, C, D; DMA streams write 3",
        ),
        (
            replace(MATEK, buses={1: replace(BUS, sck=Pin("B", 0))}),
            "PB0 cannot be SPI1's SCK, expected PA5, PB3",
        ),
        (replace(MATEK, uarts={}), "no UART that could hear a receiver"),
        (replace(MATEK, uarts={1: Uart(Pin("A", 9), None)}), "no UART that could hear a receiver"),
    ],
)
def test_what_cannot_be_served_is_named(board: Board, words: str) -> None:
    with pytest.raises(WiringError, match="MATEKF722: ") as refused:
        allocate(board)
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("spi", [1, 2, 3])
@pytest.mark.parametrize("uart", range(1, 7))
def test_every_gyro_bus_leaves_streams_for_every_receiver_and_three_ports(spi: int, uart: int) -> None:
    motors = tuple(map(Pin.of, ("PA8", "PB8", "PC8", "PC9")))
    board = replace(
        MATEK,
        gyros=(GyroPlace(spi, Pin("A", 15), Pin("C", 13), 0),),
        buses={spi: MATEK.buses[spi]},
        uarts={uart: Uart(None, {**UARTS, 6: Uart(None, Pin("C", 7))}[uart].rx)},
        motors=motors,
        volts=Pin("C", 0),
    )
    one = allocate(board)
    assert (one.receiver, one.motors, len(one.ports)) == (uart, motors, 3)


def test_the_receiver_moves_where_the_user_says() -> None:
    moved = allocate(MATEK, receiver=4)
    assert (moved.receiver, moved.msp, moved.second) == (4, 1, 3)
    with pytest.raises(WiringError, match="UART6 cannot hear a receiver, expected one of UART1, UART2"):
        allocate(MATEK, receiver=6)


def test_the_second_serial_port_goes_first_where_streams_collide() -> None:
    """A flash chip on SPI2 and UART3's transmitter want the same stream of DMA1, or the next one."""
    uarts = {n: UARTS[n] for n in (1, 2, 3)}
    flash = replace(
        MATEK, uarts=uarts, log_kind=BoardLog.FLASH, log_chip=Chip(2, Pin("B", 12)), usb_supply=None
    )
    without = allocate(flash)
    assert (without.log, without.second) == (True, None)
    assert "second serial port: UART3_TX: DMA1 S3 serves SPI2_RX, DMA1 S4 serves SPI2_TX" in without.left


def test_a_part_that_collides_is_left_alone_and_told() -> None:
    one = allocate(replace(MATEK, beeper=Pin("C", 6), led=Pin("C", 13), volts=Pin("C", 13)))
    assert (one.beeper, one.led, one.volts) == (None, Pin("C", 13), None)
    assert "beeper: PC6 serves motor 1" in one.left
    assert "battery voltage: PC13 is no input of the converter" in one.left


def test_a_log_on_the_gyros_bus_is_left_alone_but_not_selected() -> None:
    one = allocate(replace(MATEK, log_kind=BoardLog.FLASH, log_chip=Chip(1, Pin("B", 12)), usb_supply=None))
    assert not one.log
    assert "log: its chip shares SPI1 with the gyro, which has it alone" in one.left
    told = unpack(pack(one))
    assert (told["log_kind"], told["log_chip"]["select"]) == (BoardLog.NONE, Pin("B", 12).code)


DUAL = replace(
    MATEK,
    gyros=(GYRO, GyroPlace(2, Pin("B", 12), Pin("C", 13), 5)),
    uarts={n: UARTS[n] for n in (1, 2)},
    usb_supply=None,
)


def test_a_second_gyro_has_its_own_bus() -> None:
    told = unpack(pack(allocate(DUAL)))
    assert told["gyros"][1] == {"spi": 2, "select": 0x1C, "ready": 0x2D, "alignment": 5}
    assert told["buses"][1]["dma_rx"] == 0x130


@pytest.mark.parametrize(
    ("board", "why"),
    [
        (
            replace(DUAL, log_kind=BoardLog.FLASH, log_chip=Chip(2, Pin("A", 15))),
            "second gyro: it shares SPI2 with the log",
        ),
        (replace(DUAL, gyros=(GYRO, replace(DUAL.gyros[1], spi=0))), "second gyro: its SPI is not told"),
        (replace(DUAL, buses={1: BUS, 3: MATEK.buses[3]}), "second gyro: it is on SPI2, whose pins are not"),
    ],
)
def test_a_second_gyro_that_cannot_be_used_is_told_and_held_deselected(board: Board, why: str) -> None:
    one = allocate(board)
    assert any(line.startswith(why) for line in one.left)
    second = unpack(pack(one))["gyros"][1]
    assert (second["spi"], second["select"], second["ready"]) == (0, Pin("B", 12).code, BOARD_NO_PIN)


def test_an_unknown_board_is_answered_with_names_alike() -> None:
    with pytest.raises(WiringError, match="'SPEEDYBEF7V3', did you mean SPEEDYBEEF7V3 or"):
        find_board("SPEEDYBEF7V3")
    with pytest.raises(WiringError, match=f"unknown board '{'x' * 60}'; `neuroflight"):
        find_board("x" * 10_000)
    with pytest.raises(WiringError, match="did you mean MATEKF722 or"):
        find_board("matekf722")
