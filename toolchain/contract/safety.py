"""Limits of arming, failsafe and crash detection, and the states and reasons that the firmware tells."""

from __future__ import annotations

from enum import IntEnum

# Times are in milliseconds of gyro samples.
BOOT_GRACE_MS = 1000  # no arming before this, whatever is set
ARMING_DELAY_MS = 3000  # as set by default; ESCs have played their start-up tunes by then
CALIBRATION_MS = 1000  # length of the still gyro average
CALIBRATION_MOTION_DEG_S = 5.0  # a standard deviation above this is motion: start again
CALIBRATION_BIAS_DEG_S = 20.0  # a mean above this is motion: start again
# While the motors are stopped the bias follows each average whose deviation is below CALM and whose distance
# from the bias is below DRIFT: a hand neither holds an aircraft so still nor turns it so slowly. It moves by
# at most STEP a second: a chip that warms up drifts less, and ten seconds on a slow turntable spoil only 0.5
# deg/s.
CALIBRATION_CALM_DEG_S, CALIBRATION_DRIFT_DEG_S, CALIBRATION_STEP_DEG_S = 2.5, 3.0, 0.05
# After this time without a valid frame the sticks count as centred, with the throttle kept. This is the
# default; Betaflight holds the last sticks for the same time.
RECEIVER_HOLD_MS = 300
RECEIVER_LOST_MS = 1000  # default time without a valid frame until the configured failsafe stage begins
RECEIVER_RECOVERY_MS = 200  # duration of frames until a lost link counts as good again
RECEIVER_PAUSE_MS = 100  # longest pause between two frames that a recovery or a ramp survives
RECEIVER_OFF_FRAMES = 2  # consecutive frames needed to switch off
# Time for which a receiver's report of a lost transmitter holds, unless it is withdrawn: CRSF receivers
# report their link quality several times a second. Not less than the longest hold.
RECEIVER_FLAG_MS = 1000
GYRO_BAD_MS = 10  # a bad, stuck or silent gyro: the last good sample is used for this time, then motors stop
# A saturated axis is flown with the end of its range as its rate. After this time without a sample below it,
# the aircraft is out of control or its gyro is dead, because no stick commands such a rate.
GYRO_SATURATED_MS = 500
# Consecutive control steps that end late, or follow lost gyro samples, after which the PID flies.
DEADLINE_MISSES_MAX = 3
LOAD_CALM_MS = 1000  # before arming, all gyro samples must have kept their period for this time
# An axis turns towards its setpoint if the difference of its rate behind these two low-passes exceeds this
# acceleration. Three times the NF1's gyro noise gives 150 deg/s^2; the yaw of a heavy aircraft, the weakest
# axis that flies, reaches 500.
TURNING_DEG_S2 = 250.0
TURNING_NEAR_HZ, TURNING_FAR_HZ = 32.0, 16.0
TURNING_LIMIT_DEG_S = 150.0  # an axis this fast in the right direction, not accelerating, is at its limit
# Take-off: until one of these conditions holds after arming, the aircraft counts as standing on the ground.
# There integrals stay zero, because they would only wind up, and an axis that does not turn is neither the
# policy's fault nor a crash. First condition: throttle above this for this time; the NF1 hovers at 0.23 to
# 0.25, and a short blip ends sooner.
TAKEOFF_THROTTLE, TAKEOFF_MS = 0.2, 250
# Second condition: an axis has turned by this angle, with a memory of this time constant. An aircraft that
# rocks on its battery does not; one that is thrown or tips over does. A gyro error of 3 deg/s adds up to 3
# deg.
TAKEOFF_TURN_DEG, TAKEOFF_FORGETS_MS = 30.0, 1000
# Implausible outputs (tests/flights/test_plausibility.py). In 1,000 pulses, 200 aircraft drawn at random,
# roll, flip and Split-S, a sound policy leaves a large error unanswered for 2 ms, and the error changes its
# sign five times in a row. After a command beyond the aircraft's limits, unwinding an integral takes 45 ms or
# 5.5 deg.
WRONG_WAY_ERROR_DEG_S, WRONG_WAY_MS = 60.0, 100  # error without an answer of the outputs, for this time
WRONG_WAY_DEG = 8.0  # or, while the error grows, until the axis has turned the wrong way by this angle
# The angle before take-off, where no integral is wound: near the ground little height is left, and a network
# with the wrong sign doubles its rate every 10 ms.
WRONG_WAY_TAKEOFF_DEG = 3.0
NO_RESPONSE_ERROR_DEG_S, NO_RESPONSE_MS = 200.0, 200  # error without a turn of the axis, for this time
OSCILLATION_ERROR_DEG_S = 10.0  # error of alternating sign, behind a low-pass at OSCILLATION_HZ
OSCILLATION_HZ = 40.0
OSCILLATION_HALF_MS = 60  # longest half period: no stick moves so fast
OSCILLATION_SWINGS = 12
# Or the motors change by this fraction each millisecond, averaged over the motors and this time, beyond what
# the changes of the axes' errors explain: BY_ERROR for each rad/s of a stick, a chirp, noise or a shaking
# gyro. Motors that oscillate too fast for the body to follow only get hot. Two policies in pulses, full
# turns, aircraft drawn at random, sticks that jump every 80 ms and chirps of 200 deg/s stay below 0.002 (0.05
# without the errors' part), with a gyro that shakes by 20 deg/s at 80 to 250 Hz below 0.011 (0.16). A policy
# that predicts rates gives 0.04 with twice its gain, 0.01 with 1.5 times.
OSCILLATION_MOTORS, OSCILLATION_MOTORS_MS = 0.025, 200
OSCILLATION_MOTORS_BY_ERROR = 0.375
# A crash: for this time an axis has this error and does not turn towards its setpoint, while the controller's
# outputs differ by this spread. The hardest of our own flights, a flip at 720 deg/s, has this error for 50
# ms.
CRASH_ERROR_DEG_S = 500.0
CRASH_SPREAD = 0.5  # of the controller's answer, before the throttle
CRASH_MS = 250
# A runaway, as with a motor or propeller in the wrong place: for this time an axis has the same error, turns
# away from its setpoint and accelerates. After a reversal of the stick the rate falls within 30 ms.
RUNAWAY_WINDOW_MS = 1000  # after take-off, from the first raised throttle on, and before
RUNAWAY_MS = 50
HANDOVER_MS = 50  # of the blend from the old outputs to the new at a change of controller


class FlightState(IntEnum):
    """States of the firmware; firmware/src/safety/safety.c has the transitions."""

    BOOT = 0
    CALIBRATING = 1
    DISARMED = 2
    ARMED = 3
    FAILSAFE_HOLD = 4  # armed, the receiver silent: rates centred, throttle kept
    FAILSAFE_DROP = 5  # the configured stage: motors stopped, or a descent that ends with that
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
    POLICY_REFUSED = 14  # it fell back in flight, that is not acknowledged, and the switch chooses it
    GYRO_ALIGNMENT = 15  # sources disagree on how this gyro is turned: the setting gyro_alignment must say it
    CLOCK = 16  # the crystal did not start: the internal oscillator makes the clock
    LOAD = 17  # a gyro sample took longer than its period, within the last second
    MSP = 18  # a peer forbids it (ARMING_DISABLE), has not withdrawn that and is still there
    CLI = 19  # a command line is open
    PROBATION = 20  # the image is new and has not run well for long enough yet
    IMAGE_BAD = 21  # flash does not hold the image whole any more
    SETTINGS = 22  # this image refuses some of the stored settings, so that others are flown
    MOTORS_UNCHECKED = 23  # motors and gyro are not as `board motors check` last found them right


ARMING_REASON_COUNT = max(ArmingReason) + 1  # bits that a field of reasons takes
# Bit of each reason, by its number, in the flags of STATUS and STATUS_EX. Up to 27 they are the ecosystem's
# at MSP API 1.47, whose programs show their names; an image on probation and a write to flash are reported as
# boot grace, because both end by themselves. 28 the board: a fault, its image, its clock. 29 the battery or
# a setting. 30 no controller.
ARMING_FLAGS = (9, 12, 2, 7, 3, 30, 0, 8, 29, 28, 6, 16, 9, 30, 30, 29, 28, 11, 16, 13, 9, 28, 29, 29)
# Counts of beeper and LED for each reason while the arm switch is on: the remedy. The highest one is
# signalled. 0: signalled in another way, or the switch cannot be read then. 1 switch off and on, 2 throttle
# down, 3 level and still, 4 wait, 5 a computer holds it, 6 the policy, 7 the battery, 8 the board: connect a
# computer.
ARMING_COUNTS = (4, 3, 0, 2, 1, 6, 8, 3, 7, 0, 0, 5, 4, 6, 6, 8, 8, 4, 5, 5, 4, 8, 8, 8)
ARMING_FLAG_FAILSAFE = 1  # in a state of the failsafe
ARMING_FLAG_SWITCH = 31  # the last flag: the arm switch is on although arming is forbidden
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
    WEIGHTS = 7  # a weight in memory differs from flash
    ROTORS = 8  # it observes rotor speeds, an ESC is silent, and it has no model to take them from


class GyroHealth(IntEnum):
    """Faults of the gyro's samples."""

    GOOD = 0
    INVALID = 1  # transfer failed or impossible value
    STUCK = 2
    SATURATED = 3  # an axis is at the end of its range, which is flown as its rate
    SILENT = 4
