"""`neuroflight board motors`: turn motors on the bench, stop them, set their directions and their order."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, ClassVar

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.motor_places import motor_places
from neuroflight.cli.board.props_off import confirm_props_off
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Argument, Option
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX, MOTOR_TEST_MAX, MOTOR_TEST_TIMEOUT_MS
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from neuroflight.cli.board.motor_places import MotorPlace
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.motors.readiness import Bench
    from neuroflight.flash.motors.spin import Spin as SpinPlan

ALL = "all"
FRACTION_DEFAULT, LIMIT_DEFAULT = 0.1, 0.15  # motor fractions
SECONDS_DEFAULT, RAMP_DEFAULT = 2.0, 0.5
INTERRUPTED = 130


@dataclass(frozen=True)
class Person:
    """The person before the bench: answers and time."""

    ask: Callable[[str], str]  # prints the question, returns the line that was typed; "" at the end of input
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


OnTheBench = Annotated[
    str | None, Option("NAME|FILE", "on the bench; default: the policy's, where it is shipped")
]
Motor = Annotated[str, Argument("MOTOR", f"1 to {MOTOR_COUNT_MAX}, or all")]


@dataclass(frozen=True, kw_only=True)
class OnBench(OnPort):
    """A request about motors on a bench."""

    json: Json = False
    interrupted: ClassVar[str] = (
        f"the motors were stopped (without an answer they stop within {MOTOR_TEST_TIMEOUT_MS} ms)"
    )

    def run(self) -> int:
        """Carry it out. Returns 0, 1 where a motor did not do as it should, 130 after an interrupt; raises
        NeuroflightError for what cannot be done. The motors stand in each case."""
        return self.carry_out(Person(self._typed))

    def carry_out(self, person: Person) -> int:
        """Do the same as `run`, with the answers and the time of `person`."""
        with one_interrupt():
            try:
                return self.act(person)
            except KeyboardInterrupt:
                print(f"neuroflight: interrupted; {self.interrupted}", file=sys.stderr)
                return INTERRUPTED

    def act(self, person: Person) -> int:
        """Do the work of the request; an interrupt raises KeyboardInterrupt."""
        raise NotImplementedError

    def _typed(self, question: str) -> str:
        print(question, end="", file=sys.stderr if self.json else sys.stdout, flush=True)
        return sys.stdin.readline()


@dataclass(frozen=True, kw_only=True)
class Turning(OnBench):
    """A request that turns motors."""

    fraction: Annotated[float, Option("F", f"motor fraction, 0..1 (default {FRACTION_DEFAULT})")] = (
        FRACTION_DEFAULT
    )
    limit: Annotated[
        float,
        Option(
            "F",
            f"largest fraction that is let through (default {LIMIT_DEFAULT}, at most {MOTOR_TEST_MAX})",
        ),
    ] = LIMIT_DEFAULT
    seconds: Annotated[
        float, Option("S", f"each motor turns so long, the ramp included (default {SECONDS_DEFAULT:g})")
    ] = SECONDS_DEFAULT
    ramp: Annotated[float, Option("S", "from 0 to F")] = RAMP_DEFAULT
    props_off: Annotated[bool, Option(None, "they are: do not ask")] = False


# --- test ------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Test(Turning):
    """A request to turn one motor after the other."""

    aircraft: OnTheBench = None
    no_questions: Annotated[bool, Option(None, "only turn them, one after the other")] = False

    def act(self, person: Person) -> int:
        """Turn each motor and compare its answer with the aircraft file."""
        with connect(self.port) as client:
            bench, places = _prepare(client, self, "test turns each motor")
            told, wrong, turned = Account(self.json), [], []
            for motor, place in enumerate(places):
                told.say(f"motor {motor + 1}: {place}")
                if not self.no_questions and heard(person, "  Enter turns it, s skips it: ") == "s":
                    continue
                _spin(client, [motor], bench, self, person)
                turned.append(motor + 1)
                if not self.no_questions:
                    wrong += _judged(person, motor, place)
        for line in wrong:
            told.say(line)
        good = (
            ""
            if wrong or self.no_questions
            else "every motor that turned is in its place and turns the right way"
        )
        told.end({"turned": turned, "wrong": wrong}, good)
        return 1 if wrong else 0


def _judged(person: Person, motor: int, place: MotorPlace) -> list[str]:
    """Return the faults of a motor, in words that say how to mend them."""
    wrong = []
    if not _yes(person, f"  did the {place.where} motor turn, and no other? yes or no: "):
        wrong.append(f"motor {motor + 1}: another one turned, or none; see `neuroflight board motors order`")
    elif place.turns and not _yes(person, f"  did it turn {place.turns}, seen from above? yes or no: "):
        wrong.append(
            f"motor {motor + 1}: it turns the wrong way; swap two of its wires, or `neuroflight board motors "
            f"direction {motor + 1} reversed --save`, or normal where it is reversed now"
        )
    return wrong


# --- spin, stop ------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Spin(Turning):
    """A request to turn one motor, or all."""

    motor: Motor

    def act(self, person: Person) -> int:
        """Turn one motor, or all."""
        _motors(self.motor, MOTOR_COUNT_MAX)
        with connect(self.port) as client:
            what = "all motors" if self.motor == ALL else f"motor {self.motor}"
            told = f"spin turns {what} at {self.fraction:g} for {self.seconds:g} s"
            bench, _ = _prepare(client, self, told, self.motor)
            _spin(client, _motors(self.motor, bench.motor_count), bench, self, person)
        document = {"motor": self.motor, "fraction": self.fraction, "seconds": self.seconds}
        told = f"{what} turned at {self.fraction:g} for {self.seconds:g} s and stopped"
        return Account(self.json).end(document, told)


@dataclass(frozen=True, kw_only=True)
class Stop(OnBench):
    """A request to end every motor test."""

    interrupted: ClassVar[str] = "whether the motors stand was not seen; ask again"  # others may turn them on

    def act(self, person: Person) -> int:
        """Stop all motors."""
        from neuroflight.flash.link.client import Client
        from neuroflight.flash.link.transport import open_transport
        from neuroflight.flash.motors.stop import stop as stop_motors

        with Client(open_transport(self.port)) as client:  # at once, without checks
            stop_motors(client, person.clock, person.sleep)
        return Account(self.json).end({"standing": True}, "all motors stand, no motor test is open")


# --- direction -------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Direction(OnBench):
    """A request to change the direction in which an ESC turns its motor."""

    motor: Motor
    direction: Annotated[str, Argument(None, "", choices=("normal", "reversed"))]
    save: Annotated[bool, Option(None, "the ESC keeps it without power")] = False

    def act(self, person: Person) -> int:
        """Send the direction to one ESC, or all."""
        from neuroflight.flash.motors.direction import DIRECTIONS, set_direction
        from neuroflight.flash.motors.readiness import read_bench

        _motors(self.motor, MOTOR_COUNT_MAX)
        with connect(self.port) as client:
            bench = read_bench(client)
            motors = _motors(self.motor, bench.motor_count)
            set_direction(
                client,
                motors,
                DIRECTIONS[self.direction],
                save=self.save,
                clock=person.clock,
                sleep=person.sleep,
            )
        told = Account(self.json)
        kept = "forgotten when the ESC loses power, unless told with --save"
        if self.save:
            kept = "stored in the ESC"
        for motor in motors:
            told.say(f"motor {motor + 1}: {self.direction}, {kept}")
        document = {
            "motors": [motor + 1 for motor in motors],
            "direction": self.direction,
            "stored": self.save,
        }
        seen = f"`neuroflight board motors spin {self.motor}`"
        return told.end(document, f"no ESC answers: see by {seen} whether it was understood")


# --- order -----------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Order(Turning):
    """A request to find which output each motor is wired to."""

    aircraft: OnTheBench = None
    yes: Annotated[bool, Option(None, "store what was found: do not ask")] = False

    def act(self, person: Person) -> int:
        """Ask which motor turned, for each output; show, set and store what follows."""
        from neuroflight.flash.motors.order import order_changes, outputs_of
        from neuroflight.flash.motors.readiness import await_standing
        from neuroflight.flash.settings.values import Settings

        with connect(self.port) as client:
            bench, places = _prepare(client, self, "order turns each motor")
            told = Account(self.json)
            for motor, place in enumerate(places, 1):
                told.say(f"motor {motor}: {place.where}")
            turned = [_turned(client, motor, bench, self, person) for motor in range(bench.motor_count)]
            found = outputs_of(bench.outputs, turned)
            for motor, (before, after) in enumerate(zip(bench.outputs, found, strict=True), 1):
                note = "" if before == after else f", was {before}"
                told.say(f"motor {motor}, {places[motor - 1].where}: output {after}{note}")
            changes = order_changes(bench.outputs, found)
            document = {"before": list(bench.outputs), "outputs": list(found), "stored": bool(changes)}
            if not changes:
                return told.end(document, "the order is right already; nothing is changed")
            if not self.yes and not _yes(person, "store that order? yes or no: "):
                raise LinkError("nothing is changed; answer yes or give --yes to store the order")
            await_standing(client, person.clock, person.sleep)  # flash is not written beside a motor test
            Settings(client).change(changes, save=True)
        return told.end(
            document, "the order is stored; it holds from the next start on: `neuroflight board reboot`"
        )


def _turned(client: Client, motor: int, bench: Bench, args: Turning, person: Person) -> int:
    """Return the index of the motor that turned when `motor` was to."""
    output = bench.outputs[motor]
    heard(person, f"output {output}: Enter turns what is wired to it: ")
    while True:
        _spin(client, [motor], bench, args, person)
        answer = heard(person, f"  which motor turned? 1 to {bench.motor_count}, or Enter to turn it again: ")
        if answer.isdecimal() and 1 <= int(answer) <= bench.motor_count:
            return int(answer) - 1
        if answer:
            where = sys.stderr if args.json else sys.stdout
            print(f"  got {answer!r}, expected the number of a motor as listed above", file=where)


# --- Shared ----------------------------------------------------------------------------------------
def _prepare(
    client: Client, args: Turning, what: str, motor: str = "1"
) -> tuple[Bench, tuple[MotorPlace, ...]]:
    """Look at the board and have the propellers taken off. Raises NeuroflightError before anything turns.

    motor: that is turned, as the user named it; one of several that are turned one after the other.
    """
    from neuroflight.flash.motors.readiness import read_bench

    bench = read_bench(client)
    places = motor_places(
        getattr(args, "aircraft", None), bench.aircraft, bench.motor_count, reverse=bench.reversed
    )
    _wanted(_motors(motor, bench.motor_count), bench, args)  # wrong words are refused before a question
    if bench.warning:
        print(f"neuroflight: {bench.warning}", file=sys.stderr)
    confirm_props_off(args.props_off, what)
    return bench, places


def _wanted(motors: Sequence[int], bench: Bench, args: Turning) -> SpinPlan:
    from neuroflight.flash.motors.spin import Spin as SpinPlan

    return SpinPlan(motors, bench.motor_count, args.fraction, args.seconds, args.ramp, args.limit)


def _spin(client: Client, motors: Sequence[int], bench: Bench, args: Turning, person: Person) -> None:
    from neuroflight.flash.motors.readiness import check_ready
    from neuroflight.flash.motors.spin import spin as turn

    check_ready(client)  # minutes may have passed since the last look
    turn(client, _wanted(motors, bench, args), person.clock, person.sleep)


def _motors(text: str, count: int) -> list[int]:
    """Return the indices of the motors that the user named. Raises LinkError."""
    if text == ALL:
        return list(range(count))
    if not (text.isascii() and text.isdecimal() and len(text) < 3 and 1 <= int(text) <= count):
        raise LinkError(f"motor got {text!r}, expected 1 to {count}, or {ALL}")
    return [int(text) - 1]


def heard(person: Person, question: str) -> str:
    """Return the answer in small letters. Raises LinkError at the end of input."""
    line = person.ask(question)
    if not line:
        raise LinkError("nobody answers any more, expected a line on stdin; the motors stand")
    return line.strip().lower()


def _yes(person: Person, question: str) -> bool:
    while True:
        answer = heard(person, question)
        if answer in ("yes", "y", "no", "n"):
            return answer.startswith("y")
