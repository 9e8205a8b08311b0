"""`fit`: the parameters of a twin from flights, and what they cannot tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.identification.fit.estimate import (
    Data,
    Estimate,
    Wiring,
    combined,
    prepare,
    solve,
    solve_by,
)
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.held import explained, held_back
from neuroflight.sim.identification.fit.instruments import quiet, speaks
from neuroflight.sim.identification.fit.model import Layout, layout
from neuroflight.sim.identification.fit.parameters import flown_at, parameters
from neuroflight.sim.identification.fit.result import Fit
from neuroflight.sim.identification.fit.wiring import find_wiring
from neuroflight.toolchain.contract import AXES
from neuroflight.toolchain.errors import TraceError

# Of the logarithms of the response's times, and solve's rough_hz; flights differ in which of them lead home.
STARTS = ((0.0, 20.0), (0.0, 100.0), (-0.4, 0.0), (0.4, 0.0))
TRIED_ROUNDS = 7  # of each start
TRIED_S = 40.0  # of flight that starts are tried on
TURNED_SCORE = 4.0  # standard deviations of yaw's factor and kick together
MODEL_ERROR = 2.0  # of the squared half of the difference of two fits
BY_ROUNDS, KEPT_ROUNDS = 10, 4  # by commands, and of what was not held back
NO_COMMANDS = "no setpoints: gusts and wash that the motors answered make what is found too small or large"
EXPLAINED_MIN = 0.05  # of what the sticks made of one axis at least: else the log is another aircraft's

Progress = Callable[[str], None]


def fit(flights: Sequence[Flight], start: Aircraft, *, progress: Progress = lambda _: None) -> Fit:
    """Fit the twin's parameters to flights of one aircraft, beginning with those of `start`.

    Raises TraceError where the flights tell nothing of it.
    """
    if not flights:
        raise TraceError("no flight to fit")
    for flight in flights:
        if flight.motor_count != start.motor_count:
            raise TraceError(
                f"log {flight.name}: {flight.motor_count} motors, the aircraft has {start.motor_count}"
            )
    data = prepare(flights, start)
    if not data:
        raise TraceError("no flight has a second in the air without a gap; fly longer")
    usual, volts = flown_at(data)
    laid = layout(
        start,
        speeds=any(flight.has_speed for flight in flights),
        pack=any(flight.pack for flight in flights),
        usual=float(usual.mean()),
    )
    progress("motor order")
    wiring = find_wiring(data, start, laid, laid.start)
    tried = _best_start(data, laid, wiring, progress)
    wiring = find_wiring(data, start, laid, tried.theta)
    theta = tried.theta.copy()
    if turned := _props_turned(laid, tried):
        wiring = Wiring(wiring.order, tuple(-spin for spin in wiring.spins))
        theta[[laid.at("factor.yaw"), laid.at("kick")]] *= -1.0
    by_all = solve(data, laid, theta, wiring, progress=progress)
    progress("other weights")
    by_all = _with_model_error(
        by_all, solve(prepare(flights, start, other=True), laid, by_all.theta, wiring, rounds=5)
    )
    moved = any(map(speaks, data))
    found = by_all
    if moved:
        few = solve_by(quiet(data), data, laid, by_all.theta, wiring, rounds=BY_ROUNDS, progress=progress)
        found = combined(few, by_all)
    progress("held back")
    kept = prepare(flights, start, lambda flight, times: ~held_back(flight, times))
    shares = shares_start = np.full(3, np.nan)
    if kept and sum(one.used.sum() for one in data) > 1.2 * sum(one.used.sum() for one in kept):
        other = solve(kept, laid, found.theta, wiring, rounds=KEPT_ROUNDS)
        if moved:
            few = solve_by(quiet(kept), kept, laid, found.theta, wiring, rounds=KEPT_ROUNDS)
            other = combined(few, other)
        shares = explained(flights, start, held_back, (laid, other.theta, wiring))
        shares_start = explained(flights, start, held_back)
    if not np.isnan(shares).all() and np.nanmax(shares) < EXPLAINED_MIN:
        said = ", ".join(
            f"{axis} {100 * share:.0f} %"
            for axis, share in zip(AXES, shares, strict=True)
            if not np.isnan(share)
        )
        raise TraceError(
            f"{', '.join(flight.name for flight in flights)}: of what the sticks did to the aircraft the "
            f"twin predicts {said}; expected {100 * EXPLAINED_MIN:.0f} % of one axis at least: is it a log "
            "of this aircraft, flown in the air, with motors and gyro as --weight, --arm and --props say?"
        )
    values = laid.values(found.theta)
    return Fit(
        name=", ".join(Path(flight.name).name for flight in flights),
        parameters=parameters(flights, data, start, laid, found, wiring),
        explained=shares,
        explained_start=shares_start,
        order=wiring.order,
        spins=wiring.spins,
        props_out=bool(turned),
        notes=(*_notes(flights, start), *(() if moved else (NO_COMMANDS,))),
        seconds=sum(float(one.used.sum()) * one.model.piece.step_s for one in data),
        layout=laid,
        estimate=found,
        wiring=wiring,
        theta=values,
        usual=usual,
        volts=volts,
    )


def _best_start(data: Sequence[Data], laid: Layout, wiring: Wiring, progress: Progress) -> Estimate:
    """Try several starts and return where the best of them led."""
    some: list[Data] = []
    for one in sorted(data, key=lambda each: -int(each.used.sum())):
        if some and sum(float(each.used.sum()) * each.model.piece.step_s for each in some) > TRIED_S:
            break
        some.append(one)
    tried: list[Estimate] = []
    for away, rough_hz in STARTS:
        theta = laid.start.copy()
        for at, name in enumerate(laid.names):
            if name == "log_up":
                theta[at] += away
            elif name == "log_gain":
                theta[at] -= away
        progress(f"start {len(tried) + 1} of {len(STARTS)}")
        tried.append(solve(some, laid, theta, wiring, rounds=TRIED_ROUNDS, rough_hz=rough_hz))
    return min(tried, key=lambda each: each.cost)


def _props_turned(laid: Layout, tried: Estimate) -> bool:
    """Return True if yaw says that all propellers turn the other way: by its torque and by its kick."""
    score = 0.0
    for name in ("factor.yaw", "kick"):
        at = laid.at(name)
        score += tried.theta[at] / max(float(np.sqrt(tried.covariance[at, at])), 1e-6)
    return bool(score < -TURNED_SCORE)


def _with_model_error(found: Estimate, other: Estimate) -> Estimate:
    """Return the mean of two fits that weight frequencies otherwise, their difference in its covariance.

    They would agree if the equations were complete.
    """
    apart = 0.5 * (other.theta - found.theta)
    return replace(
        found,
        theta=found.theta + apart,
        covariance=found.covariance + MODEL_ERROR * np.outer(apart, apart),
    )


def _notes(flights: Sequence[Flight], start: Aircraft) -> tuple[str, ...]:
    found = []
    for flight in flights:
        name = Path(flight.name).name
        found += [f"{name}: {note}" for note in flight.notes]
        if flight.path.mixed:
            found.append(f"{name}: the gyro's filters are not told; the delay stands for them, too")
        if not flight.has_voltage:
            found.append(f"{name}: no voltage: the curve is that of this flight's mean charge")
        elif start.propulsion.supply_voltage is None:
            found.append("the start file has no supply_voltage_v: the log's voltage is not used")
    return tuple(found)
