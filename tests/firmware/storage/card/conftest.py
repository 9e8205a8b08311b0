"""Cards in the firmware's slot."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.firmware.conftest import Core
from tests.firmware.storage.card.images import copy_image, make_image
from tests.firmware.storage.card.recorder import Recorder

LOGS = ("LOG00001.BBL", "LOG00002.BBL")
FILE_BYTES = 1 << 20
MakeRecorder = Callable[..., Recorder]


@pytest.fixture(scope="session")
def empty_card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An image with two empty files for logs, and another file."""
    path = tmp_path_factory.mktemp("card") / "empty.img"
    return make_image(path, {"README.TXT": b"a card\n", **dict.fromkeys(LOGS, FILE_BYTES)})


@pytest.fixture
def slot(scripted: Core, empty_card: Path, tmp_path: Path) -> Iterator[MakeRecorder]:
    """Puts a card into a new board's slot: a copy of the empty one, or the image that is given."""
    with contextlib.ExitStack() as stack:

        def fit(path: Path | None = None, **options: Any) -> Recorder:
            path = path or copy_image(empty_card, tmp_path / "card.img")
            recorder = Recorder(scripted, path, **options)
            stack.callback(recorder.close)
            return recorder

        yield fit
