"""Worlds are closed behind each test."""

from collections.abc import Iterator

import pytest

from neuroflight.sim.physics.bullet import pybullet

WORLDS_MAX = 64  # open at once in a test; pybullet numbers them from 0


@pytest.fixture(autouse=True)
def close_worlds() -> Iterator[None]:
    yield
    for client in filter(pybullet.isConnected, range(WORLDS_MAX)):
        pybullet.disconnect(client)
