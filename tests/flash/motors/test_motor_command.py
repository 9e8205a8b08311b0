"""`board motors` against the host program: what it asks, says and never turns without leave to."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from neuroflight.cli.board import motors
from neuroflight.cli.board.motor_places import motor_places
from neuroflight.cli.main import main, parse
from neuroflight.flash.link.msp import Decoder, Message
from neuroflight.flash.motors.session import LIMIT_DEFAULT
from neuroflight.flash.motors.spin import Spin
from neuroflight.flash.settings.values import Settings
from neuroflight.toolchain.contract import MOTOR_TEST_TIMEOUT_MS, Msp
from neuroflight.toolchain.errors import AircraftError, LinkError
from tests.flash.lockstep import Lockstep, lockstep
from tests.forked import Forked

LayLine = Callable[..., str]


class Person:
    """Somebody before the bench, whose answers are written down beforehand."""

    def __init__(self, bench: Lockstep, *answers: str) -> None:
        self.bench, self.answers = bench, list(answers)
        self.asked: list[str] = []

    def ask(self, question: str) -> str:
        assert not any(self.bench.run(1)), "a motor turns while somebody is asked"
        self.asked.append(question)
        return self.answers.pop(0) + "\n" if self.answers else ""

    def run(self, *words: str) -> int:
        args = parse(["board", "motors", *words, "--port", self.bench.port])
        person = motors.Person(self.ask, self.bench.clock, self.bench.sleep)
        return int(args.request.parsed(args).carry_out(person))


# --- Confirmation ----------------------------------------------------------------------------------
@pytest.mark.parametrize("words", [["test"], ["spin", "1"], ["order"]])
def test_nothing_turns_when_nobody_confirms(booted: Lockstep, words: list[str]) -> None:
    with pytest.raises(LinkError, match="take the propellers off and give --props-off; no motor turned"):
        Person(booted, "yes", "yes").run(*words)
    assert booted.most == (0, 0, 0, 0)


@contextmanager
def typed(text: str) -> Iterator[None]:
    """A terminal at which somebody types that."""
    ours, theirs = os.openpty()
    os.write(ours, text.encode())
    before = sys.stdin
    with os.fdopen(theirs) as terminal:
        sys.stdin = terminal
        try:
            yield
        finally:
            sys.stdin = before
    os.close(ours)


@pytest.mark.parametrize("text", ["yes\n", "\n", "props on\n", "propsoff\n"])
def test_nothing_turns_when_other_words_are_typed(booted: Lockstep, text: str) -> None:
    with typed(text), pytest.raises(LinkError, match="expected 'props off' typed out; no motor turned"):
        Person(booted).run("spin", "1")
    assert booted.most == (0, 0, 0, 0)


def test_a_motor_turns_when_the_words_are_typed(booted: Lockstep, capsys: pytest.CaptureFixture[str]) -> None:
    with typed(" Props  OFF\n"):
        assert Person(booted).run("spin", "2", "--seconds", "0.6") == 0
    told = capsys.readouterr()
    assert "spin turns motor 2 at 0.1 for 0.6 s. Take the propellers off" in told.err
    assert told.out == "motor 2 turned at 0.1 for 0.6 s and stopped\n"
    assert booted.most == pytest.approx((0, 0.1, 0, 0), abs=1e-3)


# --- Limits ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ["spin", "1", "--fraction", "0.2"],
            "--fraction got 0.2, expected a motor fraction of 0 to 0.15; give",
        ),
        (
            ["spin", "1", "--fraction", "0.6", "--limit", "0.6"],
            "--limit got 0.6, expected above 0 and at most 0.5",
        ),
        (["spin", "all", "--fraction", "0.3", "--limit", "0.5"], "all motors together got 1.2"),
        (["spin", "1", "--seconds", "1e9"], "--seconds got 1e+09"),
        (["spin", "5"], "motor got '5', expected 1 to 4, or all"),
        (["spin", "0"], "motor got '0', expected 1 to 8, or all"),
        (["spin", "-1"], "motor got '-1', expected 1 to 8, or all"),
        (["test", "--fraction", "nan"], "--fraction got nan"),
        (["order", "--fraction", "0.2"], "--fraction got 0.2"),
    ],
)
def test_nothing_turns_above_a_limit(booted: Lockstep, words: list[str], told: str) -> None:
    with pytest.raises(LinkError) as error:
        Person(booted).run(*words, "--props-off")
    assert told in str(error.value)
    assert booted.most == (0, 0, 0, 0)


def test_the_commands_defaults_are_the_rooms() -> None:
    given = Spin([0], 4, motors.FRACTION_DEFAULT)
    assert (given.seconds, given.ramp_s) == (motors.SECONDS_DEFAULT, motors.RAMP_DEFAULT)
    assert given.limit == motors.LIMIT_DEFAULT == LIMIT_DEFAULT


def test_what_is_wrong_is_told_before_anybody_is_asked(booted: Lockstep) -> None:
    with typed("props off\n"), pytest.raises(LinkError, match=r"all motors together got 1\.2"):
        Person(booted).run("spin", "all", "--fraction", "0.3", "--limit", "0.3")
    assert booted.most == (0, 0, 0, 0)


def test_a_higher_limit_is_let_through_when_it_is_said(booted: Lockstep) -> None:
    words = ("spin", "4", "--fraction", "0.3", "--limit", "0.4", "--ramp", "0", "--seconds", "0.1")
    assert Person(booted).run(*words, "--props-off") == 0
    assert booted.most == pytest.approx((0, 0, 0, 0.3), abs=1e-3)


# --- test ------------------------------------------------------------------------------------------
def test_each_motor_is_turned_alone_and_said_to_turn_where(
    booted: Lockstep, capsys: pytest.CaptureFixture[str]
) -> None:
    person = Person(booted, *["", "yes", "y"] * 4)
    assert person.run("test", "--props-off", "--seconds", "0.6") == 0
    out = capsys.readouterr().out
    for line in (
        "motor 1: rear right, clockwise seen from above",
        "motor 2: front right, counter-clockwise seen from above",
        "motor 3: rear left, counter-clockwise seen from above",
        "motor 4: front left, clockwise seen from above",
    ):
        assert line in out
    assert out.endswith("every motor that turned is in its place and turns the right way\n")
    order = [motors.index(max(motors)) for motors in booted.turned if any(motors)]
    assert sorted(order) == order and set(order) == {0, 1, 2, 3}
    assert all(sum(value > 0 for value in motors) <= 1 for motors in booted.turned)


def test_what_is_wrong_is_said_with_its_mend(booted: Lockstep, capsys: pytest.CaptureFixture[str]) -> None:
    person = Person(booted, "", "no", "", "yes", "no", "s", "s")
    assert person.run("test", "--props-off", "--seconds", "0.1", "--ramp", "0") == 1
    out = capsys.readouterr().out
    assert "motor 1: another one turned, or none; see `neuroflight board motors order`\n" in out
    assert "`neuroflight board motors direction 2 reversed --save`" in out
    assert booted.most == pytest.approx((0.1, 0.1, 0, 0), abs=1e-3)


def test_it_stops_when_nobody_answers_any_more(booted: Lockstep) -> None:
    with pytest.raises(LinkError, match="nobody answers any more"):
        Person(booted, "").run("test", "--props-off", "--seconds", "0.1")
    assert booted.run(1) == (0, 0, 0, 0)


@pytest.mark.parametrize(
    ("words", "answers", "told"),
    [
        ("test", ["s", "", "yes", "yes", "s", "s"], {"turned": [2], "wrong": []}),
        ("spin 3", [], {"motor": "3", "fraction": 0.1, "seconds": 0.1}),
        (
            "order",
            ["", "1", "", "2", "", "3", "", "4"],
            {"before": [1, 2, 3, 4], "outputs": [1, 2, 3, 4], "stored": False},
        ),
    ],
)
def test_it_is_one_document_when_asked_for_json(
    booted: Lockstep,
    words: str,
    answers: list[str],
    told: dict[str, object],
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = ("--props-off", "--seconds", "0.1", "--ramp", "0", "--json")
    assert Person(booted, *answers).run(*words.split(), *options) == 0
    assert json.loads(capsys.readouterr().out) == told


def test_a_battery_that_fell_between_two_motors_ends_it(booted: Lockstep) -> None:
    def ask(question: str) -> str:
        if "other" in question:
            booted.program.power(volts=12.0)
            booted.run(2000)
        return "yes\n"

    args = parse(["board", "motors", "test", "--props-off", "--seconds", "0.1", "--port", booted.port])
    with pytest.raises(LinkError, match="the battery is low"):
        args.request.parsed(args).carry_out(motors.Person(ask, booted.clock, booted.sleep))
    assert booted.most[1:] == (0, 0, 0)


def test_motors_turn_the_other_way_when_props_are_out() -> None:
    ways = [place.turns for place in motor_places("nf1", "", 4, reverse=True)]
    assert ways == ["counter-clockwise", "clockwise", "clockwise", "counter-clockwise"]
    hexa = [place.where for place in motor_places(None, "hexa", 6, reverse=False)]
    assert hexa == ["rear right", "front right", "rear left", "front left", "right", "left"]
    assert [str(place) for place in motor_places(None, "../../etc/passwd", 5, reverse=False)][3:] == [
        "front left",
        "number 5",
    ]
    with pytest.raises(AircraftError, match="aircraft hexa: got 6 motors, expected the firmware's 4"):
        motor_places("hexa", "nf1", 4, reverse=False)


# --- order, direction, stop ------------------------------------------------------------------------
def test_the_order_that_is_found_is_stored(booted: Lockstep, capsys: pytest.CaptureFixture[str]) -> None:
    # Motors 1 and 2 are wired to each other's outputs; the second is asked for twice, and once mistyped.
    person = Person(booted, "", "2", "", "", "nine", "1", "", "3", "", "4", "maybe", "yes")
    assert person.run("order", "--props-off", "--seconds", "0.1") == 0
    out = capsys.readouterr().out
    assert "motor 1, rear right: output 2, was 1\n" in out
    assert "motor 3, rear left: output 3\n" in out
    assert "got 'nine', expected the number of a motor" in out
    assert "the order is stored; it holds from the next start on" in out
    with booted.client() as client:
        settings = Settings(client)
        assert [settings.get(f"motor{n}_output") for n in range(1, 5)] == [2, 1, 3, 4]
    booted.program.end()


def test_the_stored_order_turns_the_right_outputs_after_a_restart(host_program: Path, tmp_path: Path) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    with lockstep(host_program, option) as one:
        answers = ["", "3", "", "1", "", "2", "", "4"]
        assert Person(one, *answers).run("order", "--props-off", "--seconds", "0.1", "--yes") == 0
        one.program.end()
    with lockstep(host_program, option) as one:
        words = ("--props-off", "--seconds", "0.1", "--ramp", "0")
        assert Person(one).run("spin", "1", *words) == 0
        # What the packets tell are outputs: motor 1 was found at the second, when 2 was to turn.
        assert one.most == pytest.approx((0, 0.1, 0, 0), abs=1e-3)


@pytest.mark.parametrize(
    ("answers", "told"),
    [
        (
            ["", "1", "", "1", "", "3", "", "4"],
            "got 1, 1, 3, 4, expected each of 1 to 4 once; nothing is set",
        ),
        (["", "2", "", "1", "", "3", "", "4", "no"], "nothing is changed; answer yes"),
        (["", "2"], "nobody answers any more"),
    ],
)
def test_nothing_is_stored_when_answers_make_no_order(
    booted: Lockstep, answers: list[str], told: str
) -> None:
    with pytest.raises(LinkError, match=told):
        Person(booted, *answers).run("order", "--props-off", "--seconds", "0.1")
    with booted.client() as client:
        assert [Settings(client).get(f"motor{n}_output") for n in range(1, 5)] == [1, 2, 3, 4]


def test_nothing_is_written_when_the_order_is_right(
    booted: Lockstep, capsys: pytest.CaptureFixture[str]
) -> None:
    answers = ["", "1", "", "2", "", "3", "", "4"]
    assert Person(booted, *answers).run("order", "--props-off", "--seconds", "0.1") == 0
    assert "the order is right already; nothing is changed" in capsys.readouterr().out


def test_a_direction_is_told_without_turning_anything(
    booted: Lockstep, capsys: pytest.CaptureFixture[str]
) -> None:
    assert Person(booted).run("direction", "3", "reversed", "--save") == 0
    assert capsys.readouterr().out.startswith("motor 3: reversed, stored in the ESC\nno ESC answers")
    assert Person(booted).run("direction", "all", "normal") == 0
    assert capsys.readouterr().out.count("normal, forgotten when the ESC loses power") == 4
    assert booted.most == (0, 0, 0, 0)


def test_stop_says_that_motors_stand(booted: Lockstep, capsys: pytest.CaptureFixture[str]) -> None:
    with booted.client() as other:
        other.request(Msp.ARMING_DISABLE, b"\0\1")
        other.request(Msp.SET_MOTOR, bytes.fromhex("4c04 4c04 e803 e803"))
        assert any(booted.run(5))
        assert Person(booted).run("stop") == 0
    assert capsys.readouterr().out == "all motors stand, no motor test is open\n"
    assert booted.run(1) == (0, 0, 0, 0)


def test_an_interrupted_stop_does_not_say_that_motors_stand(
    booted: Lockstep, capsys: pytest.CaptureFixture[str]
) -> None:
    def sleep(seconds: float) -> None:
        raise KeyboardInterrupt

    with booted.client() as other:
        other.request(Msp.ARMING_DISABLE, b"\0\1")
        booted.run(5)
        args = parse(["board", "motors", "stop", "--port", booted.port])
        assert (
            args.request.parsed(args).carry_out(motors.Person(lambda question: "", booted.clock, sleep))
            == 130
        )
    assert capsys.readouterr().err == (
        "neuroflight: interrupted; whether the motors stand was not seen; ask again\n"
    )


# --- A process that ends in the middle -----------------------------------------------------------------
class Spinning:
    """`motor spin` as a process of its own behind a cable; each value that it sends is 50 ms to the firmware.

    At the third value `event` happens, before the value arrives; the next step of the test is behind it.
    """

    def __init__(self, bench: Lockstep, lay: LayLine, event: Callable[[Spinning], None]) -> None:
        self.bench, self.cut, self.event = bench, False, event
        self.values = 0
        self.ready = threading.Event()
        self._decoder = Decoder()
        device = lay(bench.port, down=self._down, up=self._up)
        words = ("spin", "1", "--seconds", "60", "--ramp", "0", "--props-off", "--port", device)
        self.process = Forked("board", "motors", *words)
        assert self.ready.wait(20), self.process.communicate(timeout=5)

    def _down(self, data: bytes) -> bytes:
        if self.cut:
            return b""
        asked = [event for event in self._decoder.feed(data) if isinstance(event, Message)]
        if any(one.command == Msp.SET_MOTOR for one in asked):
            self.values += 1
            assert any(self.bench.run(50)) == (self.values > 1)
            if self.values == 3:
                self.event(self)
                if self.cut:
                    self.ready.set()
                    return b""
        return data

    def _up(self, data: bytes) -> bytes:
        if self.values >= 3:
            self.ready.set()
        return data


def test_motors_stop_in_the_firmware_when_the_process_is_killed(booted: Lockstep, pty_line: LayLine) -> None:
    def kill(spinning: Spinning) -> None:
        spinning.process.kill()
        spinning.process.communicate(timeout=20)

    Spinning(booted, pty_line, kill)
    assert booted.stopped_after(MOTOR_TEST_TIMEOUT_MS) > MOTOR_TEST_TIMEOUT_MS - 5  # nobody told it to


def test_motors_stop_in_the_firmware_when_the_cable_is_pulled(booted: Lockstep, pty_line: LayLine) -> None:
    def pull(spinning: Spinning) -> None:
        spinning.cut = True

    spinning = Spinning(booted, pty_line, pull)
    left_ms = MOTOR_TEST_TIMEOUT_MS - 50  # since the last value that arrived
    assert booted.stopped_after(left_ms) > left_ms - 5
    _, err = spinning.process.communicate(timeout=30)
    assert spinning.process.returncode == 1
    assert err.count("\n") == 1 and "got silence" in err
    assert "the firmware stops the motors by itself after 500 ms" in err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_motors_stop_at_once_when_the_process_is_told_to_end(
    booted: Lockstep, capsys: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    def sleep(seconds: float) -> None:
        booted.sleep(seconds)
        if any(booted.turned[-1]):
            signal.raise_signal(number)

    words = ["spin", "1", "--seconds", "60", "--ramp", "0", "--props-off", "--port", booted.port]
    args = parse(["board", "motors", *words])
    person = motors.Person(lambda question: "", booted.clock, sleep)
    assert motors.Spin.parsed(args).carry_out(person) == 130
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "interrupted; the motors were stopped" in err
    assert any(booted.turned[-1]) and booted.stopped_after(3) <= 2


# --- Ports -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "words", [["test"], ["spin", "1"], ["stop"], ["direction", "1", "normal"], ["order"]]
)
def test_one_line_says_what_is_wrong_with_the_port(
    words: list[str], free_tcp_port: int, capsys: pytest.CaptureFixture[str]
) -> None:
    for port, told in (
        ("/dev/does-not-exist", "there is no such device"),
        (f"tcp:127.0.0.1:{free_tcp_port}", "nobody listens there"),
        ("nonsense", "is of no known form"),
        ("/dev/null", "cannot be opened as a serial port"),
    ):
        assert main(["board", "motors", *words, "--port", port]) == 1
        err = capsys.readouterr().err
        assert err.count("\n") == 1 and told in err


def test_one_line_says_so_when_the_device_is_someone_elses(
    tcp_server: Callable[..., str], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    port = tcp_server(lambda data: b"$GPGGA,123519,4807.038,N,01131.000,E,1,08\r\n")
    monkeypatch.setattr("neuroflight.flash.motors.session.STOP_TIMEOUT_S", 0.05)
    assert main(["board", "motors", "stop", "--port", port]) == 1
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "bytes that are no MSP" in err
