"""The parameter protocol: list, read, set. One value is told at a time: nothing else waits for long."""

from __future__ import annotations

from collections import deque
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from flash.client import NoAnswerError
from flash.mavlink.firmware import Firmware
from flash.mavlink.ground import Ground
from flash.mavlink.parameters import Parameter, decode_value, parameter_value
from flash.setting_text import RATES, STYLE
from toolchain.errors import LinkError

MESSAGES = frozenset({"PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET"})
BY_NAME = -1  # as the index of PARAM_REQUEST_READ


class ParameterServer:
    """Answers for one firmware."""

    def __init__(self, firmware: Firmware, ground: Ground) -> None:
        self._firmware, self._ground = firmware, ground
        self._queue: deque[Parameter] = deque()

    @property
    def busy(self) -> bool:
        """Whether values are to be told."""
        return bool(self._queue)

    def tell_one(self) -> None:
        """Tell the next value. Raises LinkError; it is told again then."""
        parameter = self._queue[0]
        value = self._firmware.value(parameter)
        self._queue.popleft()
        self._ground.broadcast(parameter_value(parameter, value, len(self._firmware.parameters)))

    def tell_all(self) -> None:
        """Tell every value."""
        self._queue = deque(self._firmware.parameters)

    def handle(self, message: Any) -> None:  # noqa: ANN401 - pymavlink's are untyped
        """One of MESSAGES. Raises NoAnswerError, LinkError once the line is gone."""
        if message.get_type() == "PARAM_REQUEST_LIST":
            self.tell_all()
            return
        parameter = self._named(message)
        if parameter is None:
            return
        if message.get_type() == "PARAM_SET":
            self._set(parameter, message.param_value, message.param_type)
        self._tell_first(parameter)

    def _named(self, message: Any) -> Parameter | None:  # noqa: ANN401
        """The parameter that is meant, None where there is none."""
        index = getattr(message, "param_index", BY_NAME)
        if index != BY_NAME:
            known = self._firmware.parameters
            return known[index] if 0 <= index < len(known) else None
        found = self._firmware.by_name.get(message.param_id)
        if found is None:
            self._ground.complain(f"No parameter {message.param_id!a}")
        return found

    def _tell_first(self, parameter: Parameter) -> None:
        self._queue = deque([parameter, *(one for one in self._queue if one is not parameter)])

    def _set(self, parameter: Parameter, field: float, told: int) -> None:
        """Set it, or say why not; what it is then is told in either case."""
        try:
            if self._firmware.armed:
                raise ValueError("the motors are armed; disarm first")
            self._firmware.settings.set(parameter.setting, decode_value(parameter, field, told))
        except NoAnswerError:
            raise
        except (ValueError, LinkError) as error:
            why = str(error).removeprefix(f"setting {parameter.setting} ")
            self._ground.tell(mavlink.MAV_SEVERITY_WARNING, f"{parameter.name}: {why}")
            return
        if parameter.setting == STYLE:  # which sets all rates
            self._queue += [one for one in self._firmware.parameters if one.setting in RATES]
