"""How a board reads channels: their places, and what arms it."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from neuroflight.flash.channels.layout import NAMES, REST, Layout, read_layout, throttle_low
from neuroflight.flash.settings.text import parse_mode
from neuroflight.toolchain.contract import CHANNEL_COUNT
from neuroflight.toolchain.errors import LinkError


def settings(**changes: float | str) -> Callable[[str], float]:
    """A board's settings: the defaults, but for `changes`; modes as texts."""
    known = {f"map_{name}": float(place) for place, name in enumerate(NAMES[:8])}
    known |= {f"mode{slot}": 0.0 for slot in range(1, 21)} | {
        "mode1": parse_mode("mode1", "arm aux1 1700 2100")
    }
    known |= {n: parse_mode(n, v) if isinstance(v, str) else v for n, v in changes.items()}
    return known.__getitem__


def with_aux(**changes: int) -> tuple[int, ...]:
    return tuple(changes.get(name, us) for name, us in zip(NAMES, REST, strict=True))


def layout(**changes: float | str) -> Layout:
    return read_layout(settings(**changes))


def test_channels_go_where_the_map_says() -> None:
    mapped = layout(map_roll=3, map_yaw=0)
    sent = mapped.on_wire(tuple(range(1000, 1000 + CHANNEL_COUNT)))
    assert sent == [1003, 1001, 1002, 1000, *range(1004, 1016)]
    with pytest.raises(LinkError, match="name a channel twice"):
        layout(map_roll=3)


def test_it_arms_as_the_firmware_sees_it_at_the_ends_of_a_range() -> None:
    usual = layout()
    assert [usual.arms(with_aux(aux1=us)) for us in (1699, 1700, 2099, 2100, 2250)] == [
        False,
        *[True] * 4,  # beyond the limits counts as the nearest value inside
    ]
    narrow = layout(mode1="arm aux1 1300 1500")
    assert [narrow.arms(with_aux(aux1=us)) for us in (1299, 1300, 1499, 1500)] == [False, True, True, False]
    low = layout(mode1="arm aux1 900 1200")
    assert low.arms(with_aux(aux1=800)) and low.arms(REST)


def test_any_of_several_ranges_counts_as_armed() -> None:
    several = layout(
        mode1="arm aux1 1700 2100 and", mode2="arm aux3 1700 2100 and", mode3="beeper aux2 900 2100"
    )
    assert several.arms(with_aux(aux3=2000))
    assert not several.arms(with_aux(aux2=2000))


@pytest.mark.parametrize(
    ("ranges", "off"),
    [
        ({"mode1": "arm aux1 1700 2100"}, {"aux1": 1000}),
        ({"mode1": "arm aux2 900 1500"}, {"aux2": 2000}),
        ({"mode1": "arm aux1 900 1300", "mode2": "arm aux1 1700 2100"}, {"aux1": 1300}),
        ({"mode1": "arm aux1 1700 2100", "mode2": "arm aux5 900 1200"}, {"aux1": 1000, "aux5": 2000}),
        ({"mode1": "none"}, {}),
    ],
)
def test_disarmed_is_what_no_range_holds(ranges: dict[str, str], off: dict[str, int]) -> None:
    board = layout(**ranges)
    channels = board.disarmed(with_aux(throttle=1800, aux1=1900, aux2=1100, aux5=1000))
    assert not board.arms(channels) and throttle_low(channels)
    assert {name: channels[NAMES.index(name)] for name in off} == off
    assert not board.arms(board.resting())


def test_a_board_that_is_always_armed_is_refused() -> None:
    with pytest.raises(LinkError, match="the arm switch is on at every position of aux1"):
        layout(mode1="arm aux1 900 2100")
