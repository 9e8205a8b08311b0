"""The blackbox: what a log says of a flight, where it goes, and what keeps it from going there.

The format is Betaflight's (data version 2); its numbers stand here as the ecosystem's tools read them.
"""

from __future__ import annotations

from enum import IntEnum


class LogDevice(IntEnum):
    """Destinations of a log: the setting blackbox_device."""

    NONE = 0
    SERIAL = 1  # UART3, where uart3_function says blackbox
    CARD = 2  # the board's SD card or flash chip; on the host program the file of --blackbox


class LogState(IntEnum):
    """States of the log's device."""

    ABSENT = 0  # no device, or none set
    STARTING = 1  # being checked, or erased
    READY = 2
    LOGGING = 3
    ENDING = 4  # the last bytes of a log are on their way
    FULL = 5  # no empty file, or no room on the flash chip, is left
    FAULT = 6  # as LogError says


class LogError(IntEnum):
    """Reasons why the device cannot take a log, or lost a part of one."""

    NONE = 0
    NO_CARD = 1  # nothing answers, neither a card nor a flash chip
    CARD = 2  # wrong answers of the card
    FILE_SYSTEM = 3  # not FAT32, or not a sound one
    NO_FILE = 4  # no file for logs: `neuroflight log card` makes them
    FRAGMENTED = 5  # a file for logs does not lie in one piece
    WRITE = 6  # the card refused a write, or took too long
    READ = 7
    CHIP = 8  # a flash chip that the firmware does not know
    FOREIGN = 9  # a flash chip holds what another firmware wrote, or remains of it


class LogGroup(IntEnum):
    """Groups of fields, a bit each of the setting blackbox_disabled_mask; up to 15 the ecosystem's."""

    PID = 0  # errors of rate
    COMMANDS = 1
    SETPOINT = 2
    BATTERY = 3
    RSSI = 6
    GYRO = 7
    ATTITUDE = 8
    ACC = 9
    DEBUG = 10  # chirp, action, observation
    MOTOR = 11
    RPM = 13  # rotor speeds that ESCs tell
    GYRO_UNFILTERED = 14
    EXACT = 16  # gyro, setpoint and throttle as the controller had them, to the bit
    REPLAY = 17  # all inputs of the control path
    TIMING = 18  # of the control task


class LogEvent(IntEnum):
    """Events of a log, by the ecosystem's numbers."""

    SYNC_BEEP = 0  # arming, with its time
    LOGGING_RESUME = 14  # after steps that were dropped, or a pause
    DISARM = 15  # with the reason
    FLIGHT_MODE = 30  # new and old flags
    LOG_END = 255


LOG_RECEIVER_BYTES = 48  # receiver bytes of one control step in a log; CRSF brings 42 a millisecond
LOG_FIELDS_MAX, LOG_FRAME_BYTES_MAX = 128, 256  # limits of the ecosystem's tools
LOG_HEADER_LINE_MAX = 240  # characters
LOG_BAUDS = (115200, 230400, 460800, 921600, 1_000_000, 1_500_000, 2_000_000)  # of a line that takes a log
LOG_BAUD_DEFAULT = 2_000_000
LOG_DIVIDERS = (1, 2, 4, 8, 16)  # of the control rate, the setting blackbox_divider
LOG_FILE_PREFIX, LOG_FILE_SUFFIX = "LOG", ".BBL"  # LOG00001.BBL ..
LOG_NUMBER_MAX = 99_999
LOG_FILE_MIB, LOG_FILE_MIB_MAX = 64, 4095  # at 100 kB/s 11 minutes; FAT32's limit is 4 GB less one byte
LOG_ERASE_MAGIC = 0x45534152  # "RASE", little-endian: blanks all logs of the card or flash chip
LOG_NAME_BYTES = 12  # of a log's file: 8.3
LOG_INFO_LOGGING, LOG_INFO_LOSSY = 0x01, 0x02  # flags: being written; current or last one lacks steps
LOG_INFO_LOOKING = 0x04  # still looking for files: there may be more logs
