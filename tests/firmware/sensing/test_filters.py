"""filters.c and dynamic_notch.c: responses measured sample by sample, against scipy's."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import GYRO_RATES_HZ, POLICY_FILTERS_NONE, FilterKind
from neuroflight.toolchain.policy.blob import filters_hash
from tests.sampling import sampled

Array = NDArray[np.float64]
STATE_BYTES_MAX = 600  # of DTCM
FREQUENCIES = 200  # at which responses are compared


class Filters:
    """A chain of its own."""

    def __init__(self, core: Any, rate_hz: int, **settings: float) -> None:
        self._core = core
        self.settings = core.new("struct nf_settings *")
        core.lib.settings_default(self.settings)
        for name, value in settings.items():
            setattr(self.settings, name, value)
        self.struct = core.new("struct filters *")
        core.lib.filters_init(self.struct, self.settings, rate_hz)
        self._rate = core.new("float[3]")

    def step(self, rate: Any) -> list[float]:
        self._rate[0:3] = [float(value) for value in rate]
        self._core.lib.filters_step(self.struct, self._rate)
        return list(self._rate)

    def run(self, rates: Array) -> Array:
        """Rows (N, 3) in, rows out."""
        return np.array([self.step(row) for row in rates])

    @property
    def hash(self) -> int:
        return int(self._core.lib.filters_hash(self.settings))


Make = Callable[..., Filters]


@pytest.fixture
def make(scripted: Any) -> Make:
    return lambda rate_hz=4000, **settings: Filters(scripted, rate_hz, **settings)


def stage(number: int, kind: FilterKind, hz: float, q: float = 0.70710678) -> dict[str, float]:
    return {f"filter{number}_kind": int(kind), f"filter{number}_hz": hz, f"filter{number}_q": q}


def expected_response(kind: FilterKind, hz: float, q: float, rate_hz: int, at_hz: Array) -> Array:
    """Complex response of scipy's digital filter."""
    order = {FilterKind.PT1: 1, FilterKind.PT2: 2, FilterKind.PT3: 3}.get(kind)
    if order is not None:
        # Real poles of which all together are 3 dB down at hz, brought over by e^(pole / rate).
        widest = hz / np.sqrt(2 ** (1 / order) - 1)
        pole = np.exp(-2 * np.pi * widest / rate_hz)
        system = (np.zeros(order), np.full(order, pole), (1 - pole) ** order)
    else:
        w = 2 * rate_hz * np.tan(np.pi * hz / rate_hz)  # bends back to hz under the bilinear transform
        zeros = [w * w] if kind is FilterKind.BIQUAD else [1, 0, w * w]
        system = signal.tf2zpk(*signal.bilinear(zeros, [1, w / q, w * w], rate_hz))
    response: Array = signal.freqz_zpk(*system, worN=at_hz, fs=rate_hz)[1]
    return response


def measured_response(impulse: Array, rate_hz: int, at_hz: Array) -> Array:
    """Complex response of what came out after an impulse of 1, (N,)."""
    response: Array = np.exp(-2j * np.pi * np.outer(at_hz / rate_hz, np.arange(len(impulse)))) @ impulse
    return response


def impulse_response(filters: Filters, count: int) -> Array:
    """(count, 3) of an impulse of 1, -2 and 4 on roll, pitch and yaw, over those heights."""
    heights = np.array([1.0, -2.0, 4.0])
    rates = np.zeros((count, 3))
    rates[0] = heights
    response: Array = filters.run(rates) / heights
    return response


@pytest.mark.parametrize("rate_hz", sampled(GYRO_RATES_HZ, 1000, 8000))
@pytest.mark.parametrize(
    ("kind", "hz", "q"),
    [
        *(
            (kind, hz, 0.70710678)
            for kind in (FilterKind.PT1, FilterKind.PT2, FilterKind.PT3)
            for hz in (20, 100, 450)
        ),
        *((FilterKind.BIQUAD, hz, q) for hz in (20, 100, 450) for q in (0.5, 0.70710678, 2.0)),
        *((FilterKind.NOTCH, hz, q) for hz in (60, 180, 450) for q in (0.5, 3.0, 10.0)),
    ],
)
def test_response_is_scipys_when_measured_from_dc_to_nyquist(
    make: Make, rate_hz: int, kind: FilterKind, hz: float, q: float
) -> None:
    lasts = 2 * rate_hz if q >= 10 else rate_hz // 2
    impulse = impulse_response(make(rate_hz, **stage(1, kind, hz, q)), lasts)
    for axis in (1, 2):  # powers of two change no digit, but for the smallest numbers of all
        np.testing.assert_allclose(impulse[:, axis], impulse[:, 0], rtol=0, atol=1e-36)
    at_hz = np.linspace(0, rate_hz / 2, FREQUENCIES)
    difference = measured_response(impulse[:, 0], rate_hz, at_hz) - expected_response(
        kind, hz, q, rate_hz, at_hz
    )
    assert np.abs(difference).max() < 1e-4


def test_half_the_power_passes_when_a_low_pass_is_at_its_cutoff(make: Make) -> None:
    for kind in (FilterKind.PT1, FilterKind.PT2, FilterKind.PT3, FilterKind.BIQUAD):
        impulse = impulse_response(make(8000, **stage(1, kind, 80.0)), 4000)[:, 0]
        assert abs(measured_response(impulse, 8000, np.array([80.0]))[0]) == pytest.approx(0.5**0.5, rel=0.03)


@pytest.mark.parametrize("kind", [FilterKind.PT1, FilterKind.PT3, FilterKind.BIQUAD, FilterKind.NOTCH])
def test_a_constant_passes_unchanged_when_the_frequency_is_the_lowest(make: Make, kind: FilterKind) -> None:
    """1 Hz at 8 kHz, where a direct form in float32 would lose a tenth."""
    out = make(8000, **stage(1, kind, 1.0)).run(np.full((40000, 3), 5.0))
    assert out[-1] == pytest.approx([5.0] * 3, rel=1e-4)
    if kind is not FilterKind.NOTCH:
        after = np.exp(-1.0)  # of a PT1: a time constant of 159 ms
        if kind is FilterKind.PT1:
            assert out[round(8000 / (2 * np.pi)), 0] == pytest.approx(5 * (1 - after), rel=1e-3)


def test_stages_work_one_after_the_other_when_there_are_four(make: Make) -> None:
    chain = [
        (FilterKind.PT2, 150.0, 1.0),
        (FilterKind.NOTCH, 250.0, 4.0),
        (FilterKind.BIQUAD, 300.0, 1.2),
        (FilterKind.PT1, 400.0, 1.0),
    ]
    settings = {k: v for i, (kind, hz, q) in enumerate(chain, 1) for k, v in stage(i, kind, hz, q).items()}
    at_hz = np.linspace(0, 2000, FREQUENCIES)
    expected = np.prod([expected_response(kind, hz, q, 4000, at_hz) for kind, hz, q in chain], axis=0)
    impulse = impulse_response(make(4000, **settings), 2000)[:, 0]
    assert np.abs(measured_response(impulse, 4000, at_hz) - expected).max() < 1e-4


@pytest.mark.parametrize("kind", [FilterKind.BIQUAD, FilterKind.NOTCH])
def test_a_stage_is_left_out_when_there_is_nothing_to_take_away(make: Make, kind: FilterKind) -> None:
    rates = np.float32(np.random.default_rng(2).normal(size=(50, 3))).astype(float)
    assert np.array_equal(make(1000, **stage(1, kind, 500.0)).run(rates), rates)
    assert not np.array_equal(make(1000, **stage(1, kind, 499.0)).run(rates), rates)


def test_not_one_bit_changes_when_there_is_no_stage(make: Make) -> None:
    rates = np.random.default_rng(3).normal(size=(2000, 3)) * 10.0 ** np.random.default_rng(4).uniform(
        -40, 2, (2000, 1)
    )
    rates[:4, 0] = [0.0, -0.0, 1e-45, -1e-45]
    sent = rates.astype(np.float32)
    got = make().run(sent.astype(float)).astype(np.float32)
    assert got.tobytes() == sent.tobytes()


# --- Notches that follow --------------------------------------------------------------------------
def tones(
    rate_hz: int, seconds: float, parts: dict[float, float], noise: float = 0.02, seed: int = 5
) -> Array:
    """Sines of so many rad/s on every axis, a phase each, and white noise, (N, 3)."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(rate_hz * seconds)) / rate_hz
    out = rng.normal(0, noise, (len(t), 3))
    for hz, amplitude in parts.items():
        out += amplitude * np.sin(2 * np.pi * hz * t[:, None] + rng.uniform(0, 2 * np.pi, 3))
    return out


def loss_db(before: Array, after: Array, rate_hz: int, hz: float) -> Array:
    """How much weaker a tone is in the rows of `after`, for each axis."""
    wave = np.exp(-2j * np.pi * hz / rate_hz * np.arange(len(before)))
    weight = signal.windows.hann(len(before)) * wave
    loss: Array = 20 * np.log10(np.abs(weight @ before) / np.abs(weight @ after))
    return loss


FOLLOWING = {
    "dynamic_notch_count": 2,
    "dynamic_notch_low_hz": 100,
    "dynamic_notch_high_hz": 600,
    "dynamic_notch_q": 3,
}


@pytest.mark.parametrize("rate_hz", GYRO_RATES_HZ)
def test_two_tones_go_and_what_the_pilot_does_stays_when_notches_follow(make: Make, rate_hz: int) -> None:
    found, other = (180.0, 310.0)
    rates = tones(rate_hz, 1.5, {found: 0.8, other: 0.5, 20.0: 3.0})
    out = make(rate_hz, **FOLLOWING).run(rates)
    from_here = slice(rate_hz // 2, None)
    for hz in (found, other):
        assert loss_db(rates[from_here], out[from_here], rate_hz, hz).min() > 15, hz
    assert np.abs(loss_db(rates[from_here], out[from_here], rate_hz, 20.0)).max() < 1


@pytest.mark.parametrize(
    ("low", "high", "hz"),
    [
        *((100, 600, hz) for hz in (137.0, 211.3, 333.3, 550.0)),
        *((80, 400, hz) for hz in (120.0, 211.3, 380.0)),
        *((60, 2000, hz) for hz in (333.3, 1000.0, 1700.0)),
    ],
)
def test_one_tone_goes_when_it_lies_anywhere_between_the_bins(
    make: Make, low: float, high: float, hz: float
) -> None:
    rates = tones(4000, 2.0, {hz: 1.0})
    out = make(4000, dynamic_notch_count=1, dynamic_notch_low_hz=low, dynamic_notch_high_hz=high).run(rates)
    assert loss_db(rates[4000:], out[4000:], 4000, hz).min() > 15


def test_each_axis_has_its_own_notch_when_tones_differ(make: Make) -> None:
    hz = (170.0, 290.0, 450.0)
    t = np.arange(8000) / 4000
    rates = np.stack([np.sin(2 * np.pi * f * t) for f in hz], axis=1)
    rates += np.random.default_rng(6).normal(0, 0.02, rates.shape)
    out = make(4000, dynamic_notch_count=1).run(rates)
    for axis, f in enumerate(hz):
        assert loss_db(rates[4000:], out[4000:], 4000, f)[axis] > 15


def test_a_notch_follows_when_its_tone_moves(make: Make) -> None:
    """150 to 400 Hz over four seconds, as a rotor that speeds up; the residue within its last second."""
    t = np.arange(5 * 4000) / 4000
    hz = np.interp(t, [0.5, 4.5], [150, 400])
    rates = np.sin(2 * np.pi * np.cumsum(hz) / 4000)[:, None] + np.random.default_rng(7).normal(
        0, 0.02, (len(t), 3)
    )
    out = make(4000, dynamic_notch_count=1).run(rates)
    assert out[-6000:-2000].std() < 0.5 * rates[-6000:-2000].std()
    assert out[-1200:].std() < 0.15 * rates[-1200:].std()


def test_three_tones_go_when_there_are_three_notches(make: Make) -> None:
    parts = {150.0: 0.6, 260.0: 0.6, 430.0: 0.6}
    rates = tones(4000, 2.0, parts)
    out = make(4000, dynamic_notch_count=3).run(rates)
    for hz in parts:
        assert loss_db(rates[4000:], out[4000:], 4000, hz).min() > 15, hz


@pytest.mark.parametrize("hz", [143.0, 205.0, 390.0])
def test_only_one_notch_is_placed_when_there_is_one_tone_and_its_side_lobes(make: Make, hz: float) -> None:
    filters = make(4000, dynamic_notch_count=3)
    filters.run(tones(4000, 1.0, {hz: 1.0}, noise=0.0))
    for axis in range(3):
        placed = [notch.gain for notch in filters.struct.dynamic.notch[axis] if notch.gain > 0]
        assert np.arctan(placed) * 4000 / np.pi == pytest.approx([hz], abs=1.0)


def test_a_faint_tone_is_followed_when_the_loud_one_before_it_has_gone(make: Make) -> None:
    filters = make(4000, dynamic_notch_count=1)
    filters.run(tones(4000, 0.5, {200.0: 1.0}, noise=0.0005))
    rates = tones(4000, 1.5, {400.0: 0.02}, noise=0.0005)
    out = filters.run(rates)
    assert loss_db(rates[4000:], out[4000:], 4000, 400.0).min() > 15


def test_a_notch_seldom_moves_when_there_is_only_noise(make: Make) -> None:
    filters = make(4000, dynamic_notch_count=1)
    window = filters.struct.dynamic.window
    moved, windows = 0, 0
    for row in np.random.default_rng(9).normal(0, 1, (5 * 4000, 3)):
        filters.step(row)
        d = filters.struct.dynamic
        if d.position == window + 5:  # three reads, a look, a place
            windows += 1
            moved += d.placed
    assert windows > 90
    assert moved < 0.5 * windows


def test_nothing_changes_but_little_when_there_is_only_a_manoeuvre(make: Make) -> None:
    """A flip of 300 ms: no tone, so that notches stay where they are, out of the way."""
    t = np.arange(4000) / 4000
    rates = np.repeat((15 * np.exp(-(((t - 0.5) / 0.08) ** 2)))[:, None], 3, axis=1)
    out = make(4000, dynamic_notch_count=3).run(rates)
    assert np.abs(out - rates).max() < 0.02 * rates.max()


@pytest.mark.parametrize(
    "settings",
    [
        {"dynamic_notch_low_hz": 1000, "dynamic_notch_high_hz": 60},
        {"dynamic_notch_low_hz": 30, "dynamic_notch_high_hz": 60, "dynamic_notch_q": 20},
        {"dynamic_notch_low_hz": 30, "dynamic_notch_high_hz": 2000, "dynamic_notch_q": 0.5},
        {"dynamic_notch_low_hz": 1000, "dynamic_notch_high_hz": 2000},
    ],
)
@pytest.mark.parametrize("rate_hz", [1000, 8000])
def test_rates_stay_finite_and_no_larger_when_settings_are_at_their_ends(
    make: Make, rate_hz: int, settings: dict[str, float]
) -> None:
    filters = make(rate_hz, dynamic_notch_count=3, **settings)
    rng = np.random.default_rng(8)
    rates = rng.uniform(-35, 35, (2 * rate_hz, 3))
    rates[rate_hz : rate_hz + 50] = 0.0
    out = filters.run(rates)
    assert np.isfinite(out).all()
    assert np.abs(out).max() < 4 * 35
    assert make(rate_hz, dynamic_notch_count=3, **settings).struct.dynamic.window > 0


def test_all_is_silent_when_the_gyro_says_nothing(make: Make) -> None:
    assert not make(1000, dynamic_notch_count=3).run(np.zeros((1000, 3))).any()


def test_the_state_is_small_when_everything_is_on(scripted: Any) -> None:
    assert scripted.ffi.sizeof("struct filters") <= STATE_BYTES_MAX


# --- The hash that ties a policy to its filters -----------------------------------------------------
def test_the_hash_is_that_of_no_filter_when_nothing_is_set(make: Make) -> None:
    assert make().hash == POLICY_FILTERS_NONE


@pytest.mark.parametrize(
    ("settings", "chain"),
    [
        (stage(1, FilterKind.PT1, 100.0), [["pt1", 100000]]),
        (stage(3, FilterKind.PT3, 80.5), [["pt3", 80500]]),
        (stage(4, FilterKind.BIQUAD, 4000.0, 0.707), [["biquad", 4000000, 707]]),
        # A thousand times the float32 next to 1.004 is below 1004.
        (stage(2, FilterKind.BIQUAD, 300.0, 1.004), [["biquad", 300000, 1004]]),
        (
            stage(1, FilterKind.NOTCH, 180.0, 3.0) | stage(2, FilterKind.PT2, 90.0),
            [["notch", 180000, 3000], ["pt2", 90000]],
        ),
        ({"dynamic_notch_count": 3}, [["dynamic", 3, 100000, 600000, 3000]]),
        (
            stage(2, FilterKind.PT1, 100.0) | FOLLOWING,
            [["pt1", 100000], ["dynamic", 2, 100000, 600000, 3000]],
        ),
    ],
)
def test_the_hash_is_the_builds_when_the_chain_is_the_same(
    make: Make, settings: dict[str, float], chain: list[object]
) -> None:
    assert make(**settings).hash == filters_hash(chain) == filters_hash(json.loads(json.dumps(chain)))


def test_the_hash_does_not_tell_stages_that_are_off_when_their_numbers_differ(make: Make) -> None:
    off = stage(1, FilterKind.NONE, 333.0, 9.0)
    assert make(**off, dynamic_notch_q=7.0).hash == POLICY_FILTERS_NONE
    assert contract.FILTER_STAGES == 4
