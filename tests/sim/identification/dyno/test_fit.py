"""The fit recovers the parameters of simulated rotors, and notes what a recording does not show."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import astuple, replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import RPM, FirstOrderResponse, Propulsion, TorqueResponse, load_aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.dyno.bench import (
    EXPERIMENTS,
    RAMP,
    STEPS,
    Phase,
    disturbed,
    duration,
    run,
    sample_times,
)
from neuroflight.sim.identification.dyno.fit import Fit, fit
from neuroflight.sim.identification.dyno.model import Dynamics, make_schedule, simulate
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.physics.rotor import speeds_along, target_speed
from neuroflight.toolchain.errors import DynoError

NF1 = load_aircraft("nf1").propulsion


def unknown_rotor(rng: np.random.Generator, kind: str) -> Propulsion:
    """A rotor between those of 2 and 15 inch propellers: H of any monotone shape, the rest over decades."""
    top = rng.uniform(6000, 32000) * RPM
    start = rng.uniform(0.0, 0.02) * top
    bow = rng.uniform(-0.45, 0.45) * (top - start)  # a in a u^2 + b u + c
    inertia = 10 ** rng.uniform(-6.5, -4)
    lag = rng.uniform(0.020, 0.080)
    response: TorqueResponse | FirstOrderResponse
    if kind == "torque":
        # The most a full step asks for is inertia * top / lag: the clamps cut that to a tenth to two thirds.
        most = inertia * top / lag
        response = TorqueResponse(
            inertia / lag, most * rng.uniform(0.10, 0.60), most * rng.uniform(0.15, 0.65)
        )
    else:
        response = FirstOrderResponse(lag, rng.uniform(0.020, 0.080))
    return replace(
        NF1,
        speed_curve=(bow, top - start - bow, start),
        thrust_coefficient=(10 ** rng.uniform(-7.5, -4.5),),
        torque_ratio=(10 ** rng.uniform(-2.5, -1.5),),
        rotor_inertia=inertia,
        response=response,
        delay=rng.uniform(0.0, 0.006),
    )


def record(
    propulsion: Propulsion,
    rng: np.random.Generator | None = None,
    experiment: tuple[Phase, ...] = STEPS,
    rate_hz: float = 250,
    *,
    noise: float = 0.0,
    of_reading: bool = False,
    outliers: float = 0.0,
) -> tuple[Recording, Recording]:
    """What a poor bench logs at uneven times, and the truth at the same times; even and clean without rng."""
    true = run(propulsion, experiment, sample_times(duration(experiment), rate_hz, rng))
    if rng is None:
        return true, true
    return disturbed(true, rng, noise=noise, of_reading=of_reading, outliers=outliers), true


@functools.cache
def plainly_fitted() -> Fit:
    """Of the NF1's rotor, its steps without noise."""
    return fit(record(NF1)[0])


def fitted_curve(found: Fit, throttle: Array) -> Array:
    a, b, c = (term.value for term in found.speed_curve)
    return (a * throttle + b) * throttle + c


def check_rotor(
    found: Fit, rotor: Propulsion, curve: float, coefficients: float, response: float = 0.1
) -> None:
    """The fit against the rotor: its curve by its top speed, the others by themselves."""
    throttle = np.linspace(0.0, 1.0, 101)
    away = fitted_curve(found, throttle) - target_speed(throttle, rotor)
    assert np.abs(away).max() < curve * rotor.speed_max
    assert len(found.thrust_coefficient) == len(found.torque_ratio) == 1
    assert found.thrust_coefficient[0].value == pytest.approx(rotor.thrust_coefficient[0], rel=coefficients)
    assert found.torque_ratio[0].value == pytest.approx(rotor.torque_ratio[0], rel=coefficients)
    if found.response is not None:
        known, seen = rotor.response, found.response.response(rotor.rotor_inertia)
        assert type(seen) is type(known)
        assert astuple(seen) == pytest.approx(astuple(known), rel=response)


def check_trial(number: int, rate_hz: float) -> None:
    """One unknown rotor against the bars; odd ones lag, even ones are clamped; noise of two kinds."""
    rng = np.random.default_rng((2019, number))
    kind = ("torque", "first_order")[number % 2]
    rotor = unknown_rotor(rng, kind)
    poor, true = record(
        rotor,
        rng,
        EXPERIMENTS["all"],
        rate_hz=rate_hz,
        noise=0.02,
        of_reading=bool(number // 2 % 2),
        outliers=0.01,
    )
    found = fit(poor)
    check_rotor(found, rotor, curve=0.01, coefficients=0.02)
    assert found.response is not None and found.response.kind == kind
    assert found.response.delay.value == pytest.approx(rotor.delay, abs=0.0015)
    error = (found.speed - true.speed) / rotor.speed_max
    assert np.sqrt(np.mean(error**2)) < 0.002
    assert np.abs(error).max() < (0.02 if rate_hz == 500 else 0.03)  # at every instant, steps included
    for part in found.speed_errors:
        assert part.mae < 0.02 and part.model_rms < 0.01


@pytest.mark.parametrize("number", [0, 3])  # each response, each noise; of many rotors below
def test_rotor_is_found_when_its_parameters_are_unknown(number: int) -> None:
    check_trial(number, rate_hz=250)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(20))
def test_rotor_is_found_in_every_trial_when_there_are_many(number: int) -> None:
    check_trial(number, rate_hz=500)


@pytest.mark.parametrize("response", [NF1.response, FirstOrderResponse(0.05, 0.03)], ids=["torque", "lag"])
def test_closed_form_agrees_with_the_rotor_of_the_twin_when_throttle_wanders(
    response: TorqueResponse | FirstOrderResponse,
) -> None:
    rotor = replace(NF1, response=response)
    rng = np.random.default_rng(11)
    dt, each = 1 / 20_000, 300  # throttle moves every 15 ms, before the rotor has settled
    throttle = np.repeat(rng.random(100), each)
    speeds = speeds_along(np.zeros(1), target_speed(throttle, rotor)[:-1, None], dt, rotor)[:, 0]
    time = np.arange(len(throttle), dtype=np.float64) * dt
    nothing = np.zeros_like(time)
    if isinstance(response, TorqueResponse):
        rate = response.gain / rotor.rotor_inertia
        up, down = response.torque_up / rotor.rotor_inertia, response.torque_down / rotor.rotor_inertia
        dynamics = Dynamics(rate, rate, up, down, 0.0)
    else:
        dynamics = Dynamics(1 / response.time_constant_up, 1 / response.time_constant_down, 1e12, 1e12, 0.0)
    a, b, c = rotor.speed_curve
    schedule = make_schedule(Recording(time, throttle, nothing, nothing, nothing), throttle)
    shown = simulate(schedule, np.array([c, b, 2 * a + b]), dynamics, time)
    assert np.abs(shown - speeds).max() < 1e-4 * rotor.speed_max


def test_fit_is_exact_when_the_recording_is() -> None:
    found = fit(record(NF1, experiment=EXPERIMENTS["all"])[0])
    assert [term.value for term in found.speed_curve] == pytest.approx(NF1.speed_curve, rel=2e-3)
    check_rotor(found, NF1, curve=2e-3, coefficients=1e-4, response=5e-3)
    assert found.response is not None
    assert found.response.delay.value == pytest.approx(0.002, abs=1e-4)
    assert not any(off.any() for off in found.outliers)
    assert found.notes == ()


def test_error_bars_hold_the_truth_when_noise_is_white() -> None:
    rng = np.random.default_rng(12)
    for _ in range(2):
        time = sample_times(duration(STEPS), 250)
        poor = disturbed(run(NF1, STEPS, time), rng, noise=0.02)
        found = fit(poor)
        assert found.response is not None and found.response.slew_up is not None
        for estimate, truth in (
            (found.response.rate_up, 1e-4 / 4.24e-6),
            (found.response.slew_up, 0.05 / 4.24e-6),
            (found.response.delay, 0.002),
            (found.speed_curve[1], 39125.59 * RPM),
            (found.thrust_coefficient[0], 9.37e-7),
        ):
            assert abs(estimate.value - truth) < 5 * estimate.error
            assert estimate.error < 0.25 * truth


def test_outliers_are_named_when_they_are_gross() -> None:
    rng = np.random.default_rng(13)
    poor, true = record(NF1, rng, rate_hz=500, noise=0.02, outliers=0.01)
    found = fit(poor)
    for off, name in zip(found.outliers, ("speed", "thrust", "torque"), strict=True):
        away = np.abs(getattr(poor, name) - getattr(true, name)) / getattr(true, name).max()
        assert off[away > 0.2].mean() > 0.95
        assert off[away < 0.06].mean() < 0.001


def test_limit_is_called_a_lower_bound_when_no_step_reaches_it() -> None:
    strong = replace(NF1, response=TorqueResponse(1e-4, 0.05, 10.0))
    found = fit(disturbed(record(strong)[0], np.random.default_rng(14), noise=0.01))
    assert found.response is not None and found.response.kind == "torque"
    assert found.response.reached == (True, False)
    assert found.response.slew_down is not None
    asked = 1e-4 * NF1.speed_max / 4.24e-6
    assert found.response.slew_down.value == pytest.approx(asked, rel=0.1)
    assert np.isinf(found.response.slew_down.error)
    assert any("torque limit down" in note for note in found.notes)


def test_response_is_left_out_with_its_reason_when_throttle_never_jumps() -> None:
    found = fit(record(NF1, np.random.default_rng(15), RAMP, noise=0.02, outliers=0.01)[0])
    assert found.response is None
    assert "no step up or down" in found.reason
    check_rotor(found, NF1, curve=0.01, coefficients=0.02)


def test_response_is_the_one_asked_for_even_when_the_other_fits_better() -> None:
    found = fit(record(NF1)[0], kind="first_order", delay=0.002)
    assert found.response is not None and found.response.kind == "first_order" and found.rejected is None
    assert found.response.delay.value == 0.002
    better = plainly_fitted()
    assert better.response is not None and better.rejected is not None
    assert better.response.kind == "torque" and better.response.rms < 0.1 * better.rejected.rms
    assert "torque" in better.reason and "first_order" in better.reason


def test_coefficients_follow_speed_only_when_they_do_and_may() -> None:
    top = NF1.speed_max
    bent = replace(NF1, thrust_coefficient=(8e-7, 2e-7 / top))
    poor, _ = record(bent, np.random.default_rng(16), RAMP, noise=0.02, outliers=0.01)
    found = fit(poor, speed_dependent=True)
    assert len(found.torque_ratio) == 1
    assert len(found.thrust_coefficient) > 1
    speeds = np.linspace(0.2, 1.0, 9) * top
    shown = np.polynomial.polynomial.polyval(speeds, [term.value for term in found.thrust_coefficient])
    assert shown == pytest.approx(8e-7 + 2e-7 * speeds / top, rel=0.02)
    assert len(fit(poor).thrust_coefficient) == 1


def test_torque_is_not_misled_when_the_bench_feels_the_rotor_accelerate() -> None:
    poor, true = record(NF1, np.random.default_rng(17), noise=0.01)
    reaction = NF1.rotor_inertia * np.gradient(true.speed, true.time)
    assert np.abs(reaction).max() > 0.5 * true.torque.max()
    found = fit(replace(poor, torque=poor.torque + reaction))
    assert found.torque_ratio[0].value == pytest.approx(8.64e-3, rel=0.02)


def test_jumps_between_rows_are_placed_when_rows_are_few_and_uneven() -> None:
    rotor = replace(NF1, response=FirstOrderResponse(0.03, 0.04))
    poor, true = record(rotor, np.random.default_rng(18), rate_hz=80, noise=0.01)
    found = fit(poor, kind="first_order")
    assert found.response is not None
    assert found.response.time_constant_up.value == pytest.approx(0.03, rel=0.1)
    assert found.response.time_constant_down.value == pytest.approx(0.04, rel=0.1)
    assert np.abs(found.speed - true.speed).max() < 0.05 * rotor.speed_max


def test_runs_start_anew_when_there_are_several() -> None:
    whole = record(NF1)[0]
    half = int(np.searchsorted(whole.time, 6.0))  # the rotor turns there
    late = np.where(np.arange(len(whole.time)) < half, 0.0, 100.0)
    apart = replace(whole, time=whole.time + late, starts=(0, half))
    one, two = plainly_fitted(), fit(apart)
    assert one.response is not None and two.response is not None
    assert two.response.rate_up.value == pytest.approx(one.response.rate_up.value, rel=1e-3)
    assert two.speed == pytest.approx(one.speed, abs=1e-3 * NF1.speed_max)


def test_note_says_extrapolated_when_throttle_ends_early() -> None:
    gentle = (Phase(1, 0, 0), Phase(2, 0.3, 0.3), Phase(2, 0.6, 0.6), Phase(2, 0, 0))
    found = fit(record(NF1, experiment=gentle)[0])
    assert any("throttle ends at 0.60" in note and "extrapolated" in note for note in found.notes)
    assert fitted_curve(found, np.ones(1))[0] == pytest.approx(NF1.speed_max, rel=0.02)


def test_throttle_may_be_measured_when_its_noise_and_slips_are_few() -> None:
    rng = np.random.default_rng(19)
    poor, _ = record(NF1, rng, noise=0.02, outliers=0.01)
    slip = rng.random(len(poor.time)) < 0.01
    throttle = np.where(
        slip, rng.uniform(0, 2, len(slip)), poor.throttle + 0.02 * rng.standard_normal(len(slip))
    )
    found = fit(replace(poor, throttle=throttle))
    assert any("slips of the logger" in note for note in found.notes)
    assert found.response is not None and found.response.kind == "torque"
    assert found.response.rate_up.value == pytest.approx(1e-4 / 4.24e-6, rel=0.15)
    assert fitted_curve(found, np.ones(1))[0] == pytest.approx(NF1.speed_max, rel=0.01)
    assert found.thrust_coefficient[0].value == pytest.approx(9.37e-7, rel=0.02)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: replace(r, throttle=0.5 * (r.throttle > 0)), "throttle settles near 0, 0.5 only"),
        (lambda r: replace(r, speed=0.0 * r.speed), "rpm is 0 nearly everywhere"),
        (lambda r: replace(r, thrust=-r.thrust), "thrust is negative while the rotor turns"),
        (lambda r: replace(r, torque=0.0 * r.torque), "torque is zero while the rotor turns"),
        (lambda r: replace(r, throttle=np.arange(len(r.time)) // 50 % 2 * 1.0), "throttle jumps again"),
    ],
    ids=["two levels", "no speed", "thrust's sign", "no torque", "too quick"],
)
def test_recording_is_refused_when_it_cannot_show_a_rotor(
    change: Callable[[Recording], Recording], message: str
) -> None:
    with pytest.raises(DynoError, match=message):
        fit(change(record(NF1)[0]))
