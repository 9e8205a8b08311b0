"""A bench of firmware and background that tests of this folder share."""

from __future__ import annotations

import pytest

from tests.firmware.conftest import Core
from tests.firmware.joined.ground import Ground, State


@pytest.fixture(scope="module")
def ground(scripted: Core) -> Ground:
    """Return one bench for all tests of a module; each takes up a state."""
    return Ground(scripted)


@pytest.fixture(scope="module")
def ready(ground: Ground) -> State:
    """Return a state in which the arm switch would arm it."""
    ground.get_ready()
    return ground.keep()
