"""dshot_telemetry.c: answers of ESCs out of samples of their lines.

The encoder here is written from the format's public description (bidirectional DShot in Betaflight's wiki,
the extended telemetry specification): 16 bits, a group of five for each four, whose ones are then changes.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cffi import FFI
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


class Learned:
    """What the firmware has learned of a port's lines: how long bits are, of what they should be."""

    def __init__(self, core: Any, clock: float | Sequence[float] = 1.0) -> None:
        self._told = core.new("int16_t[16]")
        for line, each in enumerate(np.broadcast_to(clock, 16)):
            self._told[line] = round((each - 1.0) * 3 * 65536)

    @property
    def c(self) -> Any:
        return self._told

    def __getitem__(self, line: int) -> float:
        return float(1.0 + self._told[line] / (3 * 65536))


def decoded(
    core: Any,
    lines: dict[int, NDArray[np.bool_]],
    others: int = 0,
    earliest: int = EARLIEST,
    learned: Learned | None = None,
) -> dict[int, int]:
    """What the firmware reads on each of these lines; `others`: levels of all the other lines of the port."""
    samples = np.full(len(next(iter(lines.values()))), others, np.uint16)
    for line, level in lines.items():
        samples = samples & ~np.uint16(1 << line) | (level.astype(np.uint16) << line).astype(np.uint16)
    words = core.new("uint16_t[16]", [UNTOUCHED] * 16)
    pairs = core.ffi.from_buffer("uint32_t[]", samples.astype("<u2").tobytes())
    picked = sum(1 << line for line in lines)
    told = (learned or Learned(core)).c
    core.lib.dshot_telemetry_decode(pairs, len(samples) // 2, earliest, picked, told, words)
    assert all(words[line] == UNTOUCHED for line in range(16) if line not in lines)
    return {line: words[line] for line in lines}


def all_of(core: Any, levels: Iterable[NDArray[np.bool_]], clock: float | Sequence[float] = 1.0) -> list[int]:
    """What it reads of each, 16 on a port, where the ESCs' clocks have been learned."""
    rest, words = list(levels), list[int]()
    clocks = np.broadcast_to(clock, len(rest)).tolist()
    while rest:
        port, rest = rest[:16], rest[16:]
        known, clocks = clocks[:16], clocks[16:]
        learned = Learned(core, known + [1.0] * (16 - len(known)))
        words += decoded(core, dict(enumerate(port)), learned=learned).values()
    return words


def one(core: Any, level: NDArray[np.bool_], others: int = 0, clock: float = 1.0) -> int:
    return decoded(core, {LINE: level}, others, learned=Learned(core, clock))[LINE]


def test_every_word_is_read_whatever_the_phase_and_the_clock(scripted: Any) -> None:
    rng = np.random.default_rng(1)
    clocks = rng.uniform(0.94, 1.095, WORDS).tolist()
    sent = [seen(levels(word), rng.uniform(20.0, 80.0), clocks[word]) for word in range(WORDS)]
    assert all_of(scripted, sent, clocks) == list(range(WORDS))


AM32 = {"F421": 0.9625, "F051": 0.969, "F415": 1.0, "L431": 1.041, "E230": 1.052, "G071": 1.09}


@pytest.mark.parametrize("chip", AM32)
def test_the_clock_of_an_esc_is_learned_from_its_answers(scripted: Any, chip: str) -> None:
    """Bits of AM32's answers, of what they should be: its timers' periods, Mcu/<chip>/Src/IO.c."""
    learned, rng = Learned(scripted), np.random.default_rng(5)
    words = rng.integers(0, WORDS, 60).tolist()
    read = [
        decoded(scripted, {LINE: seen(levels(word), rng.uniform(20, 80), AM32[chip])}, learned=learned)[LINE]
        for word in words
    ]
    assert {got for got, word in zip(read, words, strict=True) if got != word} <= {ESC_DAMAGED}
    assert read[25:] == words[25:]
    assert learned[LINE] == pytest.approx(AM32[chip], abs=0.01)


def test_edges_off_their_grid_are_no_other_word(scripted: Any) -> None:
    """Four edges a sample off, and by its levels' lengths the answer is a whole one of another word."""
    off = np.zeros(BITS + 1)
    off[[10, 21]], off[[12, 20]] = 1.0, -1.0
    sent = seen(levels(0x33A), jitter=off)
    lengths = np.diff(np.flatnonzero(np.diff(sent)))
    bits = np.cumsum([0, *np.digitize(lengths, (4.5, 7.5)) + 1])
    told = np.cumsum(np.isin(np.arange(BITS + 1), bits)) % 2 == 0
    assert told.astype(int)[:BITS].tolist() == levels(0x335)
    assert one(scripted, sent) == ESC_DAMAGED
    assert one(scripted, seen(levels(0x33A), jitter=0.4 * off)) == 0x33A


@pytest.mark.parametrize("count", [160, 118, 96])  # as DShot600, 300 and 150 sample
def test_the_last_answer_that_is_waited_for_is_whole_in_the_samples(scripted: Any, count: int) -> None:
    late = count - 74.0
    assert one(scripted, seen(levels(0xABC), late, 1.09, count=count), clock=1.09) == 0xABC
    assert one(scripted, seen(levels(0xABC), late + 6.0, 1.09, count=count), clock=1.09) == ESC_DAMAGED


def test_answers_of_many_lines_of_a_port_do_not_disturb_each_other(scripted: Any) -> None:
    rng = np.random.default_rng(2)
    for _ in range(200):
        picked = rng.choice(16, rng.integers(1, 9), replace=False).tolist()
        words = {line: int(rng.integers(WORDS)) for line in picked}
        clocks = rng.uniform(0.94, 1.08, 16).tolist()
        lines = {line: seen(levels(word), rng.uniform(20, 80), clocks[line]) for line, word in words.items()}
        silent = next(line for line in range(16) if line not in words)
        lines[silent] = np.ones(SAMPLES, bool)
        others = int(rng.integers(0x10000))
        read = decoded(scripted, lines, others, learned=Learned(scripted, clocks))
        assert read == {**words, silent: ESC_SILENT}


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


@pytest.mark.parametrize("clock", [0.8, 0.88, 1.15, 1.3])
def test_a_clock_beyond_the_tolerance_is_refused_however_long_it_is_heard(
    scripted: Any, clock: float
) -> None:
    learned = Learned(scripted)
    for word in range(0, WORDS, 16):
        assert (
            decoded(scripted, {LINE: seen(levels(word), START, clock)}, learned=learned)[LINE] == ESC_DAMAGED
        )


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


# --- Noise: how often a wrong word is taken, by the decoder and by the core behind it -------------------
SOURCES = ("motors/dshot_telemetry.c", "sensing/rotors.c")
FIRMWARE = Path(__file__).resolve().parents[3] / "firmware"
STRUCTS = """
struct noise {
    double jitter, glitches, bursts;
    int burst;
    double white, stuck, cut, told, shortest, longest;
    int samples, earliest;
};
struct tally { long answers, read, wrong, believed, misled; double off, off_share; };
void noisy_wires(const struct noise *noise, long answers, uint64_t seed, struct tally *tally);
"""


@cache
def noisy_wires(generated: Path, folder: Path) -> tuple[FFI, Any]:
    """noisy_wires.c around the firmware's decoder and gate."""
    made, include = folder / "noisy_wires.so", (FIRMWARE / "src", FIRMWARE, generated)
    sources = [Path(__file__).with_name("noisy_wires.c"), *(FIRMWARE / "src" / name for name in SOURCES)]
    flags = [
        "-O2",
        "-shared",
        "-fPIC",
        "-fshort-enums",
        "-ffp-contract=off",
        *(f"-I{path}" for path in include),
    ]
    subprocess.run(["gcc", *flags, "-o", made, *sources, "-lm"], check=True)
    ffi = FFI()
    ffi.cdef(STRUCTS)
    return ffi, ffi.dlopen(str(made))


US = 2.25  # samples, with DShot600
SPEEDS = {600: (160, 18), 300: (118, 9), 150: (96, 5)}  # samples of an answer, the first that it may begin at
Noise = dict[str, float]
# What is on the wires, how many answers are read of 100 at least, and of a million how many speeds the core
# believes that no ESC told, at most. Of ten million of each it believed none where that is 0, and else 15, 2,
# 8, 221 and 430.
NOISE: dict[str, tuple[int, Noise, float, float]] = {
    "edges that jitter by 0.04 us": (600, {"jitter": 0.04}, 99.5, 0),
    "edges that jitter by 0.1 us": (600, {"jitter": 0.1}, 93, 0),
    "edges that jitter by 0.2 us": (600, {"jitter": 0.2}, 30, 6),
    "1 sample of 500 is wrong": (600, {"glitches": 0.002}, 70, 0.3),
    "1 sample of 100 is wrong": (600, {"glitches": 0.01}, 20, 2),
    "1.3 us of noise in each third answer": (600, {"bursts": 0.33, "burst": 3}, 70, 60),
    "4 us of noise in each third answer": (600, {"bursts": 0.33, "burst": 9}, 65, 60),
    "nothing but noise": (600, {"white": 1.0}, 0, 0),
    "nothing but noise in each third answer": (600, {"white": 0.33}, 65, 0),
    "a line that sticks in each fifth answer": (600, {"stuck": 0.2}, 75, 0),
    "each fifth answer breaks off": (600, {"cut": 0.2}, 75, 0),
    "clocks 4 % quick to 9 % slow": (600, {"shortest": 0.96, "longest": 1.09}, 99, 0),
    "each fourth word is another, 0.1 us": (600, {"told": 0.25, "jitter": 0.1}, 93, 0),
    "DShot300, 0.2 us": (300, {"jitter": 0.2}, 93, 0),
    "DShot150, 0.4 us": (150, {"jitter": 0.4}, 93, 0),
    "DShot150, 1 sample of 500 is wrong": (150, {"glitches": 0.002}, 70, 0),
}


@pytest.mark.parametrize("count", [pytest.param(10_000_000, marks=pytest.mark.slow), 50_000])
@pytest.mark.parametrize("noise", NOISE)
def test_no_speed_is_believed_that_no_esc_told_when_lines_are_noisy(
    scripted_build: Path, tmp_path_factory: pytest.TempPathFactory, noise: str, count: int
) -> None:
    protocol, given, read, misled = NOISE[noise]
    ffi, lib = noisy_wires(scripted_build.parent / "generated", tmp_path_factory.getbasetemp())
    samples, earliest = SPEEDS[protocol]
    full = {"shortest": 0.97, "longest": 1.03, "samples": samples, "earliest": earliest, **given}
    full["jitter"] = given.get("jitter", 0.0) * US * protocol / 600
    tally = ffi.new("struct tally *")
    lib.noisy_wires(ffi.new("struct noise *", full), count, 7, tally)
    print(
        f"{noise}: of {tally.answers:,} answers {tally.read / tally.answers:.2%} read, "
        f"{tally.wrong:,} wrong; {tally.misled:,} believed, off by up to "
        f"{tally.off:.0f} rad/s, {tally.off_share:.1%}"
    )
    assert tally.read >= read / 100 * tally.answers
    assert tally.misled <= misled * 1e-6 * tally.answers + (2 if misled else 0)
