"""ST's gyro chips: LSM6DSV16X and LSM6DSK320X.

Sources: ST's driver lsm6dsv16x-pid (registers, fields, scales, the order of a reset), Betaflight's (SCK,
filters). That HAODR_CFG and modes change only while sensors are off is from memory of the data sheet: ST's
driver writes HAODR_CFG after the rate. The LSM6DSK320X is taken for the same but for its identity.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_chip import MICROSECOND, GyroChip, GyroKind, Registers, Setup

IF_CFG, INT1_CTRL, WHO_AM_I, CTRL1, CTRL2, CTRL3, CTRL4 = 0x03, 0x0D, 0x0F, 0x10, 0x11, 0x12, 0x13
CTRL6, CTRL7, CTRL8, CTRL9, STATUS_REG, OUT_TEMP_L, HAODR_CFG = 0x15, 0x16, 0x17, 0x18, 0x1E, 0x20, 0x62
# Where other makers' chips tell what they are, and in which bank; between STATUS_REG and the data.
_SILENT = (0x00, 0x75, 0x76, 0x1F)

_KNOWN = {  # bits that the image may write
    IF_CFG: 0x19,
    INT1_CTRL: 0x03,
    CTRL1: 0x7F,
    CTRL2: 0x7F,
    CTRL3: 0x45,
    CTRL4: 0x0A,
    CTRL6: 0x7F,
    CTRL7: 0x01,
    CTRL8: 0xE3,
    CTRL9: 0x08,
    HAODR_CFG: 0x03,
}
_ACCURATE = 1  # OP_MODE of high accuracy
_HZ = {0: 7680, 1: 8000, 2: 6400}  # of rate 12 by HAODR_SEL; 7680 also in other modes
_TOP = 12
_GYRO_SHIFT = {0: 4, 1: 3, 2: 2, 3: 1, 4: 0, 12: -1}  # by FS_G


@dataclass(frozen=True, kw_only=True)
class LsmKind(GyroKind):
    """A chip of this family."""

    told_at: int = WHO_AM_I
    data: int = OUT_TEMP_L
    order: tuple[int, ...] = (3, 4, 5, 6, 0, 1, 2)
    data_hz: int = 10_000_000
    register_hz: int = 10_000_000
    counts_per_degree: float = 256.0
    zero_deg_c: float = 25.0
    start_ms: int = 100  # ST's driver waits 30 after a new start
    pulse: int = 65 * MICROSECOND
    little: bool = True
    gyro_scale: tuple[int, int] = (100, 7)  # 70 mdeg/s a count
    ready_bit: int = 0x02  # GDA; a read of the gyro clears it, here the read of STATUS_REG before it

    def after_reset(self) -> Registers:
        return {**dict.fromkeys(_KNOWN, 0), CTRL3: 0x44}

    def known(self, register: int) -> int | None:
        return _KNOWN.get(register)

    def told(self, register: int) -> int | None:
        return 0 if register in _SILENT else super().told(register)

    def status_at(self) -> int | None:
        return STATUS_REG

    def write(self, chip: GyroChip, register: int, value: int) -> None:
        registers = chip.registers
        on = registers[CTRL1] & 0x0F or registers[CTRL2] & 0x0F
        if register == CTRL3 and value & 1:
            if on:
                chip.fail(
                    f"the {self.name} is reset while its sensors are on, expected CTRL1 and CTRL2 0 before"
                )
            chip.reset(4.0)  # ST's driver asks for its end four times, 1 ms apart
            return
        if register == HAODR_CFG and on:
            chip.fail(f"HAODR_CFG of the {self.name} is written while its sensors are on, expected both off")
        if register in (CTRL1, CTRL2) and registers[register] & 0x0F and (registers[register] ^ value) & 0x70:
            chip.fail(f"a sensor of the {self.name} changes its mode while it is on, expected it off before")
        registers[register] = value

    def setup(self, chip: GyroChip) -> Setup:
        registers = chip.registers
        rate = registers[CTRL2] & 0x0F
        if not rate or not registers[INT1_CTRL] & 0x02:
            return Setup(None)
        self._validate(chip)
        accurate = registers[CTRL2] >> 4 == _ACCURATE
        top = _HZ[registers[HAODR_CFG] if accurate else 0]
        return Setup(
            round(TIME_HZ / top * 2 ** (_TOP - rate)),
            _GYRO_SHIFT[registers[CTRL6] & 0x0F],
            3 - (registers[CTRL8] & 3),
        )

    def _validate(self, chip: GyroChip) -> None:
        """Check the set-up before samples begin."""
        registers, name = chip.registers, self.name
        if registers[CTRL2] & 0x0F > _TOP or registers[CTRL2] >> 4 not in (0, _ACCURATE):
            chip.fail(f"the {name} samples with CTRL2 0x{registers[CTRL2]:02X}, which is not modelled")
        if registers[CTRL1] & 0x0F and (registers[CTRL1] ^ registers[CTRL2]) & 0x70:
            chip.fail(f"gyro and accelerometer of the {name} are in different modes, expected one for both")
        if registers[CTRL6] & 0x0F not in _GYRO_SHIFT:
            chip.fail(f"the {name} samples with FS_G {registers[CTRL6] & 0x0F}, which is reserved")
        if registers[CTRL3] & 0x44 != 0x44:
            chip.fail(f"the {name} samples without IF_INC and BDU of CTRL3: values may be torn or not read")
        if registers[INT1_CTRL] != 0x02:
            chip.fail(f"the {name} pulses INT1 for more than its gyro, expected INT1_CTRL 0x02")
        if not registers[CTRL4] & 0x02:
            chip.fail(f"the {name} holds INT1 until it is read, which is not modelled; expected DRDY_PULSED")
        if registers[IF_CFG] & 0x18:
            chip.fail(f"the {name} has INT1 active low or open-drain, expected neither")


LSM6DSV16X = LsmKind(name="LSM6DSV16X", who_am_i=0x70)
LSM6DSK320X = replace(LSM6DSV16X, name="LSM6DSK320X", who_am_i=0x75)
