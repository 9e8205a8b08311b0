"""`board motors` and `board monitor` over the emulated board's UART: what its ESCs hear, by its own time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from neuroflight.flash.channels.script import parse_script
from neuroflight.flash.channels.sender import Sender
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.records import safety
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.monitoring.watch import Watch
from neuroflight.flash.motors.direction import set_direction
from neuroflight.flash.motors.readiness import read_bench
from neuroflight.flash.motors.session import MotorTest
from neuroflight.flash.motors.spin import Spin, spin
from neuroflight.flash.motors.stop import stop
from neuroflight.flash.settings.values import Settings
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.devices.esc import Frame
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.board.serial.idle_board import IdleBoard, with_image
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    DSHOT_MIN,
    DSHOT_SPAN,
    MOTOR_TEST_TIMEOUT_MS,
    DshotCommand,
    Msp,
    StopCause,
)
from neuroflight.toolchain.image.elf import read_flashable
from tests.flash.channels.test_layout import layout

READY_S = 1.5  # after boot: grace and calibration are over


class HeardBoard:
    """An idle board, a line to it, and what each ESC was told where it differs from before."""

    def __init__(self, elf: Path, kept: bytes | None = None) -> None:
        """kept: flash with settings."""
        self.idle = IdleBoard(with_image(read_flashable(elf.with_suffix(".bin")), kept), elf=elf)
        self.told: list[Frame] = []
        last: dict[int, int] = {}

        def hear(frame: Frame) -> None:
            if last.get(frame.motor) != frame.value:
                self.told.append(frame)
            last[frame.motor] = frame.value

        self.idle.board.hardware.hear_frames(hear)
        self.last = last
        self.idle.boot()
        self.line = UartLine(self.idle.board)

    def transport(self) -> LineTransport:
        return LineTransport(self.line, self.idle.run_to)

    def clock(self) -> float:
        return self.idle.board.cycle / TIME_HZ

    def sleep(self, seconds: float) -> None:
        self.idle.run_to(self.idle.board.cycle + round(seconds * TIME_HZ))

    def close(self) -> None:
        self.idle.close()


@pytest.fixture(scope="module")
def board(board_image: Path) -> Iterator[HeardBoard]:
    """One for all tests after which it is ready again."""
    with closing(HeardBoard(board_image)) as one:
        one.sleep(READY_S)
        yield one


def test_escs_hear_what_the_commands_ask_for(board: HeardBoard) -> None:
    with Client(board.transport(), board.clock) as client:
        assert read_bench(client).outputs == (1, 2, 3, 4)
        board.told.clear()
        spin(client, Spin([1], 4, 0.1, seconds=0.3, ramp_s=0.1), board.clock, board.sleep)
        board.sleep(0.01)
        turned = [frame for frame in board.told if frame.value >= DSHOT_MIN]
        assert {frame.motor for frame in turned} == {2}
        assert max(frame.value for frame in turned) == DSHOT_MIN + int(DSHOT_SPAN * 0.1 + 0.5)
        assert set(board.last.values()) == {0}
        stop(client, board.clock, board.sleep)

        board.told.clear()
        set_direction(
            client, [0, 2], DshotCommand.DIRECTION_REVERSED, save=True, clock=board.clock, sleep=board.sleep
        )
        board.sleep(0.1)
        heard = [(frame.motor, frame.value) for frame in board.told if frame.value]
        assert heard == [(1, 21), (1, 12), (3, 21), (3, 12)]


def test_motors_stop_by_the_boards_own_time_when_the_cable_is_pulled(board: HeardBoard) -> None:
    with Client(board.transport(), board.clock) as client:
        test = MotorTest(client, 4)
        test.__enter__()
        test.turn([0.1, 0, 0, 0])
        given = board.clock()
        board.sleep(0.05)
        assert board.last[1] > DSHOT_MIN
    board.sleep(MOTOR_TEST_TIMEOUT_MS / 1000)
    (stopped,) = [
        frame
        for frame in board.told
        if frame.motor == 1 and not frame.value and frame.cycle / TIME_HZ > given
    ]
    assert stopped.cycle / TIME_HZ - given == pytest.approx(MOTOR_TEST_TIMEOUT_MS / 1000, abs=0.01)


def test_channels_arm_the_board_and_disarm_it_over_its_uart(
    board_image: Path, resting_host: str, tmp_path: Path
) -> None:
    with Client(open_transport(resting_host)) as client:
        Settings(client).change({"receiver_protocol": 2.0, "arming_delay_ms": BOOT_GRACE_MS}, save=True)
    script = parse_script(b"t_s,throttle,aux1\n0,1000,1000\n0.3,1000,2000\n0.5,1100,\n0.8,,\n", "it", ".csv")
    with closing(HeardBoard(board_image, (tmp_path / "flash.bin").read_bytes())) as board:
        board.sleep(READY_S)
        with Client(board.transport(), board.clock) as client:
            one = Sender(client, layout(), may_arm=True, rate_hz=100, clock=board.clock, sleep=board.sleep)
            with one:
                one.begin()
                board.told.clear()
                one.run(script)
                assert all(board.last[motor] > DSHOT_MIN for motor in (1, 2, 3, 4))
            told = safety(client.request(Msp.SAFETY))
    assert one.disarmed and told.stop_cause is StopCause.SWITCH
    assert set(board.last.values()) == {0}
    assert (one.count.late, one.count.unanswered) == (0, 0)


def test_the_monitor_sees_a_restart_and_goes_on(board_image: Path) -> None:
    with closing(HeardBoard(board_image)) as board, Watch(board.transport, board.clock) as watch:
        first = watch.look()
        assert first.problem == "" and first.info is not None
        assert first.info.board.target == "MATEKF722" and first.answer_ms < 200
        with Client(board.transport(), board.clock) as other:
            other.request(Msp.REBOOT)
        sights = [watch.look() for _ in range(4)]
    assert sights[-1].problem == "" and sights[-1].restarts == 1
    assert sights[-1].snapshot is not None and sights[-1].snapshot.overview.flight is not None
    assert sights[-1].snapshot.overview.flight.boots == 2
