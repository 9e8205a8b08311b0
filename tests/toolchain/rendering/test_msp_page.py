"""docs/msp.md says what the contract says."""

from __future__ import annotations

from pathlib import Path

from toolchain.contract import LAYOUTS, Msp
from toolchain.rendering.msp_page import msp_page

PAGE = Path(__file__).resolve().parents[3] / "docs" / "msp.md"


def test_the_page_is_up_to_date_when_the_contract_changes() -> None:
    assert PAGE.read_text() == msp_page(), "run: python -m toolchain.rendering.msp_page docs/msp.md"


def test_every_message_and_layout_has_a_row_when_rendered() -> None:
    rows = [
        line.split("|") for line in msp_page().partition("## Messages")[2].splitlines() if line[:3] > "| 0"
    ]
    found = {(row[2].strip(), row[3].strip()) for row in rows}
    assert {(layout.message.name, layout.direction.value) for layout in LAYOUTS} <= found
    assert {message.name for message in Msp} <= {name for name, _ in found}
