"""`board motors check` on the emulated board in a twin that is tied down."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.cli.board import motor_check
from neuroflight.cli.board.motors import Person
from neuroflight.cli.main import parse
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.records import safety
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.physics.world import Held
from neuroflight.sim.ports.emulator import EmulatedPort, PortSnapshot
from neuroflight.toolchain.contract import BOOT_GRACE_MS, MOTOR_TEST_MAGIC, ArmingReason, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flights.held_down import SOFT, Build, HeldBoard, built_twin

GYRO_RATE_HZ = 1000
READY_S = BOOT_GRACE_MS / 1000 + 0.5
RIGHT = "every motor is in its place, turns the right way and pushes up"
YAWED = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # the board's nose points right
Moment = tuple[EmulatedPort, PortSnapshot]
Make = Callable[..., HeldBoard]
Check = Callable[..., int]


@pytest.fixture(scope="module")
def moment(board_image: Path) -> Iterator[Moment]:
    """A board that has been calibrated."""
    nf1 = load_aircraft("nf1")
    with closing(EmulatedPort(board_image.with_suffix(".bin"), GYRO_RATE_HZ, {"motor_check": 1})) as port:
        with closing(built_twin(nf1, Build(), GYRO_RATE_HZ)) as twin:
            HeldBoard(port, twin, Build()).sleep(READY_S)
        yield port, port.save()


@pytest.fixture
def built(moment: Moment) -> Iterator[Make]:
    """Builds the aircraft around the board."""
    port, saved = moment
    twins = []

    def make(held: Held = SOFT, **how: object) -> HeldBoard:
        port.restore(saved)
        build = Build(**how)  # type: ignore[arg-type]
        twins.append(built_twin(load_aircraft("nf1"), build, GYRO_RATE_HZ, held))
        return HeldBoard(port, twins[-1], build)

    yield make
    for twin in twins:
        twin.close()


@pytest.fixture
def check(monkeypatch: pytest.MonkeyPatch) -> Check:
    """Carries the command out on a board, before somebody who does as asked."""

    def run(board: HeldBoard, *words: str, tied_down: bool = True) -> int:
        def ask(question: str) -> str:
            assert not board.fractions.any(), "a motor turns while somebody is asked"
            board.raise_nose(20.0 if "nose" in question else 0.0)
            return "\n"

        monkeypatch.setattr(motor_check, "connect", lambda port: board.client())
        told = [*words, *(["--tied-down"] if tied_down else [])]
        args = parse(["board", "motors", "check", *told, "--port", "tcp:held:1"])
        return int(args.request.parsed(args).carry_out(Person(ask, board.clock, board.sleep)))

    return run


def forbidden(client: Client) -> bool:
    """Arming waits for a check of the motors."""
    return bool(safety(client.request(Msp.SAFETY)).arming_flags >> ArmingReason.MOTORS_UNCHECKED & 1)


def test_a_right_aircraft_passes_and_the_board_keeps_it_until_its_motors_are_set_otherwise(
    built: Make, check: Check, capsys: pytest.CaptureFixture[str]
) -> None:
    board = built()
    assert check(board) == 0
    assert RIGHT in capsys.readouterr().out
    assert 0.09 < board.most.max() <= 0.151
    assert not board.fractions.any()
    settings = Settings(client := board.client())
    key = int(settings.get("motors_checked"))
    assert key == safety(client.request(Msp.SAFETY)).motor_key
    board.sleep(0.7)
    assert not forbidden(client)
    settings.set("motors_checked", float(key ^ 2))  # as if they were set otherwise
    board.sleep(0.2)
    assert forbidden(client)
    settings.set("motor_check", 0.0)
    board.sleep(0.2)
    assert not forbidden(client)


@pytest.mark.slow
def test_wrong_order_direction_and_propeller_are_named_with_what_mends_them(
    built: Make, check: Check, capsys: pytest.CaptureFixture[str]
) -> None:
    board = built(order=(0, 3, 2, 1), other_way=(2,), down=(2,), gyro=YAWED)
    assert check(board) == 1
    out = capsys.readouterr().out
    for line in (
        "the gyro sits in the aircraft otherwise than set: its nose is taken for its left side",
        "settings set board_yaw_deg=90 --save --reboot --port tcp:held:1",
        "motor 2 should be front right: output 2 turns the front left rotor",
        "motor 4 should be front left: output 4 turns the front right rotor",
        "settings set motor2_output=4 motor4_output=2 --save",
        "the rear left rotor turns the wrong way and pushes down",
        "board motors direction 3 reversed --save",
    ):
        assert line in out, out
    assert Settings(board.client()).get("motors_checked") == 0.0


def test_an_aircraft_that_is_not_held_stops_the_motors_at_once(built: Make, check: Check) -> None:
    board = built(Held(0.05, 0.1))
    with pytest.raises(LinkError, match="the motors were stopped: tie it down better, or lower --fraction"):
        check(board, "--no-nose", "--fraction", "0.3", "--limit", "0.3")
    assert np.degrees(np.abs(board.twin.rate)).max() < 400
    board.sleep(0.01)
    assert not board.fractions.any()
    assert (board.most > 0).sum() == 1


def test_the_firmware_itself_ends_a_motor_test_when_the_aircraft_turns(built: Make) -> None:
    board = built()
    with board.client() as client:
        client.request(Msp.MOTOR_TEST, MOTOR_TEST_MAGIC.to_bytes(4, "little"))
        client.request(Msp.SET_MOTOR, (1100).to_bytes(2, "little"))
        board.sleep(0.05)
        assert board.fractions[0] > 0.09
        board.shove = np.radians([0.0, 310.0, 0.0])
        board.sleep(0.03)
        assert not board.fractions.any()


def test_nothing_turns_when_nobody_has_tied_it_down(built: Make, check: Check) -> None:
    board = built()
    with pytest.raises(LinkError, match=r"tie the aircraft down at its middle .* and give --tied-down"):
        check(board, "--no-nose", tied_down=False)
    assert not board.most.any()


def test_a_lost_line_stops_the_motors_by_the_boards_own_time(
    built: Make, check: Check, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = built()
    monkeypatch.setattr(
        board.line, "send", lambda data: board.fractions.any() or type(board.line).send(board.line, data)
    )
    with pytest.raises(LinkError):
        check(board, "--no-nose")
    board.sleep(0.5)
    assert board.most.any() and not board.fractions.any()
