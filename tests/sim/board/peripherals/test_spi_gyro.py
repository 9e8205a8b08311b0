"""SPI1 by register and by DMA, with the gyro chip behind it."""

from __future__ import annotations

import struct
from contextlib import nullcontext
from typing import TYPE_CHECKING

import pytest

from neuroflight.sim.board.core.context import BoardError
from neuroflight.sim.board.devices import gyro_mpu
from neuroflight.sim.board.devices.gyro_chip import GyroKind
from neuroflight.sim.board.devices.gyro_mount import accel_counts, gyro_counts
from neuroflight.sim.board.devices.gyro_mpu import ICM20601, ICM20602, ICM20689, MPU6500, MpuKind
from neuroflight.sim.board.fitted import GYROS
from neuroflight.toolchain.contract import Alignment

if TYPE_CHECKING:
    from tests.sim.board.conftest import Bench


CHIPS = [gyro.chip for name, gyro in GYROS.items() if name != "bmi270"]
TX, RX = 0x20011000, 0x20002000
SLOW, FAST = 6, 2  # BR: 0.84 and 13.5 MHz
CR2 = 7 << 8 | 1 << 12  # DS, FRXTH


def configure(bench: Bench, speed: int = SLOW) -> None:
    for pin in ("PA5", "PA6", "PA7"):
        bench.alternate(pin, 5)
    bench.write("GPIOC_BSRR", 1 << 2)
    bench.set("GPIOC_MODER", MODER2=1)
    bench.write("SPI1_CR1", 0x307 | speed << 3)
    bench.write("SPI1_CR2", CR2)
    bench.set("SPI1_CR1", SPE=1)


def select(bench: Bench, on: bool) -> None:
    bench.write("GPIOC_BSRR", 1 << (18 if on else 2))


def exchange(bench: Bench, *sent: int) -> list[int]:
    """Bytes by polling, as a driver does."""
    got = []
    select(bench, True)
    for byte in sent:
        bench.write("SPI1_DR", byte, 1)
        for _ in range(1000):
            if bench.get("SPI1_SR", "RXNE"):
                break
            bench.context.run(0.1)
        got.append(bench.read("SPI1_DR", 1))
    select(bench, False)
    return got


def start_chip(bench: Bench, speed: int = SLOW) -> None:
    """The chip awake at 8 kHz, data-ready on."""
    configure(bench)
    bench.context.run(110_000)
    kind = bench.hardware.gyro.kind
    assert isinstance(kind, MpuKind)
    exchange(bench, gyro_mpu.PWR_MGMT_1, 0x80)
    bench.context.run(100_001)
    for address, value in (
        kind.spi_only,
        (gyro_mpu.PWR_MGMT_1, 1),
        (gyro_mpu.GYRO_CONFIG, kind.full_scale << 3),
        (gyro_mpu.ACCEL_CONFIG, kind.full_scale << 3),
        (gyro_mpu.INT_ENABLE, 1),
    ):
        exchange(bench, address, value)
        assert exchange(bench, address | 0x80, 0)[1] == value
    bench.set("SPI1_CR1", SPE=0)
    bench.set("SPI1_CR1", BR=speed)
    bench.set("SPI1_CR1", SPE=1)


def started(make_bench: type[Bench], chip: GyroKind, speed: int = SLOW) -> Bench:
    """A board at 216 MHz whose chip is awake."""
    bench = make_bench(chip=chip)
    bench.full_speed()
    start_chip(bench, speed)
    return bench


def start_dma(bench: Bench, count: int = 15, rx_channel: int = 3) -> None:
    bench.set("SPI1_CR1", SPE=0)
    bench.set("SPI1_CR2", RXDMAEN=1)
    for stream, memory, direction, channel in ((2, RX, 0, rx_channel), (3, TX, 1, 3)):
        bench.stream(
            f"DMA2_S{stream}", 0x4001300C, memory, count, channel << 25 | 1 << 10 | direction << 6 | 1 << 4
        )
    select(bench, True)
    bench.set("SPI1_CR2", TXDMAEN=1)
    bench.set("SPI1_CR1", SPE=1)


@pytest.mark.parametrize("chip", CHIPS)
def test_chip_says_who_it_is_when_asked(make_bench: type[Bench], chip: GyroKind) -> None:
    bench = make_bench(chip=chip)
    bench.full_speed()
    configure(bench)
    bench.context.run(100_000)
    assert exchange(bench, chip.told_at | 0x80, *bytes(1 + chip.dummies))[-1] == chip.who_am_i


def test_an_icm20689_sleeps_when_it_is_reset_and_its_gyro_path_is_refused(make_bench: type[Bench]) -> None:
    bench = started(make_bench, ICM20689)
    assert bench.hardware.gyro.next_sample is not None
    exchange(bench, gyro_mpu.PWR_MGMT_1, 0x80)
    bench.context.run(100_001)
    assert exchange(bench, gyro_mpu.PWR_MGMT_1 | 0x80, 0)[1] == 0x41
    assert bench.hardware.gyro.next_sample is None
    exchange(bench, gyro_mpu.SIGNAL_PATH_RESET, 0x03)
    with pytest.raises(BoardError, match=r"0x68 of the ICM20689 = 0x07: the model knows bits 0x03"):
        exchange(bench, gyro_mpu.SIGNAL_PATH_RESET, 0x07)


def test_an_icm20602_has_the_registers_of_its_data_sheet_after_reset(make_bench: type[Bench]) -> None:
    bench = make_bench(chip=ICM20602)
    bench.full_speed()
    configure(bench)
    bench.context.run(100_000)
    told = {address: exchange(bench, address | 0x80, 0)[1] for address, _ in ICM20602.writable}
    assert {address: value for address, value in told.items() if value} == {
        gyro_mpu.CONFIG: 0x80,
        gyro_mpu.PWR_MGMT_1: 0x41,
    }


@pytest.mark.parametrize(
    ("address", "value", "message"),
    [
        (gyro_mpu.I2C_IF, 0, "while it may take its bus for I2C, expected register 0x70 with bit 0x40"),
        (gyro_mpu.PWR_MGMT_1, 0, "samples with CLKSEL 0, expected 1"),
    ],
)
def test_an_icm20602_is_refused_when_it_samples_without_what_it_asks_for(
    make_bench: type[Bench], address: int, value: int, message: str
) -> None:
    bench = started(make_bench, ICM20602)
    with pytest.raises(BoardError, match=message):
        exchange(bench, address, value)


def test_an_icm20602_samples_at_another_rate_and_scale_when_it_is_set_up_so(make_bench: type[Bench]) -> None:
    bench = started(make_bench, ICM20602)
    chip = bench.hardware.gyro
    chip.measure((0, 0, 0), 0, (100, -300, 20_000))
    for written, rate_hz, counts in (
        ((gyro_mpu.GYRO_CONFIG, 0x1A), 32_000, (100, -300, 20_000)),  # FCHOICE_B past the low-pass
        ((gyro_mpu.GYRO_CONFIG, 0x10), 8_000, (200, -600, 32_767)),  # +-1000 deg/s
        ((gyro_mpu.CONFIG, 0x01), 1_000, (200, -600, 32_767)),
        ((gyro_mpu.SMPLRT_DIV, 4), 200, (200, -600, 32_767)),
    ):
        exchange(bench, *written)
        bench.context.run(6_000)
        before = chip.samples
        bench.context.run(50_000)
        assert chip.samples - before == rate_hz // 20
        data = bytes(exchange(bench, gyro_mpu.DATA + 8 | 0x80, *[0] * 6)[1:])
        assert struct.unpack(">3h", data) == counts


def test_an_icm20601_halves_the_counts_when_it_is_set_up_like_its_kin(make_bench: type[Bench]) -> None:
    bench = started(make_bench, ICM20601)
    bench.hardware.gyro.measure((2048, 0, 0), 0, (1000, -1001, 0))
    for register in (gyro_mpu.GYRO_CONFIG, gyro_mpu.ACCEL_CONFIG):
        exchange(bench, register, 0x18)  # +-4000 deg/s, +-32 g
    bench.context.run(500)
    data = bytes(exchange(bench, gyro_mpu.DATA | 0x80, *[0] * 14)[1:])
    assert struct.unpack(">7h", data) == (1024, 0, 0, 0, 500, -501, 0)


@pytest.mark.parametrize(
    ("chip", "message"),
    [
        (ICM20602, r"data of the ICM20602 at 13.5 MHz, expected 10 MHz at most"),
        (ICM20689, r"data of the ICM20689 at 13.5 MHz, expected 8 MHz at most"),
    ],
)
def test_spi_is_refused_when_data_is_read_too_fast(
    make_bench: type[Bench], chip: GyroKind, message: str
) -> None:
    bench = started(make_bench, chip, FAST)
    with pytest.raises(BoardError, match=message):
        exchange(bench, gyro_mpu.DATA | 0x80, 0)


def test_byte_takes_its_clocks_when_polled(fast: Bench) -> None:
    configure(fast)
    fast.write("SPI1_DR", 0x55, 1)
    assert fast.get("SPI1_SR", "BSY") == 1
    fast.context.run(8 / 0.84375 - 0.05)
    assert fast.get("SPI1_SR", "RXNE") == 0
    fast.context.run(0.1)
    assert fast.get("SPI1_SR", "RXNE") == 1
    assert fast.get("SPI1_SR", "BSY") == 0


def test_line_is_pulled_when_no_chip_is_selected(fast: Bench) -> None:
    configure(fast)
    fast.set("GPIOA_PUPDR", PUPDR6=1)
    fast.write("SPI1_DR", 0, 1)
    fast.context.run(10)
    assert fast.read("SPI1_DR", 1) == 0xFF


def test_samples_come_at_8_khz_when_configured(fast: Bench) -> None:
    start_chip(fast)
    gyro = fast.hardware.gyro
    edges: list[int] = []
    fast.set("SYSCFG_EXTICR1", EXTI3=2)
    fast.set("EXTI_RTSR", TR3=1)
    gyro.before_sample = lambda number: edges.append(fast.context.cycle)
    begin = gyro.next_sample
    assert begin is not None
    fast.context.run_to(begin + 10 * 27_000 + 1)
    assert edges == [begin + 27_000 * i for i in range(11)]
    assert fast.read("EXTI_PR") == 8


def test_data_reaches_memory_when_read_by_dma(fast: Bench) -> None:
    start_chip(fast, FAST)
    gyro = fast.hardware.gyro
    gyro.measure((1, -2, 2048), 333, (-32768, 32767, 100))
    fast.context.run(130)
    fast.context.set_memory(TX, bytes([gyro_mpu.DATA | 0x80]) + bytes(14))
    fast.context.set_memory(RX, b"\xaa" * 20)
    start_dma(fast)
    assert not fast.context.asserted("DMA2_STREAM2")
    fast.context.run(15 * 8 / 13.5 - 0.1)
    assert fast.read("DMA2_S2NDTR") == 1
    assert fast.get("DMA2_S3CR", "EN") == 0  # sent to the FIFO already
    assert fast.get("DMA2_S2CR", "EN") == 1
    fast.context.run(0.2)
    assert fast.context.asserted("DMA2_STREAM2")
    assert fast.get("DMA2_LISR", "TCIF2") == 1
    data = fast.context.memory(RX, 16)
    assert data[0] == 0
    assert data[1:15].hex() == "0001fffe0800014d80007fff0064"
    assert data[15] == 0xAA
    fast.write("DMA2_LIFCR", 0x3D << 16)
    assert not fast.context.asserted("DMA2_STREAM2")


def test_samples_follow_each_other_when_each_is_read_by_dma(fast: Bench) -> None:
    start_chip(fast, FAST)
    gyro = fast.hardware.gyro
    fast.context.set_memory(TX, bytes([gyro_mpu.DATA | 0x80]) + bytes(14))
    for number in range(5):
        gyro.measure((number, 0, 0), 0, (0, 0, 0))
        fast.context.run(125)
        start_dma(fast)
        fast.context.run(20)
        for stream in (2, 3):
            fast.set(f"DMA2_S{stream}CR", EN=0)
        fast.write("DMA2_LIFCR", 0x3D << 16 | 0x3D << 22)
        fast.set("SPI1_CR2", RXDMAEN=0, TXDMAEN=0)
        select(fast, False)
        assert fast.context.memory(RX, 3) == bytes([0, 0, number])


def alarms_due(bench: Bench) -> int:
    return sum(alarm.due is not None for alarm in bench.context.alarms.values())


def test_one_alarm_is_enough_when_dma_moves_a_sample(fast: Bench) -> None:
    start_chip(fast, FAST)
    before = alarms_due(fast)
    start_dma(fast)
    assert alarms_due(fast) == before + 1  # the transfer's end


def test_bytes_wait_when_a_wrong_channel_is_refused(fast: Bench) -> None:
    configure(fast)
    with pytest.raises(
        BoardError,
        match=r"DMA2 stream 2: channel 4 is driven by USART1_RX, but its peripheral address is SPI1_DR; "
        r"expected channel 3 \(SPI1_RX\)",
    ):
        start_dma(fast, rx_channel=4)


def test_spi_is_refused_when_registers_are_accessed_too_fast(fast: Bench) -> None:
    configure(fast, speed=5)  # 1.69 MHz
    fast.context.run(100_000)
    with pytest.raises(
        BoardError, match=r"register 0x75 of the MPU6500 at 1.6875 MHz, expected 1 MHz at most"
    ):
        exchange(fast, gyro_mpu.WHO_AM_I | 0x80, 0)


@pytest.mark.parametrize(
    ("register", "field", "value", "message"),
    [
        ("SPI1_CR2", "DS", 15, "frames of 16 bits"),
        ("SPI1_CR1", "MSTR", 0, "MSTR 0"),
        ("SPI1_CR1", "SSI", 0, "SSM or SSI 0"),
        ("GPIOA_AFRL", "AFRL7", 6, "PA7 is alternate function 6"),
        ("SPI1_CR1", "CPHA", 0, "SPI mode 2, expected 0 or 3"),
    ],
)
def test_spi_is_refused_when_it_is_set_up_wrong(
    fast: Bench, register: str, field: str, value: int, message: str
) -> None:
    configure(fast)
    fast.context.run(100_000)
    fast.set("SPI1_CR1", SPE=0)
    fast.set(register, **{field: value})
    fast.set("SPI1_CR1", SPE=1)
    with pytest.raises(BoardError, match=message):
        exchange(fast, gyro_mpu.WHO_AM_I | 0x80, 0)


def test_chip_is_refused_when_it_is_spoken_to_at_once(fast: Bench) -> None:
    configure(fast)
    with pytest.raises(BoardError, match=r"addressed 97\.0 ms before it answers after power-up"):
        exchange(fast, gyro_mpu.WHO_AM_I | 0x80, 0)


def test_chip_is_refused_when_its_reset_is_not_over(fast: Bench) -> None:
    configure(fast)
    fast.context.run(100_000)
    exchange(fast, gyro_mpu.PWR_MGMT_1, 0x80)
    fast.context.run(99_000)
    with pytest.raises(BoardError, match="before it answers after its reset"):
        exchange(fast, gyro_mpu.WHO_AM_I | 0x80, 0)


@pytest.mark.parametrize(
    ("chip", "sent", "message"),
    [
        (MPU6500, (0x23, 1), "register 0x23 of the MPU6500 = 0x01: the model knows none of it"),
        (MPU6500, (0x1B, 3), "register 0x1B of the MPU6500 = 0x03: the model knows bits 0x18"),
        (MPU6500, (0x80 | 0x23, 0), "register 0x23 of the MPU6500 is read, which is not modelled"),
        *(
            (ICM20602, sent, "register 0x{:02X} of the ICM20602 = 0x{:02X}: the model".format(*sent))
            for sent in (
                (gyro_mpu.USER_CTRL, 0x10),  # I2C_IF_DIS of its kin
                (gyro_mpu.CONFIG, 0x80),
                (gyro_mpu.I2C_IF, 0x41),
                (gyro_mpu.SIGNAL_PATH_RESET, 0x07),
                (gyro_mpu.GYRO_CONFIG, 0x1C),
            )
        ),
    ],
)
def test_chip_is_refused_when_a_register_is_not_modelled(
    make_bench: type[Bench], chip: GyroKind, sent: tuple[int, ...], message: str
) -> None:
    bench = make_bench(chip=chip)
    bench.full_speed()
    configure(bench)
    bench.context.run(100_000)
    with pytest.raises(BoardError, match=message):
        exchange(bench, *sent)


@pytest.mark.parametrize(("count", "whole"), [(14, False), (15, True), (7, True), (8, False)])
def test_chip_is_refused_when_half_a_value_is_read(fast: Bench, count: int, whole: bool) -> None:
    start_chip(fast)
    fast.context.store(TX, 1, gyro_mpu.DATA | 0x80)
    start_dma(fast, count)
    fast.context.run(200)
    expected = "read up to 0x[0-9A-F]{2}, the upper half of a value"
    with nullcontext() if whole else pytest.raises(BoardError, match=expected):
        select(fast, False)
        select(fast, True)
        fast.write("SPI1_DR", 0, 1)
        fast.context.run(10)


def test_samples_stop_when_the_chip_is_silent_or_asleep(fast: Bench) -> None:
    start_chip(fast)
    chip = fast.hardware.gyro
    fast.set("SYSCFG_EXTICR1", EXTI3=2)
    fast.set("EXTI_RTSR", TR3=1)
    chip.silent = True
    fast.context.run(1000)
    assert fast.read("EXTI_PR") == 0
    chip.silent = False
    exchange(fast, gyro_mpu.PWR_MGMT_1, 0x41)
    assert chip.next_sample is None


def test_bits_flip_when_errors_are_injected_and_repeat_with_the_seed(make_bench: type[Bench]) -> None:
    def identities(seed: int) -> list[int]:
        bench = make_bench(seed=seed)
        bench.full_speed()
        configure(bench)
        bench.context.run(100_000)
        bench.hardware.spi.bit_error_rate = 0.1
        return [exchange(bench, gyro_mpu.WHO_AM_I | 0x80, 0)[1] for _ in range(20)]

    assert identities(1) == identities(1) != identities(2)
    assert set(identities(1)) != {0x70}


def test_chip_goes_on_when_only_the_processor_is_reset(fast: Bench) -> None:
    start_chip(fast)
    due = fast.hardware.gyro.next_sample
    fast.reset("software")
    assert fast.hardware.gyro.next_sample == due
    fast.context.run(1000)
    assert fast.hardware.gyro.samples >= 8
    fast.reset("power")
    assert fast.hardware.gyro.next_sample is None
    assert fast.hardware.gyro.samples == 0


def test_counts_are_the_host_builds_when_rates_are_turned() -> None:
    # 1 rad/s = 57.29578 deg/s = 938.73 counts; half to even; clamped.
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW0) == (939, 469, -235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW90) == (-469, 939, -235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW180) == (-939, -469, -235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW270) == (469, -939, -235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW0_FLIP) == (-939, 469, 235)  # its y axis stays
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW90_FLIP) == (469, 939, 235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW180_FLIP) == (939, -469, 235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW270_FLIP) == (-469, -939, 235)
    assert gyro_counts((1.0, 0.5, -0.25), Alignment.CW0, (100, 7)) == (819, 409, -205)  # 70 mdeg/s
    assert gyro_counts((100.0, -100.0, 0.0), Alignment.CW0) == (32767, -32768, 0)
    assert accel_counts((0.0, 0.0, 9.80665), Alignment.CW180) == (0, 0, 2048)


def test_chip_continues_alike_when_restored(fast: Bench) -> None:
    start_chip(fast, FAST)
    chip = fast.hardware.gyro
    chip.measure((1, 2, 3), 4, (5, 6, 7))
    fast.context.run(200)
    registers = fast.hardware.registers.state()
    chip.measure((9, 9, 9), 9, (9, 9, 9))
    fast.context.run(200)
    fast.hardware.registers.restore(registers)
    assert exchange(fast, gyro_mpu.DATA | 0x80, *[0] * 14)[1:] == [0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0, 7]
