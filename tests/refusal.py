"""What every command does that refuses: it says one line and gives nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from neuroflight.cli.main import main


def refused(capsys: pytest.CaptureFixture[str], words: Sequence[str | Path]) -> str:
    """Run a command that must not succeed; return its one line."""
    assert main(list(map(str, words))) == 1
    told = capsys.readouterr()
    assert told.err.startswith("neuroflight: ") and told.err.count("\n") == 1
    assert told.out == ""
    return told.err
