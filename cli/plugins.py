"""`--plugin FILE.py`: rewards and tasks of a user's own file, for every command that names one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.requests import Option, Request

if TYPE_CHECKING:
    from neuroflight.training.plugins import Plugin


@dataclass(frozen=True, kw_only=True)
class WithPlugins(Request):
    """A request that knows rewards and tasks of a user's own."""

    plugin: Annotated[
        tuple[Path, ...],
        Option(
            "FILE.py",
            "run this file of yours first; the rewards and tasks that it registers are known by name then; "
            "may be repeated",
            once=True,
        ),
    ] = ()

    def load_named(self) -> tuple[Plugin, ...]:
        """Run the files. Raises TrainingError on one that cannot be run or registers nothing."""
        if not self.plugin:
            return ()
        from neuroflight.training.plugins import load_plugins

        return load_plugins(self.plugin)
