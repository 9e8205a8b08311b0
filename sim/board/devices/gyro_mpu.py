"""InvenSense's gyro chips of the first family: MPU-6500, MPU-6000, ICM-20602 and their kin.

Sources: MPU-6500 product specification (PS-MPU-6500A-01) and register map (RM-MPU-6500A-00), ICM-20689 data
sheet (DS-000143), MPU-6000 register map (RM-MPU-6000A-00); of ICM-20602 (DS-000176), ICM-20608-G and MPU-9250
what PX4's register headers tell of their data sheets, of the ICM-20601 (DS-000191) I2Cdev's. Thermometer and
speed of the ICM-20601 are those of its kin.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.gyro_chip import GyroChip, GyroKind, Registers, Setup

SMPLRT_DIV, CONFIG, GYRO_CONFIG, ACCEL_CONFIG, ACCEL_CONFIG2 = 0x19, 0x1A, 0x1B, 0x1C, 0x1D
INT_PIN_CFG, INT_ENABLE, INT_STATUS, DATA = 0x37, 0x38, 0x3A, 0x3B
SIGNAL_PATH_RESET, USER_CTRL, PWR_MGMT_1, PWR_MGMT_2, I2C_IF, WHO_AM_I = 0x68, 0x6A, 0x6B, 0x6C, 0x70, 0x75

_DEVICE_RESET, _SLEEP = 0x80, 0x40  # PWR_MGMT_1
_CLOCK = 0x07  # PWR_MGMT_1 CLKSEL: the gyro performs as it should with some of them only
_FAST = 0x03  # GYRO_CONFIG FCHOICE_B: past the low-pass, at 32 kHz
_TRIMS = (0x00, 0x01, 0x0F)  # SELF_TEST registers that lie where other makers' chips tell what they are
_BANK = 0x76  # reserved; the second family's chips tell their register bank there
REGISTER_HZ = 1_000_000  # SCK at most, all registers of the older chips

Bits = tuple[tuple[int, int], ...]  # registers, and bits or values of each

# Registers that the image may write, and the bits of each that the model knows. Of an MPU6500:
_WRITABLE: Bits = (
    *((SMPLRT_DIV, 0xFF), (CONFIG, 0x07), (GYRO_CONFIG, 0x18), (ACCEL_CONFIG, 0x18), (ACCEL_CONFIG2, 0x0F)),
    *((INT_PIN_CFG, 0x10), (INT_ENABLE, 0x01), (USER_CTRL, 0x11), (PWR_MGMT_1, 0xC7), (PWR_MGMT_2, 0x3F)),
)


@dataclass(frozen=True, kw_only=True)
class MpuKind(GyroKind):
    """A chip of this family."""

    told_at: int = WHO_AM_I
    data: int = DATA
    order: tuple[int, ...] = (0, 1, 2, 3, 4, 5, 6)
    register_hz: int = REGISTER_HZ
    start_ms: int = 100  # at most (specification: 11 typical)
    pulse: int = TIME_HZ // 20_000  # 50 us
    reset: Bits = ()  # registers that are not 0 after reset
    reset_ms: int = 100  # from DEVICE_RESET to answers (register map, PWR_MGMT_1)
    signal_paths: int = 0x07  # SIGNAL_PATH_RESET: those that there are
    writable: Bits = _WRITABLE
    spi_only: tuple[int, int] = (USER_CTRL, 0x10)  # register and bit that switch I2C off
    full_scale: int = 3  # FS_SEL and ACCEL_FS_SEL of +-2000 deg/s and +-16 g, the counts that the loop sets
    clocks: tuple[int, ...] = (1,)  # CLKSEL that the gyro needs
    divides_8_khz: bool = False  # by SMPLRT_DIV also without the low-pass
    trim: int = 0x75  # that its factory gave it, which is another chip's identity at that address

    def after_reset(self) -> Registers:
        return {**dict.fromkeys(dict(self.writable), 0), SIGNAL_PATH_RESET: 0, **dict(self.reset)}

    def known(self, register: int) -> int | None:
        return {**dict(self.writable), SIGNAL_PATH_RESET: self.signal_paths}.get(register)

    def told(self, register: int) -> int | None:
        if register == _BANK:
            return 0
        return self.trim if register in _TRIMS else super().told(register)

    def status_at(self) -> int | None:
        return INT_STATUS

    def write(self, chip: GyroChip, register: int, value: int) -> None:
        if register == PWR_MGMT_1 and value & _DEVICE_RESET:
            chip.reset(self.reset_ms)
        elif register == SIGNAL_PATH_RESET:
            chip.clear_data()  # the bits clear themselves
        elif register == USER_CTRL:
            chip.registers[register] = value & ~0x01  # SIG_COND_RST clears itself
        else:
            chip.registers[register] = value

    def setup(self, chip: GyroChip) -> Setup:
        registers = chip.registers
        awake = not registers[PWR_MGMT_1] & _SLEEP and not registers[PWR_MGMT_2] & 0x07
        samples = awake and registers[INT_ENABLE] & 1
        if samples:
            self._validate(chip)
        return Setup(
            self._period(registers) if samples else None,
            self.full_scale - (registers[GYRO_CONFIG] >> 3 & 3),
            self.full_scale - (registers[ACCEL_CONFIG] >> 3 & 3),
        )

    def _validate(self, chip: GyroChip) -> None:
        """Check the set-up before samples begin."""
        clock = chip.registers[PWR_MGMT_1] & _CLOCK
        if clock not in self.clocks:
            expected = " or ".join(map(str, self.clocks))
            chip.fail(f"the {self.name} samples with CLKSEL {clock}, expected {expected}: its gyro needs it")
        register, bit = self.spi_only
        if not chip.registers[register] & bit:
            chip.fail(
                f"the {self.name} samples while it may take its bus for I2C, expected register "
                f"0x{register:02X} with bit 0x{bit:02X}"
            )

    def _period(self, registers: Registers) -> int:
        if registers[GYRO_CONFIG] & _FAST:
            return TIME_HZ // 32_000
        divider = 1 + registers[SMPLRT_DIV]
        if registers[CONFIG] & 7 in (0, 7):
            return TIME_HZ // 8000 * (divider if self.divides_8_khz else 1)
        return TIME_HZ // 1000 * divider


MPU6500 = MpuKind(
    name="MPU6500",
    who_am_i=0x70,
    data_hz=20_000_000,
    reset=((PWR_MGMT_1, 0x01),),
    counts_per_degree=333.87,
    zero_deg_c=21.0,
)
ICM20689 = MpuKind(
    name="ICM20689",
    who_am_i=0x98,
    data_hz=8_000_000,
    reset=((PWR_MGMT_1, 0x41),),  # asleep
    signal_paths=0x03,  # the gyro's is reserved
    counts_per_degree=326.8,
    zero_deg_c=25.0,
)
# By its data sheet it answers 2 ms after power-up; the model asks for as long a wait as its kin.
ICM20602 = MpuKind(
    name="ICM20602",
    who_am_i=0x12,
    data_hz=10_000_000,
    register_hz=10_000_000,
    reset=((PWR_MGMT_1, 0x41), (CONFIG, 0x80)),
    writable=(
        *_WRITABLE,
        (GYRO_CONFIG, 0x1B),
        (USER_CTRL, 0x01),
        (I2C_IF, 0x40),
    ),
    spi_only=(I2C_IF, 0x40),
    signal_paths=0x03,
    counts_per_degree=326.8,
    zero_deg_c=25.0,
)
ICM20608G = replace(ICM20689, name="ICM20608G", who_am_i=0xAF)
ICM20601 = replace(ICM20689, name="ICM20601", who_am_i=0xAC, full_scale=2)  # +-500 to 4000 deg/s, +-4 to 32 g
MPU9250 = replace(MPU6500, name="MPU9250", who_am_i=0x71)
MPU6000 = MpuKind(
    name="MPU6000",
    who_am_i=0x68,
    data_hz=20_000_000,
    reset=((PWR_MGMT_1, 0x40),),  # asleep
    writable=tuple(row for row in _WRITABLE if row[0] != ACCEL_CONFIG2),
    clocks=(1, 2, 3),  # of any axis of the gyro
    divides_8_khz=True,
    counts_per_degree=340.0,
    zero_deg_c=36.53,
)
