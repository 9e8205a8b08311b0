"""A policy that came over the line flies as the same one compiled in: DShot for DShot."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.flash.link.client import Client
from neuroflight.flash.policy import swap as swaps
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.idle_board import IdleBoard
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from tests.conftest import BUILD, build_beside
from tests.flash.policy.policies import another_policy

Flown = Callable[..., Trace]
FLIGHT = Scenario(
    "swapped", tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(6))
)


@pytest.fixture(scope="module")
def other(shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A policy of the shipped one's architecture."""
    return another_policy(shipped_policy, tmp_path_factory.mktemp("policy") / "other.onnx", seed=7)


def swapped_flash(image: Path, policy: Path) -> bytes:
    """The flash of a board with that image, whose policy was swapped over its UART."""
    idle = IdleBoard(image.with_suffix(".bin").read_bytes(), elf=image)
    idle.boot()
    candidate, client = candidate_of(policy), idle.client()
    board = swaps.Board(
        lambda: client._transport,
        lambda: idle.board.cycle / TIME_HZ,
        lambda seconds: idle.run_to(idle.board.cycle + round(seconds * TIME_HZ)),
    )
    client, place = swaps.write(client, candidate, board, lambda done, total: None)
    assert isinstance(swaps.start(client, candidate, place, board), Client)
    flash = idle.flash()
    idle.close()
    return flash


@pytest.mark.slow
def test_dshot_is_the_compiled_in_ones_when_the_policy_came_over_the_line(
    board_image: Path, reference_library: Path, other: Path, flown: Flown, tmp_path: Path
) -> None:
    image = tmp_path / "neuroflight.bin"
    image.write_bytes(swapped_flash(board_image, other))
    shutil.copy(board_image, image.with_suffix(".elf"))
    build_beside("HOST", other, BUILD / "swapped", pid_table(load_aircraft("nf1")))
    on_board = flown(EmulatedPort(image), FLIGHT)
    compiled_in = flown(ReferencePort(BUILD / "swapped" / "HOST" / "libneuroflight.so"), FLIGHT)
    before = flown(ReferencePort(reference_library), FLIGHT)
    assert (on_board.dshot > 0).all()
    assert on_board.same(compiled_in)
    assert not on_board.same(before), "the shipped policy flies otherwise"
