"""settings_store.c: sets of settings in two sectors, complete whenever power is cut."""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from neuroflight.toolchain.contract import (
    AXES,
    FLASH_SETTINGS,
    SETTING_TEXT_BYTES,
    SETTINGS,
    Mode,
    ModeRange,
    Refusal,
    Setting,
)

MakeChip = Callable[..., Any]
HEAD_WORDS = 4
WORDS = sum(SETTING_TEXT_BYTES // 4 if setting.kind == "text" else 1 for setting in SETTINGS)
OPERATIONS = 1 + HEAD_WORDS + 2 * WORDS + 1  # erase, head, entries, CRC
KINDS = range(5)  # of cuts: enum flash_cut


class Store:
    """Settings over a chip."""

    loaded = 0  # by the last load: of enum settings_loaded

    def __init__(self, chip: Any) -> None:
        self.chip, self.core = chip, chip.core

    def save(self, **changes: float | bytes) -> int:
        """Save the defaults with these changes."""
        made = self.core.new("struct nf_settings *")
        self.core.lib.settings_default(made)
        for name, value in changes.items():
            setattr(made, name, value)
        return int(self.core.lib.settings_save(made, self.chip.flash))

    def load(self) -> tuple[bool, dict[str, float | bytes]]:
        """Whether a set was found, and what differs from the defaults."""
        made = self.core.new("struct nf_settings *")
        self.loaded = self.core.lib.settings_load(made, self.chip.flash)
        found = self.loaded != self.core.lib.SETTINGS_NONE
        default = self.core.new("struct nf_settings *")
        self.core.lib.settings_default(default)
        differ: dict[str, float | bytes] = {}
        for setting in SETTINGS:
            value, preset = (self._value(settings, setting) for settings in (made, default))
            if value != preset:
                differ[setting.name] = value
        return found, differ

    def _value(self, settings: Any, setting: Setting) -> float | bytes:
        value = getattr(settings, setting.name)
        return bytes(self.core.ffi.string(value)) if setting.kind == "text" else float(value)


@pytest.fixture
def store(chip: MakeChip) -> Store:
    return Store(chip())


MODES = [setting.name for setting in SETTINGS if setting.kind == "mode"]
OLD: dict[str, float | bytes] = {
    "deadband_us": 7,
    "yaw_expo": 0.25,
    "uart3_baud": 9600,
    "battery_scale": 10.5,
}
NEW: dict[str, float | bytes] = {"deadband_us": 8, "yaw_expo": 0.75, "uart3_baud": 19200, "motor_limit": 0.5}
TEXT = b"sixteen letters!"


def as_set(
    values: Mapping[str, float | bytes],
    sequence: int,
    *,
    magic: bytes = b"NFPS",
    layout: int = 1,
    **names: str,
) -> bytes:
    """A set as the documentation of settings_store.c has it, built by other means."""
    kinds = {setting.name: setting.kind for setting in SETTINGS}
    entries: list[bytes] = []
    for name, value in values.items():
        key = zlib.crc32(names.get(name, name).encode())
        form = "<f" if kinds.get(name) == "float" else "<I"
        raw = value.ljust(SETTING_TEXT_BYTES, b"\0") if isinstance(value, bytes) else struct.pack(form, value)
        entries += [struct.pack("<I", key + at // 4) + raw[at : at + 4] for at in range(0, len(raw), 4)]
    body = magic + struct.pack("<3I", layout, sequence, len(entries)) + b"".join(entries)
    return body + struct.pack("<I", zlib.crc32(body))


# --- Sets come back ---------------------------------------------------------------------------
def test_defaults_are_loaded_when_flash_is_erased_or_noise(store: Store) -> None:
    assert store.load() == (False, {})
    noise = np.random.default_rng(3).bytes(FLASH_SETTINGS[0].size)
    for region in FLASH_SETTINGS:
        store.chip.fill(region.address, noise)
        assert store.load() == (False, {})
        store.chip.fill(region.address, bytes(region.size))
        assert store.load() == (False, {})


def test_the_last_set_comes_back_when_saved_again_and_again(store: Store) -> None:
    for deadband in range(1, 12):
        before = store.chip.operations
        assert store.save(deadband_us=deadband) == Refusal.NONE
        assert store.chip.operations - before == OPERATIONS
        assert store.load() == (True, {"deadband_us": deadband})
        store.chip.power_on()
        assert store.load() == (True, {"deadband_us": deadband})


def test_sectors_take_turns_when_saved(store: Store) -> None:
    for deadband in range(1, 7):
        before = [store.chip.region(region) for region in FLASH_SETTINGS]
        store.save(deadband_us=deadband)
        changed = [
            store.chip.region(region) != old for region, old in zip(FLASH_SETTINGS, before, strict=True)
        ]
        assert changed == [deadband % 2 == 1, deadband % 2 == 0]


def test_a_set_of_every_setting_comes_back_when_none_is_at_its_default(store: Store) -> None:
    def other(setting: Setting) -> float | bytes:
        if setting.kind == "text":
            return TEXT
        if setting.kind == "mode":
            return ModeRange(Mode.BEEPER, 5, 1300, 1700).packed
        if setting.name.endswith("_output"):  # the motors of a quadcopter change places
            return {1: 4, 4: 1, 2: 3, 3: 2}.get(int(setting.default), 1)
        if setting.name.startswith("map_"):
            return 7 - setting.default
        if setting.name == "gyro_rate_hz":
            return 8000
        if setting.betaflight is not None:
            return setting.betaflight.high
        return setting.high if setting.default != setting.high else setting.low

    changes = {setting.name: other(setting) for setting in SETTINGS}
    changes |= {"filter4_hz": 3000.0, "filter3_hz": 3000.0, "filter2_hz": 3000.0, "filter1_hz": 3000.0}
    changes |= {"battery_low_v": 2.5}
    changes |= {f"{axis}_max": 0.0 for axis in AXES}  # beside the highest RC rate
    assert store.save(**changes) == Refusal.NONE
    found, loaded = store.load()
    assert found
    assert set(loaded) == set(changes)
    assert loaded == pytest.approx(changes)


def test_nothing_is_written_when_settings_do_not_go_together(store: Store) -> None:
    assert store.save(**OLD) == Refusal.NONE
    before, operations = store.chip.content, store.chip.operations
    assert store.save(map_roll=1) == Refusal.CONFLICT
    assert (store.chip.content, store.chip.operations) == (before, operations)


# --- Sets of other versions -------------------------------------------------------------------
@pytest.mark.parametrize(
    ("older", "newer"), [(5, 6), (2, 2**31 + 1), (0xFFFFFFFF, 0), (0xFFFFFFFE, 3), (0xFFFFFFFE, 0xFFFFFFFF)]
)
@pytest.mark.parametrize("place", [0, 1])
def test_the_newer_set_wins_when_both_sectors_hold_one_and_numbers_wrap(
    store: Store, older: int, newer: int, place: int
) -> None:
    store.chip.fill(FLASH_SETTINGS[place].address, as_set({"deadband_us": 1}, newer))
    store.chip.fill(FLASH_SETTINGS[1 - place].address, as_set({"deadband_us": 2}, older))
    assert store.load() == (True, {"deadband_us": 1})
    for deadband in (3, 4, 5):
        assert store.save(deadband_us=deadband) == Refusal.NONE
        assert store.load() == (True, {"deadband_us": deadband})


@pytest.mark.parametrize(
    ("stored", "flown"),
    [
        # What a set of before the limits of each style may hold: both numbers as they are by default.
        ({"roll_rate": 1000.0, "roll_max": 1000.0}, {"roll_rate": 1.0, "roll_max": 0.7}),
        ({"roll_rate": 1.5, "roll_max": 1000.0}, {"roll_rate": 1.5, "roll_max": 0.7}),
        ({"roll_rate": 2.0, "roll_max": 0.5, "roll_expo": 0.25}, {"roll_rate": 2.0, "roll_max": 0.5}),
        ({}, {"roll_rate": 1.0, "roll_max": 0.7, "roll_expo": 0.0}),
    ],
)
@pytest.mark.parametrize("style_first", [False, True])
def test_a_set_is_never_flown_with_the_rates_of_another_style_when_loaded(
    store: Store, stored: dict[str, float], flown: dict[str, float], style_first: bool
) -> None:
    style: dict[str, float] = {"rates_style": 1}
    store.chip.fill(FLASH_SETTINGS[0].address, as_set(style | stored if style_first else stored | style, 3))
    made = store.core.new("struct nf_settings *")
    assert store.core.lib.settings_load(made, store.chip.flash)
    assert made.rates_style == 1
    assert {name: getattr(made, name) for name in flown} == pytest.approx(flown, rel=1e-7)
    assert (made.yaw_rate, made.yaw_max) == pytest.approx((1.0, 0.7))


@pytest.mark.parametrize(
    ("stored", "differ", "whole"),
    [
        ({"mode1": 0x64201 | 99}, {"mode1": 0}, True),  # a mode to come, where `arm` is by default
        ({"mode1": 99, "mode2": 99, "mode3": 99, "mode4": 99}, dict.fromkeys(MODES[:4], 0), True),
        ({"mode9": 77 | 5 << 12 | 30 << 18}, {}, True),
        (
            {"mode1": ModeRange(Mode.ARM, 5, 1300, 1700).packed | 1 << 26},
            {"mode1": 0},
            False,
        ),  # a kind
        ({"mode2": 13 << 8 | Mode.PID}, {"mode2": 0}, False),  # an AUX channel to come
        ({"mode1": 0}, {"mode1": 0}, True),
        ({"map_aux1": 9}, {}, False),
        ({"map_aux1": 7}, {}, False),  # and AUX 4 there as well
        ({"motor2_output": 3}, {}, False),
        ({"gyro_alignment": 9}, {}, False),
        ({"board_yaw_deg": math.nan}, {}, False),
        ({"policy_trial": 2}, {}, False),
        ({"failsafe_delay_ms": 250}, {}, False),  # as older versions took it
        ({"roll_max": 1998.0, "deadband_us": 3}, {"deadband_us": 3}, False),
        ({"to_come": 77, "deadband_us": 3}, {"deadband_us": 3}, True),
        ({"craft_name": b"\x80"}, {}, False),
    ],
)
def test_what_this_version_does_not_take_is_told_and_arms_on_no_other_switch(
    store: Store, stored: dict[str, Any], differ: dict[str, float], whole: bool
) -> None:
    store.chip.fill(FLASH_SETTINGS[0].address, as_set(stored, 3))
    assert store.load() == (True, differ)
    assert store.loaded == (store.core.lib.SETTINGS_AS_STORED if whole else store.core.lib.SETTINGS_MENDED)
    made = store.core.new("struct nf_settings *")
    store.core.lib.settings_load(made, store.chip.flash)
    assert store.core.lib.settings_save(made, store.chip.flash) == Refusal.NONE
    store.load()
    assert store.loaded == store.core.lib.SETTINGS_AS_STORED, "once saved it is what the pilot has seen"


def test_old_values_are_kept_when_the_firmware_has_more_settings(store: Store) -> None:
    store.chip.fill(FLASH_SETTINGS[1].address, as_set({"yaw_expo": 0.5, "deadband_us": 20}, 3))
    assert store.load() == (True, {"yaw_expo": 0.5, "deadband_us": 20})


def test_unknown_settings_are_passed_over_when_the_firmware_has_fewer(store: Store) -> None:
    values = {"deadband_us": 20, "to_come": 77, "yaw_expo": 0.5}
    store.chip.fill(FLASH_SETTINGS[0].address, as_set(values, 3))
    assert store.load() == (True, {"yaw_expo": 0.5, "deadband_us": 20})


def test_values_find_their_settings_when_they_stand_in_another_order(store: Store) -> None:
    changed: dict[str, float | bytes] = {"pitch_max": 720.0, "pilot_name": TEXT}
    values = {setting.name: setting.default for setting in reversed(SETTINGS) if setting.kind != "text"}
    store.chip.fill(FLASH_SETTINGS[0].address, as_set({**values, **changed}, 3))
    assert store.load() == (True, changed)


def test_a_text_comes_back_when_it_was_saved(store: Store) -> None:
    store.save(craft_name=TEXT, pilot_name=b"A")
    assert store.load() == (True, {"craft_name": TEXT, "pilot_name": b"A"})


def test_a_text_is_the_default_when_a_part_of_it_is_missing(store: Store) -> None:
    whole = as_set({"craft_name": TEXT, "deadband_us": 7}, 3)
    head, entries = whole[:16], whole[16:-4]
    body = head[:12] + struct.pack("<I", 4) + entries[:16] + entries[24:]
    store.chip.fill(FLASH_SETTINGS[0].address, body + struct.pack("<I", zlib.crc32(body)))
    assert store.load() == (True, {"deadband_us": 7})


def test_a_value_is_the_default_when_its_limits_have_changed_since(store: Store) -> None:
    values = {"deadband_us": 101, "motor_limit": float("nan"), "yaw_expo": 0.5}
    store.chip.fill(FLASH_SETTINGS[0].address, as_set(values, 3))
    assert store.load() == (True, {"yaw_expo": 0.5})


def test_conflicting_values_are_mended_when_loaded(store: Store) -> None:
    store.chip.fill(FLASH_SETTINGS[0].address, as_set({"map_aux1": 0, "map_aux2": 7, "yaw_expo": 0.5}, 3))
    assert store.load() == (True, {"yaw_expo": 0.5})


@pytest.mark.parametrize(
    "broken",
    [
        as_set(NEW, 9, magic=b"NFPX"),
        as_set(NEW, 9, layout=2),
        as_set(NEW, 9)[:-1] + b"\x00",
        as_set(NEW, 9)[:12] + struct.pack("<I", 0xFFFFFFFF) + as_set(NEW, 9)[16:],
        as_set(NEW, 9)[:12] + struct.pack("<I", 2046) + as_set(NEW, 9)[16:],
    ],
    ids=["magic", "layout", "crc", "count", "count past the sector"],
)
def test_the_older_set_is_loaded_when_the_newer_is_broken(store: Store, broken: bytes) -> None:
    store.chip.fill(FLASH_SETTINGS[0].address, as_set({"deadband_us": 1}, 4))
    store.chip.fill(FLASH_SETTINGS[1].address, broken)
    assert store.load() == (True, {"deadband_us": 1})
    store.save(deadband_us=2)
    assert store.load() == (True, {"deadband_us": 2})
    assert store.chip.region(FLASH_SETTINGS[0])[: len(as_set({"deadband_us": 1}, 4))] == as_set(
        {"deadband_us": 1}, 4
    ), "the good one was not the one to be erased"


def test_each_setting_has_a_key_of_its_own_when_named() -> None:
    words = {s.name: SETTING_TEXT_BYTES // 4 if s.kind == "text" else 1 for s in SETTINGS}
    keys = {zlib.crc32(name.encode()) + word for name, count in words.items() for word in range(count)}
    assert len(keys) == WORDS


def test_a_save_says_so_when_flash_does_not_take_it(chip: MakeChip) -> None:
    for at in range(OPERATIONS):
        s = Store(chip())
        s.chip.cut(at, 0, 1)
        assert s.save(**NEW) == Refusal.FLASH


def test_a_save_says_so_when_flash_only_claims_to_have_taken_it(store: Store) -> None:
    assert store.save(**OLD) == Refusal.NONE
    claims = store.core.ffi.callback("bool(void *, uint32_t, const void *, size_t)", lambda *_: True)
    store.chip.flash.program = claims
    assert store.save(**NEW) == Refusal.FLASH
    store.chip.power_on()
    assert store.load() == (True, OLD)


# --- Power goes ---------------------------------------------------------------------------------
# What flash holds before: how many sets were saved, the last of them OLD.
@pytest.mark.parametrize("saves", [0, 1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_the_old_or_the_new_set_is_there_when_power_goes_at_any_operation(
    store: Store, saves: int, kind: int
) -> None:
    for save in range(saves):
        store.save(**(OLD if save == saves - 1 else {"deadband_us": 99}))
    before = store.chip.content
    old = (True, OLD) if saves else (False, {})
    assert store.load() == old
    seen = []
    for at in range(OPERATIONS):
        for seed in (11 * at, 11 * at + 1):
            store.chip.content = before
            store.chip.cut(at, kind, seed)
            assert store.save(**NEW) == Refusal.FLASH
            store.chip.power_on()
            loaded = store.load()
            assert loaded in (old, (True, NEW)), (at, seed)
            seen.append(loaded == old)
        assert store.save(deadband_us=50) == Refusal.NONE, "it can be saved again"
        assert store.load() == (True, {"deadband_us": 50})
    assert all(seen[: 2 * (OPERATIONS - 1)]), "nothing is new before its CRC stands"
    if kind == 1:
        assert not any(seen[2 * (OPERATIONS - 1) :]), "all had been written when power went"


def test_a_set_is_there_when_power_goes_again_and_again(store: Store) -> None:
    """Cuts one after the other, without a whole save between them: what was good stays good."""
    s, rng = store, np.random.default_rng(8)
    s.save(**OLD)
    good: Mapping[str, float | bytes] = OLD
    for attempt in range(300):
        wanted: dict[str, float | bytes] = {"deadband_us": int(rng.integers(1, 100))}
        s.chip.cut(int(rng.integers(OPERATIONS + 3)), int(rng.integers(5)), attempt)
        saved = s.save(**wanted) == Refusal.NONE
        s.chip.power_on()
        found, loaded = s.load()
        assert found
        assert loaded in ((wanted,) if saved else (good, wanted))
        good = loaded
