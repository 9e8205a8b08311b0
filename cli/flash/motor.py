"""`neuroflight motor`: turn motors on the bench, stop them, set their directions and their order."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from neuroflight.cli.flash.interrupts import one_interrupt
from neuroflight.cli.flash.motor_places import motor_places
from neuroflight.cli.flash.props_off import confirm_props_off
from neuroflight.cli.flash.state import PORT_HELP, connect
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX, MOTOR_TEST_MAX, MOTOR_TEST_TIMEOUT_MS
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from neuroflight.cli.flash.motor_places import Place
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.motors.readiness import Bench
    from neuroflight.flash.motors.spin import Spin

COMMANDS = {
    "test": "turn the motors one after the other, and say which should turn where",
    "spin": "turn one motor, or all, up a ramp and for a while",
    "stop": "stop all motors at once and close the motor test, whoever opened it",
    "direction": "tell a motor's ESC by DShot which way it turns, and have it keep that",
    "order": "find out which output each motor is wired to, by turning them, and store it",
}
ALL = "all"
FRACTION_DEFAULT, LIMIT_DEFAULT = 0.1, 0.15  # motor fractions
SECONDS_DEFAULT, RAMP_DEFAULT = 2.0, 0.5
INTERRUPTED = 130


@dataclass(frozen=True)
class Desk:
    """Who sits before the bench: answers and time."""

    ask: Callable[[str], str]  # prints the question, returns the line that was typed; "" at the end of input
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the commands."""
    commands = parser.add_subparsers(dest="action", required=True, metavar="COMMAND")
    declared = {}
    for name, summary in COMMANDS.items():
        declared[name] = commands.add_parser(name, help=summary, description=summary)
        declared[name].add_argument("--port", required=True, metavar="PORT", help=PORT_HELP)
    for name in ("test", "spin", "order"):
        sub = declared[name]
        sub.add_argument(
            "--fraction",
            type=float,
            default=FRACTION_DEFAULT,
            metavar="F",
            help=f"motor fraction, 0..1 (default {FRACTION_DEFAULT})",
        )
        sub.add_argument(
            "--limit",
            type=float,
            default=LIMIT_DEFAULT,
            metavar="F",
            help=f"largest fraction that is let through (default {LIMIT_DEFAULT}, at most {MOTOR_TEST_MAX})",
        )
        sub.add_argument(
            "--seconds",
            type=float,
            default=SECONDS_DEFAULT,
            metavar="S",
            help=f"each motor turns so long, the ramp included (default {SECONDS_DEFAULT:g})",
        )
        sub.add_argument("--ramp", type=float, default=RAMP_DEFAULT, metavar="S", help="from 0 to F")
        sub.add_argument("--props-off", action="store_true", help="they are: do not ask")
    for name in ("test", "order"):
        declared[name].add_argument(
            "--aircraft", metavar="NAME|FILE", help="on the bench; default: the policy's, where it is shipped"
        )
    declared["test"].add_argument(
        "--no-questions", action="store_true", help="only turn them, one after the other"
    )
    for name in ("spin", "direction"):
        declared[name].add_argument("motor", metavar="MOTOR", help=f"1 to {MOTOR_COUNT_MAX}, or all")
    declared["direction"].add_argument("direction", choices=("normal", "reversed"))
    declared["direction"].add_argument("--save", action="store_true", help="the ESC keeps it without power")
    declared["order"].add_argument("--yes", action="store_true", help="store what was found: do not ask")


def run(args: argparse.Namespace) -> int:
    """Carry out the command. Returns 0, 1 where a motor did not do as it should, 130 after an interrupt;
    raises NeuroflightError for what cannot be done. The motors stand in each case."""
    return carry_out(args, Desk(_typed))


def carry_out(args: argparse.Namespace, desk: Desk) -> int:
    """`run` with another desk."""
    with one_interrupt():
        try:
            return HANDLERS[args.action](args, desk)
        except KeyboardInterrupt:
            told = f"the motors were stopped (without an answer they stop within {MOTOR_TEST_TIMEOUT_MS} ms)"
            if args.action == "stop":  # somebody else may turn them on
                told = "whether the motors stand was not seen; ask again"
            print(f"neuroflight: interrupted; {told}", file=sys.stderr)
            return INTERRUPTED


def _typed(question: str) -> str:
    print(question, end="", flush=True)
    return sys.stdin.readline()


# --- test ------------------------------------------------------------------------------------------
def test(args: argparse.Namespace, desk: Desk) -> int:
    """Turn each motor and compare with what should be."""
    with connect(args) as client:
        bench, places = _prepare(client, args, "test turns each motor")
        wrong: list[str] = []
        for motor, place in enumerate(places):
            print(f"motor {motor + 1}: {place}", flush=True)
            if not args.no_questions and _heard(desk, "  Enter turns it, s skips it: ") == "s":
                continue
            _spin(client, [motor], bench, args, desk)
            if not args.no_questions:
                wrong += _judged(desk, motor, place)
    for line in wrong:
        print(line)
    if not wrong and not args.no_questions:
        print("every motor that turned is in its place and turns the right way")
    return 1 if wrong else 0


def _judged(desk: Desk, motor: int, place: Place) -> list[str]:
    """What is wrong with a motor, in words that say how to mend it."""
    wrong = []
    if not _yes(desk, f"  did the {place.where} motor turn, and no other? yes or no: "):
        wrong.append(f"motor {motor + 1}: another one turned, or none; see `neuroflight motor order`")
    elif place.turns and not _yes(desk, f"  did it turn {place.turns}, seen from above? yes or no: "):
        wrong.append(
            f"motor {motor + 1}: it turns the wrong way; swap two of its wires, or "
            f"`neuroflight motor direction {motor + 1} reversed --save`, or normal where it is reversed now"
        )
    return wrong


# --- spin, stop ------------------------------------------------------------------------------------
def spin(args: argparse.Namespace, desk: Desk) -> int:
    """Turn one motor, or all."""
    _motors(args.motor, MOTOR_COUNT_MAX)
    with connect(args) as client:
        what = "all motors" if args.motor == ALL else f"motor {args.motor}"
        told = f"spin turns {what} at {args.fraction:g} for {args.seconds:g} s"
        bench, _ = _prepare(client, args, told, args.motor)
        _spin(client, _motors(args.motor, bench.motor_count), bench, args, desk)
    print(f"{what} turned at {args.fraction:g} for {args.seconds:g} s and stopped")
    return 0


def stop(args: argparse.Namespace, desk: Desk) -> int:
    """Stop them all."""
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.flash.motors.stop import stop as stop_motors

    with Client(open_transport(args.port)) as client:  # nothing is asked before
        stop_motors(client, desk.clock, desk.sleep)
    print("all motors stand, no motor test is open")
    return 0


# --- direction -------------------------------------------------------------------------------------
def direction(args: argparse.Namespace, desk: Desk) -> int:
    """Send it to one ESC, or all."""
    from neuroflight.flash.motors.direction import DIRECTIONS, set_direction
    from neuroflight.flash.motors.readiness import read_bench

    _motors(args.motor, MOTOR_COUNT_MAX)
    with connect(args) as client:
        bench = read_bench(client)
        motors = _motors(args.motor, bench.motor_count)
        set_direction(
            client,
            motors,
            DIRECTIONS[args.direction],
            save=args.save,
            clock=desk.clock,
            sleep=desk.sleep,
        )
    kept = "stored in the ESC" if args.save else "forgotten when the ESC loses power, unless told with --save"
    for motor in motors:
        print(f"motor {motor + 1}: {args.direction}, {kept}")
    print(f"no ESC answers: see by `neuroflight motor spin {args.motor}` whether it was understood")
    return 0


# --- order -----------------------------------------------------------------------------------------
def order(args: argparse.Namespace, desk: Desk) -> int:
    """Ask which motor turned, for each output; show, set and store what follows."""
    from neuroflight.flash.motors.order import order_changes, outputs_of
    from neuroflight.flash.motors.readiness import await_standing
    from neuroflight.flash.settings.values import Settings

    with connect(args) as client:
        bench, places = _prepare(client, args, "order turns each motor")
        for motor, place in enumerate(places, 1):
            print(f"motor {motor}: {place.where}")
        turned = [_turned(client, motor, bench, args, desk) for motor in range(bench.motor_count)]
        found = outputs_of(bench.outputs, turned)
        for motor, (before, after) in enumerate(zip(bench.outputs, found, strict=True), 1):
            note = "" if before == after else f", was {before}"
            print(f"motor {motor}, {places[motor - 1].where}: output {after}{note}")
        changes = order_changes(bench.outputs, found)
        if not changes:
            print("the order is right already; nothing is changed")
            return 0
        if not args.yes and not _yes(desk, "store that order? yes or no: "):
            raise LinkError("nothing is changed; answer yes or give --yes to store the order")
        await_standing(client, desk.clock, desk.sleep)  # flash is not written beside a motor test
        Settings(client).change(changes, save=True)
    print("the order is stored; it holds from the next start on: `neuroflight msp --port PORT reboot`")
    return 0


def _turned(client: Client, motor: int, bench: Bench, args: argparse.Namespace, desk: Desk) -> int:
    """Index of the motor that turned when `motor` was to."""
    output = bench.outputs[motor]
    _heard(desk, f"output {output}: Enter turns what is wired to it: ")
    while True:
        _spin(client, [motor], bench, args, desk)
        answer = _heard(desk, f"  which motor turned? 1 to {bench.motor_count}, or Enter to turn it again: ")
        if answer.isdecimal() and 1 <= int(answer) <= bench.motor_count:
            return int(answer) - 1
        if answer:
            print(f"  got {answer!r}, expected the number of a motor as listed above")


# --- Shared ----------------------------------------------------------------------------------------
def _prepare(
    client: Client, args: argparse.Namespace, what: str, motor: str = "1"
) -> tuple[Bench, tuple[Place, ...]]:
    """Look at the board and have the propellers taken off. Raises NeuroflightError before anything turns.

    motor: that is turned, as the user named it; one of several that are turned one after the other.
    """
    from neuroflight.flash.motors.readiness import read_bench

    bench = read_bench(client)
    places = motor_places(
        getattr(args, "aircraft", None), bench.aircraft, bench.motor_count, reverse=bench.reversed
    )
    _wanted(_motors(motor, bench.motor_count), bench, args)  # what is wrong is told before anybody is asked
    if bench.warning:
        print(f"neuroflight: {bench.warning}", file=sys.stderr)
    confirm_props_off(args.props_off, what)
    return bench, places


def _wanted(motors: Sequence[int], bench: Bench, args: argparse.Namespace) -> Spin:
    from neuroflight.flash.motors.spin import Spin

    return Spin(motors, bench.motor_count, args.fraction, args.seconds, args.ramp, args.limit)


def _spin(client: Client, motors: Sequence[int], bench: Bench, args: argparse.Namespace, desk: Desk) -> None:
    from neuroflight.flash.motors.readiness import check_ready
    from neuroflight.flash.motors.spin import spin as turn

    check_ready(client)  # minutes may have passed since the last look
    turn(client, _wanted(motors, bench, args), desk.clock, desk.sleep)


def _motors(text: str, count: int) -> list[int]:
    """Indices of the motors that the user named. Raises LinkError."""
    if text == ALL:
        return list(range(count))
    if not (text.isascii() and text.isdecimal() and len(text) < 3 and 1 <= int(text) <= count):
        raise LinkError(f"motor got {text!r}, expected 1 to {count}, or {ALL}")
    return [int(text) - 1]


def _heard(desk: Desk, question: str) -> str:
    """The answer in small letters. Raises LinkError at the end of input: nobody is there any more."""
    line = desk.ask(question)
    if not line:
        raise LinkError("nobody answers any more, expected a line on stdin; the motors stand")
    return line.strip().lower()


def _yes(desk: Desk, question: str) -> bool:
    while True:
        answer = _heard(desk, question)
        if answer in ("yes", "y", "no", "n"):
            return answer.startswith("y")


HANDLERS: dict[str, Callable[[argparse.Namespace, Desk], int]] = {
    "test": test,
    "spin": spin,
    "stop": stop,
    "direction": direction,
    "order": order,
}
