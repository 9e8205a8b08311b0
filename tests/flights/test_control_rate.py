"""A policy at 2 kHz, built by construction: it flies alike on the board and on the computer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.debug.control_timing import missed_deadlines
from neuroflight.sim.board.debug.variables import read_variables
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.scenario import Scenario, Segment, load_scenario
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.contract import FallbackCause, Msp, Task
from tests.conftest import build_kept
from tests.modelled_policy import FLYING_GAIN, GAIN, SPREAD, modelled_policy

CONTROL_RATE_HZ = 2000
MAE_DEG_S = 8.0  # of a P controller on a pulse; the aircraft left alone is off by some 20
SHORT = Scenario("short", (Segment(0.05), Segment(0.2, (120.0, -90.0, 60.0)), Segment(0.1)))
Flown = Callable[..., Trace]


class KeptPort(ReferencePort):
    """The firmware as a library that is asked before it closes."""

    fallback = FallbackCause.NONE

    def close(self) -> None:
        """See FirmwarePort."""
        self.fallback = records.safety(Client(self.reference).request(Msp.SAFETY)).fallback_cause
        super().close()


class KeptBoard(EmulatedPort):
    """The emulated board that is asked before it closes."""

    fallback, missed, runs = FallbackCause.NONE, -1, 0

    def __init__(self, image: Path) -> None:
        """See EmulatedPort."""
        self.elf = image.with_suffix(".elf")
        super().__init__(image)

    def close(self) -> None:
        """See FirmwarePort."""
        elf = self.elf
        cause, stats = read_variables(elf, "firmware.status.fallback_cause", "stats")
        memory = self.board.engine.memory
        self.fallback = FallbackCause(int(np.frombuffer(memory(cause.address, cause.size), cause.dtype)[0]))
        self.runs = int(
            np.frombuffer(memory(stats.address, stats.size), stats.dtype.base)[Task.CONTROL]["runs"]
        )
        self.missed = missed_deadlines(self.board, elf)
        super().close()


@pytest.fixture(scope="module")
def builds() -> Callable[[str, str], Path]:
    """The folder of a build around a 2 kHz policy, which "flies" or only "computes"."""

    def built(target: str, which: str) -> Path:
        gain, spread = (FLYING_GAIN, 0.0) if which == "flies" else (GAIN, SPREAD)
        policy = modelled_policy(control_rate_hz=CONTROL_RATE_HZ, gain=gain, spread=spread)
        return build_kept(target, policy, f"2khz-{which}", pid_table(load_aircraft("nf1")))

    return built


def mae_deg_s(trace: Trace) -> float:
    """Mean absolute error against the true rate, of all axes."""
    return float(np.rad2deg(np.abs(trace.setpoint - trace.rate)).mean())


def test_the_board_flies_a_2_khz_policy_like_the_computer_in_time_and_to_the_end(
    builds: Callable[[str, str], Path], flown: Flown
) -> None:
    board = KeptBoard(builds("MATEKF722", "flies") / "neuroflight.bin")
    on_board = flown(board, SHORT)
    library, longer = (KeptPort(builds("HOST", "flies") / "libneuroflight.so") for _ in range(2))
    assert board.control_rate_hz == library.control_rate_hz == CONTROL_RATE_HZ
    assert on_board.control_rate_hz == CONTROL_RATE_HZ
    assert len(on_board.t) >= round(SHORT.duration_s * CONTROL_RATE_HZ)
    assert flown(library, SHORT).same(on_board)
    whole = flown(longer, load_scenario("pulse", 1))
    assert {board.fallback, library.fallback, longer.fallback} == {FallbackCause.NONE}
    for trace in (on_board, whole):
        assert (trace.dshot > 0).all(), "armed all the time"
    assert mae_deg_s(whole) < MAE_DEG_S
    assert board.runs > len(on_board.t)
    assert board.missed == 0


@pytest.mark.slow
def test_a_policy_that_leaves_errors_unanswered_is_told_at_2_khz_too(
    builds: Callable[[str, str], Path], flown: Flown
) -> None:
    library = KeptPort(builds("HOST", "computes") / "libneuroflight.so")
    trace = flown(library, load_scenario("pulse", 1))
    assert library.fallback is FallbackCause.WRONG_WAY
    assert (trace.dshot > 0).all(), "the PID flies on"
