"""InvenSense's gyro chips with register banks: ICM-42688-P and ICM-42605.

Sources: what the register headers and drivers of PX4, Zephyr and Betaflight tell of the data sheets
(DS-000347, DS-000292); reset values of filters and of the interrupt from memory of DS-000347. That all else
but rates, ranges and modes is written while both sensors are off is what DS-000347 asks and Betaflight does;
Zephyr's and PX4's drivers set the interrupt up afterwards.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_chip import MICROSECOND, GyroChip, GyroKind, Registers, Setup

DEVICE_CONFIG, INT_CONFIG, TEMP_DATA1, INT_STATUS = 0x11, 0x14, 0x1D, 0x2D
INTF_CONFIG0, INTF_CONFIG1, PWR_MGMT0, GYRO_CONFIG0, ACCEL_CONFIG0 = 0x4C, 0x4D, 0x4E, 0x4F, 0x50
GYRO_ACCEL_CONFIG0, INT_CONFIG0, INT_CONFIG1, INT_SOURCE0 = 0x52, 0x63, 0x64, 0x65
WHO_AM_I, REG_BANK_SEL = 0x75, 0x76
GYRO_STATIC2, GYRO_STATIC3, GYRO_STATIC4, GYRO_STATIC5 = 0x10B, 0x10C, 0x10D, 0x10E
ACCEL_STATIC2, ACCEL_STATIC3, ACCEL_STATIC4 = 0x203, 0x204, 0x205

_RESET: Registers = {
    DEVICE_CONFIG: 0x00,
    INT_CONFIG: 0x00,
    INTF_CONFIG0: 0x30,
    INTF_CONFIG1: 0x91,
    PWR_MGMT0: 0x00,
    GYRO_CONFIG0: 0x06,  # +-2000 deg/s, 1 kHz
    ACCEL_CONFIG0: 0x06,
    GYRO_ACCEL_CONFIG0: 0x11,
    INT_CONFIG0: 0x00,
    INT_CONFIG1: 0x10,  # INT_ASYNC_RESET
    INT_SOURCE0: 0x10,  # the end of a reset
    REG_BANK_SEL: 0x00,
    GYRO_STATIC2: 0xA0,
    GYRO_STATIC3: 0x0D,
    GYRO_STATIC4: 0xAA,
    GYRO_STATIC5: 0x80,
    ACCEL_STATIC2: 0x30,
    ACCEL_STATIC3: 0x40,
    ACCEL_STATIC4: 0x62,
}
_KNOWN = {  # bits that the image may write
    DEVICE_CONFIG: 0x01,
    INT_CONFIG: 0x3F,
    INTF_CONFIG0: 0xF3,
    INTF_CONFIG1: 0xDB,  # bits 7:6 as Betaflight's and ArduPilot's drivers know them
    PWR_MGMT0: 0x3F,
    GYRO_CONFIG0: 0xEF,
    ACCEL_CONFIG0: 0xEF,
    GYRO_ACCEL_CONFIG0: 0xFF,
    INT_CONFIG0: 0x3F,
    INT_CONFIG1: 0x70,
    INT_SOURCE0: 0x7F,
    REG_BANK_SEL: 0x07,
    GYRO_STATIC2: 0xA3,
    GYRO_STATIC3: 0x3F,
    GYRO_STATIC4: 0xFF,
    GYRO_STATIC5: 0xFF,
    ACCEL_STATIC2: 0x7F,
    ACCEL_STATIC3: 0xFF,
    ACCEL_STATIC4: 0xFF,
}
# All else asks for both sensors off, by the data sheet's chapter on the modification of registers.
_WHILE_ON = {REG_BANK_SEL, DEVICE_CONFIG, PWR_MGMT0, GYRO_CONFIG0, ACCEL_CONFIG0}
_ODR_HZ = {1: 32_000, 2: 16_000, 3: 8000, 4: 4000, 5: 2000, 6: 1000, 7: 200, 8: 100, 15: 500}
_FAST_HZ = 4000  # from here on INT1 needs the short pulse without a dead time
_ON = 3  # GYRO_MODE and ACCEL_MODE of low noise
_TIMESTAMP = (0x2B, 0x2C)  # between data and INT_STATUS; off
# Rows of the anti-alias filter's table: DELT, DELTSQR, BITSHIFT.
_FILTERS = {
    *((1, 1, 15), (2, 4, 13), (3, 9, 12), (4, 16, 11), (5, 25, 10), (6, 36, 10), (7, 49, 9), (8, 64, 9)),
    *((10, 100, 8), (11, 122, 8), (12, 144, 8), (13, 170, 8), (21, 440, 6), (24, 576, 6), (37, 1376, 4)),
    *((39, 1536, 4), (63, 3968, 3)),
}


@dataclass(frozen=True, kw_only=True)
class IcmKind(GyroKind):
    """A chip of this family."""

    told_at: int = WHO_AM_I
    data: int = TEMP_DATA1
    order: tuple[int, ...] = (3, 0, 1, 2, 4, 5, 6)
    data_hz: int = 24_000_000
    register_hz: int = 24_000_000
    counts_per_degree: float = 132.48
    zero_deg_c: float = 25.0
    start_ms: int = 100  # by its data sheet 1; its supply rises slowly
    pulse: int = 8 * MICROSECOND
    ready_bit: int = 0x08

    def after_reset(self) -> Registers:
        return dict(_RESET)

    def known(self, register: int) -> int | None:
        return _KNOWN.get(register)

    def told(self, register: int) -> int | None:
        return 0 if register in _TIMESTAMP else super().told(register)

    def status_at(self) -> int | None:
        return INT_STATUS

    def place(self, registers: Mapping[int, int], address: int) -> int:
        return address if address == REG_BANK_SEL else registers[REG_BANK_SEL] << 8 | address

    def write(self, chip: GyroChip, register: int, value: int) -> None:
        registers = chip.registers
        if registers[PWR_MGMT0] & 0x0F and register not in _WHILE_ON:
            chip.fail(
                f"register 0x{register & 0xFF:02X} of bank {register >> 8} of the {self.name} is "
                f"written while its sensors are on, expected PWR_MGMT0 0 before"
            )
        if register == DEVICE_CONFIG and value & 1:
            chip.reset(1.0)
            return
        if register == PWR_MGMT0 and value & 0x0F & ~registers[PWR_MGMT0]:
            chip.quiet_until = chip.engine.cycle + 200 * MICROSECOND
        registers[register] = value

    def setup(self, chip: GyroChip) -> Setup:
        registers = chip.registers
        gyro, accel = registers[GYRO_CONFIG0], registers[ACCEL_CONFIG0]
        samples = registers[PWR_MGMT0] >> 2 & 3 == _ON and registers[INT_SOURCE0] & 0x08
        if not samples:
            return Setup(None)
        self._validate(chip, gyro & 0x0F)
        return Setup(TIME_HZ // _ODR_HZ[gyro & 0x0F], gyro >> 5, accel >> 5)

    def _validate(self, chip: GyroChip, rate: int) -> None:
        """Check the set-up before samples begin."""
        registers, name = chip.registers, self.name
        if rate not in _ODR_HZ:
            chip.fail(f"the {name} samples with GYRO_ODR {rate}, which is reserved or not modelled")
        if registers[INT_SOURCE0] != 0x08:
            chip.fail(f"the {name} pulses INT1 for more than data that is ready, expected INT_SOURCE0 0x08")
        if registers[INT_CONFIG] & 7 != 3:
            chip.fail(
                f"the {name} samples with INT_CONFIG 0x{registers[INT_CONFIG]:02X}, expected INT1 pulsed, "
                f"push-pull, active high: 0x03"
            )
        if registers[INT_CONFIG1] & 0x10:
            chip.fail(f"the {name} samples with INT_ASYNC_RESET 1, expected 0 for its INT pins")
        if _ODR_HZ[rate] >= _FAST_HZ and registers[INT_CONFIG1] & 0x60 != 0x60:
            chip.fail(
                f"the {name} samples at {_ODR_HZ[rate]} Hz with INT_CONFIG1 0x{registers[INT_CONFIG1]:02X}, "
                f"expected a pulse of 8 us without a dead time: 0x60"
            )
        if registers[INTF_CONFIG0] & 0x10 == 0:
            chip.fail(f"the {name} gives its values the lower byte first, which is not modelled")
        for first, shift in ((GYRO_STATIC3, 0), (ACCEL_STATIC2, 1)):
            delt, low, high = registers[first] >> shift & 0x3F, registers[first + 1], registers[first + 2]
            row = (delt, (high & 0x0F) << 8 | low, high >> 4)
            if row not in _FILTERS:
                chip.fail(f"the {name} samples behind a filter {row}, which is no row of its table")


ICM42688P = IcmKind(name="ICM42688P", who_am_i=0x47)
ICM42605 = replace(ICM42688P, name="ICM42605", who_am_i=0x42)
