"""Renders the contract's SETTINGS as docs/settings.md: `python -m toolchain.rendering.settings_page FILE`."""

from __future__ import annotations

import sys
from pathlib import Path

from toolchain.contract import SETTINGS, Setting
from toolchain.files import write_text

HEAD = """# Settings

What a pilot may change without a new image. Settings lie in flash, in two sectors that are written
alternately, so that a loss of power leaves the old or the new set; a changed one is flown from the next boot
on. On the board they are read and written over MSP (`SETTING_INFO`, `SETTING_GET`, `SETTING_SET`,
`EEPROM_WRITE`), disarmed; the host program also takes `--set NAME=VALUE`.

A policy flies behind the gyro filters that it was trained with: one that was trained without any cannot arm
while `filter1_kind` and its like are other than `none`. The PID flies behind all of them.

`msp_baud` is the speed of the very line that settings go over: from the next boot on both ends have to speak
at the new one. The host program has no such line and takes no notice.

This page is written by `python -m toolchain.rendering.settings_page docs/settings.md`.

| setting | range | default | unit | meaning |
|---|---|---|---|---|
"""


def settings_page() -> str:
    """The text of the page, a row a setting, in the contract's order."""
    return HEAD + "".join(_row(setting) for setting in SETTINGS)


def _row(setting: Setting) -> str:
    if setting.choices:
        span, default = ", ".join(setting.choices), setting.choices[int(setting.default)]
    else:
        span, default = f"{setting.low:g} to {setting.high:g}", f"{setting.default:g}"
    return f"| `{setting.name}` | {span} | {default} | {setting.unit} | {setting.meaning} |\n"


if __name__ == "__main__":
    write_text(Path(sys.argv[1]), settings_page())
