"""The twin's PIDs, which are the firmware's C, against simple-pid, hand-made numbers and printed ones."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import simple_pid
from scipy.signal import lfilter

from neuroflight.sim.aircraft.model import PidSettings, load_aircraft, shipped
from neuroflight.sim.arrays import Array, Array32
from neuroflight.sim.control import library
from neuroflight.sim.control.pid import Pid, aircraft_pid
from neuroflight.sim.control.pid_table import mixer, pid_mixer, pid_settings
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.errors import AircraftError, BuildError
from neuroflight.training.evaluation.evaluation import figures, record
from neuroflight.training.tasks.task import PulseTask

RATE_HZ = 1000
CUTOFF_HZ = 80.0
ZERO = (0.0, 0.0, 0.0)
STEPS = 3000
ULPS = 2e-5  # of a fraction of the whole: sums of numbers up to 30 in float32, over STEPS steps
ONE_AXIS = np.array([[1.0], [0.0], [-1.0]])  # motors that show only what roll asks


def step_once(pid: Pid, setpoint: Sequence[float], gyro: Sequence[float]) -> Array32:
    wanted, measured = (np.deg2rad([rates]).astype(np.float32) for rates in (setpoint, gyro))
    y: Array32 = pid.step(wanted, measured, np.zeros(1, np.float32))[0]
    return y


def commands(rng: np.random.Generator) -> tuple[Array32, Array32]:
    """Setpoints that jump and rates that follow them lazily with a gyro's noise, (STEPS, 3) [rad/s]."""
    setpoint = np.repeat(rng.normal(0, 4, (STEPS // 250, 3)), 250, axis=0)
    rate = lfilter([0.02], [1.0, -0.98], setpoint, axis=0) + rng.normal(0, 0.02, setpoint.shape)
    return setpoint.astype(np.float32), rate.astype(np.float32)


def by_simple_pid(settings: PidSettings, mix: Array, setpoint: Array32, rate: Array32) -> Array:
    """Outputs (STEPS, M) of PyPI's simple-pid, an axis each, its derivative behind scipy's filter.

    Its integral is kept within what the whole range of a motor is, 1000 units of the sum.
    """
    share = 1.0
    if settings.derivative_cutoff_hz is not None:
        share = 1.0 - math.exp(-2.0 * math.pi * settings.derivative_cutoff_hz / RATE_HZ)
    axes = np.empty((STEPS, 3))
    degrees = np.rad2deg([setpoint, rate], dtype=np.float64)
    for axis, (p, i, d) in enumerate(settings.gains):
        peer = simple_pid.PID(p, i, d, sample_time=None, output_limits=(-1000.0, 1000.0))
        terms = np.empty((STEPS, 3))
        for k, (wanted, measured) in enumerate(degrees[:, :, axis].T.tolist()):
            peer.setpoint = wanted
            peer(measured, dt=1.0 / RATE_HZ)
            terms[k] = peer.components
        axes[:, axis] = terms[:, 0] + terms[:, 1] + lfilter([share], [1.0, share - 1.0], terms[:, 2])
    demand = axes @ mix.T / 1000.0
    above = demand - np.minimum(demand.min(axis=1, keepdims=True), 0.0)
    outputs: Array = np.minimum(above / np.maximum(np.ptp(demand, axis=1), 1.0)[:, None], 1.0)
    return outputs


@pytest.mark.parametrize(
    ("aircraft", "name"), [("nf1", "flying"), ("nf1", "published"), ("hexa", None), ("iris", None)]
)
def test_a_stranger_computes_the_same_from_the_aircraft_file(aircraft: str, name: str | None) -> None:
    loaded = load_aircraft(aircraft)
    settings, (setpoint, rate) = pid_settings(loaded, name), commands(np.random.default_rng(3))
    pid, still = aircraft_pid(loaded, 1, RATE_HZ, name), np.zeros(1, np.float32)
    got = np.concatenate([pid.step(s[None], r[None], still) for s, r in zip(setpoint, rate, strict=True)])
    expected = by_simple_pid(settings, pid_mixer(loaded, settings), setpoint, rate)
    assert np.ptp(expected, axis=0).min() > 0.9, "every motor went through its range"
    assert np.abs(got - expected).max() < ULPS


def test_a_stranger_computes_the_same_when_integrals_reach_their_limits() -> None:
    gains = ((2.0, 300.0, 0.03), (0.0, 90.0, 0.0), (1.0, 0.0, 0.05))
    settings, mix = PidSettings(gains, CUTOFF_HZ, 0.0), mixer(load_aircraft("nf1"))
    setpoint, rate = commands(np.random.default_rng(5))
    pid, still = Pid(mix, settings, 1, RATE_HZ), np.zeros(1, np.float32)
    got = np.concatenate([pid.step(s[None], r[None], still) for s, r in zip(setpoint, rate, strict=True)])
    assert np.abs(got - by_simple_pid(settings, mix, setpoint, rate)).max() < ULPS
    free = dataclasses.replace(settings, gains=((2.0, 30.0, 0.03), *gains[1:]))
    other = by_simple_pid(free, mix, setpoint, rate)
    assert np.abs(other - by_simple_pid(settings, mix, setpoint, rate)).max() > 0.5, "the limit matters"


@pytest.mark.parametrize("name", shipped())
def test_each_column_turns_its_own_axis_when_thrust_acts_on_the_geometry(name: str) -> None:
    aircraft = load_aircraft(name)
    thrust = mixer(aircraft)  # a newton of change a unit of share
    positions = aircraft.rotor_positions
    moments = np.stack(
        [
            positions[:, 1] @ thrust,
            -positions[:, 0] @ thrust,
            -aircraft.spins @ thrust * aircraft.propulsion.torque_ratio[0],
        ]
    )
    assert (np.diag(moments) > 0).all()
    assert np.abs(moments - np.diag(np.diag(moments))).max() < 1e-9
    assert thrust.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.abs(thrust).max(axis=0) == pytest.approx(np.ones(3))


def test_each_aircraft_has_its_own_settings_when_they_are_listed() -> None:
    aircraft = load_aircraft("nf1")
    gains = ((2.0, 30.0, 0.02), (1.0, 5.0, 0.0), (3.0, 0.0, 0.01))
    many = [PidSettings((g, g, g), cutoff, 0.0) for g, cutoff in zip(gains, (20.0, 80.0, None), strict=True)]
    rng = np.random.default_rng(6)
    setpoint, gyro = rng.normal(0, 2, (2, 20, 3, 3)).astype(np.float32)
    together = Pid(mixer(aircraft), many, 3, RATE_HZ)
    alone = [Pid(mixer(aircraft), settings, 1, RATE_HZ) for settings in many]
    for k in range(20):
        y = together.step(setpoint[k], gyro[k], np.zeros(3, np.float32))
        for i, pid in enumerate(alone):
            single = pid.step(setpoint[k, i : i + 1], gyro[k, i : i + 1], np.zeros(1, np.float32))
            assert y[i].tobytes() == single[0].tobytes()


def test_settings_are_refused_when_they_are_neither_one_nor_one_for_each() -> None:
    settings = load_aircraft("nf1").pids[0][1]
    with pytest.raises(ValueError, match="2 settings for 3 controllers"):
        Pid(np.zeros((4, 3)), [settings, settings], 3, RATE_HZ)


@pytest.mark.parametrize("shapes", [((2, 3), (3, 3), (3,)), ((3, 3), (3, 4), (3,)), ((3, 3), (3, 3), (1,))])
def test_inputs_are_refused_when_they_are_not_one_for_each(shapes: tuple[tuple[int, ...], ...]) -> None:
    pid = aircraft_pid(load_aircraft("nf1"), 3)
    with pytest.raises(ValueError, match="got an array"):
        pid.step(*(np.zeros(shape, np.float32) for shape in shapes))
    with pytest.raises(ValueError, match=r"got an array \(2,\), expected \(3,\)"):
        pid.compensate(np.ones(2))


def test_the_integral_does_not_grow_when_it_stands_on_the_ground() -> None:
    settings = PidSettings(((1.0, 40.0, 0.0), ZERO, ZERO), None, 0.0)
    mix = np.hstack([ONE_AXIS, np.zeros((3, 2))])
    standing, flying = (Pid(mix, settings, 1, RATE_HZ, standing=ground) for ground in (True, False))
    first = step_once(standing, [50, 0, 0], ZERO)
    for _ in range(100):
        assert step_once(standing, [50, 0, 0], ZERO).tolist() == first.tolist()
        grown = step_once(flying, [50, 0, 0], ZERO)
    assert first[0] - first[1] == pytest.approx(0.05)
    assert grown[0] - grown[1] == pytest.approx(0.05 + 40 * 50 * 0.1 / 1000, rel=1e-5)


def at_throttle(throttle: float, volts: float, gains: tuple[float, float, float]) -> Array32:
    """What each axis asks of its motor in the second step, at 50 deg/s of error and 10,000 deg/s^2."""
    settings = PidSettings((gains,) * 3, None, 0.0, tpa_rate=0.4, tpa_breakpoint=0.5, nominal_voltage=15.0)
    pid = Pid(np.eye(3), settings, 1, RATE_HZ)
    pid.compensate(np.array([volts]))
    thrust = np.full(1, throttle, np.float32)
    for rate in (0.0, 10.0):
        wanted, gyro = (np.deg2rad([[r, r, r]]).astype(np.float32) for r in (60.0, rate))
        y = pid.step(wanted, gyro, thrust)
    asked: Array32 = y[0]
    return asked


@pytest.mark.parametrize(("throttle", "factor"), [(0.0, 1.0), (0.5, 1.0), (0.75, 0.8), (1.0, 0.6)])
def test_the_throttle_takes_from_the_derivative_alone_when_it_is_above_the_breakpoint(
    throttle: float, factor: float
) -> None:
    held = at_throttle(throttle, math.nan, (2.0, 30.0, 0.0))
    assert held == pytest.approx([(2.0 * 50 + 30.0 * 0.11) / 1000] * 3, rel=1e-4)
    damped = at_throttle(throttle, math.nan, (2.0, 0.0, 0.005))
    assert damped == pytest.approx([(2.0 * 50 - factor * 0.005 * 10_000) / 1000] * 3, rel=1e-4)


@pytest.mark.parametrize(
    ("volts", "factor"),
    [(math.nan, 1.0), (0.0, 1.0), (16.0, 1.0), (15.0, 1.0), (14.0, (15 / 14) ** 2), (12.0, 1.3)],
)
def test_all_terms_grow_when_the_battery_sags(volts: float, factor: float) -> None:
    gains = (2.0, 30.0, 0.005)
    full = (2.0 * 50 + 30.0 * 0.11 - 0.005 * 10_000) / 1000
    assert at_throttle(0.2, volts, gains) == pytest.approx([factor * full] * 3, rel=1e-4)


def test_first_step_knows_no_slope_when_reset() -> None:
    settings = PidSettings(((0.0, 30.0, 0.1), ZERO, ZERO), CUTOFF_HZ, 0.0)
    pid = Pid(np.hstack([ONE_AXIS, np.zeros((3, 2))]), settings, 1, RATE_HZ)
    step_once(pid, [90, 0, 0], [50, 0, 0])
    step_once(pid, [90, 0, 0], [70, 0, 0])
    pid.reset()
    assert step_once(pid, [0, 0, 0], [0, 0, 0]).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("demand", "outputs"),
    [
        ([-1.0, 1.0, 3.0], [0.0, 0.5, 1.0]),
        ([0.1, 0.2, 0.4], [0.1, 0.2, 0.4]),
        ([0.5, 0.9, 1.2], [0.5, 0.9, 1.0]),
        ([-0.5, 0.1, 0.3], [0.0, 0.6, 0.8]),
        ([-3.0, -1.0, -2.0], [0.0, 1.0, 0.5]),
        ([0.25, 1.5, 0.5], [0.2, 1.0, 0.4]),
    ],
)
def test_demand_keeps_its_shape_when_it_spans_more_than_the_range(
    demand: list[float], outputs: list[float]
) -> None:
    # A motor each axis, whose demand is its error.
    settings = PidSettings(((1000.0, 0.0, 0.0),) * 3, None, 0.0)
    assert step_once(Pid(np.eye(3), settings, 1, RATE_HZ), demand, ZERO) == pytest.approx(outputs, abs=1e-6)


def test_an_aircraft_without_gains_is_refused_when_a_pid_is_asked_for() -> None:
    with pytest.raises(AircraftError, match=r"no \[pid.NAME\] table"):
        aircraft_pid(dataclasses.replace(load_aircraft("nf1"), pids=()))


@pytest.mark.parametrize(("broken", "says"), [("pid.h", "pid.h is missing"), ("cc", "needs a C compiler")])
def test_one_line_says_what_is_missing_when_it_cannot_be_built(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, broken: str, says: str
) -> None:
    if broken == "cc":
        monkeypatch.setenv("PATH", str(tmp_path))
    else:
        monkeypatch.setattr(library, "FILES", (tmp_path / broken,))
    with pytest.raises(BuildError, match=f"the (PID is the )?firmware's.*{says}") as error:
        library.library.__wrapped__(4)
    assert "\n" not in str(error.value)


@pytest.mark.slow  # 3.5 s; the arithmetic is held above, and the figures stand in docs/results
def test_published_gains_give_the_published_figures_on_the_rig_without_noise_and_delay() -> None:
    # Koch 2019, table 5.7: IAE and ISE of a second, in deg/s; its MAE is printed without decimals.
    aircraft = load_aircraft("nf1")
    aircraft = dataclasses.replace(aircraft, propulsion=dataclasses.replace(aircraft.propulsion, delay=0.0))
    pid = aircraft_pid(aircraft, 100, RATE_HZ, "published")
    result = figures(
        record(
            pid,
            aircraft,
            PulseTask(),
            episodes=100,
            seed=1,
            control_rate_hz=RATE_HZ,
            mount=Mount.RIG,
            noise=False,
        )
    )
    assert result.tracking.mae == pytest.approx(np.array([4.773, 4.941, 3.829]), rel=0.1)
    assert result.tracking.mse == pytest.approx(np.array([414.216, 493.033, 199.662]), rel=0.1)
    assert result.effort.output == pytest.approx(0.03, abs=0.01)
