"""receiver.c: how long a silence is endured, in gyro samples, and what is flown meanwhile."""

from __future__ import annotations

from typing import Any

import pytest

from toolchain.contract import (
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
)

FLOWN = [1100 + 50 * index for index in range(CHANNEL_COUNT)]
HELD = [1500, 1500, FLOWN[2], 1500, *FLOWN[4:]]  # rates centred; throttle and switches as they were
LOST = [1500, 1500, 1000, 1500, *[1000] * 12]


class Receiver:
    def __init__(self, core: Any, rate_hz: int = 1000) -> None:
        self.lib, self.core = core.lib, core
        self.self = core.new("struct receiver *")
        self.lib.receiver_init(self.self, rate_hz)

    def frame(self, channels: list[int] = FLOWN, frame_lost: bool = False, failsafe: bool = False) -> None:
        self.lib.receiver_frame(
            self.self, self.core.new("struct sbus_frame *", (channels, frame_lost, failsafe))
        )

    def tick(self, samples: int) -> None:
        for _ in range(samples):
            self.lib.receiver_tick(self.self)

    def link(self) -> int:
        return int(self.lib.receiver_link(self.self))

    def channels(self) -> list[int]:
        out = self.core.new("uint16_t[16]")
        self.lib.receiver_channels(self.self, out)
        return list(out)


@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000, 8000])
def test_link_is_held_and_then_lost_when_silence_lasts(puppet: Any, rate_hz: int) -> None:
    lib, receiver = puppet.lib, Receiver(puppet, rate_hz)
    hold, lost = (ms * rate_hz // 1000 for ms in (RECEIVER_HOLD_MS, RECEIVER_LOST_MS))
    receiver.frame()
    receiver.tick(hold - 1)
    assert (receiver.link(), receiver.channels()) == (lib.RECEIVER_GOOD, FLOWN)
    receiver.tick(1)
    assert (receiver.link(), receiver.channels()) == (lib.RECEIVER_HOLD, HELD)
    receiver.tick(lost - hold - 1)
    assert receiver.link() == lib.RECEIVER_HOLD
    receiver.tick(1)
    assert (receiver.link(), receiver.channels()) == (lib.RECEIVER_LOST, LOST)
    receiver.tick(10)
    assert receiver.link() == lib.RECEIVER_LOST
    receiver.frame()
    assert (receiver.link(), receiver.channels()) == (lib.RECEIVER_GOOD, FLOWN)


def test_link_is_lost_when_nothing_was_ever_heard(puppet: Any) -> None:
    receiver = Receiver(puppet)
    assert (receiver.link(), receiver.channels()) == (puppet.lib.RECEIVER_LOST, LOST)


def test_link_is_lost_at_once_when_the_receiver_is_in_failsafe(puppet: Any) -> None:
    receiver = Receiver(puppet)
    receiver.frame()
    receiver.frame(failsafe=True)
    assert (receiver.link(), receiver.channels()) == (puppet.lib.RECEIVER_LOST, LOST)


def test_a_repeated_frame_is_no_news_when_the_receiver_says_frame_lost(puppet: Any) -> None:
    receiver = Receiver(puppet)
    receiver.frame()
    for _ in range(RECEIVER_HOLD_MS):
        receiver.frame([2000] * CHANNEL_COUNT, frame_lost=True)
        assert receiver.channels() == FLOWN
        receiver.tick(1)
    assert receiver.link() == puppet.lib.RECEIVER_HOLD
    assert receiver.channels()[CHANNEL_THROTTLE] == FLOWN[CHANNEL_THROTTLE]
    assert receiver.channels()[CHANNEL_ARM] == FLOWN[CHANNEL_ARM]
