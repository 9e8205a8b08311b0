"""What each kind of emulated gyro chip has of its own: banks, order of data, rates, and what it refuses."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import TIME_HZ, BoardError
from neuroflight.sim.board.devices import gyro_bmi, gyro_icm, gyro_lsm, gyro_mpu
from neuroflight.sim.board.devices.gyro_bmi import BMI270
from neuroflight.sim.board.devices.gyro_chip import GyroKind
from neuroflight.sim.board.devices.gyro_icm import ICM42605, ICM42688P
from neuroflight.sim.board.devices.gyro_lsm import LSM6DSV16X
from neuroflight.sim.board.devices.gyro_mpu import MPU6000, MPU6500
from tests.sim.board.peripherals.test_spi_gyro import configure, exchange

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench

READ = 0x80
MEASURED = ((100, -200, 2048), 77, (1000, -2000, 3000))
ICM_READY = (
    *((gyro_icm.INT_CONFIG, 0x03), (gyro_icm.INT_CONFIG1, 0x60), (gyro_icm.INT_SOURCE0, 0x08)),
    *((gyro_icm.GYRO_CONFIG0, 0x03), (gyro_icm.REG_BANK_SEL, 2), (0x03, 6), (0x04, 9), (0x05, 0xC0)),
    *((gyro_icm.REG_BANK_SEL, 0), (gyro_icm.PWR_MGMT0, 0x0F)),
)
LSM_READY = (
    *((gyro_lsm.HAODR_CFG, 1), (gyro_lsm.CTRL6, 4), (gyro_lsm.CTRL8, 3), (gyro_lsm.CTRL4, 2)),
    *((gyro_lsm.INT1_CTRL, 2), (gyro_lsm.CTRL1, 0x19), (gyro_lsm.CTRL2, 0x1C)),
)
MPU_READY = (
    *((gyro_mpu.USER_CTRL, 0x10), (gyro_mpu.PWR_MGMT_1, 1), (gyro_mpu.GYRO_CONFIG, 0x18)),
    *((gyro_mpu.ACCEL_CONFIG, 0x18), (gyro_mpu.INT_ENABLE, 1)),
)


def powered(make_bench: type[Bench], kind: GyroKind, *writes: tuple[int, int]) -> Bench:
    """A board whose chip answers, and has been written to."""
    bench = make_bench(chip=kind)
    bench.full_speed()
    configure(bench)
    bench.context.run(100_001)
    write(bench, *writes)
    return bench


def write(bench: Bench, *writes: tuple[int, int]) -> None:
    for address, value in writes:
        exchange(bench, address, value)


def read(bench: Bench, address: int, count: int = 1) -> bytes:
    return bytes(exchange(bench, address | READ, *bytes(count))[1:])


def rate_hz(bench: Bench) -> float:
    """Return the rate of samples, from the next one but one on."""
    chip = bench.hardware.gyro
    due: list[int] = []
    for _ in range(3):
        assert chip.next_sample is not None
        due.append(chip.next_sample)
        bench.context.run_to(due[-1] + 1)
    return TIME_HZ / (due[2] - due[1])


@pytest.mark.parametrize(
    ("kind", "ready", "address", "layout", "order"),
    [
        (MPU6000, MPU_READY, 0x3B, ">7h", "atg"),
        (ICM42688P, ICM_READY, 0x1D, ">7h", "tag"),
        (LSM6DSV16X, LSM_READY, 0x20, "<7h", "tga"),
    ],
    ids=lambda value: value.name if isinstance(value, GyroKind) else None,
)
def test_data_lie_in_the_order_of_the_chip_and_come_at_8_khz(
    make_bench: type[Bench],
    kind: GyroKind,
    ready: tuple[tuple[int, int], ...],
    address: int,
    layout: str,
    order: str,
) -> None:
    bench = powered(make_bench, kind, *ready)
    bench.hardware.gyro.measure(*MEASURED)
    assert rate_hz(bench) == 8000
    accel, temperature, gyro = MEASURED
    parts = {"a": accel, "t": (temperature,), "g": gyro}
    assert struct.unpack(layout, read(bench, address, 14)) == sum((parts[part] for part in order), ())


def test_the_scales_follow_the_ranges_that_are_set(make_bench: type[Bench]) -> None:
    for kind, ready, ranges, gyro_at, layout in (
        (ICM42688P, ICM_READY, ((gyro_icm.GYRO_CONFIG0, 0x23),), 0x25, ">3h"),  # +-1000 deg/s
        (LSM6DSV16X, LSM_READY, ((gyro_lsm.CTRL6, 3),), 0x22, "<3h"),
    ):
        bench = powered(make_bench, kind, *ready)
        bench.hardware.gyro.measure((0, 0, 0), 0, (1000, -2000, 30_000))
        bench.context.run(201)
        write(bench, *ranges)
        bench.context.run(1000)
        assert struct.unpack(layout, read(bench, gyro_at, 6)) == (2000, -4000, 32_767)


def test_an_mpu6000_has_no_filter_for_its_accelerometer_and_divides_8_khz(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, MPU6000, *MPU_READY, (gyro_mpu.SMPLRT_DIV, 3))
    assert rate_hz(bench) == 2000
    mpu6500 = powered(make_bench, MPU6500, *MPU_READY, (gyro_mpu.SMPLRT_DIV, 3))
    assert rate_hz(mpu6500) == 8000
    with pytest.raises(BoardError, match="register 0x1D of the MPU6000 = 0x02: the model knows none of it"):
        write(bench, (gyro_mpu.ACCEL_CONFIG2, 2))


def test_an_icm42688p_has_other_registers_in_other_banks(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, ICM42688P)
    assert read(bench, 0x75) == b"\x47"
    assert read(bench, gyro_icm.INT_CONFIG1) == b"\x10"
    write(bench, (gyro_icm.REG_BANK_SEL, 1))
    assert read(bench, 0x0C, 3) == b"\x0d\xaa\x80"
    assert read(bench, gyro_icm.REG_BANK_SEL) == b"\x01"
    with pytest.raises(
        BoardError, match="register 0x25 of bank 1 of the ICM42688P is read, which is not modelled"
    ):
        read(bench, 0x25, 6)
    again = powered(make_bench, ICM42605, (gyro_icm.REG_BANK_SEL, 2))
    with pytest.raises(BoardError, match="register 0x75 of bank 2 of the ICM42605 is read"):
        read(again, 0x75)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((gyro_icm.INT_CONFIG1, 0x70), "INT_ASYNC_RESET 1, expected 0"),
        ((gyro_icm.INT_CONFIG1, 0x20), "at 8000 Hz with INT_CONFIG1 0x20, expected a pulse of 8 us"),
        ((gyro_icm.INT_CONFIG, 0x02), "expected INT1 pulsed, push-pull, active high"),
        ((gyro_icm.INT_SOURCE0, 0x18), "pulses INT1 for more than data that is ready"),
        ((gyro_icm.GYRO_CONFIG0, 0x00), "GYRO_ODR 0, which is reserved"),
        ((gyro_icm.INTF_CONFIG0, 0x00), "the lower byte first"),
    ],
)
def test_an_icm42688p_is_refused_when_it_samples_without_what_it_asks_for(
    make_bench: type[Bench], change: tuple[int, int], message: str
) -> None:
    bench = powered(make_bench, ICM42688P, *ICM_READY[:-1], change)
    with pytest.raises(BoardError, match=message):
        write(bench, ICM_READY[-1])


def test_an_icm42688p_is_refused_when_it_is_written_too_early_or_while_it_is_on(
    make_bench: type[Bench],
) -> None:
    hasty = powered(make_bench, ICM42688P, *ICM_READY)
    with pytest.raises(BoardError, match=r"register 0x4F of the ICM42688P is written 1\d\d us too early"):
        write(hasty, (gyro_icm.GYRO_CONFIG0, 0x04))
    bench = powered(make_bench, ICM42688P, *ICM_READY)
    bench.context.run(201)
    write(bench, (gyro_icm.GYRO_CONFIG0, 0x04))  # a rate may change
    assert rate_hz(bench) == 4000
    with pytest.raises(
        BoardError, match="0x52 of bank 0 of the ICM42688P is written while its sensors are on"
    ):
        write(bench, (gyro_icm.GYRO_ACCEL_CONFIG0, 0xFF))


def test_an_icm42688p_is_refused_when_its_reset_is_not_over(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, ICM42688P, *ICM_READY)
    bench.context.run(201)
    write(bench, (gyro_icm.DEVICE_CONFIG, 1))
    assert bench.hardware.gyro.next_sample is None
    bench.context.run(1000)
    assert read(bench, gyro_icm.PWR_MGMT0) == b"\0"
    write(bench, (gyro_icm.DEVICE_CONFIG, 1))
    bench.context.run(900)
    with pytest.raises(BoardError, match="before it answers after its reset"):
        read(bench, 0x75)


def test_an_lsm6dsv16x_samples_at_8_khz_only_with_high_accuracy(make_bench: type[Bench]) -> None:
    plain = tuple((a, v & 0x0F) if a in (gyro_lsm.CTRL1, gyro_lsm.CTRL2) else (a, v) for a, v in LSM_READY)
    assert rate_hz(powered(make_bench, LSM6DSV16X, *plain)) == 7680
    bench = powered(make_bench, LSM6DSV16X, *LSM_READY, (gyro_lsm.CTRL2, 0x1A))
    assert rate_hz(bench) == 2000


@pytest.mark.parametrize(
    ("writes", "message"),
    [
        ((gyro_lsm.CTRL3, 0x01), "is reset while its sensors are on"),
        ((gyro_lsm.HAODR_CFG, 0x02), "HAODR_CFG of the LSM6DSV16X is written while its sensors are on"),
        ((gyro_lsm.CTRL2, 0x0C), "changes its mode while it is on"),
        ((gyro_lsm.CTRL4, 0x00), "holds INT1 until it is read"),
        ((gyro_lsm.CTRL3, 0x04), "without IF_INC and BDU"),
        ((gyro_lsm.IF_CFG, 0x11), "INT1 active low or open-drain"),
        ((gyro_lsm.INT1_CTRL, 0x03), "pulses INT1 for more than its gyro"),
        ((gyro_lsm.CTRL6, 0x05), "FS_G 5, which is reserved"),
        ((gyro_lsm.CTRL9, 0x10), "register 0x18 of the LSM6DSV16X = 0x10: the model knows bits 0x08"),
    ],
)
def test_an_lsm6dsv16x_is_refused_when_it_is_set_up_wrong(
    make_bench: type[Bench], writes: tuple[int, int], message: str
) -> None:
    bench = powered(make_bench, LSM6DSV16X, *LSM_READY)
    with pytest.raises(BoardError, match=message):
        write(bench, writes)


def test_an_lsm6dsv16x_is_refused_when_half_a_value_is_read(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, LSM6DSV16X, *LSM_READY)
    read(bench, 0x22, 5)
    with pytest.raises(BoardError, match="the data of the LSM6DSV16X was read up to 0x26, the lower half"):
        read(bench, 0x0F)


WHOLE = gyro_bmi.BEGIN + bytes(gyro_bmi.SHORT - 4)


def awake(make_bench: type[Bench]) -> Bench:
    """A BMI270 that listens to SPI, out of its power save."""
    bench = powered(make_bench, BMI270, (gyro_bmi.CHIP_ID, 0), (gyro_bmi.PWR_CONF, 0))
    bench.context.run(451)
    return bench


def load(bench: Bench, configuration: bytes) -> int:
    """Let it run a configuration; return INTERNAL_STATUS."""
    write(bench, (gyro_bmi.INIT_CTRL, 0))
    exchange(bench, gyro_bmi.INIT_DATA, *configuration)
    write(bench, (gyro_bmi.INIT_CTRL, 1))
    bench.context.run(20_001)
    return read(bench, gyro_bmi.INTERNAL_STATUS, 2)[1]


BMI_READY = ((gyro_bmi.ACC_RANGE, 3), (gyro_bmi.GYR_CONF, 0xCD), (gyro_bmi.PWR_CTRL, 0x0E))


def test_a_bmi270_hears_no_first_transaction_and_tells_a_dummy_byte_first(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, BMI270)
    assert read(bench, gyro_bmi.CHIP_ID, 2) == b"\0\0"  # it still listens to I2C
    assert read(bench, gyro_bmi.CHIP_ID, 2) == b"\0\x24"


def test_a_bmi270_measures_at_3200_hz_when_its_configuration_is_in_it(make_bench: type[Bench]) -> None:
    bench = awake(make_bench)
    assert load(bench, WHOLE) == 1
    write(bench, *BMI_READY)
    bench.hardware.gyro.measure(*MEASURED)
    assert rate_hz(bench) == 3200
    told = read(bench, gyro_bmi.STATUS, 34)[1:]  # behind the dummy byte
    accel, temperature, gyro = MEASURED
    assert told[0] == 0x40 and struct.unpack_from("<6h", told, 9) == (*accel, *gyro)
    assert struct.unpack_from("<h", told, 31) == (temperature,)
    due = bench.hardware.gyro.next_sample
    assert due is not None
    bench.context.run_to(due + 1)
    assert [read(bench, gyro_bmi.STATUS, 2)[1] for _ in range(2)] == [0x40, 0]  # nothing new since


@pytest.mark.parametrize("configuration", [b"", WHOLE[:-2], WHOLE + b"\0\0", b"\1" + WHOLE[1:]])
def test_a_bmi270_says_so_and_measures_nothing_when_its_configuration_is_another(
    make_bench: type[Bench], configuration: bytes
) -> None:
    bench = awake(make_bench)
    assert load(bench, configuration) == 2
    write(bench, *BMI_READY)
    assert bench.hardware.gyro.next_sample is None


def test_a_bmi270_measures_nothing_when_the_load_is_not_begun(make_bench: type[Bench]) -> None:
    bench = awake(make_bench)
    exchange(bench, gyro_bmi.INIT_DATA, *WHOLE)
    assert load(bench, b"") == 2


def test_a_bmi270_is_refused_when_it_is_hurried(make_bench: type[Bench]) -> None:
    bench = powered(make_bench, BMI270, (gyro_bmi.CHIP_ID, 0))
    with pytest.raises(BoardError, match="register 0x59 of the BMI270 is written in its power save"):
        write(bench, (gyro_bmi.INIT_CTRL, 0))
    bench = powered(make_bench, BMI270, (gyro_bmi.CHIP_ID, 0), (gyro_bmi.PWR_CONF, 0))
    with pytest.raises(BoardError, match=r"register 0x59 of the BMI270 is written \d+ us too early"):
        write(bench, (gyro_bmi.INIT_CTRL, 0))
    bench = awake(make_bench)
    write(bench, (gyro_bmi.INIT_CTRL, 1))
    with pytest.raises(BoardError, match=r"is addressed \d+\.\d ms before it answers after its load"):
        read(bench, gyro_bmi.INTERNAL_STATUS, 2)
