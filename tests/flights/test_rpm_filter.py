"""What rotor speeds are worth in closed loop: notches at the rotors' turns, and the dynamic idle."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.control.controller import PolicyController
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.esc import Words
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort, Reply, Sample
from neuroflight.sim.ports.python_controller import ControllerPort
from neuroflight.toolchain.contract import ESC_SILENT
from neuroflight.toolchain.image.report import needed_settings
from neuroflight.toolchain.policy.gyro_filters import MEAN, GyroFilters, RpmFilter
from neuroflight.toolchain.policy.model import read_policy
from tests.conftest import build_kept
from tests.flights.random_policy import frozen

NF1 = load_aircraft("nf1")
# Four rotors at full speed make 35 deg/s; logs of a 5-inch racer have 15 to 35 (docs/reference/aircraft.md).
_VIBRATION = (math.radians(25.0), math.radians(25.0), math.radians(15.0))
SHAKEN = replace(NF1, gyro=replace(NF1.gyro, vibration=_VIBRATION, harmonics=(0.1, 0.4)))
GYRO_HZ, IDLE = 4000, 0.1
FILTERS = GyroFilters(RpmFilter(2, 90.0, 4.0), mean=True)
POLICY = frozen("rate_error,rate~60Hz", IDLE, filters=FILTERS)
UNWATCHED = {"plausibility_detection": 0}  # weights are random
BUSY = Scenario("busy", tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.3) for k in range(5)))


def build(target: str) -> Path:
    return build_kept(target, POLICY, "rpm-filter", pid_table(NF1))


@pytest.fixture(scope="module")
def library() -> Path:
    """The host's library around a policy of random weights that is behind notches and mean."""
    return build("HOST") / "libneuroflight.so"


class Watched(ReferencePort):
    """The library, beside a twin whose rotors are watched; flown by its PID behind the gyro's mean."""

    def __init__(self, library: Path, **settings: float) -> None:
        super().__init__(library, GYRO_HZ, {"gyro_mean": 2, **UNWATCHED, **settings})
        self.twin: Twin | None = None
        self.rpm: list[NDArray[np.float64]] = []  # of each rotor at each gyro sample while it is armed

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        assert self.twin is not None
        reply = super().exchange(sample, channels_us)
        if reply.armed:
            self.rpm.append(self.twin.live.rotor_speed[0] * (30.0 / np.pi))
        return reply


def flown(port: FirmwarePort, scenario: Scenario = BUSY, aircraft: Aircraft = SHAKEN) -> Trace:
    twin = Twin(aircraft, rate_hz=GYRO_HZ, mount=scenario.mount, rng=np.random.default_rng((1, 1)))
    if isinstance(port, Watched):
        port.twin = twin
    with closing(twin), closing(port):
        return fly(twin, port, scenario)


def shaken(trace: Trace, begin: int = 100) -> float:
    """Mean difference of what the controller sees and the true rate [deg/s]."""
    return float(np.rad2deg(np.abs(trace.gyro - trace.rate)[begin:]).mean())


def moved(trace: Trace) -> float:
    """Mean change of a motor's fraction in 1 ms."""
    return float(np.abs(np.diff(trace.motors, axis=0)).mean())


def late_ms(trace: Trace) -> float:
    """How late the controller sees the rate, by the delay that makes them most alike."""
    step, delays = np.arange(len(trace.rate)), np.arange(0.0, 4.0, 0.1)
    apart = [
        sum(
            np.square(np.interp(step - d, step, trace.rate[:, j]) - trace.gyro[:, j])[20:].mean()
            for j in range(3)
        )
        for d in delays
    ]
    return float(delays[int(np.argmin(apart))])


def error(trace: Trace) -> float:
    """Mean rate error in the second half of each command of STEPS [deg/s]."""
    held = np.arange(len(trace.rate)) % 120 >= 70
    return float(np.rad2deg(np.abs(trace.setpoint - trace.rate))[held].mean())


def test_twin_library_and_program_fly_the_same_bits_behind_notches(library: Path) -> None:
    settings = {**needed_settings(library), **UNWATCHED}
    assert settings["rpm_filter_min_hz"] == 90.0
    controller = PolicyController(read_policy(library.parent.with_name("policy.onnx")))
    in_twin = flown(ControllerPort(controller, 4, GYRO_HZ, idle=IDLE, gyro_filters=FILTERS))
    assert flown(ReferencePort(library, GYRO_HZ, settings)).same(in_twin)
    assert flown(HostPort(library.with_name("neuroflight"), GYRO_HZ, settings)).same(in_twin)
    without = flown(ControllerPort(controller, 4, GYRO_HZ, idle=IDLE, gyro_filters=MEAN))
    assert shaken(in_twin) < 0.6 * shaken(without)


@pytest.mark.slow
def test_the_image_flies_the_hosts_bits_behind_notches(library: Path) -> None:
    settings = {**needed_settings(library), **UNWATCHED}
    on_host = flown(ReferencePort(library, GYRO_HZ, settings))
    image = build("MATEKF722") / "neuroflight.bin"
    assert flown(EmulatedPort(image, GYRO_HZ, settings)).same(on_host)


TELLS = {"motor_telemetry": 1}
NOTCHES = {**TELLS, "rpm_filter_harmonics": 3}
STEPS = Scenario(
    "steps",
    tuple(
        Segment(0.12, (150.0 * (-1) ** k, 80.0 * (-1) ** (k // 2), -30.0 * (-1) ** k), throttle, pid=True)
        for throttle in (0.3, 0.5, 0.7)
        for k in range(4)
    ),
)


def test_motors_are_calmer_behind_notches_than_behind_those_that_search(library: Path) -> None:
    """By the PID on an aircraft that shakes: behind none, dynamic notches, and those at the rotors' turns."""
    plain = flown(Watched(library), STEPS)
    search = flown(Watched(library, dynamic_notch_count=3), STEPS)
    follow = flown(Watched(library, **NOTCHES), STEPS)
    first = flown(Watched(library, **{**NOTCHES, "rpm_filter_harmonics": 1}), STEPS)
    assert moved(plain) > 4 * moved(follow) and moved(search) > 1.4 * moved(follow)
    assert moved(first) > 1.2 * moved(follow), "the third multiple is left"
    assert shaken(plain) > 2 * shaken(first) and shaken(search) > 1.2 * shaken(first)
    for trace, latest in ((plain, 0.6), (first, 1.0), (search, 1.2), (follow, 1.5)):
        assert late_ms(trace) < latest
        assert error(trace) < 1.5 * error(plain)


@pytest.mark.parametrize("silent", [(2,), (1, 2, 3, 4)])
def test_notches_of_escs_that_fall_silent_in_flight_go_and_the_flight_goes_on(
    library: Path, silent: tuple[int, ...]
) -> None:
    class Silent(Watched):
        """In flight some ESCs obey and tell nothing any more."""

        def set_rotors(self, words: Words) -> None:
            lost = np.isin(np.arange(1, 5), silent) & (len(self.rpm) > 0.45 * GYRO_HZ)
            super().set_rotors(np.where(lost, ESC_SILENT, words).astype(np.uint16))

    trace, whole, plain = (
        flown(port, STEPS)
        for port in (Silent(library, **NOTCHES), Watched(library, **NOTCHES), Watched(library))
    )
    assert (trace.dshot[100:] > 0).all()
    parts = np.flatnonzero((trace.dshot != whole.dshot).any(axis=1))[0]
    left = [shaken(each, parts + 50) for each in (trace, whole, plain)]
    if len(silent) == 4:
        assert left[0] == pytest.approx(left[2], rel=0.1)
    else:  # the other motors' notches take out most of it: rotors turn almost alike
        assert moved(whole) < moved(trace) < 0.3 * moved(plain)
    assert error(trace) < 1.1 * error(whole)


ROLLS = Scenario(
    "rolls",
    (
        Segment(0.3, throttle=0.3, pid=True),
        *(
            Segment(0.2, rates, pid=True)
            for rates in ((600.0, 0.0, 0.0), (-600.0, 0.0, 0.0), (0.0, 400.0, 0.0))
        ),
        Segment(0.4, pid=True),
    ),
)
STALLS_RPM, STALLED_S = 2400.0, 0.1


class Stalling(Watched):
    """With ESCs that lose the step of a rotor that falls below a speed, and need a while to find it."""

    def __init__(self, library: Path, **settings: float) -> None:
        super().__init__(library, **{**TELLS, **settings})
        self.stalls = 0
        self._until = np.zeros(4, int)
        self._turned = np.zeros(4, bool)

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        reply = super().exchange(sample, channels_us)
        if not reply.armed:
            return reply
        rpm, now = self.rpm[-1], len(self.rpm)
        lost = self._turned & (rpm < STALLS_RPM) & (reply.dshot > 0)
        self.stalls += int(lost.sum())
        self._turned = (self._turned & ~lost) | (rpm > STALLS_RPM + 300.0)
        self._until[lost] = now + round(STALLED_S * GYRO_HZ)
        held = now < self._until
        return replace(reply, dshot=np.where(held, 0, reply.dshot).astype(np.uint16)) if held.any() else reply


def test_no_rotor_stalls_in_rolls_with_the_throttle_closed_when_the_idle_follows_them(library: Path) -> None:
    without, behind = Stalling(library), Stalling(library, dynamic_idle_rpm=3000)
    bad, good = flown(without, ROLLS, NF1), flown(behind, ROLLS, NF1)
    assert without.stalls > 0 and behind.stalls == 0
    assert np.abs(good.setpoint - good.rate)[300:].mean() < 0.9 * np.abs(bad.setpoint - bad.rate)[300:].mean()
    hover = [float(trace.motors[200:300].mean()) for trace in (bad, good)]
    assert hover[0] == pytest.approx(hover[1], abs=1e-3), "nothing is raised where rotors are fast"
    rest = np.array(behind.rpm)[-100:].min(axis=1)
    assert rest.mean() > 2850.0, "a lasting lack is made up for in some tenths of a second"


def test_the_idle_is_not_raised_when_the_resting_rotors_are_fast_enough(library: Path) -> None:
    plain = flown(Watched(library, **TELLS), ROLLS, NF1)
    kept = flown(Watched(library, **TELLS, dynamic_idle_rpm=2000), ROLLS, NF1)
    rest = [trace.motors[-300:].mean(axis=0) for trace in (plain, kept)]
    assert rest[0] == pytest.approx(rest[1], abs=1e-3)
