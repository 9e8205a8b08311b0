"""Limits of arming, failsafe and crash detection, and the states and reasons that the firmware tells."""

from __future__ import annotations

from enum import IntEnum

# Times are in milliseconds of gyro samples.
BOOT_GRACE_MS = 1000  # no arming before this, whatever is set
ARMING_DELAY_MS = 3000  # as set by default; ESCs have played their start-up tunes by then
CALIBRATION_MS = 1000  # length of the still gyro average
CALIBRATION_MOTION_DEG_S = 5.0  # a standard deviation above this is motion: start again
CALIBRATION_BIAS_DEG_S = 20.0  # a mean above this is motion: start again
# While the motors stand the bias follows each such average that is calmer than this and no further from it
# than that: a hand does not hold an aircraft so still, nor turn it so slowly. By so much a second at most: a
# chip that warms up drifts less, and ten seconds on a slow turntable spoil half a degree a second.
CALIBRATION_CALM_DEG_S, CALIBRATION_DRIFT_DEG_S, CALIBRATION_STEP_DEG_S = 2.5, 3.0, 0.05
# Without a good frame for so long the sticks are taken as centred, throttle kept; as set by default, and as
# long as Betaflight flies the last sticks on.
RECEIVER_HOLD_MS = 300
RECEIVER_LOST_MS = 1000  # the same until the configured failsafe stage begins, as set by default
RECEIVER_RECOVERY_MS = 200  # frames must come this long before a lost link counts as good again
RECEIVER_PAUSE_MS = 100  # between two frames at most: over a longer one no recovery goes on, and no ramp
RECEIVER_OFF_FRAMES = 2  # in a row must say that the switch is off
# A receiver's word that it has lost its transmitter counts for so long, unless it takes it back: receivers of
# CRSF tell their link's quality several times a second. Not less than the longest hold.
RECEIVER_FLAG_MS = 1000
GYRO_BAD_MS = 10  # bad, stuck or silent: so long the last good sample stands in, then motors stop
# An axis at the end of its range is flown as that. An aircraft that turns faster than its gyro can tell for
# so long, without one sample below, is out of control, or its gyro is dead: no stick asks for such a rate.
GYRO_SATURATED_MS = 500
# Control steps in a row that ended late, or before which gyro samples were lost: the PID flies.
DEADLINE_MISSES_MAX = 3
LOAD_CALM_MS = 1000  # no arming before all gyro samples have kept within their period for so long
# An axis turns towards its setpoint if its rate, behind these two low-passes, changes that way by more than
# so much. Gyro noise of three times the NF1's makes 150 deg/s^2 of it; the yaw of a heavy aircraft, the
# weakest axis that flies, reaches 500.
TURNING_DEG_S2 = 250.0
TURNING_NEAR_HZ, TURNING_FAR_HZ = 32.0, 16.0
TURNING_LIMIT_DEG_S = 150.0  # as fast as this the asked way, but not turning faster: the axis is at its limit
# Take-off: until one of these holds after arming, the aircraft is taken to stand on the ground. Integrals
# stay at zero, for there they only wind up, and an axis that does not turn is neither a policy's fault nor a
# crash. The throttle was above this for so long without a break: the NF1 hovers at 0.23 to 0.25, a blip ends
# sooner.
TAKEOFF_THROTTLE, TAKEOFF_MS = 0.2, 250
# Or an axis has turned by so much lately: an aircraft that rocks on its battery does not, one that is thrown
# or tips over does. Turns are forgotten with this time constant: a gyro that is 3 deg/s off makes 3 deg of
# them.
TAKEOFF_TURN_DEG, TAKEOFF_FORGETS_MS = 30.0, 1000
# Implausible outputs (tests/flights/test_plausibility.py). In 1,000 pulses, 200 aircraft drawn at random,
# roll, flip and Split-S a sound policy leaves a large error unanswered for 2 ms, and the error swings five
# times in a row. Unwinding an integral after a stick that asks for more than an aircraft has takes 45 ms, or
# 5.5 deg.
WRONG_WAY_ERROR_DEG_S, WRONG_WAY_MS = 60.0, 100  # so far off, and the outputs do not answer for so long
WRONG_WAY_DEG = 8.0  # or, while the error grows, until the axis has gone astray by so much
# Until take-off, where no integral is wound yet: near the ground what is left of the height is little, and a
# network with the wrong sign turns twice as fast every 10 ms.
WRONG_WAY_TAKEOFF_DEG = 3.0
NO_RESPONSE_ERROR_DEG_S, NO_RESPONSE_MS = 200.0, 200  # so far off, and the axis does not turn for so long
OSCILLATION_ERROR_DEG_S = 10.0  # to either side of the setpoint by turns, behind a low-pass at
OSCILLATION_HZ = 40.0
OSCILLATION_HALF_MS = 60  # from one side to the other at most: no stick moves so fast
OSCILLATION_SWINGS = 12
# Or the motors move by so much each millisecond, on average of all of them and of so long, beyond so much for
# each rad/s that an axis' error moved, by a stick, a chirp, noise or a shaking gyro: rotors that swing too
# fast for the body to follow only get hot. Two policies in pulses, full turns, aircraft drawn at random,
# sticks that jump every 80 ms and chirps of 200 deg/s stay below 0.002 (0.05 if errors explained nothing),
# with a gyro that shakes by 20 deg/s at 80 to 250 Hz below 0.011 (0.16). A policy that predicts rates makes
# 0.04 with twice its gain, 0.01 with half as much more.
OSCILLATION_MOTORS, OSCILLATION_MOTORS_MS = 0.025, 200
OSCILLATION_MOTORS_BY_ERROR = 0.375
# A crash: for so long an axis is this far from what was asked for and does not turn towards it, while the
# controller gives one motor so much more than another. The hardest of our own flights, a flip at 720 deg/s,
# is that far off for 50 ms.
CRASH_ERROR_DEG_S = 500.0
CRASH_SPREAD = 0.5  # of the controller's answer, before the throttle
CRASH_MS = 250
# A runaway, as of a motor or propeller in the wrong place: for so long an axis is as far off, turns away from
# what was asked for, and faster at the end. A pilot who turns round sees the rate fall within 30 ms.
RUNAWAY_WINDOW_MS = 1000  # after take-off, from the first raised throttle on, and before
RUNAWAY_MS = 50
HANDOVER_MS = 50  # in which a change of controller passes from the old outputs to the new


class FlightState(IntEnum):
    """States of the firmware; firmware/src/safety/safety.c has the transitions."""

    BOOT = 0
    CALIBRATING = 1
    DISARMED = 2
    ARMED = 3
    FAILSAFE_HOLD = 4  # armed, the receiver silent: rates centred, throttle kept
    FAILSAFE_DROP = 5  # the configured stage: motors stopped, or a descent that ends so
    CRASHED = 6  # motors stopped until the switch has been off
    FAULT = 7  # motors stopped until the next boot


class ArmingReason(IntEnum):
    """Bit number of each reason that keeps the motors stopped."""

    BOOT_GRACE = 0
    GYRO_NOT_CALIBRATED = 1
    RECEIVER_LOST = 2
    THROTTLE_HIGH = 3
    SWITCH_NOT_CYCLED = 4
    POLICY_BAD = 5  # and the switch chooses the policy
    GYRO_BAD = 6  # stuck, at the end of its range, silent or no number
    NOT_LEVEL = 7  # tilted beyond the limit, or the attitude is not known
    BATTERY_UNKNOWN = 8
    FAULT = 9  # a fault record that nobody acknowledged
    CRASHED = 10
    MOTOR_TEST = 11
    STORING = 12  # flash is being erased or written, or the board is about to start anew
    PID_MISSING = 13  # the switch chooses a PID that is not built in
    POLICY_REFUSED = 14  # it fell back in flight, nobody acknowledged that, and the switch chooses it
    GYRO_ALIGNMENT = 15  # sources disagree on how this gyro is turned: the setting gyro_alignment must say it
    CLOCK = 16  # the crystal did not start: the internal oscillator makes the clock
    LOAD = 17  # a gyro sample took longer than its period, within the last second
    MSP = 18  # a peer said so (ARMING_DISABLE), and neither took it back nor went
    CLI = 19  # a command line is open
    PROBATION = 20  # the image is new and has not run well for long enough yet
    IMAGE_BAD = 21  # flash does not hold the image whole any more
    SETTINGS = 22  # what flash has stored is not what is flown: this image does not take some of it


ARMING_REASON_COUNT = max(ArmingReason) + 1  # bits that a field of reasons takes
# Bit of each reason, by its number, in the flags of STATUS and STATUS_EX. Up to 27 they are the ecosystem's
# at MSP API 1.47, whose programs show their names; an image on probation and a flash that is written count as
# in their boot grace: both end by themselves. 28 the board: a fault, its image, its clock. 29 the battery or
# a setting. 30 no controller.
ARMING_FLAGS = (9, 12, 2, 7, 3, 30, 0, 8, 29, 28, 6, 16, 9, 30, 30, 29, 28, 11, 16, 13, 9, 28, 29)
# What beeper and LED count while the arm switch is on and a reason holds, by its number: what the pilot does
# about it. The highest is told. 0: told otherwise, or no switch is heard then.
# 1 switch off and on, 2 throttle down, 3 level and still, 4 wait, 5 a computer holds it, 6 the policy,
# 7 the battery, 8 the board: connect a computer.
ARMING_COUNTS = (4, 3, 0, 2, 1, 6, 8, 3, 7, 0, 0, 5, 4, 6, 6, 8, 8, 4, 5, 5, 4, 8, 8)
ARMING_FLAG_FAILSAFE = 1  # in a state of the failsafe
ARMING_FLAG_SWITCH = 31  # the last: the arm switch is on while something forbids
ARMING_FLAG_COUNT = 32


class StopCause(IntEnum):
    """Causes of the motors' last stop."""

    NONE = 0
    SWITCH = 1
    RECEIVER = 2
    GYRO_INVALID = 3
    GYRO_STUCK = 4
    GYRO_SATURATED = 5
    GYRO_SILENT = 6
    CRASH = 7
    RUNAWAY = 8
    NO_CONTROLLER = 9  # the policy was refused in flight and no PID is built in


class FallbackCause(IntEnum):
    """Reasons why the PID flies; all but the pilot's switch keep the policy out until acknowledged."""

    NONE = 0
    SWITCH = 1  # the pilot's
    POLICY_OUTPUT = 2  # NaN or out of range
    DEADLINE = 3
    WRONG_WAY = 4  # its outputs did not turn an axis towards its setpoint
    NO_RESPONSE = 5  # a distant axis did not turn towards its setpoint
    OSCILLATION = 6
    WEIGHTS = 7  # a weight in memory was not what flash has


class GyroHealth(IntEnum):
    """Faults of the gyro's samples."""

    GOOD = 0
    INVALID = 1  # the transfer failed or the value is no rate
    STUCK = 2
    SATURATED = 3  # an axis is at the end of its range, and flown so
    SILENT = 4
