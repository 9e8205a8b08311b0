"""An MSP client: one request, one reply, or a LinkError of one line."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from neuroflight.flash.link import requests
from neuroflight.flash.link.msp import Corrupt, Decoder, Direction, Message, encode, request
from neuroflight.flash.link.transport import Transport
from neuroflight.toolchain.contract import Msp, Refusal
from neuroflight.toolchain.errors import LinkError

TIMEOUT_S = 1.0  # a board answers within a few milliseconds, the emulated one within tenths of a second
STORING_TIMEOUT_S = (
    5.0  # erasing the largest sector takes up to two seconds, and nothing else goes on meanwhile
)
RETRIES = 2
PATIENCE_S = 30.0  # with a line that is silent, where it may come back
UNASKED_MAX = 4096  # unsolicited messages kept, for each command

Reply = TypeVar("Reply")


class NoAnswerError(LinkError):
    """No answer came: it is unknown whether the request was carried out."""


class RefusedError(LinkError):
    """The firmware refused a request."""

    def __init__(self, message: str, reason: Refusal | None = None) -> None:
        """reason: as the firmware gave it; None: without one, as for a command it does not know."""
        super().__init__(message)
        self.reason = reason


def patiently(
    client: Client, ask: Callable[[], Reply], clock: Callable[[], float], patience_s: float = PATIENCE_S
) -> Reply:
    """Repeat `ask` while nobody answers, without late replies to earlier requests, and return its result.

    Raises LinkError after `patience_s` of silence.
    """
    deadline = clock() + patience_s
    while True:
        try:
            client.settle()
            return ask()
        except NoAnswerError:
            if clock() > deadline:
                raise


class Client:
    """An MSP client that owns an open transport: use it in a `with`, or close it."""

    def __init__(
        self,
        transport: Transport,
        clock: Callable[[], float] = time.monotonic,
        *,
        timeout: float = TIMEOUT_S,
        retries: int = RETRIES,
    ) -> None:
        """clock: monotonic [s]. timeout [s], retries: for requests that give none of their own."""
        self._timeout, self._retries = timeout, retries
        self._transport = transport
        self._clock = clock
        self._decoder = Decoder()
        self._late: set[int] = set()  # commands whose replies to earlier tries may still come
        self._unasked: dict[int, deque[Message]] = {}  # by command
        self.corrupt = 0  # frames so far that began and could not be used

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the line."""
        self._transport.close()

    @property
    def name(self) -> str:
        """The port as the user would write it."""
        return self._transport.name

    def request(
        self, command: Msp, payload: bytes = b"", timeout: float | None = None, retries: int | None = None
    ) -> bytes:
        """Ask for `command` and return the payload of the reply.

        timeout: seconds to wait for each try; None: as long as the command may take. retries: how often to
        ask again after silence or corruption; None: as the client was made, but never for a command that acts
        where doing it twice is not doing it once. A firmware that refuses is not asked again.
        Raises RefusedError for a refusal, NoAnswerError for silence and for corruption, LinkError for a line
        that is gone.
        """
        if timeout is None:
            timeout = STORING_TIMEOUT_S if command in requests.STORING else self._timeout
        if retries is None:
            retries = self._retries if requests.repeatable(command, payload) else 0
        if command in self._late:
            self.settle()
        failures: list[Corrupt] = []
        skipped = self._decoder.skipped
        for tried in range(1 + retries):
            if tried:
                self._late.add(command)
            self._transport.write(encode(request(command, payload)))
            answer = self._answer(command, self._clock() + timeout, failures)
            if answer is not None:
                if answer.direction is Direction.ERROR:
                    raise self._refused(command, answer.payload)
                return answer.payload
        self._late.add(command)
        raise self._no_answer(
            command, payload, timeout, 1 + retries, failures, self._decoder.skipped - skipped
        )

    def post(self, command: Msp, payload: bytes) -> None:
        """Send a request and do not wait: `collect` gets the replies, in the order of requests; any of them
        may be lost. Only for commands whose replies say what they answer."""
        self._late.add(command)
        self._transport.write(encode(request(command, payload)))

    def collect(self, command: Msp, timeout: float) -> bytes | None:
        """Return the payload of the next reply to a posted `command`; None after `timeout` [s].

        Raises RefusedError.
        """
        message = self._next(command, timeout)
        if message is not None and message.direction is Direction.ERROR:
            raise self._refused(command, message.payload)
        return None if message is None else message.payload

    def receive(self, command: Msp, timeout: float) -> bytes | None:
        """Return the payload of the next unsolicited `command`; None after `timeout` [s]."""
        deadline = self._clock() + timeout
        while (message := self._next(command, max(deadline - self._clock(), 0.0))) is not None:
            if message.direction is Direction.REPLY:
                return message.payload
        return None

    def _next(self, command: Msp, timeout: float) -> Message | None:
        """Return the next `command` kept or received within `timeout` [s]; other messages are kept."""
        deadline = self._clock() + timeout
        while True:
            if waiting := self._unasked.get(command):
                return waiting.popleft()
            left = deadline - self._clock()
            if left <= 0:
                return None
            for message in self._messages(left, []):
                self._keep(message)

    def _keep(self, message: Message) -> None:
        """Keep a message until it is asked for; drop echoes of own requests."""
        if message.direction is not Direction.REQUEST:
            self._unasked.setdefault(message.command, deque(maxlen=UNASKED_MAX)).append(message)

    def settle(self) -> None:
        """Wait until no reply to an earlier request can come any more, however often the line doubled one.

        Replies come in the order of requests: behind that to another one, none to an earlier comes.
        """
        self._late.clear()
        self.request(Msp.API_VERSION)  # harmless, because its replies are all the same

    def _answer(self, command: Msp, deadline: float, failures: list[Corrupt]) -> Message | None:
        """Wait for the reply to `command`; None after the deadline. Corrupt frames join `failures`."""
        while (left := deadline - self._clock()) > 0:
            answer = None
            for message in self._messages(left, failures):
                if message.direction is Direction.REQUEST:  # the line's own echo
                    continue
                if answer is None and message.command == command:
                    answer = message
                else:
                    self._keep(message)
            if answer is not None:
                return answer
        return None

    def _messages(self, timeout: float, failures: list[Corrupt]) -> list[Message]:
        """Read what has arrived, or what arrives first within `timeout` [s]."""
        data = self._transport.read(timeout)
        # On silence the unfinished frame is discarded: its length may be wrong and hide a true frame.
        events = self._decoder.feed(data) if data else self._decoder.flush()
        corrupt = [event for event in events if isinstance(event, Corrupt)]
        failures += corrupt
        self.corrupt += len(corrupt)
        return [event for event in events if isinstance(event, Message)]

    def _refused(self, command: Msp, payload: bytes) -> RefusedError:
        if why := requests.refusal(payload):
            message = f"{self._transport.name}: the firmware refuses MSP {command.name}: {why}"
            return RefusedError(message, requests.refusal_reason(payload))
        return RefusedError(
            f"{self._transport.name}: the firmware refuses MSP {command.name} ({command:d}), "
            "expected a reply; it does not know it: bring it and this tool to the same version"
        )

    def _no_answer(
        self, command: Msp, payload: bytes, timeout: float, tries: int, failures: list[Corrupt], skipped: int
    ) -> NoAnswerError:
        if failures:
            got = f"{len(failures)} corrupt frame(s), the last with {failures[-1].reason.value}"
            mend = "check the cable and that both ends use the same baud rate"
        elif skipped or self._decoder.pending:
            got = f"{skipped + self._decoder.pending} bytes that are no MSP"
            mend = "check that this is the firmware's MSP port and both ends use the same baud rate"
        else:
            got = "silence"
            mend = "check that the firmware runs and that this is its MSP port"
        if not requests.repeatable(command, payload):
            mend += "; it may have been carried out, so it was not asked again"
        return NoAnswerError(
            f"{self._transport.name}: got {got}, "
            f"expected a reply to MSP {command.name} within {timeout:g} s, asked {tries} time(s); {mend}"
        )
