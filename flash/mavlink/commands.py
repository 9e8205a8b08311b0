"""Commands of MAVLink: COMMAND_LONG and COMMAND_INT in, a result for COMMAND_ACK out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.customs import CUSTOM_MODE, MODE_OFFBOARD, MODE_RECEIVER
from neuroflight.flash.mavlink.offboard import Source

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = (
    mavlink.MAV_RESULT_ACCEPTED,
    mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
    mavlink.MAV_RESULT_DENIED,
    mavlink.MAV_RESULT_UNSUPPORTED,
    mavlink.MAV_RESULT_FAILED,
    mavlink.MAV_RESULT_IN_PROGRESS,
)
CANCELLED = 6  # MAV_RESULT_CANCELLED, which pymavlink does not name
ID_MAX = 0xFFFFFF  # of a message
INTERVAL_DEFAULT, INTERVAL_OFF = 0, -1
INTERVAL_MIN_US, INTERVAL_MAX_US = 20_000, 3_600_000_000
STORAGE_WRITE, STORAGE_DEFAULTS = 1, 2
REBOOT = 1


@dataclass(frozen=True)
class Request:
    """A command, and who gave it."""

    command: int
    params: tuple[float, ...]  # 1 to 4, of any value
    source: Source

    def whole(self, number: int, low: int, high: int) -> int | None:
        """Return parameter `number`, from 1, if it is a whole number within low..high, otherwise None."""
        value = self.params[number - 1]
        return int(value) if low <= value <= high and value == int(value) else None


class Actions(Protocol):
    """Actions that commands trigger; each returns a MAV_RESULT."""

    def send_once(self, message: int) -> int: ...
    def tell_capabilities(self, source: Source) -> int: ...
    def set_interval(self, message: int, interval_us: int) -> int: ...
    def tell_interval(self, message: int) -> int: ...
    def store(self, *, defaults: bool) -> int: ...
    def reboot(self) -> int: ...
    def set_mode(self, source: Source, base: int, main: int, sub: int) -> int: ...
    def arm(self, request: Request) -> int: ...
    def disarm(self, request: Request) -> int: ...


def read_request(message: Any, source: Source) -> Request:  # noqa: ANN401 - pymavlink's are untyped
    """Read the request in a COMMAND_LONG or COMMAND_INT."""
    params = message.param1, message.param2, message.param3, message.param4
    return Request(int(message.command), params, source)


def acknowledgement(request: Request, result: int) -> Any:  # noqa: ANN401
    """Return COMMAND_ACK to the sender of the command."""
    _, system, component = request.source
    return mavlink.MAVLink_command_ack_message(
        request.command, result, target_system=system, target_component=component
    )


def carry_out(request: Request, actions: Actions) -> int:
    """Execute a command and return its MAV_RESULT: UNSUPPORTED, or DENIED for impossible parameters."""
    handler = COMMANDS.get(request.command)
    return handler(request, actions) if handler is not None else int(UNSUPPORTED)


def _request_message(request: Request, actions: Actions) -> int:
    message = request.whole(1, 0, ID_MAX)
    if message == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
        return actions.tell_capabilities(request.source)
    return actions.send_once(message) if message is not None else int(DENIED)


def _request_capabilities(request: Request, actions: Actions) -> int:
    return (
        actions.send_once(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION) if request.params[0] == 1 else int(DENIED)
    )


def _set_interval(request: Request, actions: Actions) -> int:
    message, interval_us = request.whole(1, 0, ID_MAX), request.whole(2, INTERVAL_OFF, INTERVAL_MAX_US)
    if message is None or interval_us is None or 0 < interval_us < INTERVAL_MIN_US:
        return int(DENIED)
    return actions.set_interval(message, interval_us)


def _get_interval(request: Request, actions: Actions) -> int:
    message = request.whole(1, 0, ID_MAX)
    return actions.tell_interval(message) if message is not None else int(DENIED)


def _storage(request: Request, actions: Actions) -> int:
    wanted = request.whole(1, STORAGE_WRITE, STORAGE_DEFAULTS)
    return actions.store(defaults=wanted == STORAGE_DEFAULTS) if wanted is not None else int(DENIED)


def _reboot(request: Request, actions: Actions) -> int:
    return actions.reboot() if request.params[0] == REBOOT else int(DENIED)


def _set_mode(request: Request, actions: Actions) -> int:
    base, main = request.whole(1, 0, 0xFF), request.whole(2, 0, 0xFF)
    sub = 0 if math.isnan(request.params[2]) else request.whole(3, 0, 0xFF)
    if base is None or main is None or sub is None:
        return int(DENIED)
    return actions.set_mode(request.source, base, main, sub)


def _guided(request: Request, actions: Actions) -> int:
    on = request.whole(1, 0, 1)
    mode = MODE_OFFBOARD if on else MODE_RECEIVER
    return actions.set_mode(request.source, CUSTOM_MODE, mode, 0) if on is not None else int(DENIED)


def _arm(request: Request, actions: Actions) -> int:
    arm = request.whole(1, 0, 1)
    if arm is None:
        return int(DENIED)
    return actions.arm(request) if arm else actions.disarm(request)


COMMANDS: dict[int, Callable[[Request, Actions], int]] = {
    mavlink.MAV_CMD_REQUEST_MESSAGE: _request_message,
    mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: _request_capabilities,
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: _set_interval,
    mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: _get_interval,
    mavlink.MAV_CMD_PREFLIGHT_STORAGE: _storage,
    mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN: _reboot,
    mavlink.MAV_CMD_DO_SET_MODE: _set_mode,
    mavlink.MAV_CMD_NAV_GUIDED_ENABLE: _guided,
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: _arm,
}
