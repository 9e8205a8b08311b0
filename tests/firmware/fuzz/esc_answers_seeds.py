"""Inputs of the target esc_answers that mean something: answers, and what goes wrong with them."""

from __future__ import annotations

import struct
from collections.abc import Sequence

SAMPLES = 160
GROUPS = (0x19, 0x1B, 0x12, 0x13, 0x1D, 0x15, 0x16, 0x17, 0x1A, 0x09, 0x0A, 0x0B, 0x1E, 0x0D, 0x0E, 0x0F)


def answer(sent: int, start: int = 68, samples_a_bit: float = 3.0) -> int:
    """Levels of a line, bit n at sample n: 16 bits, checksum included, from sample `start` on."""
    line, levels = 0, [0]
    for bit in "".join(f"{GROUPS[sent >> shift & 15]:05b}" for shift in (12, 8, 4, 0)):
        line ^= int(bit)
        levels.append(line)
    number = 0
    for sample in range(SAMPLES):
        place = int((sample - start) / samples_a_bit) if sample >= start else -1
        number |= (levels[place] if 0 <= place < len(levels) else 1) << sample
    return number


def checked(word: int) -> int:
    return word << 4 | ~(word ^ word >> 4 ^ word >> 8) & 15


def port(levels: Sequence[int], lines: int = 0xFFFF, earliest: int = 18) -> bytes:
    """An input: levels of lines 0, 1, .., the others at rest."""
    samples = [
        sum((levels[line] >> sample & 1 if line < len(levels) else 1) << line for line in range(16))
        for sample in range(SAMPLES)
    ]
    return struct.pack("<HB", lines, earliest) + struct.pack(f"<{SAMPLES}H", *samples)


def esc_answers_seeds() -> dict[str, bytes]:
    """Answers of one and many, late and off, and lines that stick or are cut."""
    good = answer(checked(0x123))
    return {
        "one": port([good]),
        "all": port([answer(checked(257 * line), 40 + 2 * line) for line in range(16)]),
        "four_of_them": port([good] * 16, 0x03C0),
        "slow": port([answer(checked(0xFFF), 68, 3.2), answer(checked(0), 68, 2.8)]),
        "late": port([answer(checked(0x801), 86), answer(checked(0x801), 95), answer(checked(0x801), 150)]),
        "early": port([answer(checked(0x801), 17), answer(checked(0x801), 0)]),
        "checksum": port([answer(0x1230), answer(0xFFFF)]),
        "cut": port([good | ~((1 << 90) - 1), good & ((1 << 90) - 1)]),
        "stuck": port([0] * 8),
        "toggling": port([int("01" * 80, 2), int("0011" * 40, 2), int("000111" * 27, 2)]),
        "nothing": b"",
        "shortest": struct.pack("<HBHH", 0xFFFF, 0, 0x5555, 0xAAAA),
    }
