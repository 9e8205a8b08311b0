"""`neuroflight board gateway`: a running firmware as a MAVLink aircraft."""

from __future__ import annotations

import json
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.state import OnPort
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from neuroflight.flash.mavlink.endpoint import UdpPeer
    from neuroflight.flash.mavlink.session import Session

PEERS_MAX = 8
SYSTEM_MAX = 255
WAIT_MAX_S = 0.5  # longest wait for the peers before the board's line is served again


@dataclass(frozen=True, kw_only=True)
class Gateway(OnPort):
    """A request to carry MAVLink between a firmware and its peers."""

    mavlink: Annotated[
        tuple[str, ...],
        Option(
            "udp:HOST:PORT",
            "where a ground station or companion listens, such as udp:127.0.0.1:14550; may be repeated",
            once=True,
            most=PEERS_MAX,
        ),
    ]
    system: Annotated[int, Option("ID", "of the aircraft (default 1)", low=1, high=SYSTEM_MAX)] = 1
    offboard: Annotated[
        bool, Option(None, "a companion that enables it may steer; needs the MSP receiver")
    ] = False
    allow_arm: Annotated[bool, Option(None, "with --offboard: who steers may arm; propellers turn")] = False
    timeout: Annotated[
        float,
        Option(
            "S",
            "silence of who steers until no more channels are sent and the failsafe acts (default 0.3)",
            low=0.05,
            high=1.0,
            unit="s",
        ),
    ] = 0.3
    allow_remote: Annotated[
        bool, Option(None, "peers may be other computers; MAVLink asks for no password")
    ] = False
    json: Annotated[bool, Option(None, "print each event as a line of JSON")] = False

    def run(self) -> int:
        """Carry MAVLink until Ctrl-C. Raises NeuroflightError for what cannot be done."""
        import time
        from functools import partial

        from neuroflight.flash.link.client import Client
        from neuroflight.flash.link.transport import open_transport
        from neuroflight.flash.mavlink.endpoint import UdpPeer, parse_address
        from neuroflight.flash.mavlink.session import Options, Session

        if self.allow_arm and not self.offboard:
            raise NeuroflightError(
                "--allow-arm got no --offboard beside it: only who steers may arm; give both"
            )
        addresses = [parse_address(text, remote=self.allow_remote) for text in self.mavlink]
        options = Options(
            offboard=self.offboard, allow_arm=self.allow_arm, timeout_s=self.timeout, system=self.system
        )
        with ExitStack() as stack:
            peers = [stack.enter_context(closing(UdpPeer(address))) for address in addresses]
            reopen = partial(open_transport, self.port)
            client = stack.enter_context(Client(reopen()))
            session = stack.enter_context(
                closing(Session(client, peers, options, time.monotonic, self._say, reopen))
            )
            self._say(f"gateway between {client.name} and {', '.join(self.mavlink)}; Ctrl-C ends it")
            with suppress(KeyboardInterrupt):  # Ctrl-C is the usual way to end it
                _serve(session, peers)
        return 0

    def _say(self, line: str) -> None:
        print(json.dumps({"event": line}) if self.json else line, flush=True)


def _serve(session: Session, peers: Sequence[UdpPeer]) -> None:
    """Carry messages until an exception ends it."""
    import select

    while True:
        select.select(peers, [], [], min(session.step(), WAIT_MAX_S))
