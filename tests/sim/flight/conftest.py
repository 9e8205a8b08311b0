"""Worlds are closed behind each test."""

from tests.sim.physics.conftest import close_worlds as close_worlds
