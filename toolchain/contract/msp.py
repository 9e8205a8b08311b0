"""MSP: what its messages share, the measured tasks and why a request is refused."""

from __future__ import annotations

from enum import IntEnum

MSP_PROTOCOL_VERSION = 0
MSP_API_MAJOR, MSP_API_MINOR = 1, 47
# The release of the ecosystem's firmware that has this API. FC_VERSION and logs tell it, as programs choose
# by it how they read us; our own version is in IDENTITY, BOARD_INFO and GET_TEXT. Years count from 2000.
MSP_RELEASE, MSP_RELEASE_NUMBERS = "2025.12.0", (25, 12, 0)
MSP_VARIANT = "NRFL"  # the setting msp_variant chooses which of the two FC_VARIANT tells
MSP_VARIANT_BETAFLIGHT = "BTFL"
MSP_FIRMWARE = "Neuroflight"  # that IDENTITY tells
# The ecosystem's PID: a gain of 1 is so much of its sum for one deg/s (P), deg (I), deg/s^2 (D), and a sum of
# 1000 is all of a motor.
MSP_PID_SCALES = (0.032029, 0.244381, 0.000529)
MSP_PID_SUM = 1000
MSP_FEATURE_RX_SERIAL, MSP_FEATURE_MOTOR_STOP, MSP_FEATURE_RX_MSP = 3, 4, 14  # bits
MSP_FEATURE_BLACKBOX, MSP_FEATURE_AIRMODE = 19, 22
# Counts of RAW_IMU: what the ecosystem's app takes for 1 deg/s (16.4 / 4) and, since API 1.46, for 1 g. Its
# firmware tells 16.4 a deg/s, so that the app shows four times the rate.
MSP_GYRO_COUNTS, MSP_ACCELERATION_COUNTS = 4.1, 2048.0
MSP_PROVIDER_SBUS, MSP_PROVIDER_CRSF = 2, 9
MSP_RATES_BETAFLIGHT, MSP_RATES_ACTUAL = 0, 3
MSP_ADJUSTMENT_SLOTS = 30  # all unused
MSP_BUILD_OPTIONS = (4103, 4097, 8231)  # of BUILD_INFO: receivers SBUS and CRSF, DShot
MSP_PAYLOAD_MAX = 512
MSP_PORT_COUNT = 3  # peers at once: UART1, UART3 and USB of the board, three TCP clients of the host program
MSP_PORT_USB = 2  # a line without noise, of the board: see MSP_ROM_LETTER
# Alone, after that silence, it asks for the boot loader in the chip's ROM: programs without REBOOT do so.
MSP_ROM_LETTER, MSP_ROM_SILENCE_MS = ord("R"), 200
MSP_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)  # of the line, 8N1
MSP_BAUD_DEFAULT = 115200  # the ecosystem's
MSP_MODE_ARMED = 0x01  # bit of the flight modes in STATUS and STATUS_EX
MSP_STREAM_RATE_MAX_HZ = 500
MSP_STREAM_ARMED, MSP_STREAM_PID = 0x01, 0x02  # flags of a record: motors obey; the PID flies
# Flags of a bank in IMAGE_INFO.
MSP_POLICY_NONE = 255  # as the source of POLICY_INFO: no policy is good
MSP_IMAGE_FITS, MSP_IMAGE_NUMBERED, MSP_IMAGE_CONFIRMED, MSP_IMAGE_REJECTED, MSP_IMAGE_INSTALLED = (
    1 << bit for bit in range(5)
)
VERSION = (0, 1, 0)
VERSION_TEXT = ".".join(map(str, VERSION))
CRC8_DVB_S2_POLY = 0xD5


class Task(IntEnum):
    """Tasks whose processor time is measured."""

    GYRO = 0  # a gyro sample that is no control step
    CONTROL = 1  # one that is, from the interrupt to the motors' frame
    BATTERY = 2
    ALERT = 3
    STORAGE = 4
    MSP = 5


class Reboot(IntEnum):
    """Programs that REBOOT starts, by the ecosystem's numbers; its other numbers are refused."""

    FIRMWARE = 0
    ROM = 1  # the boot loader in the chip's ROM
    CARD = 2  # the firmware, which shows its SD card as a disk by USB
    CARD_UTC = 3  # the same: what the app asks for on Linux, where a disk's clock would be UTC


class Refusal(IntEnum):
    """Reasons for refusing a request that would change something."""

    NONE = 0
    ARMED = 1  # or under test; only with the motors stopped
    PAYLOAD = 2  # of a length or with a value that the command does not take
    INDEX = 3  # there is none of that number
    RANGE = 4  # beyond a setting's limits, or no number
    CONFLICT = 5  # settings that do not go together
    FLASH = 6  # did not take what was written
    ORDER = 7  # not what comes next: a policy slot or a bank is begun, written from its beginning, ended
    BLOB = 8  # the policy is not one for this image
    SEQUENCE = 9  # of the policy is not newer than the one that stays
    ABSENT = 10  # this build has no such thing
    SPOILT = 11  # stored, but not all: some of a change before it was refused
    IMAGE = 12  # the image is not one for this board's other bank, or not whole, or not the one that was told
    LOG = 13  # the device that keeps the logs failed, as LogError says
