"""Hints on how to lift what keeps a firmware from arming; flight states and causes in words."""

from __future__ import annotations

from neuroflight.flash.link.messages import bit_names

HINTS = {  # by the names of contract.ArmingReason
    "BOOT_GRACE": "it has just started: wait for arming_delay_ms",
    "GYRO_NOT_CALIBRATED": "lay it down and keep it still for a second",
    "RECEIVER_LOST": "switch the transmitter on; check receiver_protocol and the receiver's wiring",
    "THROTTLE_HIGH": "put the throttle down",
    "SWITCH_NOT_CYCLED": "put the arm switch off once",
    "POLICY_BAD": "the policy failed its self-test: flash another, or choose the PID with its switch",
    "GYRO_BAD": "the gyro is stuck, silent or out of range: check its supply, then start anew",
    "NOT_LEVEL": "lay it down level; level_limit_deg is how far it may tilt",
    "BATTERY_UNKNOWN": "plug the battery in; battery_cells says how many cells it has",
    "FAULT": "see `faults`, mend the cause, then `faults --ack`",
    "CRASHED": "put the arm switch off, look at the aircraft",
    "MOTOR_TEST": "end the motor test",
    "STORING": "flash is being written: wait a moment",
    "PID_MISSING": "the switch chooses a PID and none is built in: choose the policy",
    "POLICY_REFUSED": "it was refused in flight: look at `status` for the cause, then `acknowledge`",
    "GYRO_ALIGNMENT": "set gyro_alignment to how the chip is turned",
    "CLOCK": "the crystal did not start: start anew, or have the board mended",
    "LOAD": "a gyro sample took too long: choose a lower gyro_rate_hz",
    "MSP": "a configurator holds arming: close it or disconnect it",
    "CLI": "a command line is open: leave it with `exit`",
    "PROBATION": "a new image is tried: wait 2 s, with a gyro that works",
    "SETTINGS": "this version does not take some stored setting: look them over, save, start anew",
    "MOTORS_UNCHECKED": "tie it down, `neuroflight board motors check`; or set motor_check=off",
    "IMAGE_BAD": "flash does not hold the image whole: flash it again",
}
FAULTS = {  # by the names of contract.FaultKind
    "NONE": "of no known kind",
    "HARD": "the processor met what it cannot do; pc is where, cfsr why",
    "ASSERT": "a check in the firmware failed",
    "WATCHDOG": "the firmware stood still",
    "BROWN_OUT": "the supply fell too low",
    "CLOCK": "the crystal failed",
    "RESET": "the board was reset while armed: by its reset line, or a debugger",
}
# Below these each level resets the chip (RM0431, option bytes; comments of the STM32F7 HAL).
BROWN_OUT_V = (None, 2.1, 2.4, 2.7)
BETAFLIGHT = (  # that firmware's reasons in the order of their bits, under the names that its app shows
    *("NO_GYRO", "FAILSAFE", "RX_FAILSAFE", "NOT_DISARMED", "BOXFAILSAFE", "RUNAWAY_TAKEOFF"),
    *("CRASH_DETECTED", "THROTTLE", "ANGLE", "BOOT_GRACE_TIME", "NOPREARM", "LOAD", "CALIBRATING", "CLI"),
    *("CMS_MENU", "BST", "MSP", "PARALYZE", "GPS", "RESC", "DSHOT_TELEM", "REBOOT_REQUIRED"),
    *("DSHOT_BITBANG", "ACC_CALIBRATION", "MOTOR_PROTOCOL"),
)
BETAFLIGHT_LAST = "ARM_SWITCH"  # always the last of them


def betaflight_reasons(flags: int, count: int) -> tuple[str, ...]:
    """Name the reasons set in the `flags` of Betaflight's STATUS_EX, which has `count` of them."""
    known = {f"BIT_{bit}": name for bit, name in enumerate(BETAFLIGHT)}
    if count > 0:
        known[f"BIT_{count - 1}"] = BETAFLIGHT_LAST
    return tuple(known.get(bit, bit) for bit in bit_names(flags))


def brown_out(level: int) -> str:
    """Describe the setting of the supply's brown-out detector."""
    volts = BROWN_OUT_V[level] if level < len(BROWN_OUT_V) else None
    if volts is None:
        return "off, as chips are delivered: docs/guides/board-bring-up.md says how to set it"
    return f"level {level}: resets the processor when its supply falls below about {volts} V"


def words(name: str) -> str:
    """Convert the name of a state or cause to plain words."""
    return name.lower().replace("_", " ")
