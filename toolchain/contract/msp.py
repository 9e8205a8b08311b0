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
    STATUS = 101
    RAW_IMU = 102
    MOTOR = 104
    RC = 105
    ATTITUDE = 108
    ANALOG = 110
    BATTERY_STATE = 130
    STATUS_EX = 150
    UID = 160
    SET_RAW_RC = 200  # sticks, where the receiver is MSP
    SET_MOTOR = 214  # motor test, once MOTOR_TEST has opened it
    EEPROM_WRITE = 250  # settings to flash
    POLICY_INFO = 0x4E01  # v2, ours: what the compiled-in policy is
    TASKS = 0x4E02  # v2, ours: rate, worst, best, mean and misses of each task
    FAULTS = 0x4E03  # v2, ours: the record of the last fault; with a payload: it is acknowledged
    SAFETY = 0x4E04  # v2, ours: flight state, causes of the last stop and of the last change to the PID
    ACKNOWLEDGE = 0x4E05  # v2, ours: all logged faults, and the policy that was refused in flight
    SETTING_INFO = 0x4E10  # v2, ours: name, unit, range, default of one setting, by index
    SETTING_GET = 0x4E11  # v2, ours: value of one setting, by index
    SETTING_SET = 0x4E12  # v2, ours: one setting, by index; flown from the next boot on
    MOTOR_TEST = 0x4E20  # v2, ours: opens or closes the motor test
    DSHOT_COMMAND = 0x4E21  # v2, ours: beep, direction; disarmed only
    POLICY_SLOT_BEGIN = 0x4E30  # v2, ours: erases the slot that is not flown
    POLICY_SLOT_WRITE = 0x4E31  # v2, ours: offset and bytes
    POLICY_SLOT_END = 0x4E32  # v2, ours: checks the blob; flown from the next boot on
    STREAM = 0x4E40  # v2, ours: records of control steps unasked from now on, at the rate told
    STREAM_SAMPLE = 0x4E41  # v2, ours: one of them; never a request
    REBOOT = 68


MSP_PROTOCOL_VERSION = 0
MSP_API_MAJOR, MSP_API_MINOR = 1, 46
MSP_VARIANT = "NRFL"
MSP_PAYLOAD_MAX = 512
MSP_PORT_COUNT = 2  # peers at once: UART1 and UART3 of the board, two TCP clients of the host program
MSP_BAUDS = (9600, 19200, 38400, 57600, 115200, 230400, 460800, 921600)  # of the line, 8N1
MSP_BAUD_DEFAULT = 115200  # the ecosystem's
MSP_MODE_ARMED = 0x01  # bit of the flight modes in STATUS and STATUS_EX
MSP_STREAM_RATE_MAX_HZ = 500
MSP_STREAM_ARMED, MSP_STREAM_PID = 0x01, 0x02  # flags of a record: motors obey; the PID flies
VERSION = (0, 1, 0)
CRC8_DVB_S2_POLY = 0xD5


class Task(IntEnum):
    """What the processor is measured at."""

    GYRO = 0  # a gyro sample that is no control step
    CONTROL = 1  # one that is, from the interrupt to the motors' frame
    BATTERY = 2
    ALERT = 3
    STORAGE = 4
    MSP = 5


class Refusal(IntEnum):
    """Why a request that would change something is refused."""

    NONE = 0
    ARMED = 1  # or under test; only with the motors stopped
    PAYLOAD = 2  # of a length or with a value that the command does not take
    INDEX = 3  # there is none of that number
    RANGE = 4  # beyond a setting's limits, or no number
    CONFLICT = 5  # settings that do not go together
    FLASH = 6  # did not take what was written
    ORDER = 7  # not what comes next: a policy slot is begun, written from its beginning, ended
    BLOB = 8  # the policy is not one for this image
    SEQUENCE = 9  # of the policy is not newer than the one that stays
    ABSENT = 10  # this build has no such thing
