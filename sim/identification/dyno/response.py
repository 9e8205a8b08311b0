"""A rotor's response to steps of throttle, of either kind, and the latency before it, from a recording."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from neuroflight.sim.aircraft.model import FirstOrderResponse, Response, TorqueResponse
from neuroflight.sim.arrays import Array, Flags, Indices
from neuroflight.sim.identification.dyno.model import (
    UNLIMITED,
    Dynamics,
    Schedule,
    curve,
    knots,
    make_schedule,
    retimed,
    simulate,
)
from neuroflight.sim.identification.dyno.recording import Recording
from neuroflight.sim.identification.dyno.robust_fit import Estimate, robust_fit
from neuroflight.sim.identification.dyno.signal import (
    JUMP,
    average,
    commanded,
    outliers,
    transient_rows,
    without_spikes,
)

KINDS = ("torque", "first_order")
DELAY_MAX = 0.1  # [s], the most an aircraft file may hold
DELAY_UNIT = 0.01  # [s], makes the fit's parameters alike in size
HELD_COARSE = 0.02  # throttle, while only steps are fitted
SLOPE_MIN = 1e-3  # of the top speed: least slope of H that is written
ROUNDS = 2  # of placing jumps between rows and fitting everything
REACHED = 0.98  # a limit counts as reached if it is below this part of what a step asked for
SURE = 3.0  # standard errors by which it must be
EXACT = 1e-3  # of the noise: models that differ by less fit alike


@dataclass(frozen=True)
class ResponseFit:
    """The response and the latency before it. A first-order lag has one rate for each direction and no slew.

    A bench shows torques only as accelerations: gain and clamps are divided by the rotor's inertia.
    """

    kind: str  # one of KINDS
    rate_up: Estimate  # [1/s], 1 / time constant, or gain / inertia (then the same in both directions)
    rate_down: Estimate
    slew_up: Estimate | None  # [rad/s^2], torque_up / inertia; None: a first-order lag
    slew_down: Estimate | None
    reached: tuple[bool, bool]  # whether a step ran into the limit up, down; else the slew is a lower bound
    delay: Estimate  # [s]
    rms: float  # [rad/s], of the speed's residuals, outliers left out

    @property
    def time_constant_up(self) -> Estimate:
        """Time constant of a first-order lag while speed rises [s]."""
        return Estimate(1 / self.rate_up.value, self.rate_up.error / self.rate_up.value**2)

    @property
    def time_constant_down(self) -> Estimate:
        """Time constant of a first-order lag while speed falls [s]."""
        return Estimate(1 / self.rate_down.value, self.rate_down.error / self.rate_down.value**2)

    def response(self, inertia: float) -> Response:
        """Return the response as an aircraft file has it, for a rotor inertia [kg m^2]."""
        if self.slew_up is None or self.slew_down is None:
            return FirstOrderResponse(self.time_constant_up.value, self.time_constant_down.value)
        return TorqueResponse(
            self.rate_up.value * inertia, self.slew_up.value * inertia, self.slew_down.value * inertia
        )


@dataclass(frozen=True, eq=False)
class Tried:
    """A response fitted together with H."""

    response: ResponseFit
    slopes: Array  # (3,) H(0), H'(0), H'(1) [rad/s]
    slope_errors: Array  # (3, 3) their covariance
    speed: Array  # (N,) [rad/s]
    criterion: float  # Bayesian information criterion, less is better


def fit_response(
    kind: str,
    recording: Recording,
    schedule: Schedule,
    rows: Indices,
    slopes: Array,
    noise: float,
    full: float,
    delay: float | None,
) -> Tried:
    """Fit H and a response of `kind`: the response alone on the transients first, then all on every row."""
    time = recording.time
    shown = transient_rows(recording, rows)
    throttle = commanded(recording)
    rise, fall = _lags(recording, throttle, rows, slopes, shown)
    coarse = make_schedule(recording, throttle, noise, HELD_COARSE)

    def dynamics(p: Array) -> Dynamics:
        wait = delay if delay is not None else float(p[-1]) * DELAY_UNIT
        if kind == "torque":
            rate = math.exp(p[0])
            return Dynamics(rate, rate, full * math.exp(p[1]), full * math.exp(p[2]), wait)
        return Dynamics(math.exp(p[0]), math.exp(p[1]), UNLIMITED, UNLIMITED, wait)

    count = 3 if kind == "torque" else 2
    low = [math.log(0.2)] * count
    high = [math.log(5000.0)] * count
    start = [1 / rise, 0.6 / rise, 0.6 / fall] if kind == "torque" else [1 / rise, 1 / fall]
    if delay is None:
        low, high = [*low, 0.0], [*high, DELAY_MAX / DELAY_UNIT]

    def residuals(timed: Schedule, p: Array) -> Array:
        return simulate(timed, p[:3] * full, dynamics(p[3:]), time) - recording.speed

    def misfit(p: Array, timed: Schedule) -> Array:
        """Compute the cost of the rows after each jump."""
        rows_cost = np.where(shown, np.sqrt(1.0 + (residuals(timed, p) / noise) ** 2) - 1.0, 0.0)
        costs: Array = np.add.reduceat(rows_cost, rows)
        return costs

    best: tuple[float, Array] | None = None
    # A rotor at its torque limit resembles a slow one: start from a slow and from two quick ones.
    for quicker in (1.0, 2.5, 6.0) if kind == "torque" else (1.0,):
        guess = np.log([start[0] * quicker, *start[1:]])
        guess = np.clip(guess if delay is not None else np.append(guess, 0.2), low, high)
        found, cost, _ = robust_fit(
            lambda p: simulate(coarse, slopes, dynamics(p), time[shown]) - recording.speed[shown],
            guess,
            noise,
            (np.array(low), np.array(high)),
            evaluations=25,
        )
        if best is None or cost < best[0]:
            best = cost, found
    assert best is not None

    bounds = np.array([0.0, SLOPE_MIN, SLOPE_MIN, *low]), np.array([2.0, 50.0, 50.0, *high])
    found = np.clip(np.concatenate([slopes / full, best[1]]), *bounds)
    timed = schedule
    for _ in range(ROUNDS):
        timed = retimed(timed, rows, partial(misfit, found))
        found, cost, covariance = robust_fit(partial(residuals, timed), found, noise, bounds)
        if not timed.slack.any():
            break
    slopes = found[:3] * full
    speed = simulate(timed, slopes, dynamics(found[3:]), time)
    off = outliers(recording.speed, recording.starts)
    smooth = average(np.where(off, 0.0, recording.speed - speed), ~off, recording)
    rms = float(np.sqrt(np.mean(smooth[shown] ** 2)))
    errors = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    response = _response_fit(kind, dynamics(found[3:]), errors[3:], schedule, slopes, delay, rms)
    cost += len(time) * (EXACT * noise) ** 2
    criterion = len(time) * math.log(cost) + len(found) * math.log(len(time))
    return Tried(response, slopes, covariance[:3, :3] * full**2, speed, criterion)


def _response_fit(
    kind: str,
    fitted: Dynamics,
    errors: Array,
    schedule: Schedule,
    slopes: Array,
    delay: float | None,
    rms: float,
) -> ResponseFit:
    """Build the result with its standard errors; `errors` are those of logarithms, then of the delay."""
    wait = Estimate(fitted.delay, 0.0 if delay is not None else float(errors[-1]) * DELAY_UNIT)

    def estimate(value: float, index: int) -> Estimate:
        return Estimate(value, value * float(errors[index]))

    if kind == "first_order":
        up, down = estimate(fitted.rate_up, 0), estimate(fitted.rate_down, 1)
        return ResponseFit(kind, up, down, None, None, (True, True), wait, rms)
    rate = estimate(fitted.rate_up, 0)
    targets = curve(slopes, schedule.value)
    away = targets - knots(schedule, targets, fitted)
    most = fitted.rate_up * max(away.max(), 0.0), fitted.rate_up * max(-away.min(), 0.0)
    slews, reached = [], []
    for index, (slew, asked) in enumerate(
        zip((fitted.slew_up, fitted.slew_down), most, strict=True), start=1
    ):
        sure = 1 + SURE * float(errors[index])
        reached.append(bool(slew * sure < REACHED * asked))
        slews.append(estimate(slew, index) if reached[-1] else Estimate(asked, math.inf))
    return ResponseFit(kind, rate, rate, slews[0], slews[1], (reached[0], reached[1]), wait, rms)


def _lags(
    recording: Recording, throttle: Array, rows: Indices, slopes: Array, shown: Flags
) -> tuple[float, float]:
    """Compute the median time up and down to 63 % of the way from one held speed to the next [s]."""
    speed = without_spikes(recording.speed, recording.starts)
    lags: dict[bool, list[float]] = {True: [], False: []}
    for row, end in zip(rows, np.append(rows[1:], len(speed)), strict=True):
        window = slice(int(row), int(end))
        before, after = curve(slopes, throttle[[row - 1, row]])
        way = (speed[window][shown[window]] - before) / (after - before)
        passed = np.flatnonzero(way > 0.63)
        if len(passed):
            lags[bool(after > before)].append(float(recording.time[row + passed[0]] - recording.time[row]))
    rise, fall = (float(np.median(values)) if values else 0.05 for values in (lags[True], lags[False]))
    return max(rise, 1e-3), max(fall, 1e-3)


def why_none(throttle: Array, rows: Indices) -> str:
    change = throttle[rows] - throttle[rows - 1]
    missing = [name for name, found in (("up", change > 0), ("down", change < 0)) if not found.any()]
    if not missing:
        return ""
    return f"no response: the recording has no step {' or '.join(missing)} of {JUMP:g} throttle or more"


def why_better(tried: list[Tried]) -> str:
    best, other = tried[0], tried[1]
    top = float(best.slopes[0] + 0.5 * (best.slopes[1] + best.slopes[2]))
    rms = [100 * item.response.rms / top for item in (best, other)]
    return (
        f"{best.response.kind}: after steps the model is {rms[0]:.2f} % of top speed off (rms, noise "
        f"averaged away), with {other.response.kind} {rms[1]:.2f} %; its BIC is less by "
        f"{other.criterion - best.criterion:,.0f}"
    )


def limits(response: ResponseFit) -> list[str]:
    return [
        f"no step visibly ran into the torque limit {name}: the one given is the most that was asked for, "
        f"a lower bound"
        for name, reached in zip(("up", "down"), response.reached, strict=True)
        if not reached
    ]
