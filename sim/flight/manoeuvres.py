"""Six manoeuvres and a descent in free flight, with throttles of the thrust that a pilot wants.

Controllers turn the same throttle into different thrusts. So a manoeuvre says thrust over weight, and is made
into a scenario by each controller's own curve of thrust at rest against throttle, inverted: all then fly with
the same thrust, or the least or the most that theirs gives. Rates are as SBUS expresses them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from neuroflight.sim.flight.scenario import STILL, TURN_DEG_S, Rates, Scenario, Segment
from neuroflight.sim.physics.world import Mount

SETTLE_S = 1.0  # from standing rotors to a hover; no figure counts it
HOVER_S = 4.0  # behind each manoeuvre, level or not: shows the effect of a wound-up memory
PULL_DEG_S = 360.0
PITCH_DEG_S = 240.0  # into the dive and out of it
FULL = math.inf  # thrust of the open throttle, whatever it is
CLOSED = 0.0  # of the closed one
QUARTER, HALF, WHOLE = 90.0, 180.0, 360.0  # of a turn [deg]


@dataclass(frozen=True)
class ThrustSegment:
    """Sticks held still for a while."""

    duration_s: float
    thrust: float  # over weight, at rest
    rates: Rates = STILL  # roll, pitch, yaw [deg/s]


@dataclass(frozen=True)
class Manoeuvre:
    """A flight in segments, behind SETTLE_S of hover."""

    name: str
    about: str
    segments: tuple[ThrustSegment, ...]

    @property
    def commanded(self) -> tuple[bool, bool, bool]:
        """Axes that are commanded at some time."""
        roll, pitch, yaw = (any(segment.rates[axis] for segment in self.segments) for axis in range(3))
        return roll, pitch, yaw

    def then_hover(self) -> Manoeuvre:
        """Return the manoeuvre followed by HOVER_S of centred sticks."""
        return replace(self, segments=(*self.segments, ThrustSegment(HOVER_S, 1.0)))

    def scenario(self, throttle: Callable[[float], float]) -> Scenario:
        """Return the sticks. throttle: a function from thrust over weight at rest to throttle, 0..1."""
        segments = tuple(
            Segment(held.duration_s, held.rates, throttle(held.thrust))
            for held in (ThrustSegment(SETTLE_S, 1.0), *self.segments)
        )
        return Scenario(self.name, segments, Mount.FREE)


def _turned(angle: float, rate: float, axis: int, thrust: float) -> ThrustSegment:
    """Return a segment that turns by `angle` [deg] about `axis` at `rate` [deg/s]."""
    rates = [0.0, 0.0, 0.0]
    rates[axis] = rate
    return ThrustSegment(angle / abs(rate), thrust, (rates[0], rates[1], rates[2]))


def _whole_turn(axis: int) -> tuple[ThrustSegment, ...]:
    """Return a jump, a turn with little thrust, the fall caught, a hover."""
    turn = _turned(WHOLE, TURN_DEG_S, axis, 0.35)
    return ThrustSegment(0.3, 2.0), turn, ThrustSegment(0.4, 2.0), ThrustSegment(0.4, 1.0)


MANOEUVRES = (
    Manoeuvre("roll", "a full turn to the right in half a second", _whole_turn(0)),
    Manoeuvre("flip", "a full turn forward in half a second", _whole_turn(1)),
    Manoeuvre(
        "split-s",
        "half a roll onto the back, half a loop pulled through",
        (
            _turned(HALF, TURN_DEG_S, 0, 0.35),
            ThrustSegment(0.2, 0.35),
            _turned(HALF, -PULL_DEG_S, 1, 2.0),
            ThrustSegment(0.4, 2.0),
            ThrustSegment(0.4, 1.0),
        ),
    ),
    Manoeuvre(
        "punch-out",
        "full throttle from the hover, a full roll under four times the weight, back to the hover",
        (
            ThrustSegment(0.7, FULL),
            _turned(WHOLE, TURN_DEG_S, 0, 4.0),
            ThrustSegment(0.3, 4.0),
            ThrustSegment(0.7, 1.0),
        ),
    ),
    Manoeuvre(
        "dive-recovery",
        "throttle closed, pitched over into a dive, throttle in and pulled level",
        (
            ThrustSegment(0.1, CLOSED),
            _turned(QUARTER, PITCH_DEG_S, 1, CLOSED),
            ThrustSegment(0.8, CLOSED),
            _turned(QUARTER, -PITCH_DEG_S, 1, 3.0),
            ThrustSegment(0.4, 2.0),
            ThrustSegment(0.4, 1.0),
        ),
    ),
    Manoeuvre(
        "wash",
        "level: down through its own wash at little throttle, then closed, caught with twice the weight",
        (
            ThrustSegment(1.0, 0.6),
            ThrustSegment(0.4, CLOSED),
            ThrustSegment(0.7, 2.0),
            ThrustSegment(0.4, 1.0),
        ),
    ),
)
DESCENT = Manoeuvre("descent", "level, the throttle closed from the hover", (ThrustSegment(10.0, CLOSED),))
STAIR = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6, 0.7, 0.8, 1.0)  # throttles
STAIR_S, STAIR_MEAN_S = 0.6, 0.3  # at each of them, and its last part of which the mean counts


@dataclass(frozen=True)
class ThrustCurve:
    """Thrust at rest over weight against throttle: flown with `stairs`, zero command, held at the centre."""

    throttle: tuple[float, ...]  # rising, 0..1
    thrust: tuple[float, ...]  # over weight

    def throttle_of(self, thrust: float) -> float:
        """Return the throttle of a thrust over weight, or of the nearest possible one.

        Between the measured points the root of the thrust is taken as linear, because throttle sets the
        rotors' speed.
        """
        rising = np.sqrt(np.maximum.accumulate(np.array(self.thrust)))
        if thrust <= self.thrust[0]:
            return self.throttle[0]
        return float(np.interp(math.sqrt(thrust), rising, self.throttle))

    @classmethod
    def of_steps(cls, thrust: Sequence[float], control_rate_hz: int) -> ThrustCurve:
        """Build the curve from the thrust at each control step of a flight of `stairs`."""
        steps = np.array(thrust).reshape(len(STAIR), -1)
        last = round(STAIR_MEAN_S * control_rate_hz)
        return cls(STAIR, tuple(steps[:, -last:].mean(axis=1).tolist()))


def stairs() -> Scenario:
    """Return each throttle of STAIR for STAIR_S, at rest, the centre of mass held."""
    return Scenario("stairs", tuple(Segment(STAIR_S, throttle=throttle) for throttle in STAIR))
