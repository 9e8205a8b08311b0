"""docs/settings.md says what the contract says."""

from __future__ import annotations

from pathlib import Path

from neuroflight.toolchain.contract import SETTINGS
from neuroflight.toolchain.rendering.settings_page import settings_page

PAGE = Path(__file__).resolve().parents[3] / "docs" / "settings.md"


def test_the_page_is_up_to_date_when_the_contract_changes() -> None:
    assert PAGE.read_text() == settings_page(), (
        "run: python -m neuroflight.toolchain.rendering.settings_page docs/settings.md"
    )


def test_every_setting_has_a_row_when_rendered() -> None:
    rows = [line.split("|")[1].strip(" `") for line in settings_page().splitlines() if line.startswith("| `")]
    assert rows == [setting.name for setting in SETTINGS]
