"""A board's facts as Betaflight writes them: its command line's `dump hardware`, `diff hardware` or unified
target, and the config.h of its sources.

Both are read line by line into the same words; nothing in them is executed, and conditions of the
preprocessor are not looked at. Formats: learned from files of both kinds and from the names in Betaflight's
resource.c and cli.c.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from neuroflight.toolchain.errors import WiringError
from neuroflight.toolchain.files import read_limited

FILE_BYTES_MAX = 256 << 10  # a dump of everything has 60 kB
SHOWN = 60  # characters of a wrong word in a message
PROCESSORS = ("STM32F722", "STM32F7X2")
_ALIASES_MAX = 4  # names of names in a config.h


@dataclass(frozen=True)
class Told:
    """A word of a file, and its line."""

    text: str
    line: int


@dataclass
class Facts:
    """Facts of a file, in words that both kinds of file share: MOTOR 1, SCK 3, gyro_spi 1, name."""

    path: Path
    told: dict[str, Told] = field(default_factory=dict)
    gyro_kinds: set[str] = field(default_factory=set)
    flash_kinds: set[str] = field(default_factory=set)
    has_card: bool = False
    is_source: bool = False  # a config.h

    @property
    def by_maker(self) -> bool:
        """The word that the file is its maker's, not what a pilot's board told: that names no driver."""
        return self.is_source or bool(self.gyro_kinds)

    def error(self, key: str, words: str) -> WiringError:
        """Return the error about what was told of `key`."""
        return WiringError(f"{self.path}:{self.told[key].line}: {key}: {words}")


# Resources of the command line; LED counts from 1 there.
_RESOURCES = {
    **{"MOTOR": "MOTOR", "SERIAL_TX": "TX", "SERIAL_RX": "RX", "LED": "LED", "BEEPER": "BEEPER"},
    **{"SPI_SCK": "SCK", "SPI_MISO": "MISO", "SPI_MOSI": "MOSI", "SPI_SDI": "MISO", "SPI_SDO": "MOSI"},
    **{"GYRO_CS": "GYRO_CS", "GYRO_EXTI": "GYRO_EXTI", "FLASH_CS": "FLASH_CS", "SDCARD_CS": "CARD_CS"},
    **{"OSD_CS": "OSD_CS", "USB_DETECT": "USB_DETECT", "ADC_BATT": "VOLTS", "ADC_CURR": "AMPS"},
}
_SETTINGS = {
    **{"gyro_1_spibus": "gyro_spi 1", "gyro_2_spibus": "gyro_spi 2", "flash_spi_bus": "flash_spi"},
    **{"gyro_1_sensor_align": "gyro_align 1", "gyro_2_sensor_align": "gyro_align 2"},
    **{"gyro_to_use": "gyro_used", "gyro_enabled_bitmask": "gyro_used", "sdcard_spi_bus": "card_spi"},
    **{"max7456_spi_bus": "osd_spi", "blackbox_device": "log", "beeper_inversion": "beeper_high"},
    **{"led_inversion": "led_high", "vbat_scale": "volts_scale", "ibata_scale": "amps_scale"},
    **{f"align_board_{axis}": f"board_{axis}" for axis in ("roll", "pitch", "yaw")},
}
_DEFINES: Mapping[str, str] = {  # patterns of names; \1 is their number
    r"MOTOR(\d)_PIN": r"MOTOR \1",
    r"UART(\d+)_([TR]X)_PIN": r"\2 \1",
    r"SPI(\d)_SCK_PIN": r"SCK \1",
    r"SPI(\d)_(?:MISO|SDI)_PIN": r"MISO \1",
    r"SPI(\d)_(?:MOSI|SDO)_PIN": r"MOSI \1",
    r"LED0_PIN": "LED 1",
    r"LED0_INVERTED": "led_high",
    r"BEEPER_PIN": "BEEPER 1",
    r"BEEPER_INVERTED": "beeper_high",
    r"GYRO_([12])_(CS|EXTI)_PIN": r"GYRO_\2 \1",
    r"GYRO_([12])_SPI_INSTANCE": r"gyro_spi \1",
    r"GYRO_([12])_ALIGN": r"gyro_align \1",
    r"DEFAULT_GYRO_(?:TO_USE|ENABLED)": "gyro_used",
    r"FLASH_CS_PIN": "FLASH_CS 1",
    r"FLASH_SPI_INSTANCE": "flash_spi",
    r"SDCARD_SPI_CS_PIN": "CARD_CS 1",
    r"SDCARD_SPI_INSTANCE": "card_spi",
    r"MAX7456_SPI_CS_PIN": "OSD_CS 1",
    r"MAX7456_SPI_INSTANCE": "osd_spi",
    r"USB_DETECT_PIN": "USB_DETECT 1",
    r"ADC_VBAT_PIN": "VOLTS 1",
    r"ADC_CURR_PIN": "AMPS 1",
    r"DEFAULT_VOLTAGE_METER_SCALE": "volts_scale",
    r"DEFAULT_CURRENT_METER_SCALE": "amps_scale",
    r"DEFAULT_BLACKBOX_DEVICE": "log",
    r"SERIALRX_UART": "receiver",
    **{
        rf"(?:(?:DEFAULT_)?ALIGN_BOARD_{axis.upper()}|align_board_{axis})": f"board_{axis}"
        for axis in ("roll", "pitch", "yaw")
    },
    r"BOARD_NAME": "name",
    r"MANUFACTURER_ID": "maker",
    r"FC_TARGET_MCU": "processor",
}
_DEFINE = re.compile(r"\s*#\s*define\s+(\w+)(?:\s+(.*?))?\s*(?://.*|/\*.*)?")
_SIGN = re.compile(r"^\s*#\s*define\s+(?:\w+_PIN|FC_TARGET_MCU)\b", re.MULTILINE)
_KIND = re.compile(r"USE_(?:GYRO_SPI|ACCGYRO|GYRO)_([A-Z0-9]+)")
_FLASH = re.compile(r"USE_FLASH_([A-Z0-9]+)")
_TITLE = re.compile(r"#\s*Betaflight\s*/\s*(STM32\w+|AT32\w+|APM32\w+)\b")
_RECEIVER_FUNCTION = 64  # of a `serial` line's mask


def read_facts(path: Path) -> Facts:
    """Read what a file tells of a board. Raises WiringError, one line, for a file of neither kind."""
    mend = "; expected the output of `dump hardware`, or a config.h"
    data = read_limited(path, str(path), FILE_BYTES_MAX, WiringError, mend)
    for mark, code in ((b"\xff\xfe", "utf-16"), (b"\xfe\xff", "utf-16"), (b"", "utf-8-sig")):
        if data.startswith(mark):
            text = data.decode(code, errors="replace")
            break
    facts = Facts(path)
    lines = list(enumerate(re.split(r"\r\n|\n|\r", text), start=1))
    facts.is_source = _SIGN.search(text) is not None
    (_header if facts.is_source else _dump)(facts, lines)
    if not any(key.startswith("MOTOR") for key in facts.told):
        raise WiringError(f"{path}: it tells no motor's pin{mend}")
    return facts


def _dump(facts: Facts, lines: list[tuple[int, str]]) -> None:
    for number, line in lines:
        if (title := _TITLE.match(line)) is not None:
            facts.told["processor"] = Told(title[1], number)
        if (define := _DEFINE.fullmatch(line)) is not None:  # a comment of a unified target
            _kinds(facts, define[1])
        words = line.split()
        match words:
            case ["resource", owner, index, pin] if owner.upper() in _RESOURCES and index.isdigit():
                facts.told[f"{_RESOURCES[owner.upper()]} {int(index[:4])}"] = Told(pin, number)
            case ["set", name, *_] if (key := _SETTINGS.get(name.lower())) is not None:
                facts.told[key] = Told(line.partition("=")[2].strip(), number)
            case ["board_name", name]:
                facts.told["name"] = Told(name, number)
            case ["manufacturer_id", name]:
                facts.told["maker"] = Told(name, number)
            case ["serial", port, mask, *_] if mask.isdigit() and int(mask[:9]) & _RECEIVER_FUNCTION:
                # Ports are counted from 0, or named.
                facts.told["receiver"] = Told(f"UART{int(port[:4]) + 1}" if port.isdigit() else port, number)


def _header(facts: Facts, lines: list[tuple[int, str]]) -> None:
    defined = {
        match[1]: Told(match[2] or "", number)
        for number, line in lines
        if (match := _DEFINE.fullmatch(line)) is not None
    }
    for name, told in defined.items():
        _kinds(facts, name)
        for key in _keys(name):
            facts.told[key] = Told(_meant(told.text, defined), told.line)


def _keys(name: str) -> Iterator[str]:
    for pattern, key in _DEFINES.items():
        if (match := re.fullmatch(pattern, name)) is not None:
            yield match.expand(key)


def _meant(text: str, defined: Mapping[str, Told]) -> str:
    """Return what a value means that may be the name of another one."""
    for _ in range(_ALIASES_MAX):
        if text not in defined:
            break
        text = defined[text].text
    return text.strip('"')


def _kinds(facts: Facts, name: str) -> None:
    if (gyro := _KIND.fullmatch(name)) is not None:
        facts.gyro_kinds.add(gyro[1])
    if (flash := _FLASH.fullmatch(name)) is not None:
        facts.flash_kinds.add(flash[1])
    facts.has_card |= name == "USE_SDCARD"
