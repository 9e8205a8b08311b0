"""A flight in one sentence that a pilot understands: how well it followed and held, or what is wrong with it.

The limits are those of `policy check` where a single flight can tell; the reference is the controller that
flew the same sticks beside it, if one did. A flight without a fault here is no proof of fitness: the check
flies more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from neuroflight.sim.analysis.flight_report import Flight
from neuroflight.sim.analysis.holding import DRIFT_S
from neuroflight.sim.analysis.limits import (
    CHANGE,
    DRIFT_DEG,
    DRIFT_DEG_S,
    GROWTH_DEG_S,
    REST_CHANGE,
    ROUGHER,
    TRACKING,
)
from neuroflight.sim.analysis.swing import change, swing
from neuroflight.sim.arrays import Flags
from neuroflight.toolchain.contract import AXES

ENTRY_S = 0.2  # beginning of a held command, while rotors and aircraft still respond
HELD_S = 0.1  # least rest of it for a figure: six periods of an oscillation at 60 Hz
SEVERAL = 1  # faults that are told of each flight in the sentence on several


def verdict(flown: str, flight: Flight, beside: Flight | None = None, told: Sequence[str] = ()) -> str:
    """Return the sentence.

    flown: the commands in words, as after "followed"; told: faults that are known otherwise, such as that the
    policy was refused, in words that go on after the controller's name.
    """
    found = [*told, *faults(flight, beside)]
    mae = flight.figures.tracking.mae.mean()
    other = "" if beside is None else f" ({beside.name}: {beside.figures.tracking.mae.mean():.2f})"
    words = f"{_capital(flight.name)} followed {flown} with {mae:.2f} deg/s of mean error{other}"
    if found:
        return f"{words}, but it {'; it '.join(found)}."
    if (held := flight.holding) is None:
        return f"{words}."
    rest, drift = np.abs(held.hover).max(), np.abs(held.drift).max()
    return (
        f"{words} and then held: at rest {rest:.2f} deg/s, turned by {drift:.0f} deg in {DRIFT_S:g} s of "
        f"centred sticks."
    )


def verdict_of_several(flights: Sequence[tuple[str, Flight, Sequence[str]]]) -> str:
    """Return the sentence on flights of one firmware, each with its scenario's name and `told`."""
    bad = [(name, [*told, *faults(flight)]) for name, flight, told in flights]
    bad = [(name, found) for name, found in bad if found]
    name, worst, _ = max(flights, key=lambda each: each[1].figures.tracking.mae.mean())
    if bad:
        words = "; ".join(f"in {where} it {', it '.join(found[:SEVERAL])}" for where, found in bad)
        return f"{_capital(worst.name)}: {len(bad)} of {len(flights)} flights went wrong: {words}."
    hovered = any(flight.holding for _, flight, _ in flights)  # otherwise no drift is known
    without = "drift or swing" if hovered else "swing"
    return (
        f"{_capital(worst.name)} flew all {len(flights)} to their end without {without}; the most mean error "
        f"was {worst.figures.tracking.mae.mean():.1f} deg/s, in {name}."
    )


def faults(flight: Flight, beside: Flight | None = None) -> list[str]:
    """Return what is wrong with the flight, each in words that go on after "it", the worst first."""
    return [*_stopped(flight), *_held(flight, beside), *_swings(flight, beside), *_follows(flight, beside)]


def _stopped(flight: Flight) -> Iterator[str]:
    """Yield a fault if its motors stood still for a while."""
    still = (flight.trace.dshot == 0).any(axis=1)
    if still.any():
        at_s = flight.trace.t[still.argmax()] - flight.trace.t[0]
        yield f"stopped its motors at {at_s:.2f} s, for {100 * still.mean():.0f} % of the flight"


def _held(flight: Flight, beside: Flight | None) -> Iterator[str]:
    """Yield a fault if it turns with centred sticks, or turns more late in the flight than early."""
    if (held := flight.holding) is None:
        return
    other = None if beside is None else beside.holding
    drift, early, late = np.abs(held.drift[0]), held.early[0], held.hover[0]
    drift_there = np.zeros(3) if other is None else np.abs(other.drift[0])
    late_there = np.zeros(3) if other is None else other.hover[0]

    def there(value: float, digits: int) -> str:
        return "" if other is None or beside is None else f" ({beside.name}: {value:.{digits}f})"

    axis = int((drift - drift_there).argmax())
    if drift[axis] - drift_there[axis] > DRIFT_DEG:
        yield (
            f"DRIFTS: {drift[axis]:.0f} deg in {AXES[axis]} in {DRIFT_S:g} s of centred sticks"
            f"{there(drift_there[axis], 0)}"
        )
        return
    axis = int((late - late_there).argmax())
    if late[axis] - late_there[axis] > DRIFT_DEG_S:
        yield (
            f"does not rest: with centred sticks it turns to and fro by {late[axis]:.1f} deg/s in "
            f"{AXES[axis]}{there(late_there[axis], 1)}"
        )
        return
    axis = int(np.nan_to_num(late - early).argmax())
    if late[axis] - early[axis] > GROWTH_DEG_S:
        yield (
            f"holds worse the longer it flies: in {AXES[axis]} {early[axis]:.1f} deg/s at rest early, "
            f"{late[axis]:.1f} late"
        )


def _swings(flight: Flight, beside: Flight | None) -> Iterator[str]:
    """Yield a fault if its motors oscillate: over the flight, in a held command, or in the hover."""
    trace, step_s = flight.trace, flight.trace.step_s
    if not step_s:
        return
    seen: list[tuple[float, float, slice]] = []  # change, its part of the limit, rows
    for rows, usual in _windows(flight):
        limit = usual
        if beside is not None and len(beside.trace.t) == len(trace.t):
            limit = max(limit, ROUGHER * change(beside.trace.motors[rows], step_s))
        own = change(trace.motors[rows], step_s)
        seen.append((own, own / limit, rows))
    if not seen:
        return
    own, part, rows = max(seen, key=lambda each: each[1])
    if part > 1.0:
        _, frequency = swing(trace.motors[rows], step_s)
        yield (
            f"SWINGS at {frequency:.0f} Hz from {trace.t[rows.start]:.1f} s on: the motors change by "
            f"{100 * own:.1f} % of their range in 1 ms, at most {100 * own / part:.1f} % is sound"
        )


def _windows(flight: Flight) -> Iterator[tuple[slice, float]]:
    """Yield the measured rows of the flight, with the limit of the motors' change in them."""
    trace = flight.trace
    running: Flags = np.all(trace.dshot > 0, axis=1)
    entry, least = round(ENTRY_S / trace.step_s), max(3, round(HELD_S / trace.step_s))
    rows = len(trace.t)
    if rows >= least and running.all():
        yield slice(0, rows), CHANGE
    moved = np.flatnonzero(np.diff(trace.setpoint, axis=0).any(axis=1)) + 1
    edges = [0, *moved.tolist(), rows]
    for begin, end in pairwise(edges):
        held = slice(begin + entry, end)
        if end - begin - entry >= least and trace.setpoint[begin].any() and running[held].all():
            yield held, CHANGE
    if flight.hover_rows and running[-flight.hover_rows :].all():
        yield slice(rows - flight.hover_rows, rows), REST_CHANGE


def _follows(flight: Flight, beside: Flight | None) -> Iterator[str]:
    """Yield a fault if it follows the sticks worse than the reference."""
    if beside is None:
        return
    own, other = flight.figures.tracking, beside.figures.tracking
    for name in ("mae", "mse"):  # stops after the first: one is enough for the sentence
        mine, theirs = (float(getattr(each, name).mean()) for each in (own, other))
        if not mine <= TRACKING * theirs:
            figures = "" if name == "mae" else f": MSE {mine:.3g} (deg/s)², {theirs:.3g}"
            yield f"follows the sticks worse than {beside.name}{figures}"
            return


def _capital(name: str) -> str:
    return name[:1].upper() + name[1:]
