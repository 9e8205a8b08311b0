"""Builds frozen dataclasses from TOML or JSON data, by the types of their fields.

Nothing here depends on a particular task, reward or algorithm: the fields of a new one suffice.
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, is_dataclass
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.strict_toml import TEXT_MAX, shown
from neuroflight.training.config.algorithms import ALGORITHMS, Algorithm
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS, Reward
from neuroflight.training.tasks.task import Task

Kind = TypeVar("Kind")
NONE = "none"  # how TOML, which has no null, says None
NAME = "name"  # the key that says which task, reward or algorithm a table describes
ITEMS_MAX = 1000  # of a list
PLAIN: dict[type, str] = {
    float: "a finite number",
    int: "a whole number",
    bool: "true or false",
    str: f"one line of at most {TEXT_MAX} characters",
}
REGISTRIES: dict[object, Mapping[str, type[Any]]] = {Task: TASKS, Reward: REWARDS, Algorithm: ALGORITHMS}


@dataclass(frozen=True)
class ConfigReader:
    """A reader of one configuration's tables; its errors name the key."""

    where: str  # the file or recipe
    overrides: Mapping[str, str]  # key: the override that set it

    def table(self, kind: type[Kind], values: object, path: str = "") -> Kind:
        """Build the dataclass `kind` from the values of a table; missing ones are the defaults."""
        if not isinstance(values, Mapping):
            raise self.error(path, f"got {shown(values)}, expected a table")
        hints, given = get_type_hints(kind), {}
        known = {field.name: field for field in dataclasses.fields(kind) if field.init}  # type: ignore[arg-type]
        for key, value in values.items():
            if key not in known:
                raise self.error(_joined(path, key), f"unknown key; {nearest(key, tuple(known))}")
            default = _default(known[key])
            given[key] = self._value(hints[key], value, _joined(path, key), default)
        for name, field in known.items():
            if name not in given and _default(field) is MISSING:
                raise self.error(_joined(path, name), "missing")
        try:
            return kind(**given)
        except (TrainingError, ValueError) as error:  # ValueError: of a user's class
            raise self.error(path, str(error)) from None

    def field(self, kind: type[Any], name: str, value: object) -> object:
        """Return one field of the dataclass `kind`; a value that is an object already is taken as it is."""
        if is_dataclass(value) and not isinstance(value, type):
            return value
        return self._value(get_type_hints(kind)[name], value, name, getattr(kind(), name))

    def error(self, path: str, message: str) -> TrainingError:
        """Return the error about the key at `path`, for the caller to raise."""
        origin, parts = self.where, path.partition("[")[0].split(".")
        for depth in range(len(parts), 0, -1):
            override = self.overrides.get(".".join(parts[:depth]))
            if override is not None:
                origin = f"override {shown(override)}"
                break
        key = path if path.isprintable() else shown(path)
        return TrainingError(f"{origin}: {key}: {message}" if path else f"{origin}: {message}")

    def _value(self, kind: Any, value: object, path: str, default: object = MISSING) -> object:  # noqa: ANN401
        if kind in REGISTRIES:
            return self.named(REGISTRIES[kind], value, path, default)
        if is_dataclass(kind):
            return self.table(kind, value, path)  # type: ignore[arg-type]
        origin, inside = get_origin(kind), get_args(kind)
        if origin in (Union, UnionType) and NoneType in inside:
            if value is None or value == NONE:
                return None
            [kind] = (item for item in inside if item is not NoneType)
            return self._value(kind, value, path)
        if origin is Literal:
            if value not in inside:
                raise self.error(path, f"got {shown(value)}, expected one of: {', '.join(map(str, inside))}")
            return value
        if origin is tuple:
            return self._tuple(inside, value, path)
        return self._plain(kind, value, path)

    def named(
        self, registry: Mapping[str, type[Any]], value: object, path: str, default: object = None
    ) -> Any:  # noqa: ANN401 - what the registry holds
        """Build the registered dataclass that a table describes by its key `name`, or a name alone.

        default: returns the kind of a table without a name.
        """
        values = {NAME: value} if isinstance(value, str) else value
        if not isinstance(values, Mapping):
            raise self.error(path, f"got {shown(value)}, expected a table with a name, or the name alone")
        name = values.get(NAME, getattr(default, NAME, None))
        if not isinstance(name, str) or name not in registry:
            key = _joined(path, NAME) if NAME in values else path
            own = "" if registry is ALGORITHMS else "; one of a file of yours needs its --plugin FILE.py"
            raise self.error(key, f"got {shown(name)}, expected one of: {', '.join(registry)}{own}")
        return self.table(registry[name], {key: item for key, item in values.items() if key != NAME}, path)

    def _tuple(self, inside: tuple[Any, ...], value: object, path: str) -> tuple[object, ...]:
        some = Ellipsis in inside
        if not isinstance(value, list | tuple):
            size = "" if some else f" of {len(inside)}"
            raise self.error(path, f"got {shown(value)}, expected a list{size}")
        if len(value) > ITEMS_MAX:
            raise self.error(path, f"got {len(value)} items, expected at most {ITEMS_MAX}")
        kinds = (inside[0],) * len(value) if some else inside
        if len(value) != len(kinds):
            raise self.error(path, f"got {shown(value)}, expected a list of {len(kinds)}")
        items = enumerate(zip(kinds, value, strict=True))
        return tuple(self._value(kind, item, f"{path}[{i}]") for i, (kind, item) in items)

    def _plain(self, kind: type, value: object, path: str) -> object:
        if kind not in PLAIN:
            known = ", ".join(each.__name__ for each in PLAIN)
            raise self.error(path, f"its field is of type {kind}, expected {known} or a tuple of them")
        number = _number(value)
        fits = {
            bool: isinstance(value, bool),
            int: number is not None and isinstance(value, int),
            float: number is not None and math.isfinite(number),
            str: isinstance(value, str) and len(value) <= TEXT_MAX and (value.isprintable() or not value),
        }
        if not fits[kind]:
            raise self.error(path, f"got {shown(value)}, expected {PLAIN[kind]}")
        return number if kind is float else value


def _default(field: dataclasses.Field[Any]) -> object:
    if field.default_factory is not MISSING:
        return field.default_factory()
    return field.default


def _number(value: object) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def _joined(path: str, key: object) -> str:
    return f"{path}.{key}" if path else str(key)


def nearest(key: object, known: Sequence[str]) -> str:
    """Suggest the known keys similar to a wrong one, or list all of them."""
    near = difflib.get_close_matches(str(key)[:TEXT_MAX], known)
    return f"nearest: {', '.join(near)}" if near else f"known here: {', '.join(known)}"
