"""`neuroflight board rc`: send a firmware its channels over MSP, from a script, a scenario or a gamepad."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.interrupts import one_interrupt
from neuroflight.cli.board.props_off import confirm_props_off
from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Either, Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.flash.channels.layout import Layout
    from neuroflight.flash.channels.sender import Sender
    from neuroflight.flash.channels.source import Source
    from neuroflight.flash.link.client import Client

RATE_DEFAULT, RATE_MIN, RATE_MAX = 50, 20, 150  # Hz; below, the failsafe would hold between two frames
LEAD_S, ARMED_S = 0.5, 0.5  # of a scenario: at rest, then armed with the throttle low
SOURCE = Either(required=True)


@dataclass(frozen=True, kw_only=True)
class Channels(OnPort):
    """A request to send channels from a source, with its interlocks."""

    script: Annotated[
        Path | None,
        Option(
            "FILE",
            "times and channels, .csv or .toml; see docs/guides/motors-and-channels.md",
            either=SOURCE,
        ),
    ] = None
    scenario: Annotated[
        str | None,
        Option("NAME|FILE", "as of `neuroflight fly`; arms, so it needs --allow-arm", either=SOURCE),
    ] = None
    gamepad: Annotated[
        int | None,
        Option("N", "the first one, or that number from 0 on", number="?", bare=0, either=SOURCE),
    ] = None
    allow_arm: Annotated[bool, Option(None, "the arm switch may be on")] = False
    props_off: Annotated[bool, Option(None, "with --allow-arm: they are, do not ask")] = False
    rate: Annotated[
        int,
        Option("HZ", f"frames a second (default {RATE_DEFAULT})", low=RATE_MIN, high=RATE_MAX, unit="Hz"),
    ] = RATE_DEFAULT
    seed: Annotated[int, Option("S", "of a scenario that is drawn")] = 1
    axis: Annotated[
        tuple[str, ...],
        Option(
            "CHANNEL=N",
            "of the gamepad, - before an inverted one; default: roll=3 pitch=-4 throttle=-1 yaw=0",
        ),
    ] = ()
    button: Annotated[
        tuple[str, ...], Option("CHANNEL=N", "high while it is held; default: aux1=4 aux2=5")
    ] = ()
    whole_throttle: Annotated[
        bool,
        Option(
            None,
            "the throttle stick stays where it is put: its whole way counts, not the half above its middle",
        ),
    ] = False
    json: Json = False

    def run(self) -> int:
        """Send until the source ends, or Ctrl-C. Returns 0 when the board said that it is disarmed, else 1;
        raises NeuroflightError."""
        return self.carry_out(time.monotonic, time.sleep)

    def carry_out(self, clock: Callable[[], float], sleep: Callable[[float], None]) -> int:
        """Do the same as `run`, with the time of `clock` [s] and `sleep`."""
        from neuroflight.flash.channels.sender import Sender

        with ExitStack() as ends:
            make = _source(self, ends)
            client = ends.enter_context(connect(self.port))
            layout = _layout(client)
            source = make(layout)
            if self.allow_arm:
                confirm_props_off(
                    self.props_off, "rc may arm the board, and its motors turn as the throttle says"
                )
            ends.enter_context(one_interrupt())
            sender = Sender(
                client,
                layout,
                may_arm=self.allow_arm,
                rate_hz=self.rate,
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
                    counts = asdict(sender.count) | {"disarmed": sender.disarmed}
                    Account(self.json).end(counts, _summary(sender))
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


def _source(args: Channels, ends: ExitStack) -> Callable[[Layout], Source]:
    """Return a function that makes the source from the board's layout of channels; errors of the source
    itself are raised before the board is asked."""
    if args.script is not None:
        return _script(args, args.script)
    if args.scenario is not None:
        return _scenario(args, args.scenario)
    assert args.gamepad is not None
    return _gamepad(args, args.gamepad, ends)


def _script(args: Channels, path: Path) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.script import check_script, read_script

    script = read_script(path)

    def make(layout: Layout) -> Source:
        check_script(script, layout, may_arm=args.allow_arm)
        return script

    return make


def _scenario(args: Channels, name: str) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.timeline import Timeline
    from neuroflight.sim.flight.scenario import load_scenario

    if not args.allow_arm:
        raise NeuroflightError(
            f"scenario {name}: it arms, expected --allow-arm; give it if the motors may turn; "
            "nothing was sent"
        )
    scenario = load_scenario(name, args.seed)
    if scenario.by_eye:
        raise NeuroflightError(
            f"scenario {name}: its pilot flies by the twin's height, which nobody sees here; "
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
                f"scenario {name}: its arm switch does not arm this board, expected the range of "
                "mode1 as set by default; write a --script for its modes; nothing was sent"
            )
        return Timeline(rest, LEAD_S, tuple(armed), ARMED_S, args.rate, rows)

    return make


def _gamepad(args: Channels, number: int, ends: ExitStack) -> Callable[[Layout], Source]:
    from neuroflight.flash.channels.gamepad import DEFAULT_AXES, DEFAULT_BUTTONS, Gamepad, parse_mapping

    mapping = parse_mapping(
        args.axis or DEFAULT_AXES,
        args.button or DEFAULT_BUTTONS,
        throttle_from_centre=not args.whole_throttle,
    )
    gamepad = ends.enter_context(Gamepad(number, mapping))

    def make(layout: Layout) -> Source:
        Account(args.json).say(f"gamepad {gamepad.name}; Ctrl-C ends")
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
