"""The motor test as the tool drives it, by the firmware's own clock; attempts to defeat each interlock."""

from __future__ import annotations

import pytest

from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.msp import Decoder, Direction, Message
from neuroflight.flash.link.transport import open_transport
from neuroflight.flash.motors.direction import set_direction
from neuroflight.flash.motors.readiness import await_standing, check_ready, read_bench
from neuroflight.flash.motors.session import MotorTest, check_fraction, check_limit, check_sum
from neuroflight.flash.motors.spin import Spin, spin
from neuroflight.flash.motors.stop import stop
from neuroflight.toolchain.contract import MOTOR_TEST_TIMEOUT_MS, DshotCommand, Msp
from neuroflight.toolchain.errors import LinkError
from tests.flash.lockstep import Lockstep


class Spy:
    """A line that keeps what went over it."""

    name = "spy"

    def __init__(self, port: str) -> None:
        self.inner = open_transport(port)
        self.sent = self.got = b""

    def read(self, timeout: float) -> bytes:
        data = self.inner.read(timeout)
        self.got += data
        return data

    def write(self, data: bytes) -> None:
        self.sent += data
        self.inner.write(data)

    def close(self) -> None:
        self.inner.close()

    def requests(self) -> list[Message]:
        return messages(self.sent)

    def replies(self) -> list[Message]:
        return messages(self.got)


def messages(data: bytes) -> list[Message]:
    return [event for event in Decoder().feed(data) if isinstance(event, Message)]


def test_one_motor_turns_up_the_ramp_and_stops_when_spun(booted: Lockstep) -> None:
    with booted.client() as client:
        spin(client, Spin([2], 4, 0.12, seconds=1.0, ramp_s=0.5), booted.clock, booted.sleep)
        assert booted.run(1) == (0, 0, 0, 0)
        await_standing(client, booted.clock, booted.sleep)
    third = [motors[2] for motors in booted.turned]
    assert third[-1] == 0 and max(third) == pytest.approx(0.12, abs=1e-3)
    rising = third[: third.index(max(third))]
    assert len(rising) >= 8 and rising == sorted(rising) and rising[1] < 0.02
    assert [motors[0] + motors[1] + motors[3] for motors in booted.turned] == [0] * len(booted.turned)
    assert booted.clock() == pytest.approx(1.3 + 1.0 + MOTOR_TEST_TIMEOUT_MS / 1000, abs=0.1)


def test_motors_stop_in_the_firmware_when_values_stay_away(booted: Lockstep) -> None:
    """The process is killed or its cable pulled: nothing more is sent, not even a stop."""
    with booted.client() as client:
        test = MotorTest(client, 4)
        test.__enter__()
        test.turn([0.1] * 4)
        assert booted.run(MOTOR_TEST_TIMEOUT_MS - 5) == pytest.approx((0.1,) * 4, abs=1e-3)
        for _ in range(3):
            client.request(Msp.STATUS)  # that somebody asks something keeps nothing turning
        assert booted.stopped_after(10) <= 6
        with pytest.raises(RefusedError, match="has ended the motor test and stopped the motors"):
            test.turn([0.1] * 4)


def test_motors_stop_in_the_firmware_when_the_line_is_gone_in_the_middle(booted: Lockstep) -> None:
    def sleep(seconds: float) -> None:
        booted.sleep(seconds)
        if booted.samples > 2000:
            client.close()

    with booted.client() as client, pytest.raises(LinkError, match="the line is gone"):
        spin(client, Spin([0], 4, 0.1, seconds=5.0), booted.clock, sleep)
    assert booted.turned[-1][0] > 0
    assert booted.stopped_after(MOTOR_TEST_TIMEOUT_MS) < MOTOR_TEST_TIMEOUT_MS


@pytest.mark.parametrize("raised", [KeyboardInterrupt, RuntimeError, LinkError])
def test_motors_stop_at_once_when_anything_is_raised(booted: Lockstep, raised: type[BaseException]) -> None:
    def sleep(seconds: float) -> None:
        booted.sleep(seconds)
        if booted.samples > 2000:
            raise raised

    with booted.client() as client:
        with pytest.raises(raised):
            spin(client, Spin([0, 3], 4, 0.1, seconds=5.0), booted.clock, sleep)
        assert booted.turned[-1][0] > 0
        assert booted.stopped_after(2) <= 1


@pytest.mark.parametrize(
    ("event", "words"),
    [
        pytest.param({"arm": 2000}, "has ended the motor test", id="the arm switch"),
        pytest.param(None, "has ended the motor test", id="the receiver falls silent"),
    ],
)
def test_the_firmware_ends_it_and_the_tool_says_so_when_the_pilot_acts(
    booted: Lockstep, event: dict[str, int] | None, words: str
) -> None:
    def sleep(seconds: float) -> None:
        booted.sleep(seconds)
        if booted.samples > 2000:
            booted.receiver = event is not None
            booted.sticks = event or {}

    with booted.client() as client, pytest.raises(RefusedError, match=words):
        spin(client, Spin([0], 4, 0.1, seconds=5.0), booted.clock, sleep)
    assert booted.run(1) == (0, 0, 0, 0)
    assert booted.clock() < 4.0


def test_no_motor_turns_when_the_board_is_armed(booted: Lockstep) -> None:
    booted.sticks = {"arm": 2000}
    booted.run(5)
    idling = booted.run(5)
    with booted.client() as client:
        with pytest.raises(
            LinkError, match=r"got the state armed, expected disarmed: .* put the arm switch off"
        ):
            read_bench(client)
        with pytest.raises(RefusedError, match="armed"), MotorTest(client, 4):
            pytest.fail("it opened")
        with pytest.raises(
            LinkError, match="the board is armed, which no motor test is: nothing was stopped"
        ):
            stop(client, booted.clock, booted.sleep)
        with pytest.raises(RefusedError):
            set_direction(client, [0], DshotCommand.DIRECTION_REVERSED, save=True, sleep=booted.sleep)
    assert all(idling)


def test_it_is_refused_when_the_battery_is_low_or_absent(booted: Lockstep) -> None:
    with booted.client() as client:
        assert check_ready(client).name == "GOOD"
        for volts, told in ((4 * 3.2, "the battery is low"), (0.0, "no battery is seen")):
            booted.program.power(volts=volts)
            booted.run(2000)
            with pytest.raises(LinkError, match=told):
                check_ready(client)


def test_it_is_refused_while_the_board_starts(resting_host: str) -> None:
    told = "got the state boot, expected disarmed: it is starting"
    with Client(open_transport(resting_host)) as client, pytest.raises(LinkError, match=told):
        check_ready(client)


def test_stop_ends_a_test_that_another_program_left_open(booted: Lockstep) -> None:
    with booted.client() as left, booted.client() as client:
        left.request(Msp.ARMING_DISABLE, b"\0\1")  # as the app opens it: any request of its keeps it open
        left.request(Msp.SET_MOTOR, bytes.fromhex("4c04 4c04 e803 e803"))
        assert booted.run(5)[:2] == pytest.approx((0.1, 0.1), abs=1e-3)
        stop(client, booted.clock, booted.sleep)
        assert booted.run(1) == (0, 0, 0, 0)
        with pytest.raises(RefusedError):
            left.request(Msp.SET_MOTOR, bytes.fromhex("4c04 4c04 e803 e803"))
        stop(client, booted.clock, booted.sleep)  # again, with nothing to stop


def test_stop_goes_out_before_anything_is_asked(booted: Lockstep) -> None:
    line = Spy(booted.port)
    with Client(line) as client:
        stop(client, booted.clock, booted.sleep)
    first = line.requests()[0]
    assert (first.command, first.payload) == (Msp.MOTOR_TEST, b"\0\0\0\0")


def test_nothing_above_a_limit_is_sent(booted: Lockstep) -> None:
    with booted.client() as client, MotorTest(client, 4, limit=0.2) as test:
        for fractions, told in (
            (
                [0.201, 0, 0, 0],
                "motor 1 got 0.201, expected a motor fraction of 0 to 0.2; give --limit, up to 0.5",
            ),
            ([0, -0.1, 0, 0], "motor 2 got -0.1, expected a motor fraction"),
            ([0, 0, float("nan"), 0], "motor 3 got nan, expected a motor fraction"),
        ):
            with pytest.raises(LinkError, match=told):
                test.turn(fractions)
        with pytest.raises(ValueError, match="3 fractions"):
            test.turn([0.1] * 3)
        assert booted.run(5) == (0, 0, 0, 0)


@pytest.mark.parametrize("limit", [0.0, -0.1, 0.51, float("nan"), float("inf")])
def test_a_limit_is_refused_when_the_firmware_would_not_turn_so_fast(limit: float) -> None:
    with pytest.raises(LinkError, match=r"--limit got .*, expected above 0 and at most 0.5"):
        check_limit(limit)


def test_all_motors_together_have_a_limit_of_their_own() -> None:
    check_sum([0.25] * 4)
    with pytest.raises(LinkError, match=r"all motors together got 1.04, expected at most 1"):
        check_sum([0.26] * 4)
    check_fraction("motor 1", 0.5, 0.5)
    with pytest.raises(LinkError, match=r"all motors together got 1.6"):
        Spin(range(4), 4, 0.4, limit=0.5)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"motors": [4]}, "motor got 5, expected 1 to 4"),
        ({"motors": []}, "motor got none"),
        ({"fraction": 0.151}, "--fraction got 0.151, expected a motor fraction of 0 to 0.15; give --limit"),
        ({"seconds": 61.0}, "--seconds got 61, expected above 0 and at most 60"),
        ({"seconds": 0.0}, "--seconds got 0"),
        ({"seconds": float("nan")}, "--seconds got nan"),
        ({"ramp_s": -1.0}, "--ramp got -1"),
    ],
)
def test_a_spin_is_refused_before_anything_is_sent(words: dict[str, object], told: str) -> None:
    good: dict[str, object] = {"motors": [0], "motor_count": 4, "fraction": 0.1}
    with pytest.raises(LinkError, match=told):
        Spin(**(good | words))  # type: ignore[arg-type]


def test_directions_are_taken_one_after_the_other_and_turn_nothing(booted: Lockstep) -> None:
    """Each command takes its time on the wire; what comes meanwhile is refused and asked for again."""
    line = Spy(booted.port)
    with Client(line) as client:
        set_direction(
            client,
            [0, 3],
            DshotCommand.DIRECTION_REVERSED,
            save=True,
            clock=booted.clock,
            sleep=booted.sleep,
        )
    sent = [one.payload for one in line.requests() if one.command == Msp.DSHOT_COMMAND]
    answers = [one for one in line.replies() if one.command == Msp.DSHOT_COMMAND]
    taken = [
        payload
        for payload, answer in zip(sent, answers, strict=True)
        if answer.direction is not Direction.ERROR
    ]
    assert taken == [b"\0\x15", b"\0\x0c", b"\3\x15", b"\3\x0c"]
    assert len(sent) > len(taken)
    assert booted.most == (0, 0, 0, 0)
