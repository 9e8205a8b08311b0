"""A board as Betaflight writes it: what `dump hardware` prints, and a config.h."""

from __future__ import annotations

from collections.abc import Iterator

from neuroflight.toolchain.boards.facts import Board, Pin
from neuroflight.toolchain.contract import BoardLog

SPI = {"sck": ("SCK", "SCK"), "miso": ("SDI", "MISO"), "mosi": ("SDO", "MOSI")}


def dump(board: Board) -> str:
    """What `dump hardware` of 4.5 prints of a board with this wiring; CR LF, as a terminal saves it."""
    lines = [
        "# dump hardware",
        "",
        "# version",
        "# Betaflight / STM32F7X2 (S7X2) 4.5.1 Jul 27 2024 / 15:00:00 (77d01ba3b) MSP API: 1.46",
        "# config rev: 43e4e2f",
        "",
        f"board_name {board.name}",
        f"manufacturer_id {board.maker}",
        "",
        "# resources",
        *(f"resource {owner} {index} {cli(pin)}" for owner, index, pin in resources(board)),
        "",
        "# timer",
        *(f"timer {cli(pin)} AF2" for pin in board.motors),
        "# dma",
        "dma ADC 1 1",
        "# ADC 1: DMA2 Stream 4 Channel 0",
        "",
        "# master",
        *(f"set {name} = {value}" for name, value in settings(board)),
    ]
    return "\r\n".join(lines) + "\r\n"


def header(board: Board) -> str:
    """A config.h with this wiring."""
    names = {
        "SERIAL_TX": "UART{}_TX",
        "SERIAL_RX": "UART{}_RX",
        "GYRO_CS": "GYRO_{}_CS",
        "GYRO_EXTI": "GYRO_{}_EXTI",
        "LED": "LED0",
        "ADC_BATT": "ADC_VBAT",
        "ADC_CURR": "ADC_CURR",
        "SDCARD_CS": "SDCARD_SPI_CS",
        "OSD_CS": "MAX7456_SPI_CS",
        "SPI_SCK": "SPI{}_SCK",
        "SPI_MISO": "SPI{}_SDI",
        "SPI_MOSI": "SPI{}_SDO",
        "MOTOR": "MOTOR{}",
    }
    lines = [
        "/*",
        " * This file is part of Betaflight.",
        " */",
        "#pragma once",
        "#define FC_TARGET_MCU     STM32F722",
        f"#define BOARD_NAME        {board.name}",
        f"#define MANUFACTURER_ID   {board.maker}",
        "#define USE_GYRO",
        *(f"#define USE_{_driver(kind)}_{kind}" for kind in board.gyro_kinds),
        *(f"#define USE_FLASH_{kind}" for kind in board.flash_kinds),
        *(
            f"#define {names.get(owner, owner).format(index)}_PIN {pin}"
            for owner, index, pin in resources(board)
        ),
        "#define TIMER_PIN_MAPPING \\",
        "    TIMER_PIN_MAP( 0, PB4 , 1,  0)",
    ]
    for index, gyro in enumerate(board.gyros, 1):
        lines += [
            f"#define GYRO_{index}_SPI_INSTANCE SPI{gyro.spi}",
            f"#define GYRO_{index}_ALIGN {turn(gyro.alignment)}",
        ]
    if board.log_chip is not None:
        word = {BoardLog.CARD: "SDCARD", BoardLog.FLASH: "FLASH"}[board.log_kind]
        lines += [
            f"#define DEFAULT_BLACKBOX_DEVICE BLACKBOX_DEVICE_{word} // where it logs to",
            f"#define {word.replace('SDCARD', 'SDCARD')}_SPI_INSTANCE SPI{board.log_chip.spi}",
        ]
    if board.osd is not None:
        lines.append(f"#define MAX7456_SPI_INSTANCE SPI{board.osd.spi}")
    lines += [
        f"#define {name}"
        for name, on in (("BEEPER_INVERTED", board.beeper_high), ("LED0_INVERTED", board.led_high))
        if on
    ]
    if board.receiver is not None:
        kind = "UART" if board.receiver in (4, 5) else "USART"
        lines.append(f"#define SERIALRX_UART SERIAL_PORT_{kind}{board.receiver}")
    lines += [
        f"#define DEFAULT_VOLTAGE_METER_SCALE {board.volts_scale}",
        f"#define DEFAULT_CURRENT_METER_SCALE {board.amps_scale}",
    ]
    lines += [f"#define DEFAULT_ALIGN_BOARD_{axis.upper()} {turn}" for axis, turn in turns(board)]
    return "\n".join(lines) + "\n"


def turns(board: Board) -> list[tuple[str, int]]:
    """Axis and degrees of each turn of the whole board."""
    return [(axis, turn) for axis, turn in zip(("roll", "pitch", "yaw"), board.turn_deg, strict=True) if turn]


def resources(board: Board) -> Iterator[tuple[str, int, Pin]]:
    """Owner, number and pin of each."""
    for index, motor in enumerate(board.motors, 1):
        yield "MOTOR", index, motor
    for number, uart in board.uarts.items():
        for owner, pin in (("SERIAL_TX", uart.tx), ("SERIAL_RX", uart.rx)):
            if pin is not None:
                yield owner, number, pin
    for number, bus in board.buses.items():
        yield from (
            ("SPI_SCK", number, bus.sck),
            ("SPI_MISO", number, bus.miso),
            ("SPI_MOSI", number, bus.mosi),
        )
    for index, gyro in enumerate(board.gyros, 1):
        yield "GYRO_CS", index, gyro.select
        if gyro.ready is not None:
            yield "GYRO_EXTI", index, gyro.ready
    if board.log_chip is not None:
        yield ("SDCARD_CS" if board.log_kind is BoardLog.CARD else "FLASH_CS"), 1, board.log_chip.select
    if board.osd is not None:
        yield "OSD_CS", 1, board.osd.select
    for owner, pin in (
        *(("LED", board.led), ("BEEPER", board.beeper), ("USB_DETECT", board.usb_supply)),
        *(("ADC_BATT", board.volts), ("ADC_CURR", board.amps)),
    ):
        if pin is not None:
            yield owner, 1, pin


def settings(board: Board) -> Iterator[tuple[str, object]]:
    """Name and value of each."""
    for index, gyro in enumerate(board.gyros, 1):
        yield f"gyro_{index}_bustype", "SPI"
        yield f"gyro_{index}_spibus", gyro.spi
        yield f"gyro_{index}_sensor_align", turn(gyro.alignment).replace("_DEG", "").replace("_", "")
    words = {BoardLog.CARD: "SDCARD", BoardLog.FLASH: "SPIFLASH", BoardLog.NONE: "NONE"}
    yield "blackbox_device", words[board.log_kind]
    spi = board.log_chip.spi if board.log_chip else 0
    yield "sdcard_spi_bus", spi if board.log_kind is BoardLog.CARD else 0
    yield "flash_spi_bus", spi if board.log_kind is BoardLog.FLASH else 0
    yield "max7456_spi_bus", board.osd.spi if board.osd else 0
    yield "beeper_inversion", "ON" if board.beeper_high else "OFF"
    yield "led_inversion", int(board.led_high)
    yield from ((f"align_board_{axis}", degrees) for axis, degrees in turns(board))
    yield "vbat_scale", board.volts_scale
    yield "ibata_scale", board.amps_scale


def cli(pin: Pin) -> str:
    """A pin as the command line writes it: B04."""
    return f"{pin.port}{pin.number:02}"


def turn(alignment: int) -> str:
    """A turn as a config.h writes it: CW90_DEG_FLIP."""
    return f"CW{90 * (alignment % 4)}_DEG{'_FLIP' * (alignment // 4)}"


def _driver(kind: str) -> str:
    return "ACCGYRO" if kind.startswith(("BMI", "LSM")) else "GYRO_SPI"
