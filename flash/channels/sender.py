"""Sends channels to a board at a fixed rate, begins at rest and ends disarmed.

However it ends (the source has told all, is gone, Ctrl-C, an error), frames with the arm switch off and the
throttle down go out first; then nothing, so that the board's failsafe sees a receiver that fell silent. If
the line itself is gone the failsafe alone acts: rates centred after failsafe_hold_ms, its stage later.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from neuroflight.flash.channels.layout import Channels, Layout, throttle_low
from neuroflight.flash.channels.source import Instead, Source
from neuroflight.flash.link import messages, records, requests
from neuroflight.flash.link.client import Client, NoAnswerError, RefusedError
from neuroflight.toolchain.contract import ArmingReason, Msp, Refusal
from neuroflight.toolchain.errors import LinkError

RATE_HZ = 50.0
ANSWER_S = 0.25  # for the reply to a frame
LOST_S = 1.0  # without an accepted frame until the line counts as lost
LINK_S = 5.0  # until the board accepts the receiver's link
ENDING_FRAMES = 10  # with the switch off, at least; the board needs two in a row
ENDING_S = 1.0  # until it must report that it is disarmed
LOOK_S = 0.5  # between two looks at whether it is armed
BEHIND_TOLD_S = 1.0  # between two warnings
BEHIND_SHARE = 0.1  # share of late frames in that time that causes a warning


@dataclass
class Count:
    """Numbers of frames sent, refused, unanswered and late."""

    taken: int = 0
    passed_over: int = 0  # rejected because the board had not processed the one before
    late: int = 0  # due but never sent, because their time had passed
    unanswered: int = 0


class Sender:
    """A sender of channels for a `with` block: leaving it disarms and stops sending."""

    def __init__(
        self,
        client: Client,
        layout: Layout,
        *,
        may_arm: bool = False,
        rate_hz: float = RATE_HZ,
        tell: Callable[[str], None] = lambda line: None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """may_arm: False: no frame that arms is sent. tell: called with each warning, one line."""
        self.count = Count()
        self.disarmed = False  # at the end: the board has reported it
        self.began = False  # a frame went out
        self._client, self._layout, self._may_arm = client, layout, may_arm
        self._period, self._tell, self._clock, self._sleep = 1 / rate_hz, tell, clock, sleep
        self._due = self._taken_at = self._looked_at = self._behind_at = clock()
        self._behind = 0  # frames late since the last warning

    def __enter__(self) -> Sender:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(LinkError):  # the board's failsafe acts instead
            self._end()

    # --- Begin ---------------------------------------------------------------------------------------
    def begin(self) -> None:
        """Send rest until the board believes its receiver. Raises LinkError; for an armed board at once."""
        if self._is_armed():
            raise LinkError(
                f"{self._client.name}: the board is armed, expected disarmed; put its arm switch off, end "
                "whatever sends it channels; nothing was sent"
            )
        self._due = self._behind_at = self._clock()
        deadline = self._due + LINK_S
        for _ in self._paced():
            self._send(self._layout.resting())
            if not self._reasons() & 1 << ArmingReason.RECEIVER_LOST:
                return
            if self._clock() >= deadline:
                raise LinkError(
                    f"{self._client.name}: the board tells RECEIVER_LOST after {self.count.taken} frames in "
                    f"{LINK_S:g} s, expected it to believe them; look at `neuroflight board monitor`"
                )

    def await_rest(self, source: Source) -> None:
        """Send rest until the source's own throttle is low and its arm switch off."""
        told, begin = False, self._clock()
        for _ in self._paced():
            channels = source.at(self._clock() - begin)
            if isinstance(channels, Instead) or (throttle_low(channels) and not self._layout.arms(channels)):
                return
            if not told:
                self._tell("put the throttle down and the arm switch off; rest is sent until then")
                told = True
            self._send(self._layout.resting())

    # --- Fly -----------------------------------------------------------------------------------------
    def run(self, source: Source) -> None:
        """Send what the source tells until it ends.

        Raises LinkError when the line or the source is lost, and for an arm switch that may not be on.
        """
        begin = self._taken_at = self._clock()
        for _ in self._paced():
            told = source.at(self._clock() - begin)
            if told is Instead.END:
                return
            if told is Instead.SILENCE:
                self._taken_at = self._clock()
                continue
            assert not isinstance(told, Instead)
            if self._layout.arms(told) and not self._may_arm:
                raise LinkError("the arm switch is on, expected off without --allow-arm; it was not sent")
            self._send(told)
            self._look()

    # --- End -----------------------------------------------------------------------------------------
    def _end(self) -> None:
        """Send the arm switch off and the throttle down until the board reports that it is disarmed."""
        if not self.began:
            return
        self._taken_at = self._clock()
        self._due = max(self._due, self._taken_at)
        deadline = self._taken_at + ENDING_S
        for frames, _ in enumerate(self._paced(), 1):
            self._send(self._layout.resting())
            if frames >= ENDING_FRAMES:
                self.disarmed = not self._is_armed()
                if self.disarmed or self._clock() >= deadline:
                    return

    # --- Shared --------------------------------------------------------------------------------------
    def _paced(self) -> Iterator[None]:
        """Yield once each period; periods that have passed already are skipped."""
        while True:
            ahead = self._due - self._clock()
            if ahead > 0:
                self._sleep(ahead)
            missed = int(max(0.0, self._clock() - self._due) / self._period)
            if missed:
                self._note_late(missed)
            self._due += (1 + missed) * self._period
            yield

    def _note_late(self, frames: int) -> None:
        """Count frames that were due and could not be sent in time; warn if they are many."""
        self.count.late += frames
        self._behind += frames
        since = self._clock() - self._behind_at
        if since >= BEHIND_TOLD_S:
            if self._behind * self._period > BEHIND_SHARE * since:
                self._tell(
                    f"sending falls behind: {self._behind} of {since / self._period:.0f} frames in the last "
                    f"{since:.1f} s were late and not sent; use a faster line, or close other programs"
                )
            self._behind, self._behind_at = 0, self._clock()

    def _send(self, channels: Channels) -> None:
        """Send one frame. Raises LinkError if the board refuses it or none was answered for LOST_S."""
        payload = requests.set_raw_rc(self._layout.on_wire(channels))
        self.began = True
        try:
            self._client.request(Msp.SET_RAW_RC, payload, timeout=ANSWER_S)
        except NoAnswerError:
            self.count.unanswered += 1
        except RefusedError as error:
            if error.reason is not Refusal.ORDER:
                raise
            self.count.passed_over += 1
        else:
            self.count.taken += 1
            self._taken_at = self._clock()
        if self._clock() - self._taken_at >= LOST_S:
            raise LinkError(
                f"{self._client.name}: no frame was taken for {LOST_S:g} s, expected {1 / self._period:g} a "
                "second; the board's failsafe acts; check the cable, and that the firmware gets gyro samples"
            )

    def _look(self) -> None:
        """Raise LinkError if the board is armed without permission: its settings have changed."""
        if self._may_arm or self._clock() - self._looked_at < LOOK_S:
            return
        self._looked_at = self._clock()
        if self._is_armed():
            raise LinkError(
                f"{self._client.name}: the board armed though no channel that its settings name is on; "
                "disarmed again; restart it, so that it flies the settings that it tells"
            )

    def _is_armed(self) -> bool:
        return messages.status(self._client.request(Msp.STATUS)).armed

    def _reasons(self) -> int:
        return records.safety(self._client.request(Msp.SAFETY)).arming_flags
