"""A board's description as its image holds it: which chip sits on which pins, and which DMA stream serves it.

The same code flies on every board with this processor: `toolchain.boards` decides what serves what and
refuses what collides, `toolchain.image.stamp` writes the result into the linked image, and the firmware takes
it as it is. No value here is a choice of the pilot's.
"""

from __future__ import annotations

from enum import IntEnum

from neuroflight.toolchain.contract.frame_time_sensors import MOTOR_COUNT_MAX
from neuroflight.toolchain.contract.policy_format import HeaderField, struct_format

BOARD_MAGIC = 0x4442464E  # "NFBD"
BOARD_LAYOUT = 2
BOARD_NAME_BYTES = 24  # the longest name of a public configuration has 23 letters
BOARD_MAKER_BYTES = 8
BOARD_NO_PIN = 0xFF  # pins are told as port << 4 | number, port A being 0
BOARD_SPI_COUNT = 3
BOARD_GYRO_COUNT = 2
BOARD_MOTOR_PORTS_MAX = 3


class BoardLog(IntEnum):
    """Chips on a board that keep logs."""

    NONE = 0
    CARD = 1  # a slot for an SD card
    FLASH = 2  # NOR or NAND flash on SPI


_PIN = "port << 4 | number; 0xFF: none"
_AF = "alternate function"
_TURN = "roll, pitch, yaw as in board_roll_deg and its kin"
_DMA = "0x100 controller + 0x10 stream + request channel; 0: none"
_BUS_FIELDS = (  # one SPI; sck 0xFF: not wired
    *(
        field
        for name in ("sck", "miso", "mosi")
        for field in (
            HeaderField("uint8_t", name, "", _PIN),
            HeaderField("uint8_t", f"{name}_function", "", _AF),
        )
    ),
    HeaderField("uint16_t", "dma_rx", "", _DMA),
    HeaderField("uint16_t", "dma_tx", "", _DMA),
)
_UART_FIELDS = (  # a serial line; number 0: the board has none for this purpose
    HeaderField("uint8_t", "number", "", "of USART or UART, 1 to 6"),
    HeaderField("uint8_t", "tx", "", _PIN),
    HeaderField("uint8_t", "tx_function", "", _AF),
    HeaderField("uint8_t", "rx", "", _PIN),
    HeaderField("uint8_t", "rx_function", "", _AF),
    HeaderField("uint8_t", "reserved", "", "0"),
    HeaderField("uint16_t", "dma_rx", "", _DMA),
    HeaderField("uint16_t", "dma_tx", "", _DMA),
)
_CHIP_FIELDS = (  # a chip on an SPI; spi 0: not there
    HeaderField("uint8_t", "spi", "", "1 to 3"),
    HeaderField("uint8_t", "select", "", "chip select, low selects: " + _PIN),
    HeaderField("uint8_t", "ready", "", "of a gyro, its data-ready line: " + _PIN),
    HeaderField("uint8_t", "alignment", "", "of a gyro: enum board_alignment"),
)
_MOTOR_PORT_FIELDS = (  # a GPIO port that motors are wired to, and what writes it
    HeaderField("uint8_t", "port", "", "0: A"),
    HeaderField("uint8_t", "channel", "", "compare channel of TIM1 that asks for DMA, 1 to 4"),
    HeaderField("uint16_t", "dma", "", _DMA),
)
_BOARD_FIELDS = (
    HeaderField("uint32_t", "magic", "", "NFBD, in that order in memory"),
    HeaderField("uint16_t", "layout", "", "version of this layout"),
    HeaderField("uint16_t", "bytes", "bytes", "of this description"),
    HeaderField("char", "name", "", "ASCII, then 0: the target", BOARD_NAME_BYTES),
    HeaderField("char", "maker", "", "ASCII, then 0: the maker's four letters", BOARD_MAKER_BYTES),
    HeaderField("uint32_t", "gyro_kinds", "", "1 << enum gyro_chip of those that boards of this name carry"),
    HeaderField("struct board_chip", "gyros", "", "", BOARD_GYRO_COUNT, _CHIP_FIELDS),
    HeaderField("struct board_chip", "log_chip", "", "card or flash", 1, _CHIP_FIELDS),
    HeaderField("struct board_chip", "osd", "", "left alone, never selected", 1, _CHIP_FIELDS),
    HeaderField("struct board_bus", "buses", "", "SPI1 first", BOARD_SPI_COUNT, _BUS_FIELDS),
    HeaderField("struct board_uart", "msp", "", "the first serial port", 1, _UART_FIELDS),
    HeaderField("struct board_uart", "second", "", "MSP or the log, as set", 1, _UART_FIELDS),
    HeaderField("struct board_uart", "receiver", "", "", 1, _UART_FIELDS),
    HeaderField("struct board_motor_port", "motor_ports", "", "", BOARD_MOTOR_PORTS_MAX, _MOTOR_PORT_FIELDS),
    HeaderField("uint8_t", "motor_pins", "", _PIN, MOTOR_COUNT_MAX),
    HeaderField("uint8_t", "motor_count", "", "used entries of motor_pins, in motor order"),
    HeaderField("uint8_t", "motor_port_count", "", "used entries of motor_ports"),
    HeaderField("uint8_t", "log_kind", "", "enum board_log"),
    HeaderField("uint8_t", "led", "", _PIN),
    HeaderField("uint8_t", "led_high", "", "1: high lights it, 0: low does"),
    HeaderField("uint8_t", "beeper", "", _PIN),
    HeaderField("uint8_t", "beeper_high", "", "1: high sounds, 0: low does"),
    HeaderField("uint8_t", "usb_supply", "", "the cable's supply, divided: " + _PIN),
    HeaderField("uint8_t", "volts", "", "of the battery, divided: " + _PIN),
    HeaderField("uint8_t", "amps", "", "of the battery: " + _PIN),
    HeaderField("uint16_t", "adc_dma", "", _DMA),
    HeaderField("uint16_t", "volts_scale", "0.1", "volts at the pack for one at the pin"),
    HeaderField("uint16_t", "amps_scale", "0.1 mV/A", "of the current sensor"),
    HeaderField("int16_t", "turn_deg", "deg", "of the board by its maker: " + _TURN, 3),
    HeaderField("uint16_t", "reserved", "", "0"),
)
BOARD_FORMAT = struct_format(_BOARD_FIELDS)
BOARD_STRUCTS = {  # in C by these names
    "board_bus": _BUS_FIELDS,
    "board_uart": _UART_FIELDS,
    "board_chip": _CHIP_FIELDS,
    "board_motor_port": _MOTOR_PORT_FIELDS,
    "board": _BOARD_FIELDS,
}
