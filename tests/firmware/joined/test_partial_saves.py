"""SETs of which a part is refused, and saves between them: what is stored goes together, and the next boot
takes it."""

from __future__ import annotations

import random

import pytest

from neuroflight.flash.link import layouts
from neuroflight.flash.link.msp import Decoder, Message
from neuroflight.toolchain.contract import CONFIGURATIONS, SETTINGS, Direction, Msp, Refusal, layout_of
from tests.firmware.conftest import Core
from tests.firmware.joined.ground import Ground, Request, State

PAIRS = [(pair.request.message, pair.reply.message) for pair in CONFIGURATIONS if pair.request is not None]
SAVE = Request(Msp.EEPROM_WRITE)
AS_STORED = 1  # enum of settings_store.h


@pytest.fixture(scope="module")
def ground(scripted: Core) -> Ground:
    return Ground(scripted)


@pytest.fixture(scope="module")
def ready(ground: Ground) -> State:
    """A peer has read all that it may change."""
    for _, get in PAIRS:
        ground.ask(Request(get))
    ground.ask(Request(Msp.MODE_RANGES))
    return ground.keep()


def told(ground: Ground, get: Msp, to_set: Msp) -> bytes:
    """What sets all to what it is."""
    layout = layout_of(to_set, Direction.REQUEST)
    (reply,) = (one for one in Decoder().feed(ground.send(Request(get).frame())) if isinstance(one, Message))
    if layout is None or not reply.payload:
        return b""
    values = layouts.decode(layout_of(get), reply.payload)
    return layouts.encode(layout, {field.name: values[field.name] for field in layout.fields})


def request(ground: Ground, chance: random.Random) -> Request:
    """A SET with some bytes that are others, and perhaps its end missing."""
    kind = chance.random()
    if kind < 0.2:
        modes, ends = (0, 0, 13, 40, 255), (0, 16, 32, 48, 49)
        numbers = [
            chance.choice(row) for row in (range(21), modes, (0, 2, 12, 255), ends, ends, (0, 1, 2), (0, 1))
        ]
        return Request(Msp.SET_MODE_RANGE, bytes(numbers)[: chance.choice((4, 5, 6, 7, 7))])
    if kind < 0.3:
        outputs = (
            chance.choices((0, 1, 2, 3, 200), k=4) if chance.random() < 0.5 else chance.sample(range(4), 4)
        )
        return Request(Msp.SET_MOTOR_OUTPUT_REORDERING, bytes([4, *outputs]))
    to_set, get = chance.choice(PAIRS)
    data = bytearray(told(ground, get, to_set))
    for _ in range(chance.choice((0, 1, 1, 2, 5)) if data else 0):
        data[chance.randrange(len(data))] = chance.choice((0, 1, 255, chance.randrange(256)))
    if chance.random() < 0.1:
        del data[chance.randrange(len(data) + 1) :]
    return Request(to_set, bytes(data))


@pytest.mark.parametrize("seed", range(2))
def test_what_is_stored_goes_together_whatever_was_refused_before(
    ground: Ground, ready: State, seed: int
) -> None:
    chance = random.Random(seed)
    ground.go_back(ready)
    ffi, lib = ground.core.ffi, ground.lib
    edited = ffi.addressof(ground.background, "edited")
    loaded = ground.core.new("struct nf_settings *")
    refused, seen = False, set()
    for _ in range(600):
        one, before = request(ground, chance), ground.seen.settings
        done = ground.ask(one)
        refused |= not done
        seen.add((done, ground.seen.settings != before))
        assert lib.settings_conflict(edited) == len(SETTINGS), one
        if chance.random() < 0.05:
            assert ground.ask(SAVE) != refused, "it says whether all is stored"
            assert not refused or ground.reason == Refusal.SPOILT
            assert lib.settings_load(loaded, ffi.addressof(ground.hal, "flash")) == AS_STORED
            assert bytes(ffi.buffer(loaded)) == ground.seen.settings
            refused = False
    assert seen == {(True, True), (True, False), (False, True), (False, False)}
