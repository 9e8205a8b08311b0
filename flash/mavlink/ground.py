"""The ground: all peers together, with messages for all of them and answers to one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from neuroflight.flash.mavlink.endpoint import Peer, Wire
from neuroflight.flash.mavlink.offboard import Source
from neuroflight.flash.mavlink.texts import Text, status_texts

PACKETS_MAX = 32  # read from a peer at a time, so that none delays the others
COMPLAINT_PERIOD_S = 1.0  # between two complaints
REFUSALS_MAX = 8  # in it
EVERYBODY = 0  # as a target's id
COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1


class Ground:
    """The peers of one aircraft."""

    def __init__(
        self,
        peers: Sequence[Peer],
        system: int,
        clock: Callable[[], float],
        say: Callable[[str], None],
    ) -> None:
        """system: MAVLink's id of the aircraft. say: called with each text sent to the peers."""
        self._wires = [Wire(peer, system) for peer in peers]
        self._system, self._clock, self._say = system, clock, say
        self._texts = 0
        self._complained = -math.inf  # s, the last time
        self._refused: dict[str, float] = {}  # lines of the last second, and when

    def heard(self) -> Iterator[tuple[Source, Any]]:
        """Yield the messages addressed to this aircraft or to all, each with its sender."""
        for index, wire in enumerate(self._wires):
            for message in wire.messages(PACKETS_MAX):
                source = (index, message.get_srcSystem(), message.get_srcComponent())
                if source[1:] != (self._system, COMPONENT) and self._is_meant(message):
                    yield source, message

    def _is_meant(self, message: Any) -> bool:  # noqa: ANN401 - pymavlink's are untyped
        system = getattr(message, "target_system", getattr(message, "target", EVERYBODY))
        component = getattr(message, "target_component", EVERYBODY)
        return system in (EVERYBODY, self._system) and component in (EVERYBODY, COMPONENT)

    def broadcast(self, message: Any) -> None:  # noqa: ANN401
        """Send a message to all."""
        self.broadcast_each(lambda _: message)

    def broadcast_each(self, message: Callable[[int], Any]) -> None:
        """Send to each peer the message that `message` returns for its number."""
        for index, wire in enumerate(self._wires):
            wire.send(message(index))

    def answer(self, source: Source, message: Any) -> None:  # noqa: ANN401
        """Send a message to the peer of `source`."""
        self._wires[source[0]].send(message)

    def tell(self, severity: int, line: str) -> None:
        """Send a text to all."""
        self._texts = self._texts % 0xFFFF + 1
        for message in status_texts(Text(severity, line), self._texts):
            self.broadcast(message)
        self._say(line)

    def complain(self, line: str) -> None:
        """Send a warning about a repeated message of a peer, at most one a second."""
        if self._clock() >= self._complained + COMPLAINT_PERIOD_S:
            self._complained = self._clock()
            self.tell(mavlink.MAV_SEVERITY_WARNING, line)

    def refuse(self, line: str) -> None:
        """Send the reason for a refusal: each text once a second and REFUSALS_MAX texts at most, so that a
        peer that floods the gateway does not flood the others."""
        now = self._clock()
        self._refused = {told: at for told, at in self._refused.items() if now < at + COMPLAINT_PERIOD_S}
        if line not in self._refused and len(self._refused) < REFUSALS_MAX:
            self._refused[line] = now
            self.tell(mavlink.MAV_SEVERITY_WARNING, line)
