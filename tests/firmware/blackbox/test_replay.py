"""A flight again from its records: from a snapshot on the control path gives the same values, to the bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link.msp import Direction, Message, Version, encode
from neuroflight.flash.link.requests import set_raw_rc
from neuroflight.toolchain.contract import (
    BOOT_GRACE_MS,
    CALIBRATION_STEP_DEG_S,
    CHANNEL_ARM,
    CHANNEL_COUNT,
    CHANNEL_THROTTLE,
    LOG_RECEIVER_BYTES,
    FallbackCause,
    Msp,
)

G = 9.80665
PID_CHANNEL = 5  # AUX2: the mode PID's default range
DONE, SIZE, EARLY, LATE, UNKNOWN = 0, -1, -2, -3, -4
NOTCHES = ("dynamic_notch_count=3", "dynamic_notch_high_hz=400", "board_roll_deg=3", "gyro_stuck_ms=50")
FILTERS = (  # a policy was not trained behind these: the PID flies
    *NOTCHES,
    *("filter1_kind=pt2", "filter1_hz=900", "filter2_kind=notch", "filter2_hz=300", "filter2_q=5"),
    *("filter3_kind=biquad", "filter3_hz=900", "filter4_kind=pt3", "filter4_hz=1000"),
)


class Bench:
    """The firmware as a library, its samples given one by one."""

    def __init__(self, core: Any, gyro_hz: int, *settings: str) -> None:
        self.core, self.lib, self.gyro_hz = core, core.lib, gyro_hz
        self._memory = core.new("uint64_t[]", self.lib.reference_size() // 8 + 1)
        texts = [
            core.new("char[]", text.encode()) for text in (f"arming_delay_ms={BOOT_GRACE_MS}", *settings)
        ]
        error = self.lib.reference_init(self._memory, gyro_hz, core.new("char *[]", texts), len(texts))
        assert error == 0
        if "blackbox_device=none" not in settings:
            self.lib.reference_watch(self._memory)
        self._rates, self._force = core.new("double[3]"), core.new("double[3]")
        self._dshot = core.new("uint16_t[8]")
        self._channels = core.new(f"uint16_t[{CHANNEL_COUNT}]")
        self.rng = np.random.default_rng(7)
        self.samples = 0
        self.drift = 0.0  # rad/s, of the gyro
        self.posts = "receiver_protocol=msp" in settings
        self.records: list[Any] = []
        self.answers: list[tuple[bytes, ...]] = []
        self.seen: list[tuple[bytes, ...]] | None = None  # of every sample, the records left alone

    def sample(self, rates: Any, force: Any = (0.0, 0.0, G)) -> None:
        """One, and what came of it if it was a control step."""
        self._rates[0:3], self._force[0:3] = list(map(float, rates)), list(map(float, force))
        self.lib.reference_sample(self._memory, self._rates, self._force, self._dshot)
        self.samples += 1
        if self.seen is None:
            self.drain()
        else:
            self.seen.append(self.answer())

    def silent(self) -> None:
        self.lib.reference_silent(self._memory, self._dshot)

    def drain(self) -> None:
        record = self.core.new("struct log_record *")
        while self.lib.reference_record(self._memory, record):
            self.records.append(record)
            self.answers.append(self.answer())
            record = self.core.new("struct log_record *")

    def answer(self) -> tuple[bytes, ...]:
        """DShot values, the trace, and what the controller saw and said."""
        trace, answer = self.core.new("struct reference_trace *"), self.core.new("struct reference_answer *")
        self.lib.reference_trace(self._memory, trace)
        self.lib.reference_answer(self._memory, answer)
        return tuple(bytes(self.core.ffi.buffer(part)) for part in (self._dshot, trace, answer))

    def post(self, channels_us: Sequence[int]) -> None:
        """By MSP."""
        request = encode(Message(Version.V1, Direction.REQUEST, Msp.SET_RAW_RC, set_raw_rc(channels_us)))
        out = self.core.new("uint8_t[]", 4096)
        assert self.lib.reference_link(self._memory, 0, request, len(request), out, 4096) > 0

    def sticks(self, *, arm: int = 1000, throttle: int = 1000, pid: int = 1000, **channels: int) -> None:
        values = [1500] * 4 + [1000] * (CHANNEL_COUNT - 4)
        values[CHANNEL_ARM], values[CHANNEL_THROTTLE], values[PID_CHANNEL] = arm, throttle, pid
        for name, us in channels.items():
            values[int(name[1:])] = us
        if self.posts:
            self.post(values)
            return
        self._channels[0:CHANNEL_COUNT] = values
        self.lib.reference_receiver(self._memory, self._channels)

    def fly(self, ms: int, *, heard: bool = True, shake: float = 0.02, **sticks: int) -> None:
        """Noise around a slow turn; a frame each 10 ms."""
        for _ in range(ms * self.gyro_hz // 1000):
            if heard and self.samples % (self.gyro_hz // 100) == 0:
                self.sticks(**sticks)
            turn = 0.5 * np.sin(self.samples / self.gyro_hz * np.array([3.0, 5.0, 7.0])) * (shake > 0.02)
            rates = self.drift + turn + self.rng.normal(size=3) * shake
            self.sample(rates, np.array([0.0, 0.0, G]) + self.rng.normal(size=3) * 0.05)

    def state(self) -> bytes:
        bytes_ = self.core.new("uint8_t[]", self.lib.reference_state_size())
        while not self.lib.reference_state(self._memory, bytes_):
            self.sample((0.0, 0.0, 0.0))
        return bytes(self.core.ffi.buffer(bytes_))

    def bias(self) -> list[float]:
        """Of the gyro [rad/s]."""
        size = self.lib.reference_state_size()
        firmware = self.core.new("struct firmware *")
        self.core.ffi.memmove(firmware, self._memory, size)  # the first of struct reference
        return list(firmware.gyro.bias)

    def restore(self, state: bytes, layout: int | None = None) -> bool:
        layout = self.lib.reference_layout() if layout is None else layout
        return bool(self.lib.reference_restore(self._memory, state, len(state), layout))

    def step_of(self, record: Any) -> Any:
        step, ffi = self.core.new("struct replay_step *"), self.core.ffi
        for name in ("forbidden", "voltage_gain", "edge_flags", "lost", "samples", "receiver_count"):
            setattr(step, name, getattr(record, name))
        for name in ("accel", "gyro", "receiver_bytes"):
            array = getattr(record, name)
            ffi.memmove(getattr(step, name), array, ffi.sizeof(array))
        return step

    def replay(self, step: Any) -> int:
        return int(self.lib.reference_replay(self._memory, step, self._dshot))


def arm(b: Bench, pid: int = 1000) -> None:
    """Off, then on."""
    b.fly(100, pid=pid)
    b.fly(50, arm=2000, pid=pid)


def policy_and_pid(b: Bench) -> None:
    """Armed, the other controller by its switch and back, other sticks."""
    arm(b)
    b.fly(200, arm=2000, throttle=1300, shake=0.05)
    b.fly(150, arm=2000, throttle=1500, shake=0.05, pid=2000, c0=1600)
    b.fly(150, arm=2000, throttle=1700, shake=0.05, c1=1400, c3=1550)


def pid_alone(b: Bench) -> None:
    """From the first step to the last."""
    arm(b, pid=2000)
    b.fly(300, arm=2000, throttle=1500, shake=0.05, pid=2000, c0=1600)


def failsafe(b: Bench) -> None:
    """The receiver says nothing until the motors stop, and comes again."""
    arm(b)
    b.fly(100, arm=2000, throttle=1300, shake=0.05)
    b.fly(1500, heard=False, shake=0.05)
    b.fly(300, arm=2000, throttle=1000)
    b.fly(100)


def fallback(b: Bench) -> None:
    """Control steps that miss their deadline: the PID takes over."""
    arm(b)
    b.fly(100, arm=2000, throttle=1300, shake=0.05)
    b.lib.reference_power(b._memory, 15.0, 10.0, 2000.0)
    b.fly(50, arm=2000, throttle=1300, shake=0.05)
    b.lib.reference_power(b._memory, 14.4, 20.0, 0.0)  # and the PID flies by another voltage
    b.fly(300, arm=2000, throttle=1300, shake=0.05)
    assert b.answers[-1][2][-2] == FallbackCause.DEADLINE


def gyro_faults(b: Bench) -> None:
    """Repeated and impossible samples in flight, then silence, then a chip that is stuck."""
    arm(b)
    b.fly(100, arm=2000, throttle=1300, shake=0.05)
    for rates in ((0.1, 0.2, 0.3), (0.1, 0.2, 0.3), (np.nan, 0.0, 0.0), (30.0, 0.0, 0.0), (0.1, 0.2, 0.3)):
        b.sample(rates)
    b.fly(50, arm=2000, throttle=1300, shake=0.05)
    for _ in range(3):
        b.silent()
    b.fly(50, arm=2000, throttle=1300, shake=0.05)
    for _ in range(b.gyro_hz // 10):
        b.sample((0.1, 0.2, 0.3))
    b.fly(200)


def drifting(b: Bench) -> None:
    """Two flights; between them the gyro drifts, and its bias follows."""
    arm(b)
    b.fly(100, arm=2000, throttle=1300, shake=0.05)
    before = b.bias()
    b.drift = 0.01
    b.fly(3500)
    moved = np.array(b.bias()) - before
    assert (moved > 2.5 * np.deg2rad(CALIBRATION_STEP_DEG_S)).all()
    b.fly(50, arm=2000)
    b.fly(300, arm=2000, throttle=1300, shake=0.05)


CASES = (
    (drifting, 4000, ()),
    (policy_and_pid, 1000, ()),
    (policy_and_pid, 8000, ("board_roll_deg=3", "gyro_stuck_ms=50")),
    (pid_alone, 1000, NOTCHES),
    (pid_alone, 8000, FILTERS),
    (policy_and_pid, 4000, ("receiver_protocol=msp",)),
    (failsafe, 4000, ("failsafe_hold_ms=100", "failsafe_delay_ms=300")),
    (fallback, 2000, ()),
    (gyro_faults, 8000, ("gyro_stuck_ms=20",)),
    (gyro_faults, 1000, ("gyro_stuck_ms=0",)),
)


@pytest.mark.parametrize(("flight", "gyro_hz", "settings"), CASES)
def test_a_flight_is_the_same_again_when_its_records_are_replayed_from_a_snapshot(
    reference_core: Any, flight: Callable[[Bench], None], gyro_hz: int, settings: tuple[str, ...]
) -> None:
    flown, again = Bench(reference_core, gyro_hz, *settings), Bench(reference_core, gyro_hz, *settings)
    flown.fly(1200)  # calibrates
    state = flown.state()
    flown.records.clear()
    flown.answers.clear()
    flight(flown)
    assert any(record.trace.armed for record in flown.records)
    again.fly(37)  # has a past of its own
    assert again.restore(state)
    for number, (record, expected) in enumerate(zip(flown.records, flown.answers, strict=True)):
        assert again.replay(again.step_of(record)) == DONE, number
        assert again.answer() == expected, number


def test_a_changed_bit_of_a_record_shows_at_its_step(reference_core: Any) -> None:
    flown, again = Bench(reference_core, 4000), Bench(reference_core, 4000)
    flown.fly(1200)
    state = flown.state()
    flown.records.clear()
    flown.answers.clear()
    policy_and_pid(flown)
    assert again.restore(state)
    flown.records[250].gyro[3].counts[1] ^= 4
    differs = [
        again.replay(again.step_of(record)) != DONE or again.answer() != expected
        for record, expected in zip(flown.records, flown.answers, strict=True)
    ]
    assert differs.index(True) == 250


def test_another_size_or_layout_is_refused_and_nothing_changes(reference_core: Any) -> None:
    bench = Bench(reference_core, 1000)
    bench.fly(50)
    before, layout = bench.state(), bench.lib.reference_layout()
    assert not bench.restore(bytes(len(before) - 1))
    assert not bench.restore(bytes(len(before) + 1))
    assert not bench.restore(bytes(len(before)), layout ^ 1)
    assert bench.state() == before


def test_records_that_do_not_fit_the_state_are_told(reference_core: Any) -> None:
    flown = Bench(reference_core, 4000)
    flown.fly(100)
    step = flown.step_of(flown.records[-1])

    def given(**changed: int) -> int:
        bench = Bench(reference_core, 4000)
        bench.fly(20)
        bench.state()  # up to the end of a control step
        other = flown.core.new("struct replay_step *", step[0])
        for name, value in changed.items():
            setattr(other, name, value)
        return bench.replay(other)

    assert step.samples == 4 and given() == DONE
    assert given(samples=0) == given(samples=65) == SIZE
    assert given(receiver_count=LOG_RECEIVER_BYTES + 1) == SIZE
    assert given(samples=3) == LATE and given(samples=5) == EARLY
    assert given(edge_flags=reference_core.lib.LOG_EDGE_BENCH) == UNKNOWN
    assert given(edge_flags=reference_core.lib.LOG_EDGE_MORE_BYTES) == UNKNOWN


@pytest.mark.parametrize("gyro_hz", [1000, 8000])
def test_the_log_changes_no_motor_value(reference_core: Any, gyro_hz: int) -> None:
    with_log = Bench(reference_core, gyro_hz, *NOTCHES)
    without = Bench(reference_core, gyro_hz, "blackbox_device=none", *NOTCHES)
    answers: list[list[tuple[bytes, ...]]] = [[], []]
    for bench, seen in zip((with_log, without), answers, strict=True):
        bench.seen = seen
        bench.fly(1200)
        policy_and_pid(bench)
    assert len(set(answers[0])) > 500
    record = reference_core.new("struct log_record *")
    assert with_log.lib.reference_record(with_log._memory, record), "it was full, and nothing else"
    assert not without.lib.reference_record(without._memory, record)
    assert answers[0] == answers[1]
