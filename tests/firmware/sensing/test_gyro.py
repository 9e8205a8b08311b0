"""gyro.c: counts to body rates, calibration at rest, and the health of samples."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    CALIBRATION_CALM_DEG_S,
    CALIBRATION_DRIFT_DEG_S,
    CALIBRATION_MS,
    CALIBRATION_STEP_DEG_S,
    GYRO_BAD_MS,
    GYRO_RATES_HZ,
    GYRO_SATURATED_MS,
    Alignment,
    GyroHealth,
)
from tests.sampling import sampled

LSB_RAD_S = math.radians(2000) / 32768
ALIGNMENTS = list(Alignment)


def turn(alignment: Alignment) -> Any:
    """Rotation of the chip's readings into body axes: half a turn about y if flipped, then clockwise."""
    angle = -math.radians(90 * (alignment % 4))
    clockwise = [[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]]
    return np.round(np.array(clockwise) @ np.diag([-1, 1, -1] if alignment >= 4 else [1, 1, 1]))


Gyro = Callable[..., Any]


@pytest.fixture
def make_gyro(scripted: Any) -> Gyro:
    def make(rate_hz: int = 1000, alignment: int = 0, stuck_ms: int = 0) -> Any:
        gyro = scripted.new("struct gyro *")
        assert scripted.lib.gyro_init(gyro, rate_hz, alignment, stuck_ms) == 0
        return gyro

    return make


@pytest.fixture
def step(scripted: Any) -> Callable[..., list[float]]:
    out = scripted.new("float[3]")

    def one(gyro: Any, counts: Any) -> list[float]:
        sample = scripted.new("struct imu_sample *", ([int(c) for c in counts], (0, 0, 0), 0, True))
        scripted.lib.gyro_step(gyro, sample, out)
        return list(out)

    return one


@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_rates_match_the_float64_formula_when_counts_are_random(
    make_gyro: Gyro, step: Callable[..., list[float]], alignment: Alignment
) -> None:
    gyro = make_gyro(alignment=alignment)
    rng = np.random.default_rng(alignment)
    # Half the range: no further apart than a gyro moves in a sample.
    for counts in [(-25000, 25000, -25000), *rng.integers(-25000, 25001, (500, 3))]:
        expected = turn(alignment) @ np.array(counts, float) * LSB_RAD_S
        np.testing.assert_allclose(step(gyro, counts), expected, rtol=1.2e-7, atol=0)


@pytest.mark.parametrize("rate_hz", [1000, 4000, 8000])
def test_bias_is_removed_when_the_whole_window_was_still(
    make_gyro: Gyro, step: Callable[..., list[float]], rate_hz: int
) -> None:
    gyro = make_gyro(rate_hz, alignment=1)
    bias = np.array([100, -37, 5])
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 20, (rate_hz * CALIBRATION_MS // 1000, 3)).round()
    for index, row in enumerate(noise):
        assert not gyro.calibrated, index
        step(gyro, bias + row)
    assert gyro.calibrated
    residue = np.array(step(gyro, bias)) / LSB_RAD_S
    x, y, z = -noise.mean(axis=0)
    np.testing.assert_allclose(residue, [y, -x, z], atol=1e-3)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(
    ("mean_deg_s", "sigma_deg_s", "still"),
    [(0, 4.9, True), (0, 5.1, False), (19.9, 0, True), (20.1, 0, False), (-20.1, 0, False)],
)
def test_calibration_refuses_motion_when_spread_or_mean_is_beyond_its_limit(
    make_gyro: Gyro,
    step: Callable[..., list[float]],
    axis: int,
    mean_deg_s: float,
    sigma_deg_s: float,
    still: bool,
) -> None:
    gyro = make_gyro()
    for index in range(CALIBRATION_MS):
        deg_s = mean_deg_s + (sigma_deg_s if index % 2 else -sigma_deg_s)
        counts = [0, 0, 0]
        counts[axis] = round(deg_s * 32768 / 2000)
        step(gyro, counts)
    assert bool(gyro.calibrated) is still


def test_calibration_begins_anew_when_the_first_window_saw_motion(
    make_gyro: Gyro, step: Callable[..., list[float]]
) -> None:
    gyro = make_gyro()
    step(gyro, (30000, 0, 0))
    for _ in range(2 * CALIBRATION_MS - 2):
        step(gyro, (10, 0, 0))
    assert not gyro.calibrated
    step(gyro, (10, 0, 0))
    assert gyro.calibrated
    assert step(gyro, (10, 0, 0)) == [0, 0, 0]


@pytest.mark.parametrize("pair", [(-32759, -32759), (32759, 32759), (-20000, 31000)])
def test_sums_do_not_overflow_when_counts_are_extreme(
    make_gyro: Gyro, step: Callable[..., list[float]], pair: tuple[int, int]
) -> None:
    gyro = make_gyro(8000)
    for index in range(8 * CALIBRATION_MS):
        step(gyro, (pair[index % 2],) * 3)
    assert not gyro.calibrated


def test_init_refuses_when_the_alignment_is_unknown(scripted: Any) -> None:
    gyro = scripted.new("struct gyro *")
    assert scripted.lib.gyro_init(gyro, 1000, len(Alignment), 0) == scripted.lib.NF_ERR_ALIGNMENT


# --- What is believed -----------------------------------------------------------------------------
GOOD, INVALID = GyroHealth.GOOD, GyroHealth.INVALID
STUCK, SATURATED = GyroHealth.STUCK, GyroHealth.SATURATED
MOST = 32759  # counts: the largest that are no saturation


class Chip:
    """A gyro of its own and the samples it gets."""

    def __init__(self, core: Any, rate_hz: int = 1000, *, stuck_ms: int = 0, alignment: int = 0) -> None:
        self._core = core
        self.rate_hz = rate_hz
        self.struct = core.new("struct gyro *")
        assert core.lib.gyro_init(self.struct, rate_hz, alignment, stuck_ms) == 0
        self._out = core.new("float[3]")

    def feed(
        self,
        counts: Any = (0, 0, 0),
        *,
        accel: Any = (0, 0, 2048),
        temperature: int = 100,
        valid: bool = True,
        times: int = 1,
    ) -> GyroHealth:
        """So many samples; returns the health after the last."""
        sample = self._core.new("struct imu_sample *", (counts, accel, temperature, valid))
        for _ in range(times):
            health = self._core.lib.gyro_step(self.struct, sample, self._out)
        assert self.struct.health == health
        return GyroHealth(health)

    def samples(self, ms: int) -> int:
        return self.rate_hz * ms // 1000

    @property
    def counts(self) -> list[int]:
        """What the rates are in counts, bias added."""
        return [round((r + b) / LSB_RAD_S) for r, b in zip(self._out, self.struct.bias, strict=True)]


@pytest.fixture
def chip(scripted: Any) -> Callable[..., Chip]:
    return lambda *args, **kwargs: Chip(scripted, *args, **kwargs)


@pytest.mark.parametrize("rate_hz", GYRO_RATES_HZ)
def test_the_last_good_sample_stands_in_until_bad_ones_are_too_many(
    chip: Callable[..., Chip], rate_hz: int
) -> None:
    sample: dict[str, Any] = {"counts": (9, 9, 9), "valid": False}
    c = chip(rate_hz)
    c.feed((500, -600, 700))
    glitch = c.samples(GYRO_BAD_MS) - 1
    for roll in (501, 502, 503):  # a glitch leaves no trace
        for _ in range(glitch):
            assert c.feed(**sample) is GOOD
            assert c.counts == [roll - 1, -600, 700]
        assert c.feed((roll, -600, 700)) is GOOD
        assert c.counts == [roll, -600, 700]
    assert c.feed(**sample, times=glitch) is GOOD
    assert c.feed(**sample) is INVALID
    assert c.feed(**sample, times=10 * glitch) is INVALID
    assert c.counts == [503, -600, 700]
    assert c.feed((504, -600, 700)) is GOOD


ENDS = [(500, -600, MOST + 1), (-MOST - 1, -600, 700), (500, -32768, 700), (32767, 32767, 32767)]


@pytest.mark.parametrize("rate_hz", GYRO_RATES_HZ)
@pytest.mark.parametrize("end", ENDS)
def test_an_axis_at_the_end_of_its_range_is_flown_as_it_is_until_that_lasts(
    scripted: Any, chip: Callable[..., Chip], rate_hz: int, end: tuple[int, int, int]
) -> None:
    c = chip(rate_hz)
    near = [max(-MOST, min(count, MOST)) for count in end]
    for fast in (0.5, 1.0):  # no further apart than a gyro moves in a sample
        for _ in range(8):
            assert c.feed([round(fast * count) for count in near]) is GOOD
    assert c.counts == near
    lasts = c.samples(GYRO_SATURATED_MS)
    for times in (1, lasts - 1):
        assert c.feed(end, times=times) is SATURATED
        assert c.counts == list(end)
        assert not scripted.lib.gyro_railed(c.struct)
        assert c.feed(near) is GOOD
    assert c.feed(end, times=lasts) is SATURATED
    assert scripted.lib.gyro_railed(c.struct)
    assert c.feed(near) is GOOD
    assert not scripted.lib.gyro_railed(c.struct)


def test_saturation_goes_on_when_a_glitch_falls_into_it(scripted: Any, chip: Callable[..., Chip]) -> None:
    c = chip()
    c.feed((MOST, 0, 0))
    c.feed((32767, 0, 0), times=GYRO_SATURATED_MS - 1)
    assert c.feed(valid=False, times=GYRO_BAD_MS - 1) is SATURATED
    assert not scripted.lib.gyro_railed(c.struct)
    assert c.feed((32767, 0, 0)) is SATURATED
    assert scripted.lib.gyro_railed(c.struct)


def test_health_names_the_latest_trouble_when_it_changes(chip: Callable[..., Chip]) -> None:
    c = chip(stuck_ms=10)
    c.feed((MOST, 0, 0))
    assert c.feed((32767, 0, 0)) is SATURATED
    assert c.feed((32767, 0, 0), times=10) is STUCK
    assert c.feed(valid=False, times=10) is INVALID
    assert c.feed((32766, 0, 0)) is SATURATED
    assert c.feed((MOST, 0, 0)) is GOOD


def test_a_spike_to_the_end_is_a_glitch_when_the_chip_could_not_have_made_it(
    chip: Callable[..., Chip],
) -> None:
    c = chip(4000)
    c.feed((500, -600, 700))
    assert c.feed((32767, -600, 700)) is GOOD
    assert c.counts == [500, -600, 700]


# What the chips' 250 Hz low-pass of first order lets through of a step over the whole range, in a sample.
JUMP_DEG_S = {hz: 4000 * (1 - math.exp(-2 * math.pi * 250 / hz)) for hz in GYRO_RATES_HZ}


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize("rate_hz", [2000, 4000, 8000])
def test_a_jump_is_a_glitch_when_the_chip_could_not_have_made_it(
    chip: Callable[..., Chip], rate_hz: int, axis: int, sign: int
) -> None:
    jump = int(JUMP_DEG_S[rate_hz] * 32768 / 2000)
    c = chip(rate_hz)
    start = np.array([-sign * jump // 2] * 3)
    c.feed([0, 0, 0])
    c.feed(start.tolist())
    beyond, within = start.copy(), start.copy()
    beyond[axis] += sign * (jump + 2)
    within[axis] += sign * (jump - 1)
    c.feed(beyond.tolist())
    assert c.counts == start.tolist()
    c.feed(within.tolist())
    assert c.counts == within.tolist()
    c.feed(start.tolist())
    assert c.counts == start.tolist()


def test_a_lasting_change_is_taken_over_when_it_could_have_happened_meanwhile(
    chip: Callable[..., Chip],
) -> None:
    c = chip(8000)
    c.feed((0, 0, 0))
    far = round(1800 * 32768 / 2000)
    taken = [c.feed((far, 0, 0)) is GOOD and c.counts[0] == far for _ in range(4)]
    assert taken == [False, False, True, True], "713 deg/s a sample"


@pytest.mark.parametrize("rate_hz", GYRO_RATES_HZ)
def test_no_flip_is_a_glitch_when_it_is_the_fiercest(chip: Callable[..., Chip], rate_hz: int) -> None:
    """1900 deg/s to either side within 10 ms, ten times what a racer does, with noise of 5 deg/s."""
    rng = np.random.default_rng(1)
    t = np.arange(rate_hz) / rate_hz
    deg_s = 1900 * np.sin(2 * np.pi * 50 * t)[:, None] + rng.normal(0, 5, (rate_hz, 3))
    c = chip(rate_hz)
    for counts in np.rint(deg_s * 32768 / 2000).astype(int).tolist():
        assert c.feed(counts) is GOOD
        assert c.counts == counts


@pytest.mark.parametrize("stuck_ms", [1, 10, 250])
@pytest.mark.parametrize("rate_hz", [1000, 8000])
def test_the_gyro_is_stuck_when_every_word_stays_the_same_for_the_time_set(
    chip: Callable[..., Chip], rate_hz: int, stuck_ms: int
) -> None:
    c = chip(rate_hz, stuck_ms=stuck_ms)
    repeats = c.samples(stuck_ms)
    assert c.feed((5, 6, 7), times=repeats) is GOOD, "the first is no repetition"
    assert c.feed((5, 6, 7)) is STUCK
    assert c.feed((5, 6, 7), times=2 * repeats) is STUCK
    assert c.counts == [5, 6, 7]
    assert c.feed((5, 6, 8)) is GOOD
    assert c.feed((5, 6, 8), times=repeats) is STUCK


@pytest.mark.parametrize(
    "other",
    [
        {"counts": (0, 0, 1)},
        {"counts": (0, 1, 0)},
        {"counts": (1, 0, 0)},
        {"accel": (0, 0, 2049)},
        {"accel": (0, 1, 2048)},
        {"accel": (1, 0, 2048)},
        {"temperature": 101},
    ],
)
def test_the_gyro_lives_when_one_word_moves(chip: Callable[..., Chip], other: dict[str, Any]) -> None:
    c = chip(stuck_ms=10)
    for _ in range(10):
        assert c.feed(times=9) is GOOD
        assert c.feed(**other) is GOOD


def test_a_frozen_gyro_is_stuck_when_transfers_fail_now_and_then(chip: Callable[..., Chip]) -> None:
    c = chip(stuck_ms=10)
    c.feed(times=6)
    c.feed(valid=False, times=3)
    assert c.feed(times=5) is STUCK
    assert c.feed(valid=False) is STUCK, "a glitch changes nothing"


def test_the_same_sample_is_believed_for_ever_when_the_setting_says_never(chip: Callable[..., Chip]) -> None:
    assert chip(stuck_ms=0).feed(times=20_000) is GOOD


def test_rates_are_zero_when_there_was_no_good_sample_yet(chip: Callable[..., Chip]) -> None:
    c = chip()
    for _ in range(20):
        c.feed(valid=False)
        assert c.counts == [0, 0, 0]


@pytest.mark.parametrize("trouble", [{"valid": False}, {"counts": (32767, 0, 0)}])
def test_calibration_begins_anew_when_a_sample_is_bad(
    chip: Callable[..., Chip], trouble: dict[str, Any]
) -> None:
    c = chip()
    c.feed((10, 0, 0), times=CALIBRATION_MS - 1)
    c.feed(**trouble)
    c.feed((10, 0, 0), times=CALIBRATION_MS - 1)
    assert not c.struct.calibrated
    c.feed((10, 0, 0))
    assert c.struct.calibrated


def test_calibration_waits_when_the_gyro_is_stuck(chip: Callable[..., Chip]) -> None:
    c = chip(stuck_ms=10)
    assert c.feed((10, 0, 0), times=5 * CALIBRATION_MS) is STUCK
    assert not c.struct.calibrated
    for index in range(CALIBRATION_MS):
        c.feed((10, 0, 1 + index % 2))
    assert c.struct.calibrated


def test_the_bias_stays_when_a_calibrated_gyro_fails(chip: Callable[..., Chip]) -> None:
    c = chip()
    c.feed((10, -20, 30), times=CALIBRATION_MS)
    c.feed(valid=False, times=100)
    c.feed((0, 0, 0))
    assert [round(b / LSB_RAD_S) for b in c.struct.bias] == [10, -20, 30]


# --- What else the chip tells ----------------------------------------------------------------------
@pytest.mark.parametrize("alignment", ALIGNMENTS)
def test_acceleration_is_in_body_axes_when_the_chip_is_turned(
    scripted: Any, chip: Callable[..., Chip], alignment: Alignment
) -> None:
    c = chip(alignment=alignment)
    c.feed(accel=(100, -2000, 2048))
    out = scripted.new("float[3]")
    scripted.lib.gyro_acceleration(c.struct, out)
    expected = (turn(alignment) @ np.array([100, -2000, 2048]) / 2048 * 9.80665).tolist()
    assert list(out) == pytest.approx(expected, rel=1e-6)
    c.feed(accel=(7, 7, 7), valid=False)
    scripted.lib.gyro_acceleration(c.struct, out)
    assert list(out) == pytest.approx(expected, rel=1e-6)


def test_temperature_is_the_data_sheets_when_the_chip_is_known(
    scripted: Any, chip: Callable[..., Chip]
) -> None:
    c = chip()
    c.feed(temperature=3339)
    assert scripted.lib.gyro_temperature_c(c.struct, scripted.lib.GYRO_MPU6500) == pytest.approx(
        31.0, abs=0.01
    )
    c.feed(temperature=-3268)
    for name in ("ICM20689", "ICM20602", "ICM20601", "ICM20608G"):
        told = scripted.lib.gyro_temperature_c(c.struct, getattr(scripted.lib, f"GYRO_{name}"))
        assert told == pytest.approx(15.0, abs=0.01)
    told = scripted.lib.gyro_temperature_c(c.struct, scripted.lib.GYRO_MPU9250)
    assert told == pytest.approx(21.0 - 9.788, abs=0.01)
    for name, deg_c in (
        ("MPU6000", 26.918),
        ("ICM42688P", 0.332),
        ("LSM6DSV16X", 12.234),
        ("BMI270", 16.617),
    ):
        told = scripted.lib.gyro_temperature_c(c.struct, getattr(scripted.lib, f"GYRO_{name}"))
        assert told == pytest.approx(deg_c, abs=0.01)


# --- The bias of motors that stand ----------------------------------------------------------------
COUNTS_PER_DEG_S = 32768 / 2000
NOISE_DEG_S = 1.45  # of the NF1's noisiest axis


class Rest(Chip):
    """A calibrated gyro whose motors stand."""

    def __init__(self, core: Any, rate_hz: int = 1000, alignment: int = 0) -> None:
        super().__init__(core, rate_hz, alignment=alignment)
        self._rng = np.random.default_rng(rate_hz)
        self.lie((0.0, 0.0, 0.0), 1)
        assert self.struct.calibrated

    def lie(self, deg_s: Any, seconds: float, noise_deg_s: float = NOISE_DEG_S) -> list[float]:
        """The chip tells these rates so long; returns the bias [deg/s], chip axes."""
        count = round(seconds * self.rate_hz)
        rates = np.array(deg_s) + self._rng.normal(0, noise_deg_s, (count, 3))
        for counts in (rates * COUNTS_PER_DEG_S).round().astype(int).tolist():
            self.feed(counts)
        return self.bias_deg_s

    @property
    def bias_deg_s(self) -> list[float]:
        return [math.degrees(axis) for axis in self.struct.bias]

    def turn_motors(self, turning: bool) -> None:
        self._core.lib.gyro_rest(self.struct, not turning)


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_the_bias_follows_a_chip_that_warms_up(scripted: Any, rate_hz: int) -> None:
    """1 deg/s in a minute: no flight computer's chip drifts faster while it lies there."""
    rest = Rest(scripted, rate_hz)
    for second in range(60):
        drift = second / 60
        rest.lie((drift, -drift, drift / 2), 1)
        assert rest.struct.calibrated, "arming is never held up"
    np.testing.assert_allclose(rest.bias_deg_s, [1.0, -1.0, 0.5], atol=0.15)


def test_the_bias_follows_in_body_axes(scripted: Any) -> None:
    rest = Rest(scripted, alignment=1)
    rest.lie((0.5, 0.0, -0.25), 20)
    np.testing.assert_allclose(rest.bias_deg_s, [0.0, -0.5, -0.25], atol=0.15)


@pytest.mark.parametrize("rate_hz", [1000, 8000])
def test_the_bias_moves_once_a_second_and_by_a_little_at_most(scripted: Any, rate_hz: int) -> None:
    rest = Rest(scripted, rate_hz)
    before = rest.bias_deg_s
    step = (1.0, -1.0, 0.0)
    rest.lie(step, (rate_hz - 1) / rate_hz, noise_deg_s=0.0)
    assert rest.bias_deg_s == before
    rest.lie(step, 1 / rate_hz, noise_deg_s=0.0)
    moved = np.array(rest.bias_deg_s) - before
    np.testing.assert_allclose(moved[:2], [CALIBRATION_STEP_DEG_S, -CALIBRATION_STEP_DEG_S], rtol=1e-4)
    assert abs(moved[2]) <= CALIBRATION_STEP_DEG_S * 1.0001


@pytest.mark.parametrize("axis", sampled(range(3), 1))
@pytest.mark.parametrize(
    ("deg_s", "noise_deg_s"),
    [
        (CALIBRATION_DRIFT_DEG_S + 0.5, 0.5),  # turned by hand, steadily
        (-CALIBRATION_DRIFT_DEG_S - 0.5, 0.5),
        (15.0, 0.5),  # which a first calibration would take
        (1.0, CALIBRATION_CALM_DEG_S + 0.3),  # a hand that trembles
    ],
)
def test_the_bias_stays_when_a_hand_turns_the_aircraft(
    scripted: Any, axis: int, deg_s: float, noise_deg_s: float
) -> None:
    rest = Rest(scripted)
    before = rest.bias_deg_s
    rates = [0.0] * 3
    rates[axis] = deg_s
    rest.lie(rates, 30, noise_deg_s)
    assert rest.bias_deg_s == before


def test_a_slow_turntable_spoils_little_and_for_no_longer_than_it_turns(scripted: Any) -> None:
    rest = Rest(scripted)
    start = np.array(rest.bias_deg_s)
    rest.lie((0.0, 0.0, 2.0), 10)
    spoilt = np.array(rest.bias_deg_s) - start
    assert 0.9 * 10 * CALIBRATION_STEP_DEG_S < spoilt[2] < 1.01 * 10 * CALIBRATION_STEP_DEG_S
    rest.lie((0.0, 0.0, 0.0), 12)
    np.testing.assert_allclose(rest.bias_deg_s, start, atol=0.12)


def test_the_bias_stays_while_motors_turn_and_what_came_before_is_no_part_of_a_window(scripted: Any) -> None:
    rest = Rest(scripted)
    before = rest.bias_deg_s
    rest.lie((1.0, 1.0, 1.0), 0.9)
    rest.turn_motors(True)
    rest.lie((1.0, 1.0, 1.0), 20)
    assert rest.bias_deg_s == before
    rest.turn_motors(False)
    rest.lie((1.0, 1.0, 1.0), 0.9)
    rest.turn_motors(False)
    assert rest.bias_deg_s == before
    rest.lie((1.0, 1.0, 1.0), 0.1)
    assert rest.bias_deg_s != before


def test_a_bad_sample_ends_the_window(scripted: Any) -> None:
    rest = Rest(scripted)
    before = rest.bias_deg_s
    for _ in range(5):
        rest.lie((1.0, 1.0, 1.0), 0.99)
        rest.feed(valid=False)
    assert rest.bias_deg_s == before
