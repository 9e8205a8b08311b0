"""MSP: the commands that the firmware answers, its measured tasks and why it refuses a request."""

from __future__ import annotations

from enum import IntEnum


class Msp(IntEnum):
    """Commands of the MultiWii Serial Protocol that this firmware answers; numbers are the ecosystem's."""

    API_VERSION = 1
    FC_VARIANT = 2
    FC_VERSION = 3
    BOARD_INFO = 4
    BUILD_INFO = 5
    NAME = 10
    BATTERY_CONFIG = 32
    SET_BATTERY_CONFIG = 33
    MODE_RANGES = 34
    SET_MODE_RANGE = 35
    FEATURE_CONFIG = 36
    SET_FEATURE_CONFIG = 37
    BOARD_ALIGNMENT_CONFIG = 38
    SET_BOARD_ALIGNMENT_CONFIG = 39
    CURRENT_METER_CONFIG = 40
    SET_CURRENT_METER_CONFIG = 41
    MIXER_CONFIG = 42
    SET_MIXER_CONFIG = 43
    RX_CONFIG = 44
    SET_RX_CONFIG = 45
    RSSI_CONFIG = 50
    SET_RSSI_CONFIG = 51
    ADJUSTMENT_RANGES = 52
    SERIAL_CONFIG = 54  # COMMON_SERIAL_CONFIG of older peers
    VOLTAGE_METER_CONFIG = 56
    SET_VOLTAGE_METER_CONFIG = 57
    SONAR = 58
    PID_CONTROLLER = 59
    ARMING_CONFIG = 61
    SET_ARMING_CONFIG = 62
    RX_MAP = 64
    SET_RX_MAP = 65
    REBOOT = 68
    DATAFLASH_SUMMARY = 70
    FAILSAFE_CONFIG = 75
    SET_FAILSAFE_CONFIG = 76
    RXFAIL_CONFIG = 77
    SET_RXFAIL_CONFIG = 78
    SDCARD_SUMMARY = 79
    BLACKBOX_CONFIG = 80
    SET_BLACKBOX_CONFIG = 81
    ADVANCED_CONFIG = 90
    SET_ADVANCED_CONFIG = 91
    FILTER_CONFIG = 92
    SET_FILTER_CONFIG = 93
    PID_ADVANCED = 94
    SET_PID_ADVANCED = 95
    SENSOR_CONFIG = 96
    SET_SENSOR_CONFIG = 97
    ARMING_DISABLE = 99  # nothing arms while a peer says so; the ecosystem's motor test
    STATUS = 101
    RAW_IMU = 102
    MOTOR = 104
    RC = 105
    ATTITUDE = 108
    ALTITUDE = 109
    ANALOG = 110
    RC_TUNING = 111
    PID = 112
    BOXNAMES = 116
    PIDNAMES = 117
    BOXIDS = 119
    MOTOR_3D_CONFIG = 124
    RC_DEADBAND = 125
    SENSOR_ALIGNMENT = 126
    VOLTAGE_METERS = 128
    CURRENT_METERS = 129
    BATTERY_STATE = 130
    MOTOR_CONFIG = 131
    COMPASS_CONFIG = 133
    SIMPLIFIED_TUNING = 140
    SET_SIMPLIFIED_TUNING = 141
    VALIDATE_SIMPLIFIED_TUNING = 145
    STATUS_EX = 150
    UID = 160
    BEEPER_CONFIG = 184
    SET_BEEPER_CONFIG = 185
    SET_RAW_RC = 200  # sticks, where the receiver is MSP
    SET_PID = 202
    SET_RC_TUNING = 204
    RESET_CONF = 208  # all settings to their defaults, stored
    SET_MOTOR = 214  # motor test, once MOTOR_TEST or ARMING_DISABLE has opened it
    SET_MOTOR_3D_CONFIG = 217
    SET_RC_DEADBAND = 218
    SET_SENSOR_ALIGNMENT = 220
    SET_MOTOR_CONFIG = 222
    SET_COMPASS_CONFIG = 224
    MODE_RANGES_EXTRA = 238
    SET_ACC_TRIM = 239
    ACC_TRIM = 240
    EEPROM_WRITE = 250  # settings to flash
    DEBUG = 254
    COMMON_SERIAL_CONFIG = 4105
    COMMON_SET_SERIAL_CONFIG = 4106
    MOTOR_OUTPUT_REORDERING = 12289
    SET_MOTOR_OUTPUT_REORDERING = 12290
    SEND_DSHOT_COMMAND = 12291
    GET_TEXT = 12294
    SET_TEXT = 12295
    SENSOR_CONFIG_ACTIVE = 12298
    MCU_INFO = 12300
    GYRO_SENSOR = 12301
    POLICY_INFO = 0x4E01  # v2, ours: what the compiled-in policy is
    TASKS = 0x4E02  # v2, ours: rate, worst, best, mean and misses of each task
    FAULTS = 0x4E03  # v2, ours: the record of the last fault; with a payload: it is acknowledged
    SAFETY = 0x4E04  # v2, ours: flight state, causes of the last stop and of the last change to the PID
    ACKNOWLEDGE = 0x4E05  # v2, ours: all logged faults, and the policy that was refused in flight
    IDENTITY = 0x4E06  # v2, ours: who this is, whatever FC_VARIANT says
    CALIBRATE = 0x4E07  # v2, ours: the gyro anew; disarmed only
    SETTING_INFO = 0x4E10  # v2, ours: name, unit, range, default of one setting, by index
    SETTING_GET = 0x4E11  # v2, ours: value of one setting, by index
    SETTING_SET = 0x4E12  # v2, ours: one setting, by index
    SETTINGS_DEFAULT = 0x4E13  # v2, ours: all settings to their defaults, not stored
    MOTOR_TEST = 0x4E20  # v2, ours: opens or closes the motor test
    DSHOT_COMMAND = 0x4E21  # v2, ours: beep, direction; disarmed only
    POLICY_SLOT_BEGIN = 0x4E30  # v2, ours: erases the slot that is not flown
    POLICY_SLOT_WRITE = 0x4E31  # v2, ours: offset and bytes
    POLICY_SLOT_END = 0x4E32  # v2, ours: checks the blob; flown from the next boot on
    POLICY_SLOT_REVERT = 0x4E33  # v2, ours: the flown slot's policy is none any more from the next boot on
    POLICY_SLOT_INFO = 0x4E34  # v2, ours: what a slot holds
    STREAM = 0x4E40  # v2, ours: records of control steps unasked from now on, at the rate told
    STREAM_SAMPLE = 0x4E41  # v2, ours: one of them; never a request
    IMAGE_INFO = 0x4E50  # v2, ours: what the two banks of images hold
    IMAGE_BEGIN = 0x4E51  # v2, ours: erases the bank that is not run, for the image of that header
    IMAGE_WRITE = 0x4E52  # v2, ours: offset and bytes
    IMAGE_END = 0x4E53  # v2, ours: checks that all of it has arrived
    IMAGE_HASH = 0x4E54  # v2, ours: SHA-256 of a bank's image as flash has it
    IMAGE_SWITCH = 0x4E55  # v2, ours: the image of that SHA-256 is started from the next boot on
    LOG_INFO = 0x4E60  # v2, ours: what the blackbox does, and how many logs its device keeps
    LOG_ENTRY = 0x4E61  # v2, ours: name and size of one of them
    LOG_READ = 0x4E62  # v2, ours: bytes of one of them
    LOG_ERASE = 0x4E63  # v2, ours: makes all their files empty again


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
MSP_PORT_COUNT = 2  # peers at once: UART1 and UART3 of the board, two TCP clients of the host program
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
