"""An image from its file onto a board, whole: settings kept, bank written, checked, switched, proven.

    settings read, bank written, policy written, switched, restarted and tried, settings compared
    BEFORE         WRITING       POLICY          WRITTEN   SWITCHED             ENDED

Wherever it ends early, `Installation.consequence` says what that means for the board: until the switch the
old image stays, after it the board itself decides by whether the new image proves good.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto

from neuroflight.flash.board.restart import restart
from neuroflight.flash.image.files import bank_name
from neuroflight.flash.image.plan import InstallPlan
from neuroflight.flash.image.settings_kept import Kept, keep_settings, read_settings
from neuroflight.flash.image.trial import Ending, Trial, await_image
from neuroflight.flash.image.update import Clock, Progress, switch, write_image
from neuroflight.flash.link.client import Client, patiently
from neuroflight.flash.link.transport import Transport
from neuroflight.flash.policy import swap
from neuroflight.flash.settings.text import Value
from neuroflight.toolchain.errors import LinkError


class Stage(Enum):
    """Stages of an installation, in order."""

    BEFORE = auto()
    WRITING = auto()
    POLICY = auto()
    WRITTEN = auto()
    SWITCHED = auto()
    ENDED = auto()


@dataclass(frozen=True)
class Installed:
    """The result of an installation."""

    trial: Trial
    kept: Kept | None  # None: the new image does not run
    restarts: int


class Installation:
    """The execution of an installation plan. It owns the client from `run` on."""

    def __init__(
        self,
        client: Client,
        plan: InstallPlan,
        reopen: Callable[[], Transport],
        progress: Progress,
        clock: Clock = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """reopen: opens the line again if it is lost when the board restarts. clock, sleep: in seconds."""
        self.client = client
        self.plan = plan
        self.stage = Stage.BEFORE
        self._reopen, self._progress = reopen, progress
        self._clock, self._sleep = clock, sleep
        self._written = 0

    @property
    def consequence(self) -> str:
        """Consequence for the board if nothing more happens, as the end of a sentence."""
        new, old = bank_name(self.plan.bank), bank_name(self.plan.board.banks.running)
        match self.stage:
            case Stage.BEFORE:
                return "nothing was written"
            case Stage.WRITING:
                return (
                    f"{new} has {self._written:,} of {self.plan.bytes:,} bytes of the new image and is not "
                    f"started, {old} was not written and stays; the same command goes on from there, or "
                    "begins anew if the board was off meanwhile"
                )
            case Stage.POLICY:
                return (
                    f"{new} was written and is not started before its policy is there, {old} and the "
                    "policy that it flies were not written and stay; the same command goes on"
                )
            case Stage.WRITTEN:
                return (
                    f"{new} was written, {old} was not; whether the switch got through is not known, the "
                    "same command tells it or does it again"
                )
            case Stage.SWITCHED:
                return (
                    f"{new} was written and is started from the next boot on, {old} was not written; the "
                    "board goes back to it by itself unless the new image proves good"
                )
            case Stage.ENDED:
                return "the image was written and decided on; its settings were not compared"

    def run(self, settings: Mapping[str, Value], *, reboot: bool = True) -> Installed | None:
        """Carry out the plan; without `reboot` up to the switch, then return None. settings: those from
        before.

        Raises LinkError, which ends with the consequence.
        """
        try:
            self._write_and_switch()
            return self._prove(settings) if reboot else None
        except LinkError as error:
            raise LinkError(f"{error}; {self.consequence}") from None

    def _write_and_switch(self) -> None:
        image = self.plan.image
        self.stage = Stage.WRITING
        write_image(self.client, image, self._count, self._clock)
        if self.plan.policy is not None:
            self.stage = Stage.POLICY
            line = swap.Board(self._reopen, self._clock, self._sleep)
            self.client, _ = swap.write(self.client, self.plan.policy, line, self._count_policy)
        self.stage = Stage.WRITTEN
        switch(self.client, image, self._clock)
        self.stage = Stage.SWITCHED

    def _prove(self, settings: Mapping[str, Value]) -> Installed:
        image = self.plan.image
        self._restart()
        self._progress("prove", 0, 1)
        self.client, trial = await_image(self.client, image, self._reopen, self._clock, self._sleep)
        self._progress("prove", 1, 1)
        self.stage = Stage.ENDED
        if trial.ending not in (Ending.KEPT, Ending.POLICY_BAD):
            return Installed(trial, None, 1)
        now = patiently(self.client, lambda: read_settings(self.client), self._clock)
        kept = keep_settings(self.client, settings, now)
        if kept.restored:
            self._restart()  # settings take effect at the next boot
        return Installed(trial, kept, 2 if kept.restored else 1)

    def _restart(self) -> None:
        self.client = restart(self.client, self._reopen, self._clock, self._sleep)

    def _count_policy(self, done: int, total: int) -> None:
        self._progress("policy", done, total)

    def _count(self, what: str, done: int, total: int) -> None:
        if what == "write":
            self._written = done
        self._progress(what, done, total)
