"""The table of docs/reference/settings.md, which `python -m tests.reference` writes into the page."""

from __future__ import annotations

from neuroflight.toolchain.contract import SETTINGS, ModeRange, Setting
from neuroflight.toolchain.rendering.msp_page import table


def settings_table() -> str:
    """Render a row for each setting, in the contract's order."""
    return table(("setting", "range", "default", "unit", "meaning"), map(_row, SETTINGS))


def _row(setting: Setting) -> tuple[str, ...]:
    if setting.kind == "text":
        span, default = f"{setting.high:g} characters of printable ASCII", ""
    elif setting.kind == "mode":
        span, default = "", str(ModeRange.unpack(int(setting.default)) or "none")
    elif setting.choices:
        span, default = ", ".join(setting.choices), setting.choices[int(setting.default)]
    else:
        span, default = f"{setting.low:g} to {setting.high:g}", f"{setting.default:g}"
    unit, other = setting.unit, setting.betaflight
    if other is not None:
        span = _both(span, f"{other.low:g} to {other.high:g}")
        default, unit = _both(default, f"{other.default:g}"), _both(unit, other.unit)
    meaning = setting.meaning
    if setting.parameter != setting.name:
        meaning += f"; in MAVLink `{setting.parameter}`"
    return f"`{setting.name}`", span, default, unit, meaning


def _both(actual: str, betaflight: str) -> str:
    """Format a value that may differ between the two styles of rates."""
    return actual if actual == betaflight else f"{actual}; betaflight: {betaflight}"
