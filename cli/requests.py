"""Typed requests: a command as a frozen dataclass, that gives its parser, range checks, printed line.

    @dataclass(frozen=True, kw_only=True)
    class Verify(Request):
        policy: Annotated[Path, Argument("POLICY.onnx", "to verify")]
        count: Annotated[int, Option("N", "observations", low=1, high=1_000_000)] = 1000
        json: Json = False

        def run(self) -> int: ...

The type of a field says how its text is read: bool (a flag), int, float, str, Path, each `| None` where the
default is None, and tuple[T, ...] for several. A field without a default has to be given. `cli/tree.py` names
the class; `run` returns the exit code. Options that commands share are types of `cli/options.py`, groups of
them base classes.
"""

from __future__ import annotations

import argparse
import math
import types
import typing
from collections.abc import Callable, Sequence
from dataclasses import MISSING, Field, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from neuroflight.cli.output import check_output, command_line, plain
from neuroflight.toolchain.errors import NeuroflightError


@dataclass(frozen=True, eq=False)
class Either:
    """A choice between options: those that name it exclude each other."""

    required: bool = False  # one of them has to be given


@dataclass(frozen=True)
class Option:
    """The properties of an option that its field does not tell."""

    metavar: str | tuple[str, ...] | None
    help: str | None  # None: hidden, a word of before without a meaning
    low: float | None = None  # the least value; None: none
    high: float | None = None
    above: float | None = None  # that a value has to exceed, in place of `low`
    unit: str = ""  # of both, for people
    choices: tuple[str | int, ...] = ()
    name: str = ""  # where it is not the field's: "--from"
    old: tuple[str, ...] = ()  # spellings of before, hidden: "--contenders"
    old_choices: tuple[tuple[str, str], ...] = ()  # values of before, hidden, and what they are now
    number: int | str | None = None  # of values, as argparse's nargs, where it is not the type's: 3, "*", "?"
    bare: Any = None  # the value of the option alone, where `number` is "?"
    most: int | None = None  # values
    once: bool = False  # several values, but each behind an option of its own: --set A=1 --set B=2
    recorded: bool = True  # stands in the printed command: False for what does not change the result
    usual: bool = False  # does not stand there where it is the default
    find: Callable[[], str] | None = None  # the value where the user gives none
    either: Either | None = None
    section: str = ""  # heading in --help under which it stands
    suffix: str = ""  # of a file that is written; that it can be is checked before the work


@dataclass(frozen=True)
class Argument(Option):
    """The properties of a positional argument that its field does not tell."""


@dataclass(frozen=True, kw_only=True)
class Request:
    """The options that a user gives a command."""

    words: ClassVar[str] = ""  # of the command, from `cli/tree.py` once its parser is made
    more: ClassVar[str] = ""  # of --help, behind the command's sentence

    def run(self) -> int:
        """Carry the request out. Returns the exit code; raises NeuroflightError."""
        raise NotImplementedError

    @classmethod
    def add_arguments(cls, parser: argparse.ArgumentParser) -> None:
        """Declare every field."""
        places: dict[str | Either, argparse._ActionsContainer] = {"": parser}
        for field, kind, option in _declared(cls):
            section, either = option.section, option.either
            if section not in places:
                places[section] = parser.add_argument_group(section)
            if either is not None and either not in places:
                places[either] = places[section].add_mutually_exclusive_group(required=either.required)
            _add(places[either or section], field, kind, option)

    @classmethod
    def chosen(cls, words: Sequence[str]) -> type[Request]:
        """Return the request that these words of the command line are for, where a command has several."""
        return cls

    @classmethod
    def parsed(cls, args: argparse.Namespace) -> Self:
        """Return the request that was parsed. Raises NeuroflightError for a value outside its range."""
        given = {}
        for field, kind, option in _declared(cls):
            value = getattr(args, field.name)
            if value is None and option.find is not None:
                value = option.find()
            if isinstance(value, list):
                value = tuple(value)
            value = dict(option.old_choices).get(value, value) if option.old_choices else value
            flag = _flag(field, option)
            if kind.many and value is not None and option.most is not None and len(value) > option.most:
                raise NeuroflightError(f"{flag}: {len(value)} values, expected 1 to {option.most}")
            for one in value if kind.many and value is not None else (value,):
                _check(flag, one, option)
            if option.suffix:
                check_output(value, option.suffix)
            given[field.name] = value
        return cls(**given)

    def given(self, *names: str) -> list[str]:
        """Return the flags of those of the fields that do not have their default."""
        return [
            _flag(field, option)
            for field, _, option in _declared(type(self))
            if field.name in names and getattr(self, field.name) != field.default
        ]

    def refuse(self, *names: str, because: str) -> None:
        """Raise NeuroflightError where one of the fields does not have its default."""
        for flag in self.given(*names):
            raise NeuroflightError(f"{flag}: {because}")

    @property
    def recorded(self) -> dict[str, Any]:
        """Fields that decide the result, as JSON data."""
        return {
            field.name: _plain(getattr(self, field.name))
            for field, _, option in _declared(type(self))
            if option.recorded
        }

    @property
    def command(self) -> str:
        """The line that repeats the result, with every option that affects it."""
        words, options = [], {}
        for field, kind, option in _declared(type(self)):
            value = getattr(self, field.name)
            if not option.recorded or value is None or value == () == field.default:
                continue
            if option.usual and value == field.default:
                continue
            if isinstance(option, Argument):
                words += [str(one) for one in (value if kind.many else (value,))]
            elif option.once:
                words += [word for one in value for word in (_flag(field, option), str(one))]
            else:
                options[_flag(field, option).removeprefix("--")] = value
        return command_line(self.words, *words, **options)


@dataclass(frozen=True)
class _Kind:
    """The way in which the text of a field is read."""

    read: type
    many: bool


def _declared(cls: type[Request]) -> list[tuple[Field[Any], _Kind, Option]]:
    """Return each field with its type and its option, in the order of --help."""
    found = []
    hints = typing.get_type_hints(cls, include_extras=True)
    for field in fields(cls):
        hint, *notes = typing.get_args(hints[field.name])
        option = next(note for note in notes if isinstance(note, Option))
        if typing.get_origin(hint) is Literal:
            option, hint = replace(option, choices=typing.get_args(hint)), str
        found.append((field, _kind(hint), option))
    return found


def _kind(hint: Any) -> _Kind:  # noqa: ANN401 - a type, or what stands for several
    if typing.get_origin(hint) in (types.UnionType, typing.Union):
        (hint,) = (each for each in typing.get_args(hint) if each is not types.NoneType)
    if typing.get_origin(hint) is tuple:
        return _Kind(typing.get_args(hint)[0], many=True)
    return _Kind(hint, many=False)


def _flag(field: Field[Any], option: Option) -> str:
    if isinstance(option, Argument):
        return option.metavar if isinstance(option.metavar, str) else field.name
    return option.name or f"--{field.name.replace('_', '-')}"


def _add(place: argparse._ActionsContainer, field: Field[Any], kind: _Kind, option: Option) -> None:
    default: Any = field.default
    required = default is MISSING and option.find is None
    words: dict[str, Any] = {"help": argparse.SUPPRESS if option.help is None else option.help}
    if kind.read is bool:
        words |= {"action": "store_true"}
    else:
        words |= {"type": kind.read, "metavar": option.metavar}
        words["default"] = None if default is MISSING else default
        if option.choices:
            words |= {"choices": (*option.choices, *dict(option.old_choices))}
            words["metavar"] = option.metavar or f"{{{','.join(map(str, option.choices))}}}"
    if isinstance(option, Argument):
        if kind.many:
            words["nargs"] = option.number or ("+" if required else "*")
        elif not required:
            words["nargs"] = "?"
        action = place.add_argument(field.name, **words)
    else:
        if kind.many:
            words["default"] = None if required or default is None else list(default)
            words |= {"action": "append"} if option.once else {"nargs": option.number or "+"}
            if not option.once and not words["default"] and option.number is None:
                words["action"] = "extend"
        elif option.number is not None:
            words |= {"nargs": option.number, "const": option.bare}
        flag = _flag(field, option)
        if required and option.old:  # one of its spellings is given
            place, required = place.add_mutually_exclusive_group(required=True), False
        action = place.add_argument(flag, dest=field.name, required=required, **words)
        for old in option.old:
            words["default"] = argparse.SUPPRESS
            place.add_argument(old, dest=field.name, **{**words, "help": argparse.SUPPRESS})
    action.old_choices = tuple(dict(option.old_choices))  # type: ignore[attr-defined]


def _check(flag: str, value: Any, option: Option) -> None:  # noqa: ANN401 - of any field
    """Raise NeuroflightError for a number outside its range, as NaN is."""
    low, high, above = option.low, option.high, option.above
    if value is None or low is high is above is None:
        return
    greater = value >= low if low is not None else value > above if above is not None else True
    if greater and (high is None or value <= high) and math.isfinite(value):
        return
    unit = f" {option.unit}" if option.unit else ""
    if above is not None:
        span = f"above {_number(above)}{'' if high is None else f', at most {_number(high)}'}{unit}"
    elif low is None or high is None:
        span = f"{_number(low)}{unit} or more" if low is not None else f"{_number(high)}{unit} or less"
    else:
        span = f"{_number(low)} to {_number(high)}{unit}"
    raise NeuroflightError(f"{flag} {_number(value)}, expected {span}")


def _number(value: float | None) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:  # noqa: ANN401 - of any field
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, Path) else plain(value)
