"""What tests of recorded commands have in common."""

from pathlib import Path
from typing import Any

import pytest

from neuroflight.sim.recorded.commands import Commands
from neuroflight.sim.recorded.files import load_commands
from neuroflight.toolchain.errors import ScenarioError


def commands_of(folder: Path, content: str | bytes, name: str = "a.csv", **options: Any) -> Commands:
    """Load a recording of this content."""
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return load_commands(path, **options)


def refused(path: Path) -> str:
    """Return the one line with which a recording is refused."""
    with pytest.raises(ScenarioError) as error:
        load_commands(path)
    assert "\n" not in str(error.value)
    return str(error.value)
