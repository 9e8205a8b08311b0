"""docs/explanation/safety.md is written by hand: its tables for the field are held to the contract."""

from __future__ import annotations

import re
from pathlib import Path

from neuroflight.toolchain.contract import ARMING_COUNTS, ArmingReason

PAGE = Path(__file__).resolve().parents[3] / "docs" / "explanation" / "safety.md"
TOLD_OTHERWISE = {"RECEIVER_LOST", "FAULT", "CRASHED"}  # by rhythms of their own


def test_the_page_has_the_counts_of_what_forbids_arming() -> None:
    rows = re.findall(r"^\| (\d) \| [^|]+ \| ([A-Z_`, ]+) \|$", PAGE.read_text(), re.MULTILINE)
    counts = {name: int(count) for count, names in rows for name in re.findall(r"[A-Z_]+", names)}
    assert [int(count) for count, _ in rows] == list(range(1, 9))
    assert counts == {
        reason.name: count for reason, count in zip(ArmingReason, ARMING_COUNTS, strict=True) if count
    }
    assert {reason.name for reason in ArmingReason} - counts.keys() == TOLD_OTHERWISE


def test_the_page_has_a_row_for_each_reason() -> None:
    page = PAGE.read_text()
    first = page.index("## What forbids arming")
    rows = re.findall(r"^\| (`[^|]+) \|", page[first : page.index("### Counted in the field")], re.MULTILINE)
    named = [name for row in rows for name in re.findall(r"`([A-Z_]+)`", row)]
    assert sorted(named) == sorted(reason.name for reason in ArmingReason)
