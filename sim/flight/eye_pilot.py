"""A pilot who flies to heights by what he sees: throttle, roll and pitch of segments with a `height_m`.

No controller here levels the aircraft or holds a height: the sticks ask for rates and thrust. What keeps it
in the air is the pilot, who sees height, speed and attitude of the twin REACTION_S late, moves his sticks
every MOVE_S, and is slow: he climbs and sinks at CLIMB_M_S, wants his speed within a second, levels within
two thirds of one and leans a little against a drift. He knows no hover throttle: he pushes the stick until
the aircraft lifts, and from then on he trims. He sees nothing of the firmware, so that flights on
ports with the same bits have the same sticks.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.arrays import Array
from neuroflight.sim.control import sticks

if TYPE_CHECKING:
    from neuroflight.sim.flight.scenario import Scenario

REACTION_S = 0.2  # reaction time
MOVE_S = 0.02  # between two positions of his sticks
CLIMB_M_S = 1.0  # up and down
TOUCH_M_S, TOUCH_BELOW_M = 0.4, 1.2  # sink rate near the ground, and what is near
HEIGHT_PER_S = 0.8  # speed that he wants for a metre of height that lacks
THROTTLE_PER_M_S = 0.030  # throttle for each m/s that lacks
TRIM_PER_M = 0.020  # and for each m/s that lacks a second long
PUSH_PER_S = 0.12  # throttle a second, until he sees it lift
PUSHED_S = 0.4  # part of the push that he takes back, because the aircraft lifted before he saw it
LIFTED_M, LANDED_M = 0.03, 0.03  # above where it stood
LEVEL_PER_S = 1.5  # rate for each radian that he is off
LEAN_PER_M_S, LEAN_MAX = 0.04, 0.15  # tangent of the lean against each m/s of drift, and its limit
RATE_MAX_DEG_S = 120.0


class EyePilot:
    """The sticks of a scenario that is flown by eye, one aircraft."""

    def __init__(self, scenario: Scenario, control_rate_hz: int) -> None:
        self._segments = scenario.segments
        self._of_step = np.repeat(np.arange(len(scenario.segments)), scenario.steps(control_rate_hz)).tolist()
        self._every = max(1, round(MOVE_S * control_rate_hz))
        self._move_s = self._every / control_rate_hz
        self._seen: deque[tuple[Array, Array, Array]] = deque(maxlen=round(REACTION_S / self._move_s) + 1)
        self._steps = 0  # seen so far
        self._start = np.zeros(3)  # where it stood
        self._trim = 0.0  # throttle at which the speed stays, as far as he knows
        self._lifted = self._landed = False
        self._sticks = (0.0, 0.0, 0.0)  # roll and pitch rate [deg/s], throttle
        self._segment = 0  # that he flew last
        self._made = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=True)

    def see(self, position: Array, velocity: Array, rotation: Array) -> None:
        """Look at the aircraft, at each armed control step.

        position (3,) [m], velocity (3,) [m/s], world axes; rotation (3, 3), body to world.
        """
        if self._steps % self._every == 0:
            if not self._steps:
                self._start = position.copy()
            self._seen.append((position - self._start, velocity.copy(), rotation.copy()))
            segment = self._segments[self._of_step[min(self._steps, len(self._of_step) - 1)]]
            if segment.height_m is not None:
                roll, pitch = self._level(*self._seen[0][1:])
                self._sticks = roll, pitch, self._throttle(segment.height_m)
                self._made = self._channels()
        self._steps += 1

    def channels(self, step: int) -> NDArray[np.uint16] | None:
        """Return channels [us] (CHANNEL_COUNT,) at control step `step`; None: nothing is flown by eye."""
        index = self._of_step[step]
        if self._segments[index].height_m is None:
            return None
        if index != self._segment:
            self._segment = index
            self._made = self._channels()
        return self._made

    def _channels(self) -> NDArray[np.uint16]:
        segment = self._segments[self._segment]
        roll, pitch, throttle = self._sticks
        return sticks.channels(
            (roll, pitch, segment.setpoint_deg_s[2]), throttle, armed=True, pid=segment.pid
        )

    def _throttle(self, wanted_height: float) -> float:
        """Return the throttle 0..1 towards a height above the start [m]."""
        position, velocity, _ = self._seen[0]
        height = float(position[2])
        landing = wanted_height == 0.0
        if landing and self._lifted and height < LANDED_M:
            self._landed = True
        if self._landed and landing:
            return 0.0
        if not self._lifted:
            self._lifted = height > LIFTED_M
            change = -PUSHED_S if self._lifted else self._move_s
            self._trim = min(max(self._trim + PUSH_PER_S * change, 0.0), 1.0)
            return self._trim
        sink = TOUCH_M_S if landing and height < TOUCH_BELOW_M else CLIMB_M_S
        speed = -sink if landing else min(max(HEIGHT_PER_S * (wanted_height - height), -sink), CLIMB_M_S)
        lacks = speed - float(velocity[2])
        self._trim = min(max(self._trim + TRIM_PER_M * lacks * self._move_s, 0.0), 1.0)
        return min(max(self._trim + THROTTLE_PER_M_S * lacks, 0.0), 1.0)

    def _level(self, velocity: Array, rotation: Array) -> tuple[float, float]:
        """Return roll and pitch rate [deg/s] towards level, leaning against the drift."""
        if not self._lifted or self._landed:
            return 0.0, 0.0
        lean = np.clip(-LEAN_PER_M_S * velocity[:2], -LEAN_MAX, LEAN_MAX)
        up = rotation.T @ np.array([lean[0], lean[1], 1.0])  # where he wants the body's z axis, in its axes
        rates = np.rad2deg(LEVEL_PER_S) * np.array([-up[1], up[0]])
        roll, pitch = np.clip(rates, -RATE_MAX_DEG_S, RATE_MAX_DEG_S).tolist()
        return roll, pitch
