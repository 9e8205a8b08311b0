"""The bars of a check: limits that a policy must not exceed, why, and how exceeding them shows in flight.

No bar knows an aircraft. Where physics gives a figure it is that; else it is a ratio to, or a distance from,
the better of the references, its PID and Betaflight, which fly the same commands in the same aircraft.
Those that any flight can tell are in sim/analysis/limits.py, and the verdict of `fly` holds the same. Whoever
changes a bar or the course counts RULES of toolchain/policy/check_stamp.py up: no stamp holds then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from neuroflight.sim.analysis.limits import (
    CHANGE,
    DRIFT_DEG,
    DRIFT_DEG_S,
    GROWTH_DEG_S,
    REST_CHANGE,
    ROUGHER,
    TRACKING,
)
from neuroflight.training.fitness.course import AXES, CommandFlight, Turn
from neuroflight.training.fitness.flying import CommandFigures, CourseFigures, TurnFigures

VARIED = 1.5  # likewise of an aircraft that differs from its file: two of the references are tuned for others
SINK = 0.5  # of the weight: with more lift than that and the throttle closed it falls with less than g / 2
FULL = 0.9  # of the aircraft's lift at full throttle
FALL = 0.05  # of the weight: lift that a larger throttle may take away
SWING = 0.05  # of a motor's range, amplitude: CHANGE is that of a sine of 0.03 at 100 Hz, of 0.05 at 60 Hz
HELD = 0.01  # of the commanded rate, beyond the better reference's error
OVERSHOOT = 0.1  # of the command; a reference's if that is more
BACK_DEG_S = 5.0  # beyond the better reference's error, half a second after a full turn
TILT_DEG = 5.0  # on the ground
# Lift of four rotors, of the weight, at whose speed one lifts a third of it: at a half it tips the aircraft.
GROUND_LIFT = 4.0 / 3.0


@dataclass(frozen=True)
class Case:
    """A measured figure and its limit."""

    where: str  # such as "hover"; empty where there is one case only
    seen: float
    limit: float
    reason: str  # what happens in flight, in a sentence without its end

    @property
    def met(self) -> bool:
        """True if the figure is within the limit; NaN is not."""
        return self.seen <= self.limit

    @property
    def share(self) -> float:
        """The figure as a part of its limit."""
        return self.seen / self.limit if self.limit > 0.0 else float("inf")


@dataclass(frozen=True)
class Bar:
    """All cases of one figure."""

    name: str
    unit: str
    source: str  # where the limit is from
    cases: tuple[Case, ...]

    @property
    def worst(self) -> Case:
        """The case nearest to its limit, or farthest beyond it."""
        return max(self.cases, key=lambda case: (not case.met, case.share))

    @property
    def met(self) -> bool:
        """True if every case is within its limit."""
        return all(case.met for case in self.cases)


def bars(policy: CourseFigures, references: Sequence[CourseFigures], lift: float) -> tuple[Bar, ...]:
    """Return every bar that has a case. references: at least one; lift: of the aircraft, of its weight."""
    flown = _Beside(policy, tuple(references))
    better = f"the better of {' and '.join(each.label for each in references)}"
    rougher = f"{ROUGHER:g} x the rougher of {' and '.join(each.label for each in references)}"
    by_stick = f"{better}, and half a step of the stick"
    tracking = f"{TRACKING:g} x, varied {VARIED:g} x {better}"
    found = (
        ("lift, throttle closed", "of weight", "less than half lets it come down", flown.closed()),
        ("lift, full throttle", "of weight, missing", f"{FULL:g} of the motors'", flown.full(lift)),
        ("lift lost as throttle rises", "of weight", f"{FALL:g}: a throttle must not lower", flown.falls()),
        ("MAE of ten commands", "deg/s", tracking, flown.error("mae")),
        (
            "MSE of ten commands",
            "(deg/s)²",
            f"{TRACKING:g} x, varied {VARIED:g} x {better}",
            flown.error("mse"),
        ),
        ("rest, late", "deg/s", by_stick, flown.rest()),
        ("rest, grown since early", "deg/s", "a quarter of a step of the stick", flown.growth()),
        ("drift in 10 s", "deg", f"{by_stick} for 10 s", flown.drift()),
        ("motors' change at rest", "in 1 ms", f"half of tune-pid's, or {rougher}", flown.rest_change()),
        ("motors' change in a turn", "in 1 ms", f"tune-pid's, or {rougher}", flown.turn_change()),
        ("swing in a turn", "of range", f"{SWING:g}, or {rougher}", flown.swing()),
        ("error in a turn", "deg/s", f"{better}, and {100 * HELD:g} % of the rate", flown.held()),
        ("overshoot of a turn", "of command", f"{OVERSHOOT:g}, or the worse reference's", flown.overshoot()),
        ("error after a turn", "deg/s", f"{better}, and {BACK_DEG_S:g}", flown.back()),
        (
            "motor on the ground",
            "fraction",
            "a third of the weight, or a reference's",
            flown.ground_motor(),
        ),
        ("tilt on the ground", "deg", f"{TILT_DEG:g}, or a reference's", flown.ground_tilt()),
    )
    held = (Bar(name, unit, source, tuple(cases)) for name, unit, source, cases in found)
    return tuple(bar for bar in held if bar.cases)


@dataclass(frozen=True)
class _Beside:
    """A policy's figures beside those of its references, case by case."""

    policy: CourseFigures
    references: tuple[CourseFigures, ...]

    def closed(self) -> Iterator[Case]:
        seen = self.policy.lift[0][1]
        limit = max(SINK, 1.05 * min(each.lift[0][1] for each in self.references))
        told = f"with the throttle closed it still lifts {seen:.2f} of its weight: it does not come down"
        yield Case("", seen, limit, told)

    def full(self, lift: float) -> Iterator[Case]:
        seen = self.policy.lift[-1][1]
        told = f"at full throttle it lifts {seen:.2f} of its weight, the motors could lift {lift:.2f}"
        yield Case("", lift - seen, (1.0 - FULL) * lift, told)

    def falls(self) -> Iterator[Case]:
        for (low, before), (high, after) in pairwise(self.policy.lift):
            told = (
                f"raising the throttle from {low:g} to {high:g} lowers the lift from {before:.2f} to "
                f"{after:.2f} of the weight"
            )
            yield Case(f"{low:g} to {high:g}", max(0.0, before - after), FALL, told)

    def error(self, figure: str) -> Iterator[Case]:
        for flight, own in self.policy.flights.items():
            seen = float(getattr(own, figure))
            each = {one.label: float(getattr(one.flights[flight], figure)) for one in self._flew(flight)}
            label = min(each, key=lambda name: each[name])
            factor = TRACKING if flight.condition is None else VARIED
            unit = "deg/s" if figure == "mae" else "(deg/s)²"
            told = (
                f"follows the sticks worse than {label} {flight.where}: {figure.upper()} {seen:.3g} {unit}, "
                f"{label} {each[label]:.3g}"
            )
            yield Case(flight.name, seen, factor * each[label], told)

    def rest(self) -> Iterator[Case]:
        for flight, axis, own in self._axes():
            seen, least = own.late[axis], min(each.flights[flight].late[axis] for each in self._flew(flight))
            told = (
                f"does not hold {flight.where}: with centred sticks it turns on in {AXES[axis]} by "
                f"{seen:.2g} deg/s after half a minute of flight, the better reference by {least:.2g}"
            )
            yield Case(f"{flight.name}, {AXES[axis]}", seen, least + DRIFT_DEG_S, told)

    def growth(self) -> Iterator[Case]:
        for flight, axis, own in self._axes():
            early, late = own.early[axis], own.late[axis]
            told = (
                f"holds worse the longer it flies {flight.where}: in {AXES[axis]} {early:.2g} deg/s at rest "
                f"early, {late:.2g} late"
            )
            yield Case(f"{flight.name}, {AXES[axis]}", late - early, GROWTH_DEG_S, told)

    def drift(self) -> Iterator[Case]:
        for flight, axis, own in self._axes():
            seen = abs(own.drift[axis])
            least = min(abs(each.flights[flight].drift[axis]) for each in self._flew(flight))
            told = (
                f"drifts {flight.where}: {seen:.0f} deg in {AXES[axis]} in 10 s of centred sticks, the "
                f"better reference {least:.0f}"
            )
            yield Case(f"{flight.name}, {AXES[axis]}", seen, least + DRIFT_DEG, told)

    def rest_change(self) -> Iterator[Case]:
        for flight, own in self.policy.flights.items():
            limit = max(
                REST_CHANGE, ROUGHER * max(each.flights[flight].change for each in self._flew(flight))
            )
            told = (
                f"the motors do not rest {flight.where}: their change is {own.change:.3g} a ms, at most "
                f"{limit:.3g}"
            )
            yield Case(flight.name, own.change, limit, told)

    def turn_change(self) -> Iterator[Case]:
        return self._turns(
            lambda figures: figures.change,
            lambda turn, others: max(CHANGE, ROUGHER * max(others)),
            lambda turn, seen, limit: (
                f"swings at {self.policy.turns[turn].swing_hz:.0f} Hz in {turn.name}: the motors' change is "
                f"{seen:.3g} a ms, at most {limit:.3g}"
            ),
        )

    def swing(self) -> Iterator[Case]:
        return self._turns(
            lambda figures: figures.swing,
            lambda turn, others: max(SWING, ROUGHER * max(others)),
            lambda turn, seen, limit: (
                f"swings at {self.policy.turns[turn].swing_hz:.0f} Hz in {turn.name}: the motors go up and "
                f"down by {100 * seen:.1f} % of their range, at most {100 * limit:.1f} %"
            ),
        )

    def held(self) -> Iterator[Case]:
        return self._turns(
            lambda figures: figures.held,
            lambda turn, others: min(others) + HELD * abs(turn.rate_deg_s),
            lambda turn, seen, limit: (
                f"does not hold {turn.name}: it is {seen:.3g} deg/s off, at most {limit:.3g}"
            ),
        )

    def overshoot(self) -> Iterator[Case]:
        return self._turns(
            lambda figures: max(0.0, figures.overshoot),
            lambda turn, others: max(OVERSHOOT, *others),
            lambda turn, seen, limit: (
                f"overshoots {turn.name} by {100 * seen:.0f} %, at most {100 * limit:.0f} %"
            ),
        )

    def back(self) -> Iterator[Case]:
        return self._turns(
            lambda figures: figures.back,
            lambda turn, others: min(others) + BACK_DEG_S,
            lambda turn, seen, limit: (
                f"does not come to rest after {turn.name}: half a second later it is {seen:.3g} deg/s off, "
                f"at most {limit:.3g}"
            ),
        )

    def ground_motor(self) -> Iterator[Case]:
        seen, hover = self.policy.ground_motor, self._fraction(1.0)
        limit = max(self._fraction(GROUND_LIFT), *(each.ground_motor for each in self.references))
        told = (
            f"on the ground with the throttle closed a motor turns at {100 * seen:.0f} %, in a hover at "
            f"{100 * hover:.0f} %: it may tip over before take-off"
        )
        yield Case("", seen, limit, told)

    def ground_tilt(self) -> Iterator[Case]:
        seen = self.policy.ground_turned
        limit = max(TILT_DEG, *(each.ground_turned for each in self.references))
        yield Case("", seen, limit, f"tips by {seen:.0f} deg on the ground with the throttle closed")

    def _fraction(self, lift: float) -> float:
        """Return the motor fraction of a transparent controller that lifts this share of the weight."""
        for (low, before), (high, after) in pairwise(self.references[0].lift):
            if before <= lift <= after:
                throttle = low + (high - low) * (lift - before) / (after - before)
                return self.references[0].idle + (1.0 - self.references[0].idle) * throttle
        return 1.0

    def _flew(self, flight: CommandFlight) -> list[CourseFigures]:
        """Return the references that flew the segment."""
        return [each for each in self.references if flight in each.flights]

    def _axes(self) -> Iterator[tuple[CommandFlight, int, CommandFigures]]:
        for flight, own in self.policy.flights.items():
            for axis in range(len(AXES)):
                yield flight, axis, own

    def _turns(
        self,
        figure: Callable[[TurnFigures], float],
        limit_of: Callable[[Turn, Sequence[float]], float],
        told: Callable[[Turn, float, float], str],
    ) -> Iterator[Case]:
        """Yield one case for each full turn; limit_of: called with the references' figures."""
        for turn, own in self.policy.turns.items():
            seen = figure(own)
            others = [figure(each.turns[turn]) for each in self.references if turn in each.turns]
            limit = limit_of(turn, others)
            yield Case(turn.name, seen, limit, told(turn, seen, limit))
