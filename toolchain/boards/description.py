"""A board's description as bytes, which `toolchain.image.stamp` writes into an image, and back.

The layout is `toolchain.contract.board_format`'s.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from neuroflight.toolchain.boards.allocation import Allocation, bus_functions, uart_function
from neuroflight.toolchain.boards.facts import Bus, Chip, GyroPlace, Pin, Uart
from neuroflight.toolchain.boards.gyro_kinds import with_known_turn
from neuroflight.toolchain.boards.processor import Stream
from neuroflight.toolchain.contract import (
    BOARD_FORMAT,
    BOARD_GYRO_COUNT,
    BOARD_LAYOUT,
    BOARD_MAGIC,
    BOARD_MOTOR_PORTS_MAX,
    BOARD_NO_PIN,
    BOARD_SPI_COUNT,
    BOARD_STRUCTS,
    IMAGE_TABLE_OFFSET,
    MOTOR_COUNT_MAX,
    BoardLog,
    GyroChip,
    HeaderField,
    struct_format,
)
from neuroflight.toolchain.errors import WiringError

Values = Mapping[str, Any]  # of a struct by field; an array is a list, a struct a mapping
BOARD_BYTES = struct.calcsize(BOARD_FORMAT)
_NO_BUS = {"sck": BOARD_NO_PIN, "miso": BOARD_NO_PIN, "mosi": BOARD_NO_PIN}
_NO_CHIP = {"select": BOARD_NO_PIN, "ready": BOARD_NO_PIN}
_NO_UART = {"tx": BOARD_NO_PIN, "rx": BOARD_NO_PIN}


def pack(allocation: Allocation) -> bytes:
    """Return the description of a board: BOARD_BYTES, the same for the same board."""
    board, streams = allocation.board, allocation.streams
    values: Values = {
        "magic": BOARD_MAGIC,
        "layout": BOARD_LAYOUT,
        "bytes": BOARD_BYTES,
        "name": board.name,
        "maker": board.maker,
        "gyro_kinds": sum(1 << GyroChip[kind] for kind in with_known_turn(allocation.gyro_kinds)),
        "gyros": _filled([_gyro(place) for place in allocation.gyros], BOARD_GYRO_COUNT, _NO_CHIP),
        "log_chip": _chip(allocation.log_chip),
        "osd": _chip(allocation.osd),
        "buses": [_bus(number, board.buses.get(number), streams) for number in range(1, BOARD_SPI_COUNT + 1)],
        "msp": _uart(allocation.msp, board.uarts, streams),
        "second": _uart(allocation.second, board.uarts, streams),
        "receiver": _uart(allocation.receiver, board.uarts, streams, only_rx=True),
        "motor_ports": _filled(
            [
                {"port": ord(one.port) - ord("A"), "channel": one.channel, "dma": one.stream.code}
                for one in allocation.ports
            ],
            BOARD_MOTOR_PORTS_MAX,
            {},
        ),
        "motor_pins": _filled([pin.code for pin in allocation.motors], MOTOR_COUNT_MAX, BOARD_NO_PIN),
        "motor_count": len(allocation.motors),
        "motor_port_count": len(allocation.ports),
        "log_kind": board.log_kind if allocation.log else BoardLog.NONE,
        "led": _pin(allocation.led),
        "led_high": board.led_high,
        "beeper": _pin(allocation.beeper),
        "beeper_high": board.beeper_high,
        "usb_supply": _pin(allocation.usb_supply),
        "volts": _pin(allocation.volts),
        "amps": _pin(allocation.amps),
        "adc_dma": _dma(streams, "ADC1"),
        "volts_scale": board.volts_scale,
        "amps_scale": board.amps_scale,
        "turn_deg": list(board.turn_deg),
    }
    return _encoded(BOARD_STRUCTS["board"], values)


def unpack(data: bytes) -> dict[str, Any]:
    """Return the fields of a description by name. Raises WiringError, one line: it is none of this layout."""
    if len(data) != BOARD_BYTES:
        raise WiringError(f"a board's description of {len(data)} bytes, expected {BOARD_BYTES}")
    values = _decoded(BOARD_STRUCTS["board"], data)
    told = values["magic"], values["layout"], values["bytes"]
    if told != (BOARD_MAGIC, BOARD_LAYOUT, BOARD_BYTES):
        raise WiringError(
            f"magic {told[0]:#x}, layout {told[1]}, {told[2]} bytes are no board's description, expected "
            f"{BOARD_MAGIC:#x}, {BOARD_LAYOUT}, {BOARD_BYTES}"
        )
    return values


def described(bank: bytes) -> dict[str, Any] | None:
    """Return the description in an image; None: it has none.

    bank: content of flash from the bank's begin on.
    """
    try:
        return unpack(bank[IMAGE_TABLE_OFFSET : IMAGE_TABLE_OFFSET + BOARD_BYTES])
    except WiringError:
        return None


def _pin(pin: Pin | None) -> int:
    return BOARD_NO_PIN if pin is None else pin.code


def _dma(streams: Mapping[str, Stream], request: str) -> int:
    stream = streams.get(request)
    return 0 if stream is None else stream.code


def _filled(values: Sequence[Any], count: int, rest: object) -> list[Any]:
    return [*values, *[rest] * (count - len(values))]


def _gyro(place: GyroPlace) -> Values:
    return {
        "spi": place.spi,
        "select": place.select.code,
        "ready": _pin(place.ready),
        "alignment": place.alignment,
    }


def _chip(chip: Chip | None) -> Values:
    return _NO_CHIP if chip is None else {**_NO_CHIP, "spi": chip.spi, "select": chip.select.code}


def _bus(number: int, bus: Bus | None, streams: Mapping[str, Stream]) -> Values:
    """Return an SPI; one without streams is not driven."""
    if bus is None or f"SPI{number}_RX" not in streams:
        return _NO_BUS
    functions = bus_functions(number, bus)
    return {
        "sck": bus.sck.code,
        "sck_function": functions["SCK"],
        "miso": bus.miso.code,
        "miso_function": functions["MISO"],
        "mosi": bus.mosi.code,
        "mosi_function": functions["MOSI"],
        "dma_rx": _dma(streams, f"SPI{number}_RX"),
        "dma_tx": _dma(streams, f"SPI{number}_TX"),
    }


def _uart(
    number: int | None, uarts: Mapping[int, Uart], streams: Mapping[str, Stream], *, only_rx: bool = False
) -> Values:
    if number is None:
        return _NO_UART
    uart = uarts[number]
    tx = None if only_rx else uart.tx
    return {
        "number": number,
        "tx": _pin(tx),
        "tx_function": 0 if tx is None else uart_function(number, "TX", tx),
        "rx": _pin(uart.rx),
        "rx_function": 0 if uart.rx is None else uart_function(number, "RX", uart.rx),
        "dma_rx": _dma(streams, f"UART{number}_RX"),
        "dma_tx": 0 if tx is None else _dma(streams, f"UART{number}_TX"),
    }


def _encoded(fields: Sequence[HeaderField], values: Values) -> bytes:
    """Encode a struct; a field that is not given is 0."""
    return b"".join(_encoded_field(field, values.get(field.name, 0)) for field in fields)


def _encoded_field(field: HeaderField, value: object) -> bytes:
    if isinstance(value, str):
        text = value.encode("ascii")
        assert len(text) < field.count, "checked where the board was read"
        return bytes(text.ljust(field.count, b"\0"))
    return b"".join(_encoded_one(field, one) for one in (value if isinstance(value, list) else [value]))


def _encoded_one(field: HeaderField, value: object) -> bytes:
    if isinstance(value, Mapping):
        return _encoded(field.members, value)
    return struct.pack(f"<{_code(field)}", value)


def _decoded(fields: Sequence[HeaderField], data: bytes) -> dict[str, Any]:
    values, at = {}, 0
    for field in fields:
        size = struct.calcsize("<" + field.format)
        values[field.name] = _decoded_field(field, data[at : at + size])
        at += size
    return values


def _decoded_field(field: HeaderField, data: bytes) -> object:
    if field.c_type == "char":
        text = data.partition(b"\0")[0].decode("latin-1")
        return "".join(c if " " <= c <= "~" else "?" for c in text)
    size = len(data) // field.count
    parts = [data[at : at + size] for at in range(0, len(data), size)]
    if field.members:
        many: list[object] = [_decoded(field.members, part) for part in parts]
    else:
        many = [struct.unpack(f"<{_code(field)}", part)[0] for part in parts]
    return many if field.count > 1 else many[0]


def _code(field: HeaderField) -> str:
    """Return one value of the field for `struct`."""
    return struct_format((HeaderField(field.c_type, field.name, "", ""),)).removeprefix("<")
