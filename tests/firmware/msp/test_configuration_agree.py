"""Configuration messages: what is told of the settings, and what a SET makes of them, a thousand times.

The settings walk at random through all that they may be. What a message tells then is held against the
contract's layouts; what another firmware, of other settings, told goes in as a SET.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link.layouts import decode, encode
from neuroflight.flash.link.msp import Decoder, Direction, Message
from neuroflight.toolchain.contract import SETTINGS
from neuroflight.toolchain.contract.msp_configuration import CONFIGURATIONS
from neuroflight.toolchain.contract.msp_fields import NUMBERS, Bound, MspField, MspHow
from neuroflight.toolchain.contract.msp_layouts import Configuration
from tests.firmware.conftest import Core
from tests.firmware.joined.ground import Ground, Request
from tests.sampling import examples

STATES = examples(1600)
CHANGES = 6  # settings, from one state to the next
INDEX = {setting.name: index for index, setting in enumerate(SETTINGS)}
FILTERS = [index for name, index in INDEX.items() if name.startswith(("filter", "dynamic_notch"))]
NAMES = [pair.reply.message.name for pair in CONFIGURATIONS]
WRITABLE = [pair for pair in CONFIGURATIONS if pair.request is not None]
BITS = {"B": 8, "b": 8, "H": 16, "h": 16, "I": 32, "i": 32}


class Walker:
    """A firmware whose settings walk through what they may be together."""

    def __init__(self, core: Core, seed: int) -> None:
        self.ground = Ground(core)
        self.ground.run(20)
        self.core, self.lib = core, core.lib
        self.edited = core.ffi.addressof(self.ground.background, "edited")
        self._kept, self._presets = core.new("struct nf_settings *"), core.new("struct nf_settings *")
        self._value_kept = core.new("union setting_value *")
        self.lib.settings_default(self._presets)
        self._rng = np.random.default_rng(seed)

    def walk(self) -> None:
        """Some settings become others; those that do not go with the rest stay."""
        if self._rng.random() < 0.6:  # else filters soon have no form that the ecosystem's messages can tell
            for index in FILTERS:
                self.lib.settings_get(self._presets, index, self._value_kept)
                self.lib.settings_set(self.edited, index, self._value_kept)
        for index in self._rng.integers(len(SETTINGS), size=CHANGES).tolist():
            self._kept[0] = self.edited[0]
            value = self._value(index)
            refused = self.lib.settings_set(self.edited, index, value)
            if refused or self.lib.settings_conflict(self.edited) != len(SETTINGS):
                self.edited[0] = self._kept[0]

    def _value(self, index: int) -> Any:
        setting, value = SETTINGS[index], self.core.new("union setting_value *")
        share = self._rng.random()
        number = setting.low + (setting.high - setting.low) * share
        match setting.kind:
            case "float":
                value.as_float = number
            case "text":
                text = self._rng.integers(33, 127, int(number)).astype(np.uint8).tobytes()
                self.core.ffi.memmove(value, text, len(text))
            case _:
                value.as_uint32_t = round(number)
        return value

    def setting(self, name: str) -> float:
        """A setting as it is."""
        value = self.core.new("union setting_value *")
        self.lib.settings_get(self.edited, INDEX[name], value)
        return float(value.as_float if SETTINGS[INDEX[name]].kind == "float" else value.as_uint32_t)

    def ask(self, command: int, payload: bytes = b"") -> bytes | None:
        """The answer's payload; None: it was refused."""
        (said,) = Decoder().feed(self.ground.send(Request(command, payload).frame()))
        assert isinstance(said, Message)
        return said.payload if said.direction is Direction.REPLY else None

    @property
    def bytes(self) -> bytes:
        return bytes(self.core.ffi.buffer(self.edited))


@pytest.fixture(scope="module")
def walker(scripted: Core) -> Walker:
    return Walker(scripted, 18)


@pytest.fixture(scope="module")
def other(scripted: Core) -> Walker:
    """Another, whose settings are told to the first."""
    return Walker(scripted, 81)


def states(walker: Walker) -> Iterator[int]:
    for number in range(STATES):
        walker.walk()
        yield number


def held(field: MspField, number: float) -> float:
    """As near as the field can say it."""
    letter = NUMBERS[field.kind]
    span = 2 ** BITS[letter]
    low = 0 if letter.isupper() else -span // 2
    return float(min(max(number, low), low + span - 1))


def bound_fields(pair: Configuration) -> list[tuple[MspField, Bound]]:
    """What a SET brings, and where it goes."""
    assert pair.request is not None
    return [(f, f.bound) for f in pair.request.fields if isinstance(f, MspField) and f.bound is not None]


def meant(values: dict[str, Any], fields: list[MspField]) -> dict[str, Any]:
    """What the fields say; of a scale above a divider, what both together do."""
    found = {field.name: values[field.name] for field in fields}
    if "divider" in found:
        found["scale"] /= found.pop("divider") * found.pop("multiplier")
    return found


def check_field(walker: Walker, field: MspField, told: Any) -> None:
    """What was told of a setting is that setting."""
    bound = field.bound
    assert bound is not None
    for one in told if field.count > 1 else (told,):
        match bound.how:
            case MspHow.CONSTANT | MspHow.UNUSED:
                assert one == bound.number
            case MspHow.SCALED:
                exact = walker.setting(bound.setting) * bound.gain + bound.offset
                assert one == pytest.approx(held(field, exact), rel=1e-6, abs=0.5005), field.name
            case MspHow.CHOICE:
                assert one == bound.choices[int(walker.setting(bound.setting))], field.name


@pytest.mark.parametrize("pair", CONFIGURATIONS, ids=NAMES)
def test_it_tells_its_settings_to_the_byte(walker: Walker, pair: Configuration) -> None:
    told = 0
    for _ in states(walker):
        payload = walker.ask(pair.reply.message)
        if payload is None:  # these filters have no such form
            continue
        told += 1
        values = decode(pair.reply, payload, whole=True)
        assert encode(pair.reply, values) == payload
        for field in pair.reply.fields:
            assert isinstance(field, MspField)
            check_field(walker, field, values[field.name])
    assert told > STATES // 50


@pytest.mark.parametrize("pair", WRITABLE, ids=[pair.reply.message.name for pair in WRITABLE])
def test_nothing_changes_when_what_it_told_is_sent_back(walker: Walker, pair: Configuration) -> None:
    assert pair.request is not None
    names = {field.name for field in pair.request.fields}
    taken = 0
    for _ in states(walker):
        payload = walker.ask(pair.reply.message)
        if payload is None:
            continue
        values = decode(pair.reply, payload, whole=True)
        back = encode(pair.request, {name: value for name, value in values.items() if name in names})
        before = walker.bytes
        assert walker.ask(pair.request.message, back) is not None, values
        assert walker.bytes == before
        taken += 1
    assert taken > STATES // 50


@pytest.mark.parametrize("pair", WRITABLE, ids=[pair.reply.message.name for pair in WRITABLE])
def test_it_tells_what_it_was_set_to_when_another_told_it(
    walker: Walker, other: Walker, pair: Configuration
) -> None:
    """Taken, it tells the same; refused, of each field the same or what it told before. No setting beside the
    message's changes."""
    assert pair.request is not None
    brought = bound_fields(pair)
    told_back = [f for f, bound in brought if not f.told_only and bound.how is not MspHow.UNUSED]
    bounds = {bound.setting for _, bound in brought if bound.setting}
    computed = any(bound.how is MspHow.SOURCE for _, bound in brought)
    names = {field.name for field in pair.request.fields}
    taken = 0
    for _ in states(walker):
        other.walk()
        payload, told = other.ask(pair.reply.message), walker.ask(pair.reply.message)
        if payload is None or told is None:
            continue
        values, before = decode(pair.reply, payload, whole=True), decode(pair.reply, told, whole=True)
        sent = {name: value for name, value in values.items() if name in names}
        settings = {
            setting.name: walker.setting(setting.name) for setting in SETTINGS if setting.kind != "text"
        }
        refused = walker.ask(pair.request.message, encode(pair.request, sent)) is None
        now = decode(pair.reply, walker.ask(pair.reply.message) or b"", whole=True)
        if refused and not computed:
            for field in told_back:
                assert meant(now, [field]) in (meant(sent, [field]), meant(before, [field])), (
                    field.name,
                    sent,
                )
        elif not refused:
            taken += 1
            assert meant(now, told_back) == meant(sent, told_back)
        if not computed:
            changed = {name for name, value in settings.items() if walker.setting(name) != value}
            assert changed <= bounds, sent
    assert taken > STATES // 50
