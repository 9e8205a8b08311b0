"""`any`, specialized for an aircraft: the same bits wherever it flies, and a slot for what replaces it."""

from __future__ import annotations

import re
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from neuroflight.cli.board.policy import candidate_of
from neuroflight.flash.link.records import safety
from neuroflight.flash.policy import swap as swaps
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.serial.idle_board import IdleBoard, configured
from neuroflight.sim.control.any_policy import own_policy
from neuroflight.sim.control.pid_table import pid_table
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import ArmingReason, Msp
from neuroflight.toolchain.policy.model import parse_policy
from tests.conftest import build_kept

Flown = Callable[..., Trace]
FLIGHT = Scenario(
    "any", tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(6))
)
BAUD, SWAP_S = 921_600, 2.5  # the restart included


@dataclass(frozen=True)
class Built:
    """Image and library around one policy."""

    image: Path
    library: Path


def built(aircraft: Aircraft, name: str) -> Built:
    policy, pid = own_policy("any", aircraft), pid_table(aircraft)
    image = build_kept("MATEKF722", policy, f"any-{name}", pid) / "neuroflight.bin"
    return Built(image, build_kept("HOST", policy, f"any-{name}", pid) / "libneuroflight.so")


@pytest.mark.parametrize("name", ["nf1", "iris"])
def test_what_is_made_of_any_has_one_architecture_and_asks_for_a_check_of_the_motors(name: str) -> None:
    own = compile_policy(parse_policy(own_policy("any", load_aircraft(name))))
    other = compile_policy(parse_policy(own_policy("any", load_aircraft("nf1"))))
    assert own.plan.architecture_hash == other.plan.architecture_hash
    assert re.search(r"#define POLICY_MOTOR_CHECK 1\b", own.emission.header)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["nf1", "iris"])
def test_it_flies_the_same_dshot_on_board_and_library(name: str, flown: Flown) -> None:
    made = built(load_aircraft(name), name)
    on_board = flown(EmulatedPort(made.image), FLIGHT, aircraft=name)
    assert (on_board.dshot > 0).all()
    assert on_board.same(flown(ReferencePort(made.library), FLIGHT, aircraft=name))


@pytest.mark.slow
def test_another_policy_of_the_aircraft_takes_its_place_within_two_seconds(tmp_path: Path) -> None:
    nf1 = load_aircraft("nf1")
    made = built(nf1, "nf1")
    elf = made.image.with_suffix(".elf")
    flash = configured(made.image.read_bytes(), elf, {"msp_baud": BAUD})
    refined = tmp_path / "policy.onnx"
    refined.write_bytes(own_policy("any", replace(nf1, propulsion=replace(nf1.propulsion, delay=0.005))))
    with closing(IdleBoard(flash, elf=elf)) as idle:
        idle.boot()
        candidate, client = candidate_of(refined), idle.client(BAUD)
        board = swaps.Board(
            lambda: client._transport,
            lambda: idle.board.cycle / TIME_HZ,
            lambda seconds: idle.run_to(idle.board.cycle + round(seconds * TIME_HZ)),
        )
        begin = idle.board.cycle
        client, place = swaps.write(client, candidate, board, lambda done, total: None)
        swaps.start(client, candidate, place, board)
        assert (idle.board.cycle - begin) / TIME_HZ < SWAP_S
        told = safety(client.request(Msp.SAFETY))
        assert told.arming_flags >> ArmingReason.MOTORS_UNCHECKED & 1, "nobody has checked the motors"
        Settings(client).change({"motors_checked": float(told.motor_key or 0)})
        idle.run_to(idle.board.cycle + TIME_HZ // 4)
        assert not safety(client.request(Msp.SAFETY)).arming_flags >> ArmingReason.MOTORS_UNCHECKED & 1
