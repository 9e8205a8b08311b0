"""The parameter protocol: list, read, set. One value is told at a time: nothing else waits for long."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.link.client import NoAnswerError
from neuroflight.flash.mavlink.customs import Customs
from neuroflight.flash.mavlink.firmware import Firmware
from neuroflight.flash.mavlink.ground import Ground
from neuroflight.flash.mavlink.offboard import Source
from neuroflight.flash.mavlink.parameters import (
    Parameter,
    TypeMismatchError,
    came_in_bytes,
    decode_value,
    encode_value,
)
from neuroflight.flash.settings.text import RATES, STYLE
from neuroflight.toolchain.errors import LinkError

MESSAGES = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"})
BY_NAME = -1  # as the index of PARAM_REQUEST_READ
ANSWERS_MAX = 256  # waiting answers; further requests are dropped
UNKNOWN, OUT_OF_RANGE, FORBIDDEN = (
    mavlink.MAV_PARAM_ERROR_DOES_NOT_EXIST,
    mavlink.MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
    mavlink.MAV_PARAM_ERROR_PERMISSION_DENIED,
)
TYPE_MISMATCH = 7  # MAV_PARAM_ERROR_TYPE_MISMATCH, which pymavlink does not name


@dataclass(frozen=True)
class _Answer:
    """A requested value and who asked for it."""

    parameter: Parameter
    source: Source
    name: str  # as requested, because the client waits for this name
    in_bytes: bool


class ParameterServer:
    """A parameter server for one firmware."""

    def __init__(self, firmware: Firmware, ground: Ground, customs: Customs) -> None:
        self._firmware, self._ground, self._customs = firmware, ground, customs
        self._queue: deque[Parameter] = deque()  # to be sent to all peers
        self._answers: dict[_Answer, None] = {}  # in order of the requests; sent before `_queue`
        self._readers: dict[int, Source] = {}  # who asked last, by peer

    @property
    def busy(self) -> bool:
        """True if values are waiting to be sent."""
        return bool(self._answers or self._queue)

    def tell_one(self) -> None:
        """Send the next value. If LinkError is raised, the value is sent again later."""
        answer = next(iter(self._answers), None)
        parameter = answer.parameter if answer is not None else self._queue[0]
        value = self._firmware.value(parameter)
        if answer is not None:
            del self._answers[answer]
        else:
            self._queue.popleft()

        def message(peer: int) -> Any:  # noqa: ANN401 - pymavlink's are untyped
            if answer is not None and peer == answer.source[0]:
                name, in_bytes = answer.name, answer.in_bytes
            else:
                name, in_bytes = parameter.name, self._customs.reads_bytes(self._readers.get(peer))
            field, kind = encode_value(parameter, value, in_bytes=in_bytes)
            count = len(self._firmware.parameters)
            return mavlink.MAVLink_param_value_message(name.encode(), field, kind, count, parameter.index)

        self._ground.broadcast_each(message)

    def tell_all(self) -> None:
        """Send every value."""
        self._queue = deque(self._firmware.parameters)

    def handle(self, source: Source, message: Any) -> None:  # noqa: ANN401
        """Handle one of MESSAGES. Raises NoAnswerError, and LinkError once the line is lost."""
        self._readers[source[0]] = source
        self._customs.hear_parameters(source)
        if message.get_type() == "PARAM_REQUEST_LIST":
            self.tell_all()
            return
        index = getattr(message, "param_index", BY_NAME)
        parameter = self._named(message.param_id) if index == BY_NAME else self._numbered(index)
        if parameter is None:
            if index == BY_NAME:
                self._refuse(source, message.param_id, UNKNOWN)
                self._ground.complain(f"No parameter {message.param_id!a}")
            return
        in_bytes = self._customs.reads_bytes(source)
        if message.get_type() == "PARAM_SET":
            in_bytes |= self._set(source, parameter, message)
        name = message.param_id if index == BY_NAME else parameter.name
        if len(self._answers) < ANSWERS_MAX:
            self._answers[_Answer(parameter, source, name, in_bytes)] = None

    def _named(self, name: str) -> Parameter | None:
        return self._firmware.by_name.get(name.upper())

    def _numbered(self, index: int) -> Parameter | None:
        known = self._firmware.parameters
        return known[index] if 0 <= index < len(known) else None

    def _set(self, source: Source, parameter: Parameter, message: Any) -> bool:  # noqa: ANN401
        """Set a parameter or refuse it, then send its value. Returns whether the value came in bytes: then
        the answer does, too."""
        field, told = message.param_value, message.param_type
        error = OUT_OF_RANGE
        try:
            if self._firmware.armed:
                error = FORBIDDEN
                raise ValueError("the motors are armed; disarm first")
            self._firmware.settings.set(parameter.setting, decode_value(parameter, field, told))
            if parameter.setting == STYLE:  # which sets all rates
                known = (one for one in self._firmware.parameters if one.setting in RATES)
                self._queue += [one for one in known if one not in self._queue]
        except NoAnswerError:
            raise
        except (ValueError, LinkError) as why:
            if isinstance(why, TypeMismatchError):
                error = TYPE_MISMATCH
            words = str(why).removeprefix(f"setting {parameter.setting} ")
            self._refuse(source, message.param_id, error)
            self._ground.refuse(f"{parameter.name}: {words}")
        return parameter.whole and came_in_bytes(field, told)

    def _refuse(self, source: Source, name: str, error: int) -> None:
        """Send PARAM_ERROR, which newer clients wait for; older ones get the text."""
        _, system, component = source
        told = mavlink.MAVLink_param_error_message(system, component, name.encode(), BY_NAME, error)
        self._ground.answer(source, told)
