"""dshot_telemetry.c: answers of ESCs out of samples of their lines.

The encoder here is written from the format's public description (bidirectional DShot in Betaflight's wiki,
the extended telemetry specification): 16 bits, a group of five for each four, whose ones are then changes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import ESC_DAMAGED, ESC_SILENT

BITS = 21
GROUPS = (0x19, 0x1B, 0x12, 0x13, 0x1D, 0x15, 0x16, 0x17, 0x1A, 0x09, 0x0A, 0x0B, 0x1E, 0x0D, 0x0E, 0x0F)
SAMPLES = 160  # DShot600: 38 us and 74 samples
EARLIEST = 18  # 8 us
START = 67.3  # samples: about 30 us
WORDS = 4096
LINE = 6
UNTOUCHED = 0x5A5A


def levels(word: int, checksum: int | None = None) -> list[int]:
    """The 21 levels of an answer, first sent first; `checksum`: instead of the right one."""
    sent = word << 4 | (~(word ^ word >> 4 ^ word >> 8) & 15 if checksum is None else checksum)
    line, said = 0, [0]
    for bit in "".join(f"{GROUPS[sent >> shift & 15]:05b}" for shift in (12, 8, 4, 0)):
        line ^= int(bit)
        said.append(line)
    return said


def seen(
    said: Sequence[int],
    start: float = START,
    clock: float = 1.0,
    jitter: float | NDArray[np.float64] = 0.0,
    count: int = SAMPLES,
) -> NDArray[np.bool_]:
    """Levels at `count` samples, three a nominal bit, of an answer that begins at sample `start`.

    clock: how long its bits are, 1 as they should be. jitter [samples]: by how much each bit's begin, and the
    last one's end, come later; [BITS + 1].
    """
    edges = start + 3.0 * clock * np.arange(BITS + 1) + jitter
    return np.array([1, *said, 1], bool)[np.searchsorted(edges, np.arange(count), side="right")]


def decoded(
    core: Any, lines: dict[int, NDArray[np.bool_]], others: int = 0, earliest: int = EARLIEST
) -> dict[int, int]:
    """What the firmware reads on each of these lines; `others`: levels of all the other lines of the port."""
    samples = np.full(len(next(iter(lines.values()))), others, np.uint16)
    for line, level in lines.items():
        samples = samples & ~np.uint16(1 << line) | (level.astype(np.uint16) << line).astype(np.uint16)
    words = core.new("uint16_t[16]", [UNTOUCHED] * 16)
    pairs = core.ffi.from_buffer("uint32_t[]", samples.astype("<u2").tobytes())
    picked = sum(1 << line for line in lines)
    core.lib.dshot_telemetry_decode(pairs, len(samples) // 2, earliest, picked, words)
    assert all(words[line] == UNTOUCHED for line in range(16) if line not in lines)
    return {line: words[line] for line in lines}


def all_of(core: Any, levels: Iterable[NDArray[np.bool_]]) -> list[int]:
    """What it reads of each, 16 on a port."""
    rest, words = list(levels), list[int]()
    while rest:
        port, rest = rest[:16], rest[16:]
        words += decoded(core, dict(enumerate(port))).values()
    return words


def one(core: Any, level: NDArray[np.bool_], others: int = 0) -> int:
    return decoded(core, {LINE: level}, others)[LINE]


def test_every_word_is_read_whatever_the_phase_and_the_clock(scripted: Any) -> None:
    rng = np.random.default_rng(1)
    sent = [seen(levels(word), rng.uniform(20.0, 80.0), rng.uniform(0.93, 1.07)) for word in range(WORDS)]
    assert all_of(scripted, sent) == list(range(WORDS))


@pytest.mark.parametrize("clock", [0.921, 1.0, 1.079])
def test_words_are_read_at_the_ends_of_the_clocks_tolerance(scripted: Any, clock: float) -> None:
    words = range(0, WORDS, 7)
    for start in (30.0, 66.5, 84.9):
        assert all_of(scripted, (seen(levels(word), start, clock) for word in words)) == list(words)


@pytest.mark.parametrize("count", [160, 118, 96])  # as DShot600, 300 and 150 sample
def test_the_last_answer_that_is_waited_for_is_whole_in_the_samples(scripted: Any, count: int) -> None:
    late = count - 74.0
    assert one(scripted, seen(levels(0xABC), late, 1.07, count=count)) == 0xABC
    assert one(scripted, seen(levels(0xABC), late + 6.0, 1.07, count=count)) == ESC_DAMAGED


def test_answers_of_many_lines_of_a_port_do_not_disturb_each_other(scripted: Any) -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        picked = rng.choice(16, rng.integers(1, 9), replace=False).tolist()
        words = {line: int(rng.integers(WORDS)) for line in picked}
        lines = {
            line: seen(levels(word), rng.uniform(20, 80), rng.uniform(0.94, 1.06))
            for line, word in words.items()
        }
        silent = next(line for line in range(16) if line not in words)
        lines[silent] = np.ones(SAMPLES, bool)
        others = int(rng.integers(0x10000))
        assert decoded(scripted, lines, others) == {**words, silent: ESC_SILENT}


def test_a_line_that_never_moves_is_silent_high_or_low(scripted: Any) -> None:
    assert one(scripted, np.ones(SAMPLES, bool)) == ESC_SILENT
    assert one(scripted, np.zeros(SAMPLES, bool), 0xFFFF) == ESC_SILENT


def test_what_comes_too_early_or_too_late_or_from_a_line_that_does_not_rest_is_damaged(scripted: Any) -> None:
    good = seen(levels(0x123))
    assert one(scripted, good) == 0x123
    early = seen(levels(0x123), EARLIEST - 1.0)
    assert one(scripted, early) == ESC_DAMAGED
    low_before, low_after, blip_before, blip_after = (good.copy() for _ in range(4))
    low_before[:40] = False
    low_after[-1] = False
    blip_before[5] = False
    blip_after[150] = False
    for level in (low_before, low_after, blip_before, blip_after):
        assert one(scripted, level) == ESC_DAMAGED
    assert one(scripted, ~good) == ESC_DAMAGED, "the levels of an answer upside down"


@pytest.mark.parametrize("clock", [0.8, 0.88, 1.12, 1.3])
def test_a_clock_beyond_the_tolerance_is_refused(scripted: Any, clock: float) -> None:
    sent = (seen(levels(word), START, clock) for word in range(0, WORDS, 16))
    assert set(all_of(scripted, sent)) == {ESC_DAMAGED}


def test_a_wrong_checksum_is_refused(scripted: Any) -> None:
    for word in range(0, WORDS, 11):
        right = ~(word ^ word >> 4 ^ word >> 8) & 15
        sent = [seen(levels(word, checksum)) for checksum in range(16)]
        assert all_of(scripted, sent) == [
            word if checksum == right else ESC_DAMAGED for checksum in range(16)
        ]


def test_groups_that_stand_for_no_nibble_are_refused(scripted: Any) -> None:
    known = {tuple(levels(word)): word for word in range(WORDS)}
    rng = np.random.default_rng(4)
    bits = rng.integers(0, 2, (20_000, BITS - 1))
    said = np.hstack((np.zeros((len(bits), 1), int), np.cumsum(bits, axis=1) % 2))
    got = np.array(all_of(scripted, map(seen, said)))
    assert got.tolist() == [known.get(tuple(row), ESC_DAMAGED) for row in said.tolist()]
    assert np.count_nonzero(got != ESC_DAMAGED) == pytest.approx(20_000 / 256, rel=0.3), (
        "1 of 256 passes both"
    )


# --- Noise: how often a wrong word is taken -----------------------------------------------------------
# A checksum of 4 bits cannot notice all. It does notice every answer of which one nibble alone is wrong. Each
# bound is two to three times what ten million answers (edges that jitter) or 230,000 (the others) have shown.
ALL_LEVELS = np.array([[1, *levels(word), 1] for word in range(WORDS)], bool)
Spoil = Callable[[np.random.Generator, NDArray[np.bool_]], NDArray[np.bool_]]


def answers(rng: np.random.Generator, words: NDArray[np.int64], jitter: float = 0.0) -> NDArray[np.bool_]:
    """Samples of answers, [count, SAMPLES], begun between samples 30 and 80, up to 5 % fast or slow."""
    count = len(words)
    start, clock = rng.uniform(30, 80, (count, 1)), rng.uniform(0.95, 1.05, (count, 1))
    edges = start + 3.0 * clock * np.arange(BITS + 1) + rng.normal(0.0, jitter, (count, BITS + 1))
    changed = np.zeros((count, SAMPLES), np.uint8)
    turns = np.bitwise_and(np.diff(ALL_LEVELS[words].astype(np.uint8), axis=1), 1)
    rows = np.repeat(np.arange(count), BITS + 1)
    np.bitwise_xor.at(changed, (rows, np.ceil(edges).astype(int).ravel()), turns.ravel())
    return ~np.bitwise_xor.accumulate(changed, axis=1).astype(bool)


def ports_of(core: Any, samples: NDArray[np.bool_]) -> NDArray[np.uint16]:
    """What is read of each line, 16 on a port; their count is a multiple of 16."""
    ports = samples.reshape(-1, 16, SAMPLES).astype(np.uint16) << np.arange(16, dtype=np.uint16)[:, None]
    packed = np.ascontiguousarray(ports.sum(axis=1, dtype=np.uint16))
    words = np.empty((len(packed), 16), np.uint16)
    for port, told in zip(packed, words, strict=True):
        pairs, out = core.ffi.from_buffer("uint32_t[]", port), core.ffi.from_buffer("uint16_t[]", told)
        core.lib.dshot_telemetry_decode(pairs, SAMPLES // 2, EARLIEST, 0xFFFF, out)
    return words.ravel()


def burst(length: int, rng: np.random.Generator, samples: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Any levels for that many samples somewhere in the answer."""
    begin, place = rng.integers(25, 150, (len(samples), 1)), np.arange(SAMPLES)
    hit = (place >= begin) & (place < begin + length)
    return np.where(hit, rng.random(samples.shape) < 0.5, samples)


NOISE: dict[str, tuple[float, Spoil, float]] = {  # jitter [samples], what else, share of wrong words at most
    "edges that jitter by 0.04 us": (0.1, lambda rng, samples: samples, 0.0),
    "edges that jitter by 0.1 us": (0.225, lambda rng, samples: samples, 3e-4),
    "edges that jitter by 0.2 us": (0.45, lambda rng, samples: samples, 1e-2),
    "1 sample of 500 is wrong": (
        0.0,
        lambda rng, samples: samples ^ (rng.random(samples.shape) < 0.002),
        3e-4,
    ),
    "1 sample of 100 is wrong": (
        0.0,
        lambda rng, samples: samples ^ (rng.random(samples.shape) < 0.01),
        4e-4,
    ),
    "1.3 us of noise": (0.0, partial(burst, 3), 2e-3),
    "4 us of noise": (0.0, partial(burst, 9), 2e-3),
    "nothing but noise": (0.0, lambda rng, samples: rng.random(samples.shape) < 0.5, 0.0),
}


@pytest.mark.parametrize("count", [pytest.param(10_000_000, marks=pytest.mark.slow), 30_000])
@pytest.mark.parametrize("noise", NOISE)
def test_few_wrong_words_are_taken_when_lines_are_noisy(scripted: Any, noise: str, count: int) -> None:
    jitter, spoil, most = NOISE[noise]
    rng, step = np.random.default_rng(7), 1 << 15
    right = wrong = seen_ones = 0
    while seen_ones < count:
        words = rng.integers(0, WORDS, step)
        got = ports_of(scripted, spoil(rng, answers(rng, words, jitter)))
        right += int(np.count_nonzero(got == words))
        wrong += int(np.count_nonzero((got != words) & (got < WORDS)))
        seen_ones += step
    print(f"{noise}: of {seen_ones:,} answers {right / seen_ones:.2%} read, {wrong:,} wrong ones taken")
    assert wrong <= most * seen_ones + (3 if most else 0)
