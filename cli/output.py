"""Functions for commands that write files: early checks that they can be written; the command as a text."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.files import check_writable


def check_output(path: Path | None, suffix: str) -> None:
    """Reject a file that could not be written after the work."""
    if path is None:
        return
    if "\0" in str(path):
        raise NeuroflightError(f"{str(path)!r}: no file can have that name; choose another")
    if path.suffix != suffix:
        raise NeuroflightError(f"{path}: expected a name that ends in {suffix}")
    if path.is_dir():
        raise NeuroflightError(f"{path}: is a directory, expected a file to write")
    parent = next(folder for folder in path.absolute().parents if folder.exists())
    if not parent.is_dir():
        raise NeuroflightError(f"{path}: {parent} is no directory; choose another place")
    if not os.access(parent, os.W_OK):
        raise NeuroflightError(f"{path}: may not be written in {parent}; choose another place")
    check_writable(path)


def check_folder(path: Path | None, option: str) -> None:
    """Reject a folder for outputs in which none could be written after the work."""
    if path is None:
        return
    if path.exists() and not path.is_dir():
        raise NeuroflightError(f"{option} {path} is no folder; give the name of one, new or old")
    try:
        check_writable(path / "output")
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def command_line(command: str, /, *words: str, **options: object) -> str:
    """Return the command that repeats a result, for a shell: no options that are None or False."""
    line = ["neuroflight", *command.split(), *(_short(word) for word in words)]
    for name, value in options.items():
        if value is None or value is False:
            continue
        line.append(f"--{name.replace('_', '-')}")
        if value is not True:
            values = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
            line += [f"{item:g}" if isinstance(item, float) else _short(str(item)) for item in values]
    return shlex.join(line)


def plain(value: object) -> object:
    """Return dictionaries of arrays as JSON data."""
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return value.tolist() if hasattr(value, "tolist") else value


def _short(word: str) -> str:
    return Path(word).name if Path(word).is_absolute() else word
