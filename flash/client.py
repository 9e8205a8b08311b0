"""An MSP client: one request, one reply, or a LinkError of one line."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from flash import messages, requests
from flash.messages import ApiVersion, BoardInfo, BuildInfo, PolicyInfo
from flash.msp import Corrupt, Decoder, Direction, Message, encode, request
from flash.transport import Transport
from toolchain.contract import MSP_API_MAJOR, MSP_PROTOCOL_VERSION, MSP_VARIANT, Msp
from toolchain.errors import LinkError

TIMEOUT_S = 1.0  # a board answers within a few milliseconds, the emulated one within tenths of a second
STORING_TIMEOUT_S = (
    5.0  # erasing the largest sector takes up to two seconds, and nothing else goes on meanwhile
)
RETRIES = 2


class Client:
    """Speaks MSP over an open transport, which it owns: use it in a `with`, or close it."""

    def __init__(self, transport: Transport, clock: Callable[[], float] = time.monotonic) -> None:
        """clock: seconds, never going back."""
        self._transport = transport
        self._clock = clock
        self._decoder = Decoder()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the line."""
        self._transport.close()

    def request(
        self, command: Msp, payload: bytes = b"", timeout: float | None = None, retries: int = RETRIES
    ) -> bytes:
        """Ask for `command` and return the payload of the reply.

        timeout: seconds to wait for each try; None: as long as the command may take. retries: how often
        to ask again after silence or corruption; a firmware that refuses is not asked again.
        Raises LinkError for a refusal, for silence, for corruption and for a line that is gone.
        """
        if timeout is None:
            timeout = STORING_TIMEOUT_S if command in requests.STORING else TIMEOUT_S
        failures: list[Corrupt] = []
        skipped = self._decoder.skipped
        for _ in range(1 + retries):
            self._transport.write(encode(request(command, payload)))
            answer = self._answer(command, self._clock() + timeout, failures)
            if answer is not None:
                if answer.direction is Direction.ERROR:
                    raise self._refused(command, answer.payload)
                return answer.payload
        raise self._no_answer(command, timeout, 1 + retries, failures, self._decoder.skipped - skipped)

    def _answer(self, command: Msp, deadline: float, failures: list[Corrupt]) -> Message | None:
        """Reply or refusal of `command`, None after the deadline; what was corrupt joins `failures`."""
        while (left := deadline - self._clock()) > 0:
            data = self._transport.read(left)
            # On silence the unfinished frame is given up: a true one may hide behind its false length.
            events = self._decoder.feed(data) if data else self._decoder.flush()
            failures += [event for event in events if isinstance(event, Corrupt)]
            for event in events:
                if (
                    isinstance(event, Message)
                    and event.command == command
                    and event.direction is not Direction.REQUEST  # the line's own echo
                ):
                    return event
        return None

    def _refused(self, command: Msp, payload: bytes) -> LinkError:
        if why := requests.refusal(payload):
            return LinkError(f"{self._transport.name}: the firmware refuses MSP {command.name}: {why}")
        return LinkError(
            f"{self._transport.name}: the firmware refuses MSP {command.name} ({command:d}), "
            "expected a reply; it does not know it: bring it and this tool to the same version"
        )

    def _no_answer(
        self, command: Msp, timeout: float, tries: int, failures: list[Corrupt], skipped: int
    ) -> LinkError:
        if failures:
            got = f"{len(failures)} corrupt frame(s), the last with {failures[-1].reason.value}"
            mend = "check the cable and that both ends use the same baud rate"
        elif skipped or self._decoder.pending:
            got = f"{skipped + self._decoder.pending} bytes that are no MSP"
            mend = "check that this is the firmware's MSP port and both ends use the same baud rate"
        else:
            got = "silence"
            mend = "check that the firmware runs and that this is its MSP port"
        return LinkError(
            f"{self._transport.name}: got {got}, "
            f"expected a reply to MSP {command.name} within {timeout:g} s, asked {tries} time(s); {mend}"
        )


@dataclass(frozen=True)
class Info:
    """What a firmware says about itself."""

    variant: str
    version: str
    api: ApiVersion
    board: BoardInfo
    build: BuildInfo
    name: str
    uid: str
    control_period_us: int
    armed: bool
    arming_reasons: tuple[str, ...]  # what forbids arming now
    policy: PolicyInfo | None  # None from a firmware of another make


def read_info(client: Client) -> Info:
    """Read a firmware's identity and state. Raises LinkError."""
    api = messages.api_version(client.request(Msp.API_VERSION))
    if (api.protocol, api.major) != (MSP_PROTOCOL_VERSION, MSP_API_MAJOR):
        raise LinkError(
            f"the firmware speaks MSP {api.protocol}.{api.major}.{api.minor}, expected "
            f"{MSP_PROTOCOL_VERSION}.{MSP_API_MAJOR}.x; bring it and this tool to the same version"
        )
    variant = messages.fc_variant(client.request(Msp.FC_VARIANT))
    ours = variant == MSP_VARIANT
    extended = messages.status_ex(client.request(Msp.STATUS_EX))
    status, flags = extended.status, extended.arming_flags
    return Info(
        variant=variant,
        version=messages.fc_version(client.request(Msp.FC_VERSION)),
        api=api,
        board=messages.board_info(client.request(Msp.BOARD_INFO)),
        build=messages.build_info(client.request(Msp.BUILD_INFO)),
        name=messages.name(client.request(Msp.NAME)),
        uid=messages.uid(client.request(Msp.UID)),
        control_period_us=status.cycle_time_us,
        armed=status.armed,
        arming_reasons=messages.arming_reasons(flags) if ours else messages.bit_names(flags),
        policy=messages.policy_info(client.request(Msp.POLICY_INFO)) if ours else None,
    )
