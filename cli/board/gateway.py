"""`neuroflight board gateway`: a running firmware as a MAVLink aircraft."""

from __future__ import annotations

import argparse
from contextlib import ExitStack, closing, suppress
from typing import TYPE_CHECKING

from neuroflight.cli.options import add_port
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from neuroflight.flash.mavlink.endpoint import UdpPeer
    from neuroflight.flash.mavlink.session import Session

PEERS_MAX = 8
SYSTEM_MAX = 255
WAIT_MAX_S = 0.5  # longest wait for the peers before the board's line is served again


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port, the peers and what they are allowed."""
    add_port(parser)
    parser.add_argument(
        "--mavlink",
        required=True,
        action="append",
        metavar="udp:HOST:PORT",
        help="where a ground station or companion listens, such as udp:127.0.0.1:14550; may be repeated",
    )
    parser.add_argument("--system", type=int, default=1, metavar="ID", help="of the aircraft (default 1)")
    parser.add_argument(
        "--offboard",
        action="store_true",
        help="a companion that enables it may steer; needs the MSP receiver",
    )
    parser.add_argument(
        "--allow-arm", action="store_true", help="with --offboard: who steers may arm; propellers turn"
    )
    parser.add_argument(
        "--timeout",
        type=float,
        default=0.3,
        metavar="S",
        help="silence of who steers until no more channels are sent and the failsafe acts (default 0.3)",
    )
    parser.add_argument(
        "--allow-remote",
        action="store_true",
        help="peers may be other computers; MAVLink asks for no password",
    )


def run(args: argparse.Namespace) -> int:
    """Carry MAVLink until Ctrl-C. Raises NeuroflightError for what cannot be done."""
    import time
    from functools import partial

    from neuroflight.flash.link.client import Client
    from neuroflight.flash.link.transport import open_transport
    from neuroflight.flash.mavlink.endpoint import UdpPeer, parse_address
    from neuroflight.flash.mavlink.session import Options, Session

    _check(args)
    addresses = [parse_address(text, remote=args.allow_remote) for text in args.mavlink]
    options = Options(
        offboard=args.offboard, allow_arm=args.allow_arm, timeout_s=args.timeout, system=args.system
    )
    with ExitStack() as stack:
        peers = [stack.enter_context(closing(UdpPeer(address))) for address in addresses]
        reopen = partial(open_transport, args.port)
        client = stack.enter_context(Client(reopen()))
        session = stack.enter_context(closing(Session(client, peers, options, time.monotonic, _say, reopen)))
        _say(f"gateway between {client.name} and {', '.join(args.mavlink)}; Ctrl-C ends it")
        with suppress(KeyboardInterrupt):  # Ctrl-C is the usual way to end it
            _serve(session, peers)
    return 0


def _serve(session: Session, peers: Sequence[UdpPeer]) -> None:
    """Carry messages until an exception ends it."""
    import select

    while True:
        select.select(peers, [], [], min(session.step(), WAIT_MAX_S))


def _check(args: argparse.Namespace) -> None:
    from neuroflight.flash.mavlink.offboard import TIMEOUT_MAX_S, TIMEOUT_MIN_S

    if len(args.mavlink) > PEERS_MAX:
        raise NeuroflightError(f"--mavlink got {len(args.mavlink)} peers, expected {PEERS_MAX} at most")
    if not 1 <= args.system <= SYSTEM_MAX:
        raise NeuroflightError(f"--system got {args.system}, expected 1 to {SYSTEM_MAX}")
    if not TIMEOUT_MIN_S <= args.timeout <= TIMEOUT_MAX_S:
        raise NeuroflightError(
            f"--timeout got {args.timeout:g}, expected {TIMEOUT_MIN_S:g} to {TIMEOUT_MAX_S:g} s"
        )
    if args.allow_arm and not args.offboard:
        raise NeuroflightError("--allow-arm got no --offboard beside it: only who steers may arm; give both")


def _say(line: str) -> None:
    print(line, flush=True)
