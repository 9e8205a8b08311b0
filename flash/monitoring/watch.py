"""Repeated looks at a firmware, through restarts and pulled cables."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.flash.board.info import Info, read_info
from neuroflight.flash.link.client import Client, NoAnswerError
from neuroflight.flash.link.transport import Transport
from neuroflight.flash.monitoring.snapshot import Snapshot, read_snapshot
from neuroflight.toolchain.errors import LinkError

ANSWER_S = 0.5  # for one answer: a display must not stand still for long


@dataclass(frozen=True)
class Sight:
    """The result of one look: the state and the quality of the link."""

    info: Info | None  # None: nobody has answered yet
    snapshot: Snapshot | None  # newest
    problem: str  # reason why this look found nothing new; "": none
    silent_s: float  # since the last successful look
    looks: int  # so far
    failed: int  # of them
    corrupt: int  # frames so far
    restarts: int  # of the firmware so far
    reconnects: int  # of the line so far
    answer_ms: float  # that the look took


class Watch:
    """A watcher with a line of its own, which is opened again whenever it is lost."""

    def __init__(self, reopen: Callable[[], Transport], clock: Callable[[], float] = time.monotonic) -> None:
        """reopen: opens the line."""
        self._reopen, self._clock = reopen, clock
        self._client: Client | None = None
        self._info: Info | None = None
        self._snapshot: Snapshot | None = None
        self._seen_at = clock()
        self._looks = self._failed = self._restarts = self._connects = 0
        self._corrupt = 0  # on lines that are closed

    def __enter__(self) -> Watch:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def look(self) -> Sight:
        """Look once. If the firmware does not answer, the Sight has a problem; no error is raised."""
        self._looks += 1
        begin, problem = self._clock(), ""
        try:
            self._see()
            self._seen_at = self._clock()
        except NoAnswerError as error:  # it may be starting anew: the line stays
            problem = str(error)
        except LinkError as error:
            problem = str(error)
            self._close()
        self._failed += bool(problem)
        return Sight(
            info=self._info,
            snapshot=self._snapshot,
            problem=problem,
            silent_s=self._clock() - self._seen_at,
            looks=self._looks,
            failed=self._failed,
            corrupt=self._corrupt + (self._client.corrupt if self._client is not None else 0),
            restarts=self._restarts,
            reconnects=max(0, self._connects - 1),
            answer_ms=1000 * (self._clock() - begin),
        )

    def _see(self) -> None:
        """Read the firmware's state and keep it. Raises LinkError."""
        fresh = self._client is None
        if self._client is None:
            self._client = Client(self._reopen(), self._clock, timeout=ANSWER_S, retries=0)
            self._connects += 1
        if fresh or self._info is None:
            self._info = read_info(self._client)
        seen = read_snapshot(self._client, self._info)
        if self._has_restarted(seen):
            self._restarts += 1
            self._info = read_info(self._client)  # it may fly another policy now
        self._snapshot = seen

    def _has_restarted(self, seen: Snapshot) -> bool:
        """Return True if the count of boots has changed; another make of firmware gives none."""
        before = self._snapshot.overview.flight if self._snapshot is not None else None
        now = seen.overview.flight
        return before is not None and now is not None and before.boots != now.boots

    def _close(self) -> None:
        if self._client is not None:
            self._corrupt += self._client.corrupt
            self._client.close()
            self._client = None
