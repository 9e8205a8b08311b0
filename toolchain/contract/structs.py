"""Structs that C and Python lay over the same bytes, and numbers that both know by name.

For C, nf_contract.h defines them; `sim.structs` makes dtypes of them.
"""

from __future__ import annotations

from enum import IntEnum, IntFlag

from neuroflight.toolchain.contract.blackbox import LOG_RECEIVER_BYTES
from neuroflight.toolchain.contract.frame_time_sensors import MOTOR_COUNT_MAX
from neuroflight.toolchain.contract.policy_format import HeaderField


class FirmwareError(IntEnum):
    """Errors of input that the firmware cannot fly with."""

    OK = 0
    ERR_GYRO_RATE = -1  # gyro rate unknown, or no multiple of the policy's control rate
    ERR_ALIGNMENT = -2  # no such gyro alignment
    ERR_IDLE = -3  # idle outside [0, 1)
    ERR_OBSERVATION = -4  # the policy asks for a term that this core does not compute
    ERR_POLICY = -5  # the self-test's results differ in a bit
    # A policy blob, in the order of the checks.
    ERR_BLOB_SHORT = -6  # fewer bytes than a header and a CRC
    ERR_BLOB_MAGIC = -7  # not a blob: an erased slot, for instance
    ERR_BLOB_LAYOUT = -8  # of another layout version
    ERR_BLOB_SIZE = -9  # sizes that contradict each other or exceed the bytes; no self-test
    ERR_BLOB_CRC = -10  # damaged
    ERR_BLOB_RATE = -11  # trained for another control rate
    ERR_BLOB_FILTERS = -12  # trained behind other gyro filters
    ERR_BLOB_ARCHITECTURE = -13  # weights for other code
    ERR_BLOB_IDLE = -14  # an idle that no policy is trained with
    ERR_SETTINGS = -15  # beyond their limits, or they contradict each other
    # -16 was a policy older than its image, before images named their policies.
    # An image for a bank, in the order of the checks.
    ERR_IMAGE_MAGIC = -17  # not an image
    ERR_IMAGE_LAYOUT = -18  # of another layout version
    ERR_IMAGE_BOARD = -19  # for another board
    ERR_IMAGE_BANK = -20  # linked for another bank
    ERR_IMAGE_SIZE = -21  # a size that no image has, or that does not fit the bank
    ERR_IMAGE_HEADER = -22  # flash has another header than the one that was told
    ERR_IMAGE_CRC = -23  # damaged, or not all of it is there
    ERR_IMAGE_SHA256 = -24  # whole, but not the image of that SHA-256
    # A policy blob again.
    ERR_BLOB_MIX = -25  # a mix that this firmware does not know; checked behind ERR_BLOB_IDLE
    ERR_BLOB_MODEL = -26  # a model of no aircraft, one too many, or none where a term needs it
    ERR_BLOB_BUILD = -27  # it came with another image; checked behind ERR_BLOB_CRC


class FaultKind(IntEnum):
    """Kinds of faults that end a run."""

    NONE = 0
    HARD = 1  # a processor fault: registers say where
    ASSERT = 2  # `file` and `line` say where
    WATCHDOG = 3  # nobody fed it; where is not known
    BROWN_OUT = 4
    CLOCK = 5  # the crystal failed
    RESET = 6  # armed, and none of the above: the reset line was pulled, or a debugger reset the chip


class Weights(IntEnum):
    """Result of comparing the policy's weights with flash."""

    KNOWN = 0  # already compared, result unchanged
    BAD = 1  # they differ from flash, until they are renewed
    RENEWED = 2  # they are equal again: told once


class LogEdge(IntFlag):
    """Bits of a control step's edge_flags."""

    POSTED = 1 << 0  # receiver bytes are 16 channels [us], little-endian, that MSP posted
    ACKNOWLEDGED = 1 << 1  # firmware_acknowledge
    CALIBRATE = 1 << 2  # firmware_calibrate
    WEIGHTS_BAD = 1 << 3  # firmware_weights: false, until true
    WEIGHTS_GOOD = 1 << 4  # firmware_weights: true, since the last step
    MISSED = 1 << 5  # this step missed its deadline: firmware_deadline
    SILENT = 1 << 6  # firmware_gyro_silent was called before this step
    MORE_BYTES = 1 << 7  # more receiver bytes came than fit: cannot be replayed
    BENCH = 1 << 8  # a motor test or DShot command was under way: cannot be replayed
    SILENCE = 1 << 16  # the upper half counts the calls of firmware_gyro_silent since the last step


class LogSampleFlag(IntFlag):
    """Bits of a gyro sample's flags in a log."""

    INVALID = 1 << 0  # the transfer failed
    # A good sample that equals the good one before in every word; only where gyro_stuck_ms looks for it.
    REPEATED = 1 << 1


FAULT_REGISTERS = ("r0", "r1", "r2", "r3", "r12", "lr", "pc", "psr", "cfsr", "hfsr", "mmfar", "bfar", "sp")
REPLAY_SAMPLES_MAX = 64  # gyro samples a control step, of any policy
REPLAY_STREAM_MAGIC = 0x5052464E  # "NFRP"
FAULT_FILE_BYTES = 24
_SAMPLE = (
    HeaderField("int16_t", "counts", "", "chip axes", 3),
    HeaderField("uint16_t", "flags", "", "enum log_sample_flag"),
)
STRUCTS = {  # in C by these names
    "fault_record": (
        HeaderField("uint32_t", "kind", "", "enum fault_kind"),
        # As stacked by the exception; fault status and address registers (ARMv7-M B3.2); the stack pointer.
        HeaderField("uint32_t", "r", "", "r0 to r3", 4),
        *(HeaderField("uint32_t", name, "", "register") for name in FAULT_REGISTERS[4:]),
        HeaderField(
            "uint32_t", "line", "", "of the assertion; else the exception's number, or a brown-out's BOR_LEV"
        ),
        HeaderField("char", "file", "", "end of its path, ended with 0", FAULT_FILE_BYTES),
        HeaderField("uint32_t", "uptime_steps", "control steps", "since boot"),
    ),
    "log_sample": _SAMPLE,
    "replay_stream": (  # how a replay begins; the state follows, then one replay_step a control step
        HeaderField("uint32_t", "magic", "", "REPLAY_STREAM_MAGIC"),
        HeaderField("uint32_t", "state_bytes", "bytes", "of struct firmware"),
        HeaderField("uint32_t", "layout", "", "firmware_layout"),
    ),
    "replay_step": (  # what one control step was given; the members of struct log_record of these names
        HeaderField("uint32_t", "forbidden", "", "arming reasons"),
        HeaderField("float", "voltage_gain", "", "of the PID"),
        HeaderField("uint32_t", "edge_flags", "", "enum log_edge, all 32 bits"),
        HeaderField("uint32_t", "lost", "", "gyro samples"),
        HeaderField("uint16_t", "samples", "", "used entries of gyro, at least 1"),
        HeaderField("uint16_t", "receiver_count", "bytes", "from the receiver"),
        HeaderField("int16_t", "accel", "", "chip axes", 3),
        HeaderField("uint16_t", "reserved", "", "0"),
        HeaderField("uint16_t", "rotors", "", "words of the ESCs, by output", MOTOR_COUNT_MAX),
        HeaderField("struct log_sample", "gyro", "", "oldest first", REPLAY_SAMPLES_MAX, _SAMPLE),
        HeaderField("uint8_t", "receiver_bytes", "", "used up to receiver_count", LOG_RECEIVER_BYTES),
    ),
    "replay_answer": (  # what came of a control step
        HeaderField("uint32_t", "step", "control steps", "since boot"),
        HeaderField("float", "setpoint", "rad/s", "body axes", 3),
        HeaderField("float", "gyro", "rad/s", "body axes, as the controller had it", 3),
        HeaderField("float", "throttle", "", "0..1"),
        HeaderField("uint16_t", "dshot", "", "motor order", MOTOR_COUNT_MAX),
    ),
    "reference_trace": (  # the last control step of the reference library
        HeaderField("uint32_t", "step", "control steps", "since init, the first is 0"),
        HeaderField("float", "setpoint", "rad/s", "body axes", 3),
        HeaderField("float", "gyro", "rad/s", "body axes, as the policy used it", 3),
        HeaderField("float", "throttle", "", "0..1"),
        HeaderField("uint8_t", "armed", "", "1: the motors obey"),
        HeaderField("uint8_t", "motors", "", "used entries of dshot"),
        HeaderField("uint16_t", "pad", "", "0"),
        HeaderField("uint16_t", "dshot", "", "motor order", MOTOR_COUNT_MAX),
    ),
}
