"""pid.c as a build has it: the bits of the twin's PIDs with the gains compiled in, and the pilot's factors.

What those bits should be is tests/sim/control/test_pid.py's.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import PidSettings, load_aircraft
from neuroflight.sim.control.pid import Pid, aircraft_pid
from neuroflight.sim.control.pid_table import mixer, pid_settings, pid_table, settings_table
from neuroflight.toolchain.contract import PID_COMPENSATION_MAX
from neuroflight.toolchain.rendering.pid_table import render_pid_table

STEPS = 3000
RATE_HZ = 1000
TOLERANCE = 1e-4  # where a factor is multiplied before a gain is rounded, or after


def flight(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints that jump and rates that follow them lazily with gyro noise, float32 (STEPS, 3) [rad/s]."""
    setpoint = np.repeat(rng.normal(0, 4, (STEPS // 250, 3)), 250, axis=0)
    rate = np.zeros((STEPS, 3))
    for k in range(1, STEPS):
        rate[k] = rate[k - 1] + 0.02 * (setpoint[k] - rate[k - 1])
    rate += rng.normal(0, 0.02, rate.shape)
    return setpoint.astype(np.float32), rate.astype(np.float32)


def stepped(core: Any, pid: Any, setpoint: np.ndarray, rate: np.ndarray, throttle: float = 0.0) -> np.ndarray:
    out = core.new("float[4]")
    rows = []
    for s, r in zip(setpoint.tolist(), rate.tolist(), strict=True):
        core.lib.pid_step(pid, core.new("float[3]", s), core.new("float[3]", r), throttle, out)
        rows.append(list(out))
    return np.array(rows, np.float32)


def flown(peer: Pid, setpoint: np.ndarray, rate: np.ndarray, throttle: float = 0.0) -> np.ndarray:
    thrust = np.full(1, throttle, np.float32)
    return np.concatenate([peer.step(s[None], r[None], thrust) for s, r in zip(setpoint, rate, strict=True)])


@pytest.mark.parametrize("seed", range(3))
def test_the_built_in_pid_is_the_twins_to_the_bit_when_it_flies_at_random(
    reference_core: Any, seed: int
) -> None:
    core = reference_core
    pid = core.new("struct pid *")
    gains = core.ffi.addressof(core.lib, "pid_gains_built_in")
    core.lib.pid_init(pid, gains, factors(core))
    setpoint, rate = flight(np.random.default_rng(seed))
    peer = aircraft_pid(load_aircraft("nf1"), 1, RATE_HZ)
    got = stepped(core, pid, setpoint, rate)
    assert np.ptp(got, axis=0).min() > 0.9, "every motor went through its range"
    assert got.tobytes() == flown(peer, setpoint, rate).tobytes()
    core.lib.pid_reset(pid)
    peer.reset()
    again = flown(peer, setpoint[:50], rate[:50])
    assert stepped(core, pid, setpoint[:50], rate[:50]).tobytes() == again.tobytes()


def factors(core: Any, **changed: float) -> Any:
    """The usual settings, whose factors on the gains are 1, but for those changed."""
    settings = core.new("struct nf_settings *")
    core.lib.settings_default(settings)
    for name, value in changed.items():
        setattr(settings, name, value)
    return settings


def built_in(core: Any, **changed: float | list[float]) -> Any:
    """The built-in gains, or a copy with these members changed."""
    gains = core.new("struct pid_gains *", core.lib.pid_gains_built_in)
    for name, value in changed.items():
        setattr(gains, name, value)
    return gains


@pytest.mark.parametrize("throttle", [0.0, 0.3, 0.6, 0.61, 0.9, 1.0])
@pytest.mark.parametrize("volts", [math.nan, 16.8, 16.0, 15.2, 14.2, 12.0])
def test_c_follows_throttle_and_battery_as_the_twins_pid_does(
    reference_core: Any, throttle: float, volts: float
) -> None:
    core, nf1 = reference_core, load_aircraft("nf1")
    tuned = pid_settings(nf1, "tuned")
    gains = built(core, tuned, mixer(nf1))
    pid = core.new("struct pid *")
    core.lib.pid_init(pid, gains, factors(core))
    pid.compensation = core.lib.pid_compensation(gains, volts)
    peer = aircraft_pid(nf1, 1, RATE_HZ, "tuned")
    peer.compensate(np.array([volts]))
    setpoint, rate = (part[:600] for part in flight(np.random.default_rng(7)))
    got = stepped(core, pid, setpoint, rate, throttle)
    assert got.tobytes() == flown(peer, setpoint, rate, throttle).tobytes()
    bare = core.new("struct pid *")
    plain = core.new("struct pid_gains *", gains[0])
    plain.tpa_slope = plain.nominal_voltage = 0.0
    core.lib.pid_init(bare, plain, factors(core))
    bare.compensation = core.lib.pid_compensation(plain, volts)
    unchanged = got.tobytes() == stepped(core, bare, setpoint, rate, throttle).tobytes()
    acts = volts < 16.0 or np.float32(throttle) > np.float32(tuned.tpa_breakpoint)
    assert unchanged == (not acts), "1 exactly, or it acts"


@pytest.mark.parametrize(
    ("volts", "factor"),
    [
        (0.0, 1.0),
        (-1.0, 1.0),
        (math.nan, 1.0),
        (-math.inf, 1.0),
        (math.inf, 1.0),
        (25.2, 1.0),
        (16.0, 1.0),
        (15.0, (16 / 15) ** 2),
        (14.1, (16 / 14.1) ** 2),
        (13.9, PID_COMPENSATION_MAX),
        (1e-30, PID_COMPENSATION_MAX),
    ],
)
def test_the_compensation_stays_in_its_range_whatever_the_battery_says(
    reference_core: Any, volts: float, factor: float
) -> None:
    core, gains = reference_core, built_in(reference_core)
    pid = core.new("struct pid *")
    core.lib.pid_init(pid, gains, factors(core))
    assert pid.compensation == 1.0
    pid.compensation = core.lib.pid_compensation(gains, volts)
    assert pid.compensation == pytest.approx(factor, rel=1e-6)
    assert (pid.compensation == 1.0) == (factor == 1.0)
    core.lib.pid_reset(pid)
    assert pid.compensation == pytest.approx(factor, rel=1e-6), "the battery outlives a flight"


def built(core: Any, settings: PidSettings, mix: np.ndarray) -> Any:
    """A PID of other gains, as C with the numbers of the rendered table."""
    table = settings_table(settings, mix, "x", "y")
    text = render_pid_table(table, 4, RATE_HZ)
    gains = core.new("struct pid_gains *")
    for line in text.splitlines():
        if line.startswith("\t.") and not line.endswith("{"):
            name, value = line.strip(" \t.,").split(" = ")
            if value.startswith("NF_"):
                setattr(gains, name, getattr(core.lib, value))
                continue
            numbers = [float(word.rstrip("f")) for word in value.strip("{} ").split(",")]
            setattr(gains, name, numbers if len(numbers) > 1 else type(getattr(gains, name))(numbers[0]))
    gains.mixer = mix.astype(np.float32).tolist()
    return gains


def test_the_integral_is_clamped_and_unfiltered_slopes_pass_when_gains_are_such(scripted: Any) -> None:
    gains = ((2.0, 300.0, 0.03), (0.0, 20.0, 0.0), (1.0, 0.0, 0.05))
    settings = PidSettings(gains=gains, derivative_cutoff_hz=None, idle=0.0)
    mix = mixer(load_aircraft("nf1"))
    pid = scripted.new("struct pid *")
    kept = built(scripted, settings, mix)
    scripted.lib.pid_init(pid, kept, factors(scripted))
    peer = Pid(mix, settings, 1, RATE_HZ)
    setpoint, rate = flight(np.random.default_rng(5))
    got = stepped(scripted, pid, setpoint, rate)
    assert abs(pid.integral[0]) == kept.integral_max[0]
    assert got.tobytes() == flown(peer, setpoint, rate).tobytes()


def test_the_throttle_leaves_p_alone_and_a_reset_leaves_no_slope(scripted: Any) -> None:
    # The twin's PID is this same C: what both have wrong, only its own other outputs show.
    settings = PidSettings(
        gains=((2.0, 0.0, 0.0), (1.0, 0.0, 0.05), (1.0, 0.0, 0.0)),
        derivative_cutoff_hz=50.0,
        idle=0.0,
        tpa_rate=0.4,
        tpa_breakpoint=0.5,
    )
    kept = built(scripted, settings, mixer(load_aircraft("nf1")))
    pid = scripted.new("struct pid *")
    setpoint, rate = flight(np.random.default_rng(6))
    still = np.zeros((1, 3), np.float32)

    def first(throttle: float) -> bytes:
        return stepped(scripted, pid, setpoint[:1], still, throttle).tobytes()

    scripted.lib.pid_init(pid, kept, factors(scripted))
    fresh = first(0.0)
    moved = [stepped(scripted, pid, setpoint[:200], rate[:200], throttle) for throttle in (0.0, 1.0)]
    assert moved[0].tobytes() != moved[1].tobytes(), "the throttle takes from D"
    for throttle in (0.0, 1.0):
        scripted.lib.pid_reset(pid)
        assert first(throttle) == fresh


def test_a_pid_of_other_motors_is_refused_when_rendered() -> None:
    table = pid_table(load_aircraft("hexa"))
    with pytest.raises(ValueError, match="6 motors, expected 4"):
        render_pid_table(table, 4, RATE_HZ)


FACTORS = {
    "pid_roll_p": 1.5,
    "pid_roll_i": 0.5,
    "pid_roll_d": 1.25,
    "pid_pitch_p": 0.75,
    "pid_pitch_i": 2.0,
    "pid_pitch_d": 0.625,
    "pid_yaw_p": 1.125,
    "pid_yaw_i": 0.25,
    "pid_yaw_d": 3.0,
}


def test_gains_are_the_built_in_ones_times_the_pilots_factors(reference_core: Any) -> None:
    """Against the twin's PID with gains that are multiplied so."""
    core, gains = reference_core, built_in(reference_core)
    pid = core.new("struct pid *")
    core.lib.pid_init(pid, gains, factors(core, **FACTORS))
    times = np.array(list(FACTORS.values())).reshape(3, 3)
    nf1 = load_aircraft("nf1")
    usual = pid_settings(nf1)
    changed = (times * np.array(usual.gains)).tolist()
    roll, pitch, yaw = (tuple(row) for row in changed)
    peer = Pid(mixer(nf1), replace(usual, gains=(roll, pitch, yaw)), 1, RATE_HZ)
    setpoint, rate = flight(np.random.default_rng(3))
    got = stepped(core, pid, setpoint, rate)
    assert np.abs(got - flown(peer, setpoint, rate)).max() <= TOLERANCE


@pytest.mark.parametrize("name", FACTORS)
def test_each_factor_acts_on_its_own_gain_alone(reference_core: Any, name: str) -> None:
    core, gains = reference_core, built_in(reference_core)
    gains.i = [value or 0.01 for value in gains.i]
    gains.integral_max = [1.0 / value for value in gains.i]
    usual, other = core.new("struct pid *"), core.new("struct pid *")
    core.lib.pid_init(usual, gains, factors(core))
    core.lib.pid_init(other, gains, factors(core, **{name: 0.5}))
    _, axis, term = name.split("_")
    for one in "pid":
        for index, each in enumerate(("roll", "pitch", "yaw")):
            before, after = getattr(usual, one)[index], getattr(other, one)[index]
            assert before == getattr(gains, one)[index], "1 leaves every bit"
            assert after == (0.5 * before if (one, each) == (term, axis) else before)
            if one == "i":
                reach = after * other.integral_max[index]
                assert reach == pytest.approx(1.0), "what the integral alone may ask for stays"


def test_the_integral_asks_for_nothing_when_its_factor_is_0(reference_core: Any) -> None:
    core, gains = reference_core, built_in(reference_core)
    pid, bare = core.new("struct pid *"), core.new("struct pid *")
    core.lib.pid_init(pid, gains, factors(core, pid_roll_i=0.0, pid_pitch_i=0.0, pid_yaw_i=0.0))
    none = built_in(core, i=[0.0] * 3)
    core.lib.pid_init(bare, none, factors(core))
    setpoint, rate = (part[:500] for part in flight(np.random.default_rng(4)))
    assert stepped(core, pid, setpoint, rate).tobytes() == stepped(core, bare, setpoint, rate).tobytes()
