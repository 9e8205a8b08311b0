"""hal/host/convert.c: the simulator's values converted to those of a board's sensors."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import Alignment

SBUS, CRSF, MSP = range(3)  # choices of the setting receiver_protocol


def counts_of(core: Any, rates_frd: list[float], alignment: int = 0) -> list[int] | None:
    out = core.new("int16_t[3]", [1, 2, 3])
    good = core.lib.convert_rates(rates_frd, alignment, out)
    assert good or list(out) == [1, 2, 3], "counts must be left alone"
    return list(out) if good else None


def test_counts_are_the_nearest_when_rates_are_random(scripted: Any) -> None:
    rng = np.random.default_rng(11)
    for rates in rng.uniform(-35, 35, (2000, 3)).tolist():
        exact = [Fraction(math.degrees(rate)) * 32768 / 2000 for rate in rates]
        expected = [min(max(round(value), -32768), 32767) for value in exact]
        assert counts_of(scripted, [rates[0], -rates[1], -rates[2]]) == expected


def test_halves_go_to_the_even_count_when_a_rate_lies_between_two(scripted: Any) -> None:
    tried = set()
    for halves in range(1, 200, 2):
        deg_s = halves * 125 / 4096  # 16.384 counts a deg/s: so many half counts exactly
        near = math.radians(deg_s)
        for rate in (near, math.nextafter(near, 0), math.nextafter(near, 1)):
            if rate * (180 / math.pi) == deg_s:
                even = (halves + 1) // 4 * 2
                assert counts_of(scripted, [rate, rate, -rate]) == [even, -even, even]
                tried.add(halves % 4)
    assert tried == {1, 3}, "halves above and below an even count"


@pytest.mark.parametrize("rate", [math.inf, 1e300, 35.0])
def test_counts_saturate_when_a_rate_is_beyond_the_chip(scripted: Any, rate: float) -> None:
    assert counts_of(scripted, [rate, rate, -rate]) == [32767, -32768, 32767]
    assert counts_of(scripted, [-rate, -rate, rate]) == [-32768, 32767, -32768]


@pytest.mark.parametrize("axis", range(3))
def test_rates_are_refused_when_one_is_nan(scripted: Any, axis: int) -> None:
    rates = [1.0, 2.0, 3.0]
    rates[axis] = math.nan
    assert counts_of(scripted, rates) is None


@pytest.mark.parametrize("alignment", Alignment)
def test_the_core_reads_the_true_body_rates_back_when_the_chip_is_turned(
    scripted: Any, alignment: int
) -> None:
    gyro, rate = scripted.new("struct gyro *"), scripted.new("float[3]")
    assert scripted.lib.gyro_init(gyro, 1000, alignment, 0) == 0
    rng = np.random.default_rng(alignment)
    half_count = math.radians(2000) / 32768 / 2
    for body in rng.uniform(-20, 20, (200, 3)).tolist():  # no further apart than a gyro moves in a sample
        counts = counts_of(scripted, [body[0], -body[1], -body[2]], alignment)
        scripted.lib.gyro_step(gyro, scripted.new("struct imu_sample *", (counts, [0] * 3, 0, True)), rate)
        np.testing.assert_allclose(list(rate), body, atol=1.01 * half_count)


@pytest.fixture(params=["sbus", "crsf"])
def carried(scripted: Any, request: pytest.FixtureRequest) -> Callable[[list[int]], list[int]]:
    """Return channels after a frame of the protocol and the firmware's parser."""
    lib, wire = scripted.lib, scripted.new("uint8_t[26]")
    parser, frame = scripted.new(f"struct {request.param} *"), scripted.new(f"struct {request.param}_frame *")

    def by_sbus(channels: list[int]) -> list[int]:
        assert lib.convert_frame(SBUS, channels, wire) == 25
        assert [lib.sbus_push(parser, byte, frame) for byte in wire[0:25]] == [False] * 24 + [True]
        assert (frame.frame_lost, frame.failsafe) == (False, False)
        return list(frame.channels_us)

    def by_crsf(channels: list[int]) -> list[int]:
        assert lib.convert_frame(CRSF, channels, wire) == 26
        taken = 0
        while taken < 26:
            assert not lib.crsf_take(parser, False, frame)
            taken += lib.crsf_put(parser, wire + taken, 26 - taken)
        assert lib.crsf_take(parser, False, frame)
        assert frame.kind == lib.CRSF_CHANNELS
        return list(frame.channels_us)

    return by_sbus if request.param == "sbus" else by_crsf


def test_channels_come_through_the_parser_unchanged_when_the_protocol_can_say_them(
    carried: Callable[[list[int]], list[int]],
) -> None:
    for us in range(880, 2160):
        channels = [880 + (us - 880 + 80 * index) % 1280 for index in range(16)]
        assert carried(channels) == channels


def test_channels_are_sent_as_the_nearer_end_when_the_protocol_cannot_say_them(
    carried: Callable[[list[int]], list[int]],
) -> None:
    for us, end in [(0, 880), (879, 880), (2160, 2159), (65535, 2159)]:
        assert carried([us] * 16) == [end] * 16


def test_nothing_is_sent_when_the_protocol_has_no_line(scripted: Any) -> None:
    assert scripted.lib.convert_frame(MSP, [1500] * 16, scripted.new("uint8_t[26]")) == 0


def test_dshot_is_decoded_as_an_esc_does_when_a_motor_runs_or_stops(scripted: Any) -> None:
    assert [scripted.lib.convert_dshot(value) for value in (0, 1, 47, 48, 2047)] == [0, 0, 0, 0, 1]
    for value in range(48, 2048):
        assert scripted.lib.convert_dshot(value) == np.float32((value - 48) / 1999)
