"""rpm_filter.c: notches at the rotors' turns, against published ones and a rotor that changes its speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import signal

from neuroflight.sim.physics.esc import rotor_words
from neuroflight.toolchain.contract import ESC_SILENT
from neuroflight.toolchain.policy.blob import filters_hash

Array = NDArray[np.float64]
RATE_HZ, CONTROL_HZ, MOTORS = 4000, 1000, 4
SETTINGS = {"motor_telemetry": 1, "rpm_filter_harmonics": 3, "rpm_filter_q": 5.0, "rpm_filter_min_hz": 100.0}


class Filter:
    """The filter beside the rotors that it follows."""

    def __init__(self, core: Any, **settings: float) -> None:
        self._core = core
        chosen = core.new("struct nf_settings *")
        core.lib.settings_default(chosen)
        for name, value in {**SETTINGS, **settings}.items():
            setattr(chosen, name, value)
        self.settings = chosen
        self.rotors, self.struct = core.new("struct rotors *"), core.new("struct rpm_filter *")
        core.lib.rotors_init(self.rotors, chosen, CONTROL_HZ)
        core.lib.rpm_filter_init(self.struct, chosen, RATE_HZ)
        self._outputs = core.new("uint8_t[]", list(range(MOTORS)))
        self._rate = core.new("float[3]")
        self._samples = 0

    def tell(self, *speeds: float, silent: tuple[int, ...] = ()) -> None:
        """A control step's words."""
        words = rotor_words(np.array(speeds)).tolist()
        given = [ESC_SILENT if motor in silent else word for motor, word in enumerate(words, start=1)]
        self._core.lib.rotors_step(
            self.rotors, self._core.new("uint16_t[8]", given + [ESC_SILENT] * 4), self._outputs
        )

    def step(self, rate: Any) -> list[float]:
        self._rate[0:3] = [float(value) for value in rate]
        self._core.lib.rpm_filter_step(self.struct, self.rotors, self._rate)
        return list(self._rate)

    def run(self, rates: Array, *speeds: float, silent: tuple[int, ...] = ()) -> Array:
        """Rows (N, 3) in, rows out, while the rotors turn at these speeds [rad/s]."""
        out = []
        for index, row in enumerate(rates):
            if index % (RATE_HZ // CONTROL_HZ) == 0:
                self.tell(*speeds, silent=silent)
            out.append(self.step(row))
        return np.array(out)


def tone(hz: float, count: int = 4000) -> Array:
    """(count, 3), amplitudes 1, 2 and -3."""
    return np.outer(np.sin(2 * np.pi * hz / RATE_HZ * np.arange(count)), [1.0, 2.0, -3.0])


def left(filtered: Array, hz: float) -> Array:
    """What is left of each axis' tone, behind the filter's start."""
    settled = filtered[2000:]
    wave = np.exp(-2j * np.pi * hz / RATE_HZ * np.arange(2000, len(filtered)))
    amplitude = 2 * np.abs(wave @ settled) / len(settled)
    part: Array = amplitude / np.array([1.0, 2.0, 3.0])
    return part


def hz_of(speed: float) -> float:
    """Turns a second of a rotor as its word tells it."""
    period = int(np.floor(4e6 * np.pi / 14 / speed))
    assert period < 1024
    period -= period % (2 if period >= 512 else 1)
    return 4e6 / 14 / period / 2


SPEEDS = (1500.0, 1700.0, 1900.0, 2200.0)


@pytest.mark.parametrize("harmonic", [1, 2, 3])
@pytest.mark.parametrize("motor", range(MOTORS))
def test_each_axis_loses_each_motors_turns_and_their_multiples(
    scripted: Any, motor: int, harmonic: int
) -> None:
    hz = harmonic * hz_of(SPEEDS[motor])
    assert left(Filter(scripted).run(tone(hz), *SPEEDS), hz).max() < 0.01


def cookbook(hz: float, q: float) -> tuple[Array, Array]:
    """The notch of Bristow-Johnson's Audio EQ Cookbook, whose response Betaflight's RPM filter has: b, a."""
    w = 2 * np.pi * hz / RATE_HZ
    alpha = np.sin(w) / (2 * q)
    cosine = -2 * np.cos(w)
    return np.array([1, cosine, 1]), np.array([1 + alpha, cosine, 1 - alpha])


def test_what_is_left_between_the_notches_is_what_the_published_ones_leave(scripted: Any) -> None:
    speeds = (2000.0,) * MOTORS
    for hz in (40.0, 150.0, 260.0, 400.0, 800.0, 1500.0):
        expected = 1.0
        for harmonic in (1, 2, 3):
            notch = cookbook(harmonic * hz_of(2000.0), 5.0)
            expected *= np.abs(signal.freqz(*notch, worN=[hz], fs=RATE_HZ)[1][0]) ** MOTORS
        np.testing.assert_allclose(left(Filter(scripted).run(tone(hz), *speeds), hz), expected, atol=4e-3)


def test_a_notch_far_below_the_gyro_rate_is_scipys(scripted: Any) -> None:
    # Higher up scipy's have the width that the bilinear transform takes from the others.
    centre = hz_of(1100.0)
    notch = signal.iirnotch(centre, 5.0, RATE_HZ)
    for hz in (60.0, 140.0, 160.0, 190.0, 220.0, 600.0):
        found = left(Filter(scripted, rpm_filter_harmonics=1).run(tone(hz), *([1100.0] * MOTORS)), hz)
        expected = np.abs(signal.freqz(*notch, worN=[hz], fs=RATE_HZ)[1][0]) ** MOTORS
        np.testing.assert_allclose(found, expected, atol=0.012)


def test_the_notch_follows_a_rotor_that_gains_speed(scripted: Any) -> None:
    filter_, phase, rest = Filter(scripted), 0.0, []
    for sample in range(4000):
        speed = 1200.0 + 0.4 * sample  # to 2800 rad/s in a second
        if sample % 4 == 0:
            filter_.tell(speed, *SPEEDS[1:])
        phase += speed / RATE_HZ
        rest.append(filter_.step([np.sin(phase), 0.0, 0.0])[0])
    assert np.abs(rest[1000:]).max() < 0.25


@pytest.mark.parametrize("off", [{"rpm_filter_harmonics": 0}, {"motor_telemetry": 0}])
def test_not_a_bit_changes_when_it_is_off(scripted: Any, off: dict[str, float]) -> None:
    rates = np.float32(np.random.default_rng(1).normal(0, 3, (200, 3))).astype(float)
    assert Filter(scripted, **off).run(rates, *SPEEDS).tobytes() == rates.tobytes()


def test_nothing_is_taken_out_for_rotors_that_are_slow_or_silent(scripted: Any) -> None:
    hz = hz_of(1500.0)
    slow = Filter(scripted, rpm_filter_harmonics=1).run(tone(60.0), *([60.0 * 2 * np.pi] * MOTORS))
    np.testing.assert_allclose(left(slow, 60.0), 1.0, atol=1e-3)
    heard = Filter(scripted)
    heard.run(tone(hz, 400), *([1500.0] * MOTORS))
    silent = heard.run(tone(hz), *([1500.0] * MOTORS), silent=(1, 2, 3, 4))
    np.testing.assert_allclose(left(silent, hz), 1.0, atol=1e-3)
    one = Filter(scripted).run(tone(hz), *([1500.0] * MOTORS), silent=(1, 2, 3))
    assert left(one, hz).max() < 0.01, "the others' notches stay"


def test_a_notch_fades_in_above_its_least_centre(scripted: Any) -> None:
    parts = []
    for hz in (101.0, 112.5, 125.0, 151.0):
        filter_ = Filter(scripted, rpm_filter_harmonics=1)
        parts.append(left(filter_.run(tone(hz), *([hz * 2 * np.pi] * MOTORS)), hz)[0])
    assert parts == sorted(parts, reverse=True)
    assert parts[0] > 0.9 and parts[2] == pytest.approx(0.5**MOTORS, rel=0.25) and parts[3] < 0.02


def test_a_policy_behind_it_names_it_in_its_chain(scripted: Any) -> None:
    plain, behind = Filter(scripted, rpm_filter_harmonics=0), Filter(scripted)
    unasked = Filter(scripted, motor_telemetry=0)
    hashes = [int(scripted.lib.filters_hash(each.settings)) for each in (plain, behind, unasked)]
    assert hashes == [filters_hash([]), filters_hash([["rpm", 3, 100_000, 5000]]), filters_hash([])]
