"""A virtual gamepad of SDL's own: the library takes it for one that is plugged in."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.channels.gamepad import NO_SCREEN, Gamepad

GAME_CONTROLLER = 1  # SDL_JOYSTICK_TYPE_GAMECONTROLLER
AXES, BUTTONS = 6, 8
FULL = 32767


class Pad:
    """A virtual device, plugged in."""

    def __init__(self) -> None:
        import pygame

        self.game: Any = pygame
        library = next(
            line.split()[-1]
            for line in Path("/proc/self/maps").read_text().splitlines()
            if "libSDL2-2" in line
        )
        self.sdl = ctypes.CDLL(library)
        self.sdl.SDL_JoystickFromInstanceID.restype = ctypes.c_void_p
        pygame.joystick.init()
        self.index = self.sdl.SDL_JoystickAttachVirtual(GAME_CONTROLLER, AXES, BUTTONS, 0)
        assert self.index >= 0

    def _handle(self, pad: Gamepad) -> ctypes.c_void_p:
        return ctypes.c_void_p(self.sdl.SDL_JoystickFromInstanceID(pad._id))

    def axis(self, pad: Gamepad, number: int, value: int) -> None:
        self.sdl.SDL_JoystickSetVirtualAxis(self._handle(pad), number, ctypes.c_int16(value))

    def button(self, pad: Gamepad, number: int, held: bool) -> None:
        self.sdl.SDL_JoystickSetVirtualButton(self._handle(pad), number, ctypes.c_uint8(held))

    def unplug(self) -> None:
        self.sdl.SDL_JoystickDetachVirtual(self.index)


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> Iterator[Pad]:
    for name, value in NO_SCREEN.items():
        monkeypatch.setenv(name, value)
    pad = Pad()
    yield pad
    pad.game.joystick.quit()
