"""A gamepad, or a transmitter that shows itself as one over USB: axes and buttons to channels.

Read by SDL through pygame-ce (extra `gamepad`). SDL keeps the last position of a device that was unplugged:
its removal is looked for before each reading, so that no stale stick is ever sent.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from neuroflight.flash.channels.layout import NAMES, REST, Channels
from neuroflight.flash.channels.source import Instead, SourceLostError
from neuroflight.toolchain.contract import CHANNEL_MAX_US, CHANNEL_MID_US, CHANNEL_MIN_US, CHANNEL_THROTTLE
from neuroflight.toolchain.errors import LinkError

STICK_SPAN_US = (CHANNEL_MAX_US - CHANNEL_MIN_US) // 2
NO_SCREEN = {  # of SDL: it needs no window, and must leave signals to Python
    "SDL_VIDEODRIVER": "dummy",
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
    "SDL_NO_SIGNAL_HANDLERS": "1",
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}


@dataclass(frozen=True)
class Axis:
    """An axis of the device that moves a channel."""

    channel: int  # place in NAMES
    number: int
    inverted: bool  # for axes whose upper end is -1


@dataclass(frozen=True)
class Button:
    """A button that puts a switch to its upper position while it is held."""

    channel: int
    number: int


@dataclass(frozen=True)
class Mapping:
    """The axis or button of each channel. A channel without one is at rest."""

    axes: tuple[Axis, ...]
    buttons: tuple[Button, ...]
    # True: a stick that springs back, whose centre is throttle down and whose upper half raises it. False:
    # the stick's whole travel, as on a transmitter.
    throttle_from_centre: bool = True


DEFAULT_AXES = (
    "roll=3",
    "pitch=-4",
    "throttle=-1",
    "yaw=0",
)  # mode 2 on the usual pad: left stick is throttle
DEFAULT_BUTTONS = ("aux1=4", "aux2=5")  # the two upper shoulder buttons


def parse_mapping(axes: Sequence[str], buttons: Sequence[str], *, throttle_from_centre: bool) -> Mapping:
    """Read CHANNEL=NUMBER, an axis with - before an inverted one. Raises LinkError."""
    read_axes = []
    for word in axes:
        channel, number = _pair("--axis", word)
        inverted = number.startswith("-")
        read_axes.append(Axis(channel, _number("--axis", word, number.removeprefix("-")), inverted))
    read_buttons = []
    for word in buttons:
        channel, number = _pair("--button", word)
        read_buttons.append(Button(channel, _number("--button", word, number)))
    moved = [axis.channel for axis in read_axes] + [button.channel for button in read_buttons]
    for channel in moved:
        if moved.count(channel) > 1:
            raise LinkError(f"{NAMES[channel]} is moved by two of --axis and --button, expected one")
    return Mapping(tuple(read_axes), tuple(read_buttons), throttle_from_centre)


def _pair(option: str, word: str) -> tuple[int, str]:
    name, equals, number = word.partition("=")
    if not equals or name not in NAMES:
        raise LinkError(f"{option} got {word!r}, expected CHANNEL=NUMBER, CHANNEL roll, pitch, ... or aux12")
    return NAMES.index(name), number


def _number(option: str, word: str, number: str) -> int:
    if not (number.isascii() and number.isdecimal() and len(number) <= 3):
        raise LinkError(f"{option} got {word!r}, expected the number of an axis or button from 0 on")
    return int(number)


def channels_of(mapping: Mapping, axes: Sequence[float], buttons: Sequence[bool]) -> Channels:
    """Convert a device's axes, -1..1 by number, and held buttons to channels."""
    channels = list(REST)
    for axis in mapping.axes:
        value = max(-1.0, min(1.0, -axes[axis.number] if axis.inverted else axes[axis.number]))
        if axis.channel == CHANNEL_THROTTLE and mapping.throttle_from_centre:
            channels[axis.channel] = CHANNEL_MIN_US + round(2 * STICK_SPAN_US * max(0.0, value))
        else:
            channels[axis.channel] = CHANNEL_MID_US + round(STICK_SPAN_US * value)
    for button in mapping.buttons:
        channels[button.channel] = CHANNEL_MAX_US if buttons[button.number] else CHANNEL_MIN_US
    return tuple(channels)


class Gamepad:
    """A Source: an open gamepad, until it is closed or unplugged."""

    def __init__(self, index: int, mapping: Mapping) -> None:
        """index: from 0, in the system's order. Raises LinkError if library, device or axis is missing."""
        self._mapping = mapping
        self._gone = False  # permanent, even if another device takes its place
        self._game = _library()
        self._game.display.init()  # its events report removals; the dummy driver opens no window
        self._game.joystick.init()
        try:
            self._device = self._open(index)
        except BaseException:
            self.close()
            raise
        self.name = str(self._device.get_name())

    def __enter__(self) -> Gamepad:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def at(self, elapsed_s: float) -> Channels | Instead:
        """See Source; `elapsed_s` does not matter."""
        removed = self._game.event.get(self._game.JOYDEVICEREMOVED)
        self._game.event.clear()
        self._gone |= any(event.instance_id == self._id for event in removed)
        if self._gone:
            raise SourceLostError(
                f"the gamepad {self.name!r} is gone, expected it to stay plugged in; nothing of it is sent"
            )
        axes = [self._device.get_axis(number) for number in range(self._device.get_numaxes())]
        buttons = [bool(self._device.get_button(number)) for number in range(self._device.get_numbuttons())]
        return channels_of(self._mapping, axes, buttons)

    def close(self) -> None:
        """Let the device go."""
        self._game.joystick.quit()
        self._game.display.quit()

    def _open(self, index: int) -> Any:  # noqa: ANN401 - pygame's
        count = self._game.joystick.get_count()
        if not 0 <= index < count:
            raise LinkError(
                f"--gamepad got {index}, and {count or 'no'} gamepad(s) are there; plug it in, and join the "
                "group that owns /dev/input/event*, often input"
            )
        device = self._game.joystick.Joystick(index)
        self._id = device.get_instance_id()
        axes, buttons = device.get_numaxes(), device.get_numbuttons()
        wanted = [("axis", axis.channel, axis.number, axes) for axis in self._mapping.axes]
        wanted += [("button", button.channel, button.number, buttons) for button in self._mapping.buttons]
        for what, channel, number, there in wanted:
            if number >= there:
                raise LinkError(
                    f"--{what} {NAMES[channel]}={number}: the gamepad {device.get_name()!r} has {there} of "
                    f"them, expected a number below {there}"
                )
        return device


def _library() -> Any:  # noqa: ANN401 - a module
    """Import pygame, set up to work without a screen. Raises LinkError if it is not installed."""
    for name, value in NO_SCREEN.items():
        os.environ.setdefault(name, value)
    try:
        import pygame
    except ModuleNotFoundError:
        raise LinkError(
            "--gamepad needs pygame-ce, which is not installed; run: pip install pygame-ce, "
            "or pip install 'neuroflight[gamepad]'"
        ) from None
    return pygame
