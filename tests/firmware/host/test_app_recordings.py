"""The Betaflight app's visits as recorded: tabs saved and read back, motors turned, settings restored."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.firmware.host.recordings import replay

RECORDINGS = sorted((Path(__file__).parent / "recorded").glob("*.txt"))


@pytest.mark.parametrize("recording", RECORDINGS, ids=lambda path: path.stem)
def test_the_app_finds_and_keeps_what_it_did_when_its_visit_is_replayed(
    start: Callable[..., Any], host_program: Path, tmp_path: Path, recording: Path
) -> None:
    for number, line in enumerate(replay(recording, start, host_program.parent, tmp_path / "flash.bin"), 1):
        print(f"{recording.name}:{number}: {line}")  # the last one that pytest shows is the one that failed
