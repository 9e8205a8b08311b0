"""Limits of what a pilot need bear of a controller: `policy check` and the verdict of `fly` hold the same.

Where physics gives a figure it is that; else it is a ratio to, or a distance from, a reference controller
that flew the same commands in the same aircraft.
"""

from __future__ import annotations

TRACKING = 1.25  # times the reference's error: ten commands determine errors to about a tenth
STICK_STEP_DEG_S = 2.0  # the least change of a command in a receiver's channel
DRIFT_DEG_S = STICK_STEP_DEG_S / 2  # more than this is not acceptable; less cannot be trimmed by the stick
DRIFT_DEG = DRIFT_DEG_S * 10.0  # in the 10 s that are measured
GROWTH_DEG_S = STICK_STEP_DEG_S / 4  # of the error at rest, from the flight's beginning to its end
CHANGE = 0.012  # of a motor's fraction in 1 ms: the most that `tune-pid` allows a PID of any aircraft
REST_CHANGE = CHANGE / 2  # at rest, where only the gyro's noise moves the motors
ROUGHER = 1.5  # times the reference's change: gyros with more noise move every controller's motors
