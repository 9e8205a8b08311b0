"""Bosch's BMI270: it measures only after its configuration has been loaded whole, and in its order.

Sources: Bosch's BMI270_SensorAPI (registers, the dummy byte of a read, order and waits of the load, STATUS)
and the questions of its users, whose chips told zeros or INTERNAL_STATUS 2 otherwise; scales from the API's
constants. What the configuration does is not modelled: its length and first bytes are checked, no more. That
STATUS is cleared by its own read stands for the read of the gyro behind it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_chip import MICROSECOND, GyroChip, GyroKind, Registers, Setup

CHIP_ID, STATUS, ACC_X, INTERNAL_STATUS, TEMPERATURE = 0x00, 0x03, 0x0C, 0x21, 0x22
ACC_CONF, ACC_RANGE, GYR_CONF, GYR_RANGE, INIT_CTRL, INIT_DATA = 0x40, 0x41, 0x42, 0x43, 0x59, 0x5E
PWR_CONF, PWR_CTRL, CMD = 0x7C, 0x7D, 0x7E
SHORT, LONG = 328, 8192  # bytes of the configurations that Bosch publishes
BEGIN = bytes.fromhex("c82e002e")  # of all of them

_RESET, _POWER_SAVE, _GYRO_ON, _INIT_OK, _INIT_ERROR = 0xB6, 0x01, 0x02, 1, 2
_RESET_MS, _LOAD_MS, _SAVE_US = 2.0, 20.0, 450
_KNOWN = {  # bits that the image may write
    CHIP_ID: 0x00,
    ACC_CONF: 0xFF,
    ACC_RANGE: 0x03,
    GYR_CONF: 0xFF,
    GYR_RANGE: 0x0F,
    INIT_CTRL: 0x01,
    INIT_DATA: 0xFF,
    PWR_CONF: 0x07,
    PWR_CTRL: 0x0F,
    CMD: 0xFF,
}
_AFTER_RESET = {ACC_CONF: 0xA8, ACC_RANGE: 0x02, GYR_CONF: 0xA9, PWR_CONF: 0x03}
# Beyond the addresses of the bus: does it listen to SPI, the bytes of a load, and of those that a
# configuration begins with the number that were right.
_ON_SPI, _LOADED, _RIGHT = 0x100, 0x101, 0x102
_UNTOLD = 0x103  # sensor time and more that lies between the data
_ODR_3200 = 13


@dataclass(frozen=True, kw_only=True)
class BmiKind(GyroKind):
    """A chip of this family."""

    told_at: int = CHIP_ID
    data: int = ACC_X
    order: tuple[int, ...] = (0, 1, 2, 4, 5, 6, 3)
    data_hz: int = 10_000_000
    register_hz: int = 10_000_000
    counts_per_degree: float = 512.0
    zero_deg_c: float = 23.0
    start_ms: int = 100
    pulse: int = TIME_HZ // 20_000
    little: bool = True
    dummies: int = 1
    ready_bit: int = 0x40

    def after_reset(self) -> Registers:
        zeros = dict.fromkeys((*_KNOWN, INTERNAL_STATUS, _ON_SPI, _LOADED, _RIGHT), 0)
        del zeros[CHIP_ID]
        return zeros | _AFTER_RESET

    def known(self, register: int) -> int | None:
        return _KNOWN.get(register)

    def told(self, register: int) -> int | None:
        return 0 if STATUS < register < INTERNAL_STATUS or register == _UNTOLD else super().told(register)

    def status_at(self) -> int | None:
        return STATUS

    def place(self, registers: Mapping[int, int], address: int) -> int:
        temperature = ACC_X + 12  # as the model keeps the data
        if address in (TEMPERATURE, TEMPERATURE + 1):
            return temperature + address - TEMPERATURE
        return _UNTOLD if address in (temperature, temperature + 1) else address

    def listens(self, registers: Registers) -> bool:
        return bool(registers[_ON_SPI])

    def wake(self, registers: Registers) -> None:
        registers[_ON_SPI] = 1

    def window(self) -> range:
        return range(STATUS, TEMPERATURE + 2)

    def stays(self, register: int) -> bool:
        return register == INIT_DATA

    def write(self, chip: GyroChip, register: int, value: int) -> None:
        registers = chip.registers
        if register == CMD:
            if value == _RESET:
                chip.reset(_RESET_MS)
            return
        if registers[PWR_CONF] & _POWER_SAVE and register not in (PWR_CONF, CHIP_ID):
            chip.fail(
                f"register 0x{register:02X} of the {self.name} is written in its power save, expected it off"
            )
        if register == PWR_CONF and (registers[PWR_CONF] ^ value) & _POWER_SAVE:
            chip.quiet_until = chip.engine.cycle + _SAVE_US * MICROSECOND
        if register == INIT_DATA:
            self._load(registers, value)
        elif register == INIT_CTRL:
            if value:
                self._begin(chip)
            else:
                registers[_LOADED] = registers[_RIGHT] = registers[INTERNAL_STATUS] = 0
            registers[INIT_CTRL] = value
        elif register != CHIP_ID:
            registers[register] = value

    def _load(self, registers: Registers, value: int) -> None:
        count = registers[_LOADED]
        if count < len(BEGIN) and value == BEGIN[count]:
            registers[_RIGHT] += 1
        registers[_LOADED] = min(count + 1, LONG + 1)

    def _begin(self, chip: GyroChip) -> None:
        """Run what was loaded since INIT_CTRL was 0."""
        registers = chip.registers
        whole = registers[_LOADED] in (SHORT, LONG) and registers[_RIGHT] == len(BEGIN)
        registers[INTERNAL_STATUS] = _INIT_OK if whole and not registers[INIT_CTRL] else _INIT_ERROR
        chip.rest_for(_LOAD_MS, "its load")

    def setup(self, chip: GyroChip) -> Setup:
        registers = chip.registers
        if registers[INTERNAL_STATUS] != _INIT_OK or not registers[PWR_CTRL] & _GYRO_ON:
            return Setup(None)
        rate = registers[GYR_CONF] & 0x0F
        if not 6 <= rate <= _ODR_3200 or registers[GYR_RANGE] & 7 > 4:
            chip.fail(
                f"the {self.name} samples with GYR_CONF 0x{registers[GYR_CONF]:02X} and GYR_RANGE "
                f"0x{registers[GYR_RANGE]:02X}, which are reserved"
            )
        return Setup(TIME_HZ // 3200 << _ODR_3200 - rate, registers[GYR_RANGE] & 7, 3 - registers[ACC_RANGE])


BMI270 = BmiKind(name="BMI270", who_am_i=0x24)
