"""Detection of each client's custom: MAVLink leaves open how parameters hold whole numbers and what the
numbers of modes mean, and PX4's clients and ArduPilot's differ.

A client that asks for AUTOPILOT_VERSION by MAV_CMD_REQUEST_MESSAGE before it asks for parameters (MAVSDK,
QGroundControl) is told there that whole numbers stand in bytes. Others take the field for a float; some ask
later, for the version alone (MAVProxy). Who asks for REQUEST_DATA_STREAM, which only ArduPilot still serves
(MAVProxy, dronekit, Mission Planner), takes mode numbers for ArduPilot's as well.
"""

from __future__ import annotations

from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.offboard import Source

SOURCES_MAX = 64  # sources remembered; a forgotten client gets floats

CUSTOM_MODE = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED

# The autopilot's modes: in HEARTBEAT.custom_mode, MAV_CMD_DO_SET_MODE and SET_MODE.
MODE_RECEIVER = 0  # the firmware's receiver steers; the gateway sends no channels
MODE_OFFBOARD = 1  # a companion steers through the gateway

PX4_AUTO, PX4_OFFBOARD = 4, 6  # main modes
PX4_HOLD = 3  # sub mode of PX4_AUTO; MAVSDK's offboard.stop()
ARDUPILOT_GUIDED = (4, 20)  # GUIDED, GUIDED_NOGPS


@dataclass(frozen=True)
class Mode:
    """A mode that was asked for."""

    offboard: bool
    number: int  # that HEARTBEAT tells while it lasts
    owner_only: bool = False  # only the source that steers may end offboard by it


RECEIVER = Mode(False, MODE_RECEIVER)
# MAVSDK's offboard.stop() requests it, but so does a client that wants to hover, which is impossible here.
HOLD = Mode(False, MODE_RECEIVER, owner_only=True)


class ModeError(ValueError):
    """There is no such mode."""


class Customs:
    """The custom of each source, as its messages have shown it so far."""

    def __init__(self) -> None:
        self._in_bytes: dict[Source, bool] = {}  # by source: sent bytewise
        self._ardupilot: dict[Source, bool] = {}

    def hear_request(self, source: Source) -> None:
        """Note that `source` asked how whole numbers are encoded."""
        _note(self._in_bytes, source, self._in_bytes.get(source, True))

    def hear_parameters(self, source: Source) -> None:
        """Note that `source` asked for parameters, or set one."""
        _note(self._in_bytes, source, self._in_bytes.get(source, False))

    def hear_stream_request(self, source: Source) -> None:
        """Note that `source` sent REQUEST_DATA_STREAM."""
        _note(self._in_bytes, source, False)
        _note(self._ardupilot, source, True)

    def reads_bytes(self, source: Source | None) -> bool:
        """Return True if `source` is told whole numbers bytewise."""
        return source is not None and self._in_bytes.get(source, False)

    def offboard_number(self, peer: int) -> int:
        """Return HEARTBEAT's custom_mode for a peer while another one steers, in the numbers it knows."""
        if any(source[0] == peer for source in self._ardupilot):
            return ARDUPILOT_GUIDED[0]
        in_bytes = any(known and source[0] == peer for source, known in self._in_bytes.items())
        return px4_number(PX4_OFFBOARD) if in_bytes else MODE_OFFBOARD

    def command_mode(self, source: Source, base: int, main: int, sub: int) -> Mode:
        """Return the mode that the parameters of a MAV_CMD_DO_SET_MODE ask for. Raises ModeError."""
        _check_base(base)
        if main == MODE_RECEIVER:
            return RECEIVER
        if (main, sub) == (PX4_AUTO, PX4_HOLD):
            return HOLD
        if main == MODE_OFFBOARD or (main in ARDUPILOT_GUIDED and sub == 0):
            return Mode(True, main)
        if main == PX4_OFFBOARD and source not in self._ardupilot:  # ArduPilot's mode 6 is RTL
            return Mode(True, px4_number(PX4_OFFBOARD))
        raise _no_mode(f"{main}, {sub}" if sub else str(main))


def message_mode(base: int, custom: int) -> Mode:
    """Return the mode that a SET_MODE asks for. Raises ModeError."""
    _check_base(base)
    if custom == MODE_RECEIVER:
        return RECEIVER
    if custom == px4_number(PX4_AUTO, PX4_HOLD):
        return HOLD
    if custom in (MODE_OFFBOARD, *ARDUPILOT_GUIDED, px4_number(PX4_OFFBOARD)):
        return Mode(True, custom)
    raise _no_mode(str(custom))


def px4_number(main: int, sub: int = 0) -> int:
    """Return PX4's custom_mode of a main and a sub mode."""
    return main << 16 | sub << 24


def _check_base(base: int) -> None:
    if not base & CUSTOM_MODE:
        raise ModeError(f"base mode {base} names no custom mode, expected {CUSTOM_MODE} in it")


def _no_mode(number: str) -> ModeError:
    return ModeError(
        f"there is no mode {number}, expected {MODE_RECEIVER} (receiver) or {MODE_OFFBOARD} (offboard)"
    )


def _note(known: dict[Source, bool], source: Source, what: bool) -> None:
    known.pop(source, None)
    known[source] = what
    if len(known) > SOURCES_MAX:
        del known[next(iter(known))]
