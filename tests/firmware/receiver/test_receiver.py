"""receiver.c: frames of any protocol to channels, and the failsafe values while frames are missing."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    CHANNEL_ARM,
    CHANNEL_AUX1,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    CHANNEL_UNTOLD_US,
    CHANNEL_YAW,
    RECEIVER_FLAG_MS,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_PAUSE_MS,
    RECEIVER_RECOVERY_MS,
    Mode,
    ModeRange,
)

Frame = Callable[..., bytes]
FLOWN = [1100 + 50 * index for index in range(CHANNEL_COUNT)]
HELD = [1500, 1500, FLOWN[2], 1500, *FLOWN[4:]]  # rates centred; throttle and switches as they were
LOST = [1500, 1500, 1000, 1500, *[1000] * 12]
SBUS, CRSF, MSP = range(3)
VALUE_OF_US = {880 + (5 * value + 4) // 8: value for value in range(2048)}


class Receiver:
    """A receiver fed with SBUS frames unless told otherwise."""

    def __init__(self, core: Any, sbus: Frame, rate_hz: int = 1000, **changed: int) -> None:
        self.lib, self.core, self.sbus, self.rate_hz = core.lib, core, sbus, rate_hz
        self.self = core.new("struct receiver *")
        values = core.new("struct nf_settings *")
        core.lib.settings_default(values)
        for name, value in changed.items():
            setattr(values, name, value)
        core.lib.receiver_init(self.self, values, rate_hz)

    def push(self, data: bytes) -> list[list[int]]:
        """The channels as they are flown after each frame."""
        buffer = self.core.new("uint8_t[]", data)
        bytes_, count = self.core.new("const uint8_t **", buffer), self.core.new("size_t *", len(data))
        seen = []
        while self.lib.receiver_push(self.self, bytes_, count):
            seen.append(self.channels())
        assert count[0] == 0 and bytes_[0] - buffer == len(data)
        return seen

    def frame(self, channels: list[int] = FLOWN, frame_lost: bool = False, failsafe: bool = False) -> None:
        values = [VALUE_OF_US[us] for us in channels]
        assert len(self.push(self.sbus(values, frame_lost=frame_lost, failsafe=failsafe))) == 1

    def tick(self, samples: int) -> None:
        for _ in range(samples):
            self.lib.receiver_tick(self.self)

    def run(self, ms: int, every_ms: int = 10, **frame: Any) -> None:
        """Frames every `every_ms`, the first at once."""
        for elapsed in range(ms):
            if elapsed % every_ms == 0:
                self.frame(**frame)
            self.tick(self.rate_hz // 1000)

    def recover(self) -> None:
        """As long as a lost link needs, and a last frame."""
        self.run(RECEIVER_RECOVERY_MS)
        self.frame()

    def link(self) -> int:
        return int(self.lib.receiver_link(self.self))

    def channels(self) -> list[int]:
        out = self.core.new("uint16_t[16]")
        self.lib.receiver_channels(self.self, out)
        return list(out)

    def modes(self) -> set[str]:
        """Names of those that are on."""
        on = self.lib.receiver_modes(self.self)
        return {mode.name for mode in Mode if on >> getattr(self.lib, f"MODE_{mode.name}") & 1}

    def arm(self) -> bool:
        return "ARM" in self.modes()

    def quality(self) -> int:
        return int(self.lib.receiver_quality(self.self))


@pytest.fixture
def make(scripted: Any, sbus: Frame) -> Callable[..., Receiver]:
    return lambda *args, **kwargs: Receiver(scripted, sbus, *args, **kwargs)


Make = Callable[..., Receiver]


@pytest.fixture
def receiver(make: Make) -> Receiver:
    """With the default settings, at 1 kHz."""
    return make()


# --- The link ---------------------------------------------------------------------------------
@pytest.mark.parametrize("rate_hz", [1000, 2000, 4000, 8000])
@pytest.mark.parametrize(("hold_ms", "delay_ms"), [(None, None), (100, 200), (None, 400), (1000, 20_000)])
def test_link_is_held_and_then_lost_when_silence_lasts_as_long_as_is_set(
    make: Make, scripted: Any, rate_hz: int, hold_ms: int | None, delay_ms: int | None
) -> None:
    lib = scripted.lib
    changed = {"failsafe_hold_ms": hold_ms, "failsafe_delay_ms": delay_ms}
    receiver = make(rate_hz, **{name: ms for name, ms in changed.items() if ms is not None})
    hold, lost = (ms * rate_hz // 1000 for ms in (hold_ms or RECEIVER_HOLD_MS, delay_ms or RECEIVER_LOST_MS))
    receiver.recover()
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


def test_link_is_good_again_at_once_when_it_was_only_held(receiver: Receiver, scripted: Any) -> None:
    receiver.recover()
    receiver.tick(RECEIVER_LOST_MS - 1)
    assert receiver.link() == scripted.lib.RECEIVER_HOLD
    receiver.frame()
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)


@pytest.mark.parametrize("rate_hz", [1000, 8000])
@pytest.mark.parametrize("before", ["boot", "silence", "failsafe"])
def test_a_lost_link_is_good_when_frames_have_come_for_as_long_as_it_takes(
    make: Make, scripted: Any, rate_hz: int, before: str
) -> None:
    receiver = make(rate_hz)
    if before != "boot":
        receiver.recover()
    if before == "silence":
        receiver.tick(RECEIVER_LOST_MS * rate_hz // 1000)
    if before == "failsafe":
        receiver.run(RECEIVER_LOST_MS, failsafe=True)
    receiver.run(RECEIVER_RECOVERY_MS - 1)
    receiver.tick(rate_hz // 1000 - 1)
    receiver.frame()
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)
    receiver.tick(1)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)
    receiver.frame()
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)


@pytest.mark.parametrize("setback", ["gap", "failsafe"])
def test_recovery_begins_anew_when_it_is_set_back(receiver: Receiver, scripted: Any, setback: str) -> None:
    receiver.run(RECEIVER_RECOVERY_MS - 10)
    if setback == "failsafe":
        receiver.frame(failsafe=True)
        receiver.tick(1)
    else:
        receiver.tick(RECEIVER_PAUSE_MS)
    receiver.run(RECEIVER_RECOVERY_MS)
    assert receiver.link() == scripted.lib.RECEIVER_LOST
    receiver.frame()
    assert receiver.link() == scripted.lib.RECEIVER_GOOD


def test_link_never_recovers_when_frames_are_rare_or_repeated(make: Make, scripted: Any) -> None:
    rare, repeated = make(), make()
    rare.run(3000, every_ms=RECEIVER_PAUSE_MS + 1)
    assert rare.link() == scripted.lib.RECEIVER_LOST
    repeated.frame()
    repeated.run(3000, frame_lost=True)
    assert repeated.link() == scripted.lib.RECEIVER_LOST


def test_link_recovers_as_slowly_when_a_long_hold_is_set(make: Make, scripted: Any) -> None:
    receiver = make(failsafe_hold_ms=1000, failsafe_delay_ms=2000)
    receiver.run(3000, every_ms=RECEIVER_PAUSE_MS + 1)
    assert receiver.link() == scripted.lib.RECEIVER_LOST


def test_link_is_lost_when_nothing_was_ever_heard(receiver: Receiver, scripted: Any) -> None:
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)
    receiver.tick(5000)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)


# --- Flagged frames: the receiver says that they are not the transmitter's -----------------------
PRESET = [2000, 1000, 1000, 2000, *[1000] * 12]  # what a receiver may have been taught: low, off


@pytest.mark.parametrize("frame_lost", [False, True])
def test_it_holds_at_once_and_flies_on_with_the_first_good_frame_when_frames_say_failsafe(
    receiver: Receiver, scripted: Any, frame_lost: bool
) -> None:
    receiver.recover()
    for _ in range(3):
        for _ in range(5):
            receiver.frame(PRESET, frame_lost=frame_lost, failsafe=True)
            assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_HOLD, HELD)
            receiver.tick(10)
            assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_HOLD, HELD)
        receiver.frame()
        assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)


@pytest.mark.parametrize("delay_ms", [400, 5000])
@pytest.mark.parametrize("frame_lost", [False, True])
def test_link_is_lost_as_late_as_in_silence_when_frames_say_failsafe(
    make: Make, scripted: Any, delay_ms: int, frame_lost: bool
) -> None:
    receiver = make(failsafe_delay_ms=delay_ms)
    receiver.recover()
    for elapsed in range(delay_ms):
        if elapsed % 9 == 5:
            receiver.frame(PRESET, frame_lost=frame_lost, failsafe=True)
        assert receiver.link() == (scripted.lib.RECEIVER_GOOD if elapsed < 5 else scripted.lib.RECEIVER_HOLD)
        receiver.tick(1)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)
    receiver.run(3000, channels=PRESET, frame_lost=frame_lost, failsafe=True)
    assert receiver.link() == scripted.lib.RECEIVER_LOST


def test_a_hold_by_a_flag_does_not_end_in_silence(make: Make, scripted: Any) -> None:
    receiver = make(failsafe_hold_ms=RECEIVER_FLAG_MS, failsafe_delay_ms=20_000)
    receiver.recover()
    receiver.frame(PRESET, failsafe=True)
    for _ in range(2 * RECEIVER_FLAG_MS):
        assert receiver.link() == scripted.lib.RECEIVER_HOLD
        receiver.tick(1)


def test_flagged_frames_that_say_off_are_no_off(make: Make) -> None:
    receiver, on = make(), [1500] * 4 + [2000] * 12
    off = [*on[:CHANNEL_ARM], 1000, *on[CHANNEL_ARM + 1 :]]
    receiver.run(RECEIVER_RECOVERY_MS + 10, channels=on)
    for flags in ({"failsafe": True}, {"frame_lost": True}, {"failsafe": True, "frame_lost": True}):
        receiver.run(500, channels=off, **flags)
        assert receiver.arm()
        receiver.frame(on)
    receiver.frame(off)
    receiver.run(500, channels=on, failsafe=True)
    assert receiver.arm()
    receiver.frame(off)
    assert not receiver.arm(), "the pilot's second one, whatever came between"


def uplink(crsf: Frame, percent: int) -> bytes:
    """A frame of CRSF that tells the uplink's quality."""
    return crsf(0x14, bytes([70, 70, percent, *[0] * 7]))


def test_channels_of_crsf_are_no_frame_while_the_uplink_has_no_quality(
    make: Make, scripted: Any, sbus: Frame, crsf: Frame
) -> None:
    receiver = make(receiver_protocol=CRSF, failsafe_delay_ms=5000)
    flown, preset = (
        crsf(0x16, sbus([VALUE_OF_US[us] for us in channels])[1:23]) for channels in (FLOWN, PRESET)
    )

    def run(ms: int, channels: bytes, percent: int) -> None:
        for elapsed in range(ms):
            receiver.push((uplink(crsf, percent) if elapsed % 100 == 0 else b"") + channels)
            receiver.tick(1)

    run(RECEIVER_RECOVERY_MS + 1, flown, 1)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)
    receiver.push(uplink(crsf, 0))
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_HOLD, HELD)
    run(4900, preset, 0)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_HOLD, HELD)
    receiver.push(uplink(crsf, 1) + flown)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)
    run(5000, preset, 0)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_LOST, LOST)
    run(1000, preset, 0)
    run(RECEIVER_RECOVERY_MS, flown, 1)
    assert receiver.link() == scripted.lib.RECEIVER_LOST
    run(1, flown, 1)
    assert (receiver.link(), receiver.channels()) == (scripted.lib.RECEIVER_GOOD, FLOWN)


def test_channels_of_crsf_count_again_when_the_quality_is_told_no_more(
    make: Make, scripted: Any, sbus: Frame, crsf: Frame
) -> None:
    receiver = make(receiver_protocol=CRSF)
    receiver.push(uplink(crsf, 0))
    for _ in range(RECEIVER_FLAG_MS + RECEIVER_RECOVERY_MS + 1):
        assert receiver.link() == scripted.lib.RECEIVER_LOST
        receiver.push(crsf_sticks(sbus, crsf, 1500))
        receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_GOOD


def test_the_switch_is_off_when_two_good_frames_in_a_row_say_so(make: Make) -> None:
    receiver, on = make(), [1500] * 4 + [2000] * 12
    off = [*on[:CHANNEL_ARM], 1000, *on[CHANNEL_ARM + 1 :]]

    def switch(channels: list[int], **frame: bool) -> bool:
        receiver.frame(channels, **frame)
        return receiver.arm()

    receiver.run(RECEIVER_RECOVERY_MS, channels=on)
    assert switch(on)
    for _ in range(3):
        assert [switch(off), switch(on), switch(off), switch(on)] == [True] * 4
    assert switch(off)
    receiver.tick(RECEIVER_HOLD_MS + 10)  # in a row, however long it takes
    assert switch(on, frame_lost=True)
    assert not switch(off)
    assert [switch(off), switch(on), switch(off)] == [False, True, True], "on counts at once"


# --- Flipped bits that a frame does not show ---------------------------------------------------
ON_VALUES = [992, 992, 700, 992, 1792, *[192] * 11]


def flipped(data: bytes, *bits: int) -> bytes:
    """`data` with these bits turned over, bit 0 the first one's lowest."""
    number = int.from_bytes(data, "little")
    for bit in bits:
        number ^= 1 << bit
    return number.to_bytes(len(data), "little")


def flown_through(receiver: Receiver, wrong: bytes, good: bytes) -> int:
    """How many frames came out of `wrong`, whether they were a flight's end or not; then comes a good one."""
    seen = len(receiver.push(wrong))
    receiver.tick(5)
    assert receiver.link() != receiver.lib.RECEIVER_LOST
    assert receiver.arm()
    assert len(receiver.push(good)) >= 1
    assert receiver.link() == receiver.lib.RECEIVER_GOOD
    receiver.tick(5)
    assert receiver.arm()
    return seen


def test_no_two_flipped_bits_of_one_sbus_frame_end_a_flight(make: Make, scripted: Any, sbus: Frame) -> None:
    receiver, good = make(), sbus(ON_VALUES)
    for _ in range(RECEIVER_RECOVERY_MS // 5 + 1):
        receiver.push(good)
        receiver.tick(5)
    parser, frame = scripted.new("struct sbus *"), scripted.new("struct sbus_frame *")
    ends = 0
    for first, second in combinations(range(8 * len(good)), 2):
        wrong = flipped(good, first, second)
        scripted.lib.sbus_reset(parser)
        if [scripted.lib.sbus_push(parser, byte, frame) for byte in wrong][-1]:
            ends += frame.channels_us[CHANNEL_ARM] < 1700 and not (frame.frame_lost or frame.failsafe)
        flown_through(receiver, wrong, good)
    print(f"{ends} pairs of bits make a frame that would have ended the flight")
    assert ends > 300


def test_the_crc_of_crsf_misses_two_flipped_bits_when_they_lie_93_apart_and_yet_no_flight_ends(
    make: Make, scripted: Any, sbus: Frame, crsf: Frame
) -> None:
    """Why two frames must say off with CRSF too: all pairs of bits of a frame of channels."""
    receiver, good = make(receiver_protocol=CRSF), crsf(0x16, sbus(ON_VALUES)[1:23])
    for _ in range(RECEIVER_RECOVERY_MS // 5 + 1):
        assert len(receiver.push(good)) == 1
        receiver.tick(5)
    covered = range(16, 8 * len(good))  # type, payload and CRC
    assert len(covered) == 192
    for bit in covered:
        assert flown_through(receiver, flipped(good, bit), good) == 0, "one flipped bit is always seen"

    def order(bit: int) -> int:
        """Place in the CRC's order, which takes the highest bit of a byte first."""
        return bit // 8 * 8 + 7 - bit % 8

    missed = [
        (first, second)
        for first, second in combinations(covered, 2)
        if flown_through(receiver, flipped(good, first, second), good) > 0
    ]
    assert {abs(order(first) - order(second)) for first, second in missed} == {93}
    assert len(missed) == 192 - 93 - 8, "all such pairs, but for those that make another type of frame of it"
    parser, frame = scripted.new("struct crsf *"), scripted.new("struct crsf_frame *")
    ends = 0
    for pair in missed:
        while scripted.lib.crsf_take(parser, True, frame):
            pass
        at, wrong = 0, flipped(good, *pair)
        while at < len(wrong):
            at += scripted.lib.crsf_put(parser, wrong[at:], len(wrong) - at)
            if scripted.lib.crsf_take(parser, False, frame):
                ends += frame.channels_us[CHANNEL_ARM] < 1700
    assert ends > 0, "some of them say off"


def test_a_repeated_frame_is_no_news_when_the_receiver_says_frame_lost(
    receiver: Receiver, scripted: Any
) -> None:
    receiver.recover()
    for _ in range(RECEIVER_HOLD_MS):
        receiver.frame([2000] * CHANNEL_COUNT, frame_lost=True)
        assert receiver.channels() == FLOWN
        receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_HOLD
    assert receiver.channels()[CHANNEL_THROTTLE] == FLOWN[CHANNEL_THROTTLE]
    assert receiver.channels()[CHANNEL_ARM] == FLOWN[CHANNEL_ARM]


# --- Bytes ------------------------------------------------------------------------------------
def test_every_frame_is_seen_when_several_come_at_once(receiver: Receiver, sbus: Frame) -> None:
    receiver.recover()
    values = [[992] * CHANNEL_COUNT for _ in range(3)]
    for index, throttle in enumerate((1792, 192, 1792)):
        values[index][CHANNEL_THROTTLE] = throttle
    seen = receiver.push(b"\x55".join(map(sbus, values)))
    assert [channels[CHANNEL_THROTTLE] for channels in seen] == [2000, 1000, 2000]


def test_half_a_frame_is_forgotten_when_the_line_falls_silent(make: Make, sbus: Frame) -> None:
    receiver, data = make(4000), sbus([992] * CHANNEL_COUNT)
    for gap, frames in ((7, 1), (8, 0)):  # 2 ms of 4 kHz
        receiver.push(data[:10])
        receiver.tick(gap)
        assert len(receiver.push(data[10:])) == frames
        receiver.tick(20)


def crsf_sticks(sbus: Frame, crsf: Frame, us: int) -> bytes:
    return crsf(0x16, sbus([VALUE_OF_US[us]] * CHANNEL_COUNT)[1:23])


def test_link_recovers_and_flies_when_crsf_is_the_protocol(
    make: Make, scripted: Any, sbus: Frame, crsf: Frame
) -> None:
    receiver = make(receiver_protocol=CRSF)
    for us in (1000, 1200, 1400, 1600):
        for _ in range(RECEIVER_RECOVERY_MS // 4):
            assert len(receiver.push(crsf_sticks(sbus, crsf, us))) == 1
            receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_LOST
    assert receiver.push(crsf_sticks(sbus, crsf, 1800)) == [[1800] * CHANNEL_COUNT]
    assert receiver.link() == scripted.lib.RECEIVER_GOOD


def test_every_frame_is_seen_when_one_byte_completes_several(make: Make, sbus: Frame, crsf: Frame) -> None:
    receiver = make(receiver_protocol=CRSF)
    for _ in range(RECEIVER_RECOVERY_MS + 1):
        receiver.push(crsf_sticks(sbus, crsf, 2000))
        receiver.tick(1)
    low, high = crsf_sticks(sbus, crsf, 1000), crsf_sticks(sbus, crsf, 2000)
    false = bytes([0xC8, 62, 0x7A]) + low + high
    assert receiver.push(false + bytes(63 - len(false))) == []
    assert [channels[CHANNEL_THROTTLE] for channels in receiver.push(b"\x00" + low)] == [1000, 2000, 1000]


def test_half_a_crsf_frame_is_forgotten_when_the_line_falls_silent(
    make: Make, sbus: Frame, crsf: Frame
) -> None:
    receiver, data = make(4000, receiver_protocol=CRSF), crsf_sticks(sbus, crsf, 1500)
    for gap, frames in ((7, 1), (8, 0)):  # 2 ms of 4 kHz
        receiver.push(data[:10])
        receiver.tick(gap)
        assert len(receiver.push(data[10:])) == frames
        receiver.tick(20)


# Addressed to another device, or noise: what follows looks like a long frame of ours and never ends.
@pytest.mark.parametrize(
    "before", ["ee3c7ac8303a00", "c83e", "00c83e16", "c82c143c", "c83ec83ec83e"], ids="after-{}".format
)
def test_the_link_lives_when_each_frame_follows_what_seems_to_begin_a_longer_one(
    make: Make, scripted: Any, sbus: Frame, crsf: Frame, before: str
) -> None:
    receiver, seen = make(receiver_protocol=CRSF), 0
    for _ in range(RECEIVER_RECOVERY_MS // 4 + 2):
        seen += len(receiver.push(bytes.fromhex(before) + crsf_sticks(sbus, crsf, 1800)))
        for _ in range(4):
            receiver.tick(1)
            seen += len(receiver.push(b""))
    assert seen == RECEIVER_RECOVERY_MS // 4 + 2
    assert receiver.link() == scripted.lib.RECEIVER_GOOD
    assert receiver.channels() == [1800] * CHANNEL_COUNT


def test_no_off_is_lost_when_both_frames_lie_behind_a_false_beginning(
    make: Make, sbus: Frame, crsf: Frame
) -> None:
    receiver = make(receiver_protocol=CRSF)
    for _ in range(RECEIVER_RECOVERY_MS + 1):
        receiver.push(crsf_sticks(sbus, crsf, 2000))
        receiver.tick(1)
    receiver.push(b"\xc8\x3e" + crsf_sticks(sbus, crsf, 1000) + crsf_sticks(sbus, crsf, 2000)[:-1])
    receiver.tick(2)
    seen = receiver.push(crsf_sticks(sbus, crsf, 1200))
    assert [channels[CHANNEL_THROTTLE] for channels in seen] == [1000, 1200]


def test_link_statistics_are_no_sticks_when_they_come_alone(make: Make, scripted: Any, crsf: Frame) -> None:
    receiver = make(receiver_protocol=CRSF)
    for _ in range(3 * RECEIVER_RECOVERY_MS):
        assert receiver.push(crsf(0x14, bytes([1, 2, 90, *[0] * 7]))) == []
        receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_LOST


def test_half_a_frame_is_forgotten_when_single_bytes_come_after_the_silence(make: Make, sbus: Frame) -> None:
    receiver, data = make(), sbus([992] * CHANNEL_COUNT)
    receiver.push(data[:10])
    receiver.tick(2)
    assert [len(receiver.push(bytes([byte]))) for byte in data] == [0] * 24 + [1]


def test_nothing_is_read_from_the_line_when_the_protocol_is_msp(
    make: Make, scripted: Any, sbus: Frame
) -> None:
    receiver = make(receiver_protocol=MSP)
    assert receiver.push(sbus([992] * CHANNEL_COUNT) * 3) == []
    receiver.tick(50)
    assert receiver.push(sbus([992] * CHANNEL_COUNT) * 3) == []
    assert receiver.link() == scripted.lib.RECEIVER_LOST


# --- The map ----------------------------------------------------------------------------------
def test_channels_are_mapped_when_the_pilot_says_so(make: Make) -> None:
    names = ("roll", "pitch", "throttle", "yaw", "aux1", "aux2", "aux3", "aux4")
    wire = (3, 2, 0, 1, 7, 6, 4, 5)
    receiver = make(**{f"map_{name}": channel for name, channel in zip(names, wire, strict=True)})
    receiver.recover()
    assert receiver.channels() == [FLOWN[channel] for channel in wire] + FLOWN[8:]
    receiver.tick(RECEIVER_HOLD_MS)
    assert receiver.channels()[:4] == [1500, 1500, FLOWN[0], 1500]


# --- Modes ------------------------------------------------------------------------------------
EVERYWHERE = {  # every mode is on wherever its channel stands
    f"mode{slot}": ModeRange(mode, slot, 900, 2100).packed for slot, mode in enumerate(Mode, start=1)
}


def test_modes_are_none_until_the_link_is_good_and_stay_while_it_is_held(make: Make, scripted: Any) -> None:
    receiver = make(**EVERYWHERE)
    assert receiver.modes() == set()
    for _ in range(RECEIVER_RECOVERY_MS // 10):
        receiver.frame()
        receiver.tick(10)
        assert (receiver.link(), receiver.modes()) == (scripted.lib.RECEIVER_LOST, set())
    receiver.frame()
    assert (receiver.link(), receiver.modes()) == (scripted.lib.RECEIVER_GOOD, {mode.name for mode in Mode})
    receiver.tick(RECEIVER_LOST_MS - 1)
    assert (receiver.link(), receiver.modes()) == (scripted.lib.RECEIVER_HOLD, {mode.name for mode in Mode})
    receiver.tick(1)
    assert (receiver.link(), receiver.modes()) == (scripted.lib.RECEIVER_LOST, set())


@pytest.mark.parametrize("mode", Mode)
def test_no_mode_is_on_when_only_what_stands_in_for_a_lost_receiver_lies_in_its_range(
    make: Make, mode: Mode
) -> None:
    receiver = make(**{f"mode{slot}": 0 for slot in range(2, 5)}, mode1=ModeRange(mode, 1, 900, 1100).packed)
    off = [1500] * CHANNEL_COUNT
    receiver.run(RECEIVER_RECOVERY_MS + 20, channels=off)
    assert receiver.modes() == set()
    receiver.run(RECEIVER_LOST_MS, channels=[1000] * CHANNEL_COUNT, failsafe=True)
    assert (receiver.channels()[CHANNEL_ARM], receiver.modes()) == (1000, set())
    receiver.run(RECEIVER_RECOVERY_MS + 20, channels=off)
    receiver.tick(RECEIVER_LOST_MS)
    assert (receiver.channels()[CHANNEL_ARM], receiver.modes()) == (1000, set())
    receiver.run(RECEIVER_RECOVERY_MS + 20, channels=[1000] * CHANNEL_COUNT)
    assert receiver.modes() == {mode.name}


def test_modes_follow_the_map(make: Make) -> None:
    receiver = make(map_roll=7, map_aux1=0, map_aux4=4)
    channels = [2000, *[1000] * (CHANNEL_COUNT - 1)]
    receiver.run(RECEIVER_RECOVERY_MS + 20, channels=channels)
    assert receiver.modes() == {"ARM"}


@pytest.mark.parametrize("other", ["PID", "BEEPER", "TRIAL"])
def test_only_arm_waits_for_a_second_frame_that_says_off(make: Make, other: str) -> None:
    ranges = {"mode2": ModeRange(Mode[other], 1, 1700, 2100).packed, "mode3": 0, "mode4": 0}
    receiver = make(**ranges, mode1=ModeRange(Mode.ARM, 2, 900, 2100).packed)
    on, off = ([us] * CHANNEL_COUNT for us in (2000, 1000))
    receiver.run(RECEIVER_RECOVERY_MS + 20, channels=on)
    assert receiver.modes() == {"ARM", other}
    receiver.frame(off)
    assert receiver.modes() == {"ARM"}


# --- MSP --------------------------------------------------------------------------------------
def test_channels_come_over_msp_when_that_is_the_protocol(make: Make, scripted: Any) -> None:
    receiver = make(receiver_protocol=MSP, map_aux1=7, map_aux4=4)
    for _ in range(RECEIVER_RECOVERY_MS + 1):
        assert scripted.lib.receiver_msp(receiver.self, FLOWN)
        receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_GOOD
    assert receiver.channels() == [*FLOWN[:4], FLOWN[7], *FLOWN[5:7], FLOWN[4], *FLOWN[8:]]


@pytest.mark.parametrize("us", [1, 749, 2251, 65535])
@pytest.mark.parametrize("channel", [0, 15])
def test_channels_over_msp_are_refused_when_one_is_none(
    make: Make, scripted: Any, us: int, channel: int
) -> None:
    receiver = make(receiver_protocol=MSP)
    wrong = list(FLOWN)
    wrong[channel] = us
    for _ in range(2 * RECEIVER_RECOVERY_MS):
        assert not scripted.lib.receiver_msp(receiver.self, wrong)
        receiver.tick(1)
    assert receiver.link() == scripted.lib.RECEIVER_LOST


@pytest.mark.parametrize("told", range(CHANNEL_COUNT + 1))
@pytest.mark.parametrize("roll", [0, 7])
def test_a_frame_over_msp_needs_all_sticks_and_what_it_does_not_tell_switches_nothing(
    make: Make, scripted: Any, told: int, roll: int
) -> None:
    ranges = {f"mode{slot}": ModeRange(Mode.ARM, slot, 900, 2100).packed for slot in range(1, AUX_COUNT + 1)}
    receiver = make(receiver_protocol=MSP, map_roll=roll, map_aux4=7 - roll, **ranges)
    whole = told > max(roll, CHANNEL_YAW)
    for _ in range(RECEIVER_RECOVERY_MS + 1):
        frame = FLOWN[:told] + [CHANNEL_UNTOLD_US] * (CHANNEL_COUNT - told)
        assert scripted.lib.receiver_msp(receiver.self, frame) is whole
        receiver.tick(1)
    assert receiver.link() == (scripted.lib.RECEIVER_GOOD if whole else scripted.lib.RECEIVER_LOST)
    assert receiver.arm() is (told > max(roll, CHANNEL_YAW + 1))
    if whole:
        seen = receiver.channels()
        assert seen[CHANNEL_AUX1 + 4 :] == [us if us else 1000 for us in frame[CHANNEL_AUX1 + 4 :]]
        assert min(seen) >= 1000


@pytest.mark.parametrize("protocol", [SBUS, CRSF])
def test_channels_over_msp_are_refused_when_another_receiver_is_set(
    make: Make, scripted: Any, protocol: int
) -> None:
    receiver = make(receiver_protocol=protocol)
    assert not scripted.lib.receiver_msp(receiver.self, FLOWN)
    receiver.tick(RECEIVER_RECOVERY_MS)
    assert receiver.link() == scripted.lib.RECEIVER_LOST


# --- Interpolation ----------------------------------------------------------------------------
def sticks_at(us: int) -> list[int]:
    return [us] * CHANNEL_COUNT


@pytest.mark.parametrize("rate_hz", [1000, 4000])
def test_sticks_ramp_over_a_frame_interval_when_interpolated(make: Make, rate_hz: int) -> None:
    receiver = make(rate_hz, interpolation=1)
    receiver.run(400, every_ms=10, channels=sticks_at(1200))
    assert receiver.channels() == sticks_at(1200)
    receiver.frame(sticks_at(1800))
    for step in range(10 * rate_hz // 1000 + 5):
        expected = min(1200 + 60_000 * step / rate_hz, 1800)
        roll, pitch, throttle, yaw, *others = receiver.channels()
        assert roll == pitch == yaw
        assert abs(roll - expected) <= 1
        assert {throttle, *others} == {1800}
        receiver.tick(1)
    assert receiver.channels()[0] == 1800


def test_ramps_join_when_a_frame_comes_early(make: Make) -> None:
    receiver = make(interpolation=1)
    receiver.run(400, every_ms=10, channels=sticks_at(1000))
    receiver.frame(sticks_at(2000))
    receiver.tick(5)
    assert receiver.channels()[0] == 1500
    receiver.frame(sticks_at(1000))
    assert receiver.channels()[0] == 1500
    receiver.tick(1)
    assert receiver.channels()[0] == 1400, "the interval is now the 5 ms between the last two"
    receiver.frame(sticks_at(1000))
    receiver.tick(5)
    assert receiver.channels()[0] == 1000


def test_marked_frames_keep_the_beat_when_interpolated(make: Make) -> None:
    receiver = make(interpolation=1)
    receiver.run(400, every_ms=10, channels=sticks_at(1000))
    receiver.frame(frame_lost=True)
    receiver.tick(10)
    receiver.frame(sticks_at(2000))
    receiver.tick(5)
    assert receiver.channels()[0] == 1500


def test_sticks_start_from_the_centre_when_the_link_was_held(make: Make) -> None:
    receiver = make(interpolation=1)
    receiver.run(400, every_ms=10, channels=sticks_at(2000))
    receiver.tick(RECEIVER_HOLD_MS)
    receiver.frame(sticks_at(2000))
    assert receiver.channels()[0] == 1500
    receiver.tick(5)
    assert receiver.channels()[0] == 1750, "the silence was no interval"


def test_sticks_start_from_the_centre_when_the_hold_was_a_flags(make: Make) -> None:
    receiver = make(interpolation=1)
    receiver.run(400, every_ms=10, channels=sticks_at(2000))
    receiver.frame(failsafe=True)
    receiver.tick(10)
    receiver.frame(sticks_at(2000))
    assert receiver.channels()[0] == 1500


def test_sticks_jump_when_there_is_no_interval_yet(make: Make) -> None:
    receiver = make(interpolation=1, receiver_protocol=SBUS)
    receiver.frame(sticks_at(1800))
    receiver.frame(sticks_at(1200))
    receiver.tick(RECEIVER_PAUSE_MS - 1)
    assert receiver.self.interval == 0


def test_sticks_stay_as_sent_when_interpolation_is_off(receiver: Receiver) -> None:
    receiver.run(400, every_ms=10, channels=sticks_at(1000))
    receiver.frame(sticks_at(2000))
    assert receiver.channels() == sticks_at(2000)


# --- Quality ----------------------------------------------------------------------------------
def test_quality_is_full_when_every_frame_comes(receiver: Receiver) -> None:
    receiver.run(3000, every_ms=9)
    assert receiver.quality() >= 99


@pytest.mark.parametrize("marked", [False, True])
def test_quality_is_the_share_that_came_when_every_fourth_is_missing(
    receiver: Receiver, marked: bool
) -> None:
    receiver.run(2000)
    for index in range(200):
        if index % 4 != 0:
            receiver.frame()
        elif marked:
            receiver.frame(frame_lost=True)
        receiver.tick(10)
    assert receiver.quality() == pytest.approx(75, abs=1)


def test_quality_is_exact_when_frames_are_few(receiver: Receiver) -> None:
    for index in range(40):
        receiver.frame(frame_lost=index % 2 == 1)
        receiver.tick(100)
    assert receiver.quality() == 50


def test_quality_falls_within_a_second_and_is_none_when_the_link_is_lost(receiver: Receiver) -> None:
    receiver.run(2000)
    receiver.tick(400)
    assert 55 <= receiver.quality() <= 75
    receiver.tick(RECEIVER_LOST_MS - 400 - 1)
    assert 0 <= receiver.quality() <= 10
    receiver.tick(1)
    assert receiver.quality() == 0


def test_quality_is_judged_by_the_new_beat_when_a_slower_receiver_returns(receiver: Receiver) -> None:
    receiver.run(2000, every_ms=5)
    receiver.tick(RECEIVER_LOST_MS)
    receiver.run(2000, every_ms=20)
    assert receiver.quality() == 100


def test_quality_is_the_receivers_own_for_a_second_when_it_tells_one(
    make: Make, sbus: Frame, crsf: Frame
) -> None:
    receiver = make(receiver_protocol=CRSF)
    for step in range(2000):
        if step % 4 == 0:
            receiver.push(crsf_sticks(sbus, crsf, 1500))
        receiver.tick(1)
    assert receiver.quality() == 100
    receiver.push(crsf(0x14, bytes([1, 2, 42, *[0] * 7])))
    for step in range(999):
        receiver.push(crsf_sticks(sbus, crsf, 1500) if step % 4 == 0 else b"")
        receiver.tick(1)
        assert receiver.quality() == 42
    receiver.tick(1)
    assert receiver.quality() == 100


def test_quality_counts_no_further_when_frames_pour_in(make: Make, scripted: Any) -> None:
    receiver = make(receiver_protocol=MSP)
    for _ in range(3):
        for _ in range(70_000):
            scripted.lib.receiver_msp(receiver.self, FLOWN)
        receiver.tick(100)
    assert receiver.quality() == 100


# --- Any bytes --------------------------------------------------------------------------------
@pytest.mark.parametrize("protocol", [SBUS, CRSF])
def test_channels_stay_in_range_when_bytes_are_random(make: Make, sbus: Frame, protocol: int) -> None:
    rng = np.random.default_rng(protocol)
    receiver = make(receiver_protocol=protocol, interpolation=1)
    frames = 0
    for _ in range(3000):
        data = rng.integers(0, 256, rng.integers(1, 80), np.uint8)
        data[rng.random(len(data)) < 0.3] = (0x0F, 0xC8)[protocol]
        data[rng.random(len(data)) < 0.3] = 0x00
        seen = receiver.push(
            data.tobytes() if rng.random() < 0.5 else sbus(rng.integers(0, 2048, 16).tolist())
        )
        frames += len(seen)
        receiver.tick(int(rng.integers(0, 12)))
        for channels in [*seen, receiver.channels()]:
            assert min(channels) >= 880 and max(channels) <= 2159
    assert frames > 100 or protocol == CRSF
