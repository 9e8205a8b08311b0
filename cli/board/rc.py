"""`neuroflight board rc`: send a firmware its channels over MSP, from a script, a scenario or a gamepad."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.props_off import confirm_props_off
from neuroflight.cli.board.state import connect
from neuroflight.cli.options import add_port
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.channels.layout import Layout
    from neuroflight.flash.channels.sender import Sender
    from neuroflight.flash.channels.source import Source
    from neuroflight.flash.link.client import Client

RATE_DEFAULT, RATE_MIN, RATE_MAX = 50, 20, 150  # Hz; below, the failsafe would hold between two frames
LEAD_S, ARMED_S = 0.5, 0.5  # of a scenario: at rest, then armed with the throttle low


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the sources and the interlocks."""
    add_port(parser)
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument(
        "--script",
        type=Path,
        metavar="FILE",
        help="times and channels, .csv or .toml; see docs/guides/motors-and-channels.md",
    )
    source.add_argument(
        "--scenario", metavar="NAME|FILE", help="as of `neuroflight fly`; arms, so it needs --allow-arm"
    )
    source.add_argument(
        "--gamepad", type=int, nargs="?", const=0, metavar="N", help="the first one, or that number from 0 on"
    )
    parser.add_argument("--allow-arm", action="store_true", help="the arm switch may be on")
    parser.add_argument("--props-off", action="store_true", help="with --allow-arm: they are, do not ask")
    parser.add_argument(
        "--rate",
        type=int,
        default=RATE_DEFAULT,
        metavar="HZ",
        help=f"frames a second (default {RATE_DEFAULT})",
    )
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of a scenario that is drawn")
    parser.add_argument(
        "--axis",
        nargs="+",
        metavar="CHANNEL=N",
        help="of the gamepad, - before an inverted one; default: roll=3 pitch=-4 throttle=-1 yaw=0",
    )
    parser.add_argument(
        "--button", nargs="+", metavar="CHANNEL=N", help="high while it is held; default: aux1=4 aux2=5"
    )
    parser.add_argument(
        "--whole-throttle",
        action="store_true",
        help="the throttle stick stays where it is put: its whole way counts, not the half above its middle",
    )


def run(args: argparse.Namespace) -> int:
    """Send until the source ends, or Ctrl-C. Returns 0 when the board said that it is disarmed, else 1;
    raises NeuroflightError."""
    return carry_out(args, time.monotonic, time.sleep)


def carry_out(args: argparse.Namespace, clock: Callable[[], float], sleep: Callable[[float], None]) -> int:
    """Do the same as `run`, with the time of `clock` [s] and `sleep`."""
    from neuroflight.flash.channels.sender import Sender

    if not RATE_MIN <= args.rate <= RATE_MAX:
        raise NeuroflightError(f"--rate got {args.rate}, expected {RATE_MIN} to {RATE_MAX} Hz")
    with ExitStack() as ends:
        make = _source(args, ends)
        client = ends.enter_context(connect(args.port))
        layout = _layout(client)
        source = make(layout)
        if args.allow_arm:
            confirm_props_off(
                args.props_off, "rc may arm the board, and its motors turn as the throttle says"
            )
        ends.enter_context(one_interrupt())
        sender = Sender(
            client,
            layout,
            may_arm=args.allow_arm,
            rate_hz=args.rate,
            tell=_warn,
            clock=clock,
            sleep=sleep,
        )
        try:
            with sender:
                _fly(client, sender, source)
        except KeyboardInterrupt:
            pass  # Ctrl-C is the usual way to end it
        finally:
            if sender.count.taken:
                print(_summary(sender), flush=True)
        return 0 if sender.disarmed else 1


def _fly(client: Client, sender: Sender, source: Source) -> None:
    from neuroflight.flash.channels.receiver import not_listening
    from neuroflight.flash.link.client import RefusedError
    from neuroflight.flash.settings.values import Settings
    from neuroflight.toolchain.contract import Refusal

    try:
        sender.begin()
    except RefusedError as error:
        if error.reason is Refusal.ABSENT:
            raise not_listening(client.name, Settings(client).get) from None
        raise
    sender.await_rest(source)
    sender.run(source)


def _layout(client: Client) -> Layout:
    """Return the order and range of the board's channels. Raises LinkError for another make."""
    from neuroflight.flash.board.info import check_ours
    from neuroflight.flash.channels.layout import read_layout
    from neuroflight.flash.settings.values import Settings

    check_ours(client, "nothing that acts was sent")
    return read_layout(Settings(client).get)


def _source(args: argparse.Namespace, ends: ExitStack) -> Callable[[Layout], Source]:
    """Return a function that makes the source from the board's layout of channels; errors of the source
    itself are raised before the board is asked."""
    if args.script is not None:
        return _script(args)
    if args.scenario is not None:
        return _scenario(args)
    return _gamepad(args, ends)


def _script(args: argparse.Namespace) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.script import check_script, read_script

    script = read_script(args.script)

    def make(layout: Layout) -> Source:
        check_script(script, layout, may_arm=args.allow_arm)
        return script

    return make


def _scenario(args: argparse.Namespace) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.timeline import Timeline
    from neuroflight.sim.flight.scenario import load_scenario

    if not args.allow_arm:
        raise NeuroflightError(
            f"scenario {args.scenario}: it arms, expected --allow-arm; give it if the motors may turn; "
            "nothing was sent"
        )
    scenario = load_scenario(args.scenario, args.seed)
    if scenario.by_eye:
        raise NeuroflightError(
            f"scenario {args.scenario}: its pilot flies by the twin's height, which nobody sees here; "
            "expected sticks that are known before; nothing was sent"
        )
    widths, heard = scenario.timeline(args.rate)
    rows = [tuple(int(us) for us in row) if on else None for row, on in zip(widths, heard, strict=True)]
    armed_at = tuple(int(us) for us in widths[0])

    def make(layout: Layout) -> Source:
        rest = layout.resting()
        armed = list(rest)
        for channel, _ in layout.disarmed_us:
            armed[channel] = armed_at[channel]
        if not layout.arms(tuple(armed)):
            raise NeuroflightError(
                f"scenario {args.scenario}: its arm switch does not arm this board, expected the range of "
                "mode1 as set by default; write a --script for its modes; nothing was sent"
            )
        return Timeline(rest, LEAD_S, tuple(armed), ARMED_S, args.rate, rows)

    return make


def _gamepad(args: argparse.Namespace, ends: ExitStack) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.gamepad import DEFAULT_AXES, DEFAULT_BUTTONS, Gamepad, parse_mapping

    mapping = parse_mapping(
        args.axis or DEFAULT_AXES,
        args.button or DEFAULT_BUTTONS,
        throttle_from_centre=not args.whole_throttle,
    )
    gamepad = ends.enter_context(Gamepad(args.gamepad, mapping))

    def make(layout: Layout) -> Source:
        print(f"gamepad {gamepad.name}; Ctrl-C ends", flush=True)
        return gamepad

    return make


def _warn(line: str) -> None:
    print(f"neuroflight: {line}", file=sys.stderr, flush=True)


def _summary(sender: Sender) -> str:
    count = sender.count
    told = f"{count.taken} frames taken"
    for number, what in (
        (count.late, "late and not sent"),
        (count.passed_over, "not taken up in time"),
        (count.unanswered, "without an answer"),
    ):
        if number:
            told += f", {number} {what}"
    if not sender.disarmed:
        return f"{told}; the board did not say that it is disarmed: its failsafe acts on the silence"
    return f"{told}; the board is disarmed"
