"""A gamepad through SDL: a virtual one of SDL's own, moved and unplugged as a real one."""

from __future__ import annotations

import sys

import pytest

from neuroflight.flash.channels.gamepad import (
    DEFAULT_AXES,
    DEFAULT_BUTTONS,
    Gamepad,
    Mapping,
    channels_of,
    parse_mapping,
)
from neuroflight.flash.channels.layout import NAMES, REST, Channels
from neuroflight.flash.channels.source import Instead, SourceLostError
from neuroflight.toolchain.errors import LinkError
from tests.flash.virtual_pad import AXES, FULL, Pad

DEFAULT = parse_mapping(DEFAULT_AXES, DEFAULT_BUTTONS, throttle_from_centre=True)


def named(channels: Channels | Instead) -> dict[str, int]:
    assert not isinstance(channels, Instead)
    return dict(zip(NAMES, channels, strict=True))


def test_sticks_and_buttons_move_their_channels(plugged: Pad) -> None:
    with Gamepad(plugged.index, DEFAULT) as pad:
        for number in range(AXES):
            plugged.axis(pad, number, 0)
        assert pad.at(0.0) == REST
        plugged.axis(pad, 1, -FULL)  # left stick up
        plugged.axis(pad, 0, FULL)
        plugged.axis(pad, 4, FULL)  # right stick down
        plugged.axis(pad, 3, FULL // 2)
        plugged.button(pad, 4, True)
        told = named(pad.at(0.0))
        assert (told["throttle"], told["yaw"], told["pitch"], told["roll"]) == (2000, 2000, 1000, 1750)
        assert (told["aux1"], told["aux2"]) == (2000, 1000)
        plugged.axis(pad, 1, FULL)  # down: no throttle below the middle
        plugged.button(pad, 4, False)
        told = named(pad.at(0.0))
        assert (told["throttle"], told["aux1"]) == (1000, 1000)


def test_nothing_is_told_any_more_when_it_is_unplugged(plugged: Pad) -> None:
    with Gamepad(plugged.index, DEFAULT) as pad:
        plugged.axis(pad, 1, -FULL)
        plugged.button(pad, 4, True)
        assert named(pad.at(0.0))["aux1"] == 2000
        plugged.unplug()
        with pytest.raises(SourceLostError, match="is gone, expected it to stay plugged in"):
            pad.at(0.02)
        with pytest.raises(SourceLostError):  # SDL would tell the old positions for ever
            pad.at(0.04)


def test_one_line_says_so_when_it_is_not_there_or_has_less(plugged: Pad) -> None:
    with pytest.raises(LinkError, match=r"--gamepad got 7, and 1 gamepad\(s\) are there"):
        Gamepad(7, DEFAULT)
    more = parse_mapping(["roll=6"], [], throttle_from_centre=True)
    plugged.unplug()
    other = Pad()
    with pytest.raises(
        LinkError, match=r"--axis roll=6: the gamepad .* has 6 of them, expected a number below 6"
    ):
        Gamepad(other.index, more)
    other.unplug()
    with pytest.raises(LinkError, match="got 0, and no gamepad"):
        Gamepad(0, DEFAULT)


def test_one_line_names_the_extra_when_the_library_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(
        LinkError, match=r"--gamepad needs pygame-ce, .* pip install 'neuroflight\[gamepad\]'"
    ):
        Gamepad(0, DEFAULT)


def test_the_whole_way_of_the_throttle_counts_when_it_is_said() -> None:
    whole = Mapping(DEFAULT.axes, (), throttle_from_centre=False)
    axes = [0.0] * 6
    assert named(channels_of(whole, axes, []))["throttle"] == 1500
    axes[1] = 1.0
    assert named(channels_of(whole, axes, []))["throttle"] == 1000
    assert named(channels_of(DEFAULT, [0.0] * 6, [False] * 6)) == dict(zip(NAMES, REST, strict=True))
    axes[3] = 1.7  # no axis is beyond its end
    assert named(channels_of(whole, axes, []))["roll"] == 2000


@pytest.mark.parametrize(
    ("axes", "buttons", "told"),
    [
        (["rol=1"], [], "--axis got 'rol=1', expected CHANNEL=NUMBER"),
        (["roll"], [], "--axis got 'roll'"),
        (["roll=x"], [], "--axis got 'roll=x', expected the number of an axis"),
        ([], ["aux1=-1"], "--button got 'aux1=-1', expected the number"),
        (["aux1=1"], ["aux1=2"], "aux1 is moved by two of --axis and --button"),
    ],
)
def test_a_mapping_is_refused_when_it_is_none(axes: list[str], buttons: list[str], told: str) -> None:
    with pytest.raises(LinkError, match=told):
        parse_mapping(axes, buttons, throttle_from_centre=True)
