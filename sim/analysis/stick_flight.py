"""Figures of a flight by sticks over ground: heights, tilt, touchdown; and of a descent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from neuroflight.sim.flight.motion import Motion
from neuroflight.sim.flight.scenario import Scenario

STEADY_S = 2.0  # end of a segment in which a height is held
AIRBORNE_M = 0.05  # above the start
TOUCH_M = 0.01
STAND_S, UPRIGHT_DEG = 0.5, 20.0
TOUCH_S = 0.02  # before the touch: the speed is taken there, because the contact itself takes some samples


@dataclass(frozen=True)
class StickFigures:
    """Figures of one flight by eye."""

    height_error_m: float  # mean |height - wanted| of the last STEADY_S of segments with a height above 0
    tilt_deg: float  # mean in the air
    tilt_max_deg: float
    drift_m: float  # farthest from the start, level
    landed: bool  # whether it is on the ground and upright for the last STAND_S
    touchdown_m_s: float | None  # downward speed at the first touch of the landing; None: there was none
    touchdown_level_m_s: float | None  # and level speed


def stick_figures(scenario: Scenario, motion: Motion, control_rate_hz: int) -> StickFigures:
    """Compute the figures of a flight of `scenario`, whose last height is 0: the landing."""
    height = motion.position[:, 2] - motion.position[0, 2]
    speed, tilt = motion.velocity, np.rad2deg(motion.tilt)
    ends = np.cumsum(scenario.steps(control_rate_hz))
    last, stand = round(STEADY_S * control_rate_hz), round(STAND_S * control_rate_hz)
    errors, landing = [], len(height)
    for segment, end in zip(scenario.segments, ends.tolist(), strict=True):
        if segment.height_m:
            errors.append(np.abs(height[max(0, end - last) : end] - segment.height_m))
            landing = end
    in_air = height > AIRBORNE_M
    touch = next((k for k in range(landing, len(height)) if height[k] < TOUCH_M), None)
    down = level = None
    if touch is not None:
        before = slice(max(0, touch - round(TOUCH_S * control_rate_hz)), touch + 1)
        down = float(-speed[before, 2].min())
        level = float(np.hypot(speed[before, 0], speed[before, 1]).max())
    return StickFigures(
        height_error_m=float(np.concatenate(errors).mean()) if errors else 0.0,
        tilt_deg=float(tilt[in_air].mean()) if in_air.any() else 0.0,
        tilt_max_deg=float(tilt.max()),
        drift_m=float(np.hypot(motion.position[:, 0], motion.position[:, 1]).max()),
        landed=bool((np.abs(height[-stand:]) < AIRBORNE_M).all() and (tilt[-stand:] < UPRIGHT_DEG).all()),
        touchdown_m_s=down,
        touchdown_level_m_s=level,
    )


@dataclass(frozen=True)
class DescentFigures:
    """Figures of one descent from a hover, the throttle closed."""

    sink_m_s: float  # downward speed, mean of the last second
    fallen_m: float  # since the throttle closed
    tilt_deg: float  # at the end


def descent_figures(motion: Motion, closed_at: int, control_rate_hz: int) -> DescentFigures:
    """Compute the figures of a flight whose throttle closes at row `closed_at`."""
    height = motion.position[:, 2]
    return DescentFigures(
        sink_m_s=float(-motion.velocity[-control_rate_hz:, 2].mean()),
        fallen_m=float(height[closed_at] - height[-1]),
        tilt_deg=float(np.rad2deg(motion.tilt[-1])),
    )
