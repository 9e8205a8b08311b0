"""The files that the words of a command name, with a digest of each, by which a change is noticed."""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import json
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from neuroflight.sim.aircraft.model import FOLDER as AIRCRAFT
from neuroflight.sim.aircraft.model import over_base
from neuroflight.toolchain.errors import AircraftError
from neuroflight.training.config.config_file import FOLDER as RECIPES

DIGITS = 16  # of a SHA-256
SHIPPED = {"--config": RECIPES, "--aircraft": AIRCRAFT}  # by option: where the files are that it names


def inputs(words: Sequence[str], root: Path) -> dict[str, str]:
    """Return a digest of each file that words name, by its path in `root`; recipes and aircraft
    that come with the project are such files too. Comments in TOML do not count, an aircraft's `base` does.

    Files that an input names in its turn (a mesh of an aircraft) and the program itself are not looked at.
    """
    found: dict[str, str] = {}
    for option, word in itertools.pairwise(["", *words]):
        shipped = [SHIPPED[option] / f"{word}.toml"] if option in SHIPPED else []
        # Unlike Path's, os.path's isfile is False for a word that is too long for a name.
        path = next((each for each in (*shipped, root / word) if os.path.isfile(each)), None)  # noqa: PTH113
        if path is not None:
            found[word] = _digest(path)
    return found


def changed(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Return the name of an input that has changed; empty if none has."""
    return next((name for name in {**before, **now} if before.get(name) != now.get(name)), "")


def _digest(path: Path) -> str:
    data = path.read_bytes()
    if path.suffix == ".toml":
        with contextlib.suppress(ValueError, AircraftError):  # a damaged file: the command raises the error
            document = over_base(tomllib.loads(data.decode()), str(path))
            data = json.dumps(document, sort_keys=True, default=str).encode()
    return hashlib.sha256(data).hexdigest()[:DIGITS]
