"""Betaflight's `aux` lines as mode ranges, and the slots that they take."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from neuroflight.toolchain.contract import (
    AUX_COUNT,
    MODE_LOW_US,
    MODE_SLOT_COUNT,
    MODE_STEP_US,
    MODE_STEPS,
    Mode,
    ModeRange,
)

PREARM = 36
HIGH_US = MODE_LOW_US + MODE_STEPS * MODE_STEP_US
# Modes that both firmwares have; 40 and 41 (PID, TRIAL here) are others there. Before 3.2 a line has a box's
# place in a list instead of its number, which is the same for these. Betaflight has CHIRP since 2025.12.
SHARED = frozenset({Mode.ARM, Mode.BEEPER, Mode.BLACKBOX, Mode.CHIRP})
BOXES = {  # permanent numbers, src/main/msp/msp_box.c of 2025.12.5; those that files have most
    **{1: "ANGLE", 2: "HORIZON", 3: "ALTHOLD", 4: "ANTI GRAVITY", 5: "MAG", 6: "HEADFREE", 7: "HEADADJ"},
    **{11: "POS HOLD", 12: "PASSTHRU", 15: "LEDLOW", 17: "CALIB", 19: "OSD DISABLE", 20: "TELEMETRY"},
    **{27: "FAILSAFE", 28: "AIR MODE", 29: "3D", 30: "FPV ANGLE MIX", 31: "BLACKBOX ERASE", 35: "CRASH FLIP"},
    **{36: "PREARM", 37: "GPS BEEP", 39: "VTX PIT MODE", 40: "USER1", 41: "USER2", 42: "USER3", 43: "USER4"},
    **{44: "PID AUDIO", 45: "PARALYZE", 46: "GPS RESCUE", 47: "ACRO TRAINER", 48: "VTX CONTROL DISABLE"},
    **{
        49: "LAUNCH CONTROL",
        50: "MSP OVERRIDE",
        51: "STICK COMMANDS DISABLE",
        52: "BEEPER MUTE",
        53: "READY",
    },
}


def box_name(number: int) -> str:
    """Return what Betaflight calls that box."""
    names = {mode.value: mode.name for mode in SHARED}
    return names.get(number) or BOXES.get(number) or f"box {number}"


def read_aux(numbers: list[int]) -> ModeRange | None:
    """Return the range of `aux SLOT BOX AUX LOW HIGH [LOGIC [LINK]]`; None: an unused slot.

    Raises ValueError, one line, for what has no counterpart.
    """
    if not 5 <= len(numbers) <= 7:
        raise ValueError("expected aux SLOT MODE AUX LOW HIGH, perhaps LOGIC and LINK behind them")
    box, aux, low, high, logic, link = (*numbers[1:], 0, 0)[:6]
    low_us, high_us = (_on_grid(us) for us in (low, high))
    if link:
        raise ValueError(f"{box_name(box)} follows another mode ({box_name(link)}), which nothing here does")
    if low_us >= high_us:
        return None
    if box not in SHARED:
        raise ValueError(f"{box_name(box)}: there is no such mode here")
    if not 0 <= aux < AUX_COUNT:
        raise ValueError(f"{box_name(box)} on AUX {aux + 1}: there are AUX 1 to {AUX_COUNT} here")
    return ModeRange(Mode(box), aux + 1, low_us, high_us, logic == 1)


def _on_grid(us: int) -> int:
    """Round as Betaflight stores it: within 900 to 2100 us, down to a whole step of 25."""
    held = min(max(us, MODE_LOW_US), HIGH_US)
    return held - (held - MODE_LOW_US) % MODE_STEP_US


def placed(wanted: Iterable[ModeRange], present: Mapping[str, float]) -> dict[str, float]:
    """Return the slots to change so that the modes of `wanted` have those ranges and no others.

    present: the packed ranges of all slots, by setting. Raises ValueError where the slots are too few.
    """
    ranges = list(dict.fromkeys(wanted))
    modes = {one.mode for one in ranges}
    own = [name for name in present if (found := unpacked(present[name])) and found.mode in modes]
    free = [name for name in present if unpacked(present[name]) is None]
    slots = own + free
    if len(ranges) > len(slots):
        raise ValueError(
            f"{len(ranges)} ranges, and {len(slots)} of the {MODE_SLOT_COUNT} slots are free for them"
        )
    packed = [float(one.packed) for one in ranges] + [0.0] * len(slots)
    return {name: value for name, value in zip(slots, packed, strict=False) if name in own or value}


def unpacked(packed: float) -> ModeRange | None:
    """Return the range in a slot; None: it is free, or of a mode that this tool does not know."""
    try:
        return ModeRange.unpack(int(packed))
    except ValueError:
        return None
