"""The motor test, DShot values and commands, and the idle of armed motors."""

from __future__ import annotations

from enum import IntEnum

MOTOR_TEST_TIMEOUT_MS = 500  # a motor test without a fresh request ends; arming waits as long after it
MOTOR_TEST_MAGIC = 0x5453544D  # "MTST": opens it; 0 closes it
MOTOR_TEST_MAX = 0.5  # motor fraction: shows direction, order and balance at a quarter of the thrust
MOTOR_TEST_SUM_MAX = 1.0  # of all motors: the NF1 hovers at four times 0.27
MOTOR_TEST_TURN_DEG_S = 300.0  # an aircraft that turns so fast is not held: the test ends within 20 ms
MOTOR_WIZARD_MAX = 0.125  # motor fraction, of the app's wizards: above the idle of 5.5 %, lifts no aircraft
MOTOR_BENCH_MAGIC = 0x48434E42  # "BNCH": opens it for a rotor on a dynamometer, whose limits follow
MOTOR_BENCH_MAX = 1.0  # motor fraction: of one motor alone, as the sum keeps its limit

DSHOT_STOP = 0
DSHOT_MIN, DSHOT_MAX = 48, 2047  # 1..47 are commands, never sent by the control path
DSHOT_SPAN = DSHOT_MAX - DSHOT_MIN  # value = 48 + (uint16)(1999 u + 0.5)
DSHOT_ALL_MOTORS = 255  # where a command may name one

# --- What ESCs tell over the motor wire, in the answer to each frame: a word of 12 bits, by output ------
ESC_SILENT = 0xFFFF  # in its place: nothing answered
ESC_DAMAGED = 0xFFFE  # something did, but no valid word
ESC_WORD_MAX = 0x0FFF
# A speed: the period of an electrical turn in us, as 9 bits shifted left by an exponent of 3 bits. The
# largest word is a rotor that stands still.
ESC_STANDS = ESC_WORD_MAX
ESC_MANTISSA_BITS = 9
ESC_PERIOD_MAX_US = 510 << 7  # of a rotor that turns; a slower one is told to stand
MOTOR_POLES_DEFAULT = 14  # magnets of a motor's bell
# A word beyond physics is noise that looks like an answer. No propeller turns faster, and none gains or loses
# speed faster: the quickest of our twins does a fifth of that. Beyond what rotors do in flight a word counts
# only once the next one agrees. The word's own step comes on top.
ROTOR_SPEED_MAX = 10_000.0  # [rad/s]
ROTOR_ACCELERATION_MAX = 250_000.0  # [rad/s^2]
ROTOR_ACCELERATION_USUAL = 100_000.0  # [rad/s^2]
ROTOR_HOLD_MS = 8  # without a good word the last speed holds so long; then the ESC counts as silent

# Notches at the rotors' turns (rpm_filter.c): whole so far above their lowest centre; the highest one.
RPM_FILTER_FADE_HZ = 50.0
RPM_FILTER_HIGHEST = 0.45  # of the gyro rate

DYNAMIC_IDLE_MAX = 0.1  # output that a dynamic idle adds at most: it lifts no aircraft
# A motor is weak that gives less than this share of the speed that the best one gives for its output, both
# behind a low-pass, for this time. On our twins the curve of speed over output makes 0.64 of 1 between a
# tenth of the output and all of it.
WEAK_MOTOR_SHARE, WEAK_MOTOR_MS, WEAK_MOTOR_FILTER_MS = 0.5, 300, 100


class EscTold(IntEnum):
    """Other words of ESCs, extended telemetry: a byte of each kind. Their upper bits are 2 (kind + 1), 0.

    They come once EXTENDED_TELEMETRY was commanded, the first one is a STATE.
    """

    TEMPERATURE = 0  # degC
    VOLTAGE = 1  # 0.25 V
    CURRENT = 2  # A
    DEBUG_1 = 3
    DEBUG_2 = 4
    STRESS = 5
    STATE = 6  # bits of alerts, and the highest stress so far


class DshotCommand(IntEnum):
    """Commands to a motor's controller; all others are refused."""

    STOP = 0  # ends the present command
    BEACON_1 = 1
    BEACON_2 = 2
    BEACON_3 = 3
    BEACON_4 = 4
    BEACON_5 = 5
    DIRECTION_1 = 7  # as the motor is wired
    DIRECTION_2 = 8
    SAVE = 12  # stores the last direction
    EXTENDED_TELEMETRY = 13  # answers are now and then a word of EscTold
    DIRECTION_NORMAL = 20  # as the controller is set up
    DIRECTION_REVERSED = 21


# u' = idle + (1 - idle) u. The idle is the fraction at which an armed motor turns without thrust; each policy
# has the one it was trained with.
IDLE_DEFAULT = 0.0  # of policies without one
IDLE_MAX = 0.5


class Mix(IntEnum):
    """Two ways to compute motor fractions u from a controller's outputs y and the pilot's thrust T, before
    the idle.

    Both keep the differences between the motors, which turn the aircraft, and both are computed in float32 in
    the order written here. ATTITUDE_FIRST: u_i = T (1 - max y) + y_i. The outputs carry thrust of their own.
    CENTRED: u_i = T + (y_i - mean y), all raised until none is below 0, or lowered until none is above 1.
    The outputs turn only: at rest the motors' mean is the throttle.
    """

    ATTITUDE_FIRST = 0
    CENTRED = 1

    @property
    def text(self) -> str:
        """Name in files: attitude-first, centred."""
        return self.name.lower().replace("_", "-")

    @staticmethod
    def of(text: str) -> Mix:
        """Return the mix with that name. Raises ValueError, one line."""
        for mix in Mix:
            if mix.text == text:
                return mix
        raise ValueError(f"mix {text[:60]!r}, expected one of: {', '.join(mix.text for mix in Mix)}")


# --- The battery, and the PID's answer to it -----------------------------------------------------
BATTERY_RATE_HZ = 100  # of its measurements
BATTERY_FILTER_S = 0.1  # of its low-pass: slower than the motors' current ripple, faster than a pilot
# Limit of the PID's compensation for a sagging pack: 3.5 V a cell with a nominal 4.0. A wrong reading of the
# voltage raises the loop gain no further, and the NF1's tuned PID flies with this gain at every throttle.
PID_COMPENSATION_MAX = 1.3
