"""Controllers of a user's own file, as he names them: FILE.py:CLASS, or FILE.py:CLASS:VALUES.toml.

The class is made for a number of aircraft that fly side by side, and stepped at its control rate; what may be
tuned of it are its `parameters`. docs/guides/own-modules.md has an example.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array32
from neuroflight.sim.control.controller import Controller
from neuroflight.toolchain.contract import CONTROL_RATES_HZ, Mix
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.policy.gyro_filters import NONE, GyroFilters
from neuroflight.toolchain.strict_toml import StrictTable, parse_toml
from neuroflight.training.plugins import blaming, real_array, users_class

PYTHON = ".py"
RATE_HZ, IDLE, IDLE_MAX = 1000, 0.0, 0.5  # where the class says nothing
VALUES_BYTES_MAX = 100_000
VALUE_MAX = 1e12
PARAMETERS_MAX = 100


@dataclass(frozen=True)
class Parameter:
    """A number of a controller that may be tuned."""

    start: float
    low: float
    high: float


@dataclass(frozen=True)
class UsersController:
    """A class of a user's file, and its attributes."""

    name: str  # as the user wrote it, without a file of values
    kind: type[Any]
    sha256: str  # of its file
    parameters: Mapping[str, Parameter]
    values: Mapping[str, float]  # of the parameters
    control_rate_hz: int
    idle: float
    mix: Mix
    gyro_filters: GyroFilters

    def build(self, aircraft: Aircraft, count: int, values: Mapping[str, float] | None = None) -> Controller:
        """Make one for `count` aircraft. values: of its parameters, None: its own."""
        chosen = self.values if values is None else values
        with blaming(self.name):
            made = self.kind(aircraft, count, self.control_rate_hz, **chosen)
        return _Checked(self.name, made, (count, aircraft.motor_count))


def is_users_controller(name: str) -> bool:
    """Return True if a controller's name is that of a user's file."""
    return f"{PYTHON}:" in name or name.endswith(PYTHON)


def users_label(name: str) -> str:
    """Return a short name for tables and plots."""
    whole, values = _split(name)
    path, _, kind = whole.rpartition(":")
    return ":".join([Path(path).stem, kind, *([values.stem] if values else [])])


def load_users_controller(name: str) -> UsersController:
    """Read the class called `name` and its values. Raises TrainingError, one line, on anything wrong."""
    whole, file = _split(name)
    kind, where, plugin = users_class(whole, ("reset", "step"))
    parameters = _parameters(where, getattr(kind, "parameters", {}))
    values = {each: parameter.start for each, parameter in parameters.items()}
    found = UsersController(
        name=where,
        kind=kind,
        sha256=plugin.sha256,
        parameters=parameters,
        values=values if file is None else values | _read_values(file, parameters),
        control_rate_hz=_said(where, kind, "control_rate_hz", RATE_HZ, CONTROL_RATES_HZ),
        idle=_idle(where, getattr(kind, "idle", IDLE)),
        mix=Mix.of(_said(where, kind, "mix", Mix.ATTITUDE_FIRST.text, [mix.text for mix in Mix])),
        gyro_filters=_gyro_filters(where, getattr(kind, "gyro_filter", NONE)),
    )
    return found


class _Checked:
    """A user's controller, whose outputs are checked and limited to 0..1."""

    def __init__(self, name: str, made: Any, shape: tuple[int, int]) -> None:  # noqa: ANN401 - of any class
        self._name, self._made, self._shape = name, made, shape

    def reset(self) -> None:
        """Begin an episode, see Controller."""
        with blaming(self._name):
            self._made.reset()

    def step(self, setpoint: Array32, gyro: Array32, throttle: Array32) -> Array32:
        """Return the checked outputs, see Controller."""
        with blaming(self._name):
            found = self._made.step(*map(_own, (setpoint, gyro, throttle)))
        outputs = real_array(f"{self._name}: step()", found, self._shape, "aircraft, motors")
        return outputs.clip(np.float32(0.0), np.float32(1.0))


def _own(array: Array32) -> Array32:
    """Return a copy that the user may change."""
    return np.array(array, np.float32)


def _split(name: str) -> tuple[str, Path | None]:
    """Return FILE.py:CLASS and the file of values of a name."""
    path, colon, rest = name.partition(f"{PYTHON}:")
    kind, values_colon, values = rest.partition(":")
    return f"{path}{colon}{kind}", Path(values) if values_colon else None


def _said(where: str, kind: type[Any], key: str, usual: Any, known: Any) -> Any:  # noqa: ANN401
    """Return an attribute of a class, one of `known`."""
    value = getattr(kind, key, usual)
    if not isinstance(value, type(usual)) or value not in known:
        raise TrainingError(f"{where}: {key} {value!r}, expected one of: {', '.join(map(str, known))}")
    return value


def _gyro_filters(where: str, value: Any) -> GyroFilters:  # noqa: ANN401 - as the class has it
    try:
        return GyroFilters.parse(str(value))
    except ValueError as error:
        raise TrainingError(f"{where}: {error}") from None


def _idle(where: str, value: Any) -> float:  # noqa: ANN401 - as the class has it
    if not _is_number(value) or not 0.0 <= value <= IDLE_MAX:
        raise TrainingError(f"{where}: idle {value!r}, expected 0 to {IDLE_MAX:g}")
    return float(value)


def _parameters(where: str, given: object) -> dict[str, Parameter]:
    """Return the parameters of a class, checked."""
    if not isinstance(given, Mapping) or len(given) > PARAMETERS_MAX:
        raise TrainingError(f'{where}: parameters, expected a dictionary such as {{"p": (0.02, 0.001, 1.0)}}')
    found = {}
    for name, numbers in given.items():
        fine = isinstance(numbers, tuple) and len(numbers) == 3 and all(map(_is_number, numbers))
        if (
            not isinstance(name, str)
            or not name.isidentifier()
            or not fine
            or not (
                -VALUE_MAX <= numbers[1] <= numbers[0] <= numbers[2] <= VALUE_MAX and numbers[1] < numbers[2]
            )
        ):
            raise TrainingError(
                f"{where}: parameters[{name!r}] {numbers!r}, expected (start, least, greatest) in order"
            )
        found[name] = Parameter(*map(float, numbers))
    return found


def _is_number(value: Any) -> bool:  # noqa: ANN401
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _read_values(path: Path, parameters: Mapping[str, Parameter]) -> dict[str, float]:
    """Read values of some parameters. Raises TrainingError naming one that is unknown or out of its range."""
    data = read_limited(path, str(path), VALUES_BYTES_MAX, TrainingError)
    table = StrictTable(parse_toml(data, str(path), TrainingError), str(path), TrainingError)
    known = [name for name in parameters if table.has(name)]
    values = {name: table.number(name, parameters[name].low, parameters[name].high) for name in known}
    table.finish()
    return values


def values_text(values: Mapping[str, float], comment: str) -> str:
    """Return the text of a file of values."""
    lines = [
        *(f"# {line}" for line in comment.splitlines()),
        *(f"{name} = {value!r}" for name, value in values.items()),
    ]
    return "\n".join(lines) + "\n"
