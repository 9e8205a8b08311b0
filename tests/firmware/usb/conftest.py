"""Devices of the firmware's src/usb on a scripted bus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import pytest

from tests.firmware.conftest import Core
from tests.firmware.usb.scripted_bus import ScriptedBus

TEXTS = ("Neuroflight", "MATEKF722 nf1", "2C0041001950")


@dataclass
class Device:
    """A device with a class, and what belongs to it."""

    bus: ScriptedBus
    device: Any
    function: Any
    kept: list[Any]

    def start(self, core: Core) -> None:
        texts = [core.ffi.new("char[]", text.encode()) for text in TEXTS]
        kept = core.new("struct usb_texts *", texts)
        self.kept += [*texts, kept]
        self.bus.events = core.lib.usb_device_init(self.device, self.bus.controller, self.function, kept)


@dataclass
class SerialDevice(Device):
    """A serial port: `line` is the firmware's end of it."""

    serial: Any
    line: Any

    def said(self) -> bytes:
        """What the firmware reads now."""
        buffer = self.bus.core.new("uint8_t[4096]")
        return bytes(self.bus.core.ffi.buffer(buffer, self.line.read(self.line.context, buffer, 4096)))

    def look(self) -> int:
        return int(self.line.look(self.line.context))

    def room(self) -> int:
        room = self.bus.core.new("size_t *")
        self.line.room(self.line.context, room)
        return int(room[0])

    def say(self, words: bytes) -> None:
        """The firmware sends."""
        room = self.bus.core.new("size_t *")
        place = self.line.room(self.line.context, room)
        assert room[0] >= len(words)
        self.bus.core.ffi.memmove(place, words, len(words))
        self.line.fill(self.line.context, len(words))
        self.line.send(self.line.context)


@pytest.fixture
def serial(scripted: Core) -> SerialDevice:
    """A serial port that no host has looked at yet."""
    bus = ScriptedBus(scripted)
    device, function = scripted.new("struct usb_device *"), scripted.new("struct usb_function *")
    port = scripted.new("struct usb_serial *")
    scripted.lib.usb_serial_init(port, bus.controller, function)
    made = SerialDevice(bus, device, function, [], port, scripted.lib.usb_serial_line(port))
    made.start(scripted)
    return made


class Medium:
    """Blocks to read: each begins with its number. `late` asks of each are answered by LATER."""

    DONE, LATER, FAILED = range(3)

    def __init__(self, core: Core) -> None:
        self.core, self.blocks, self.late, self.bad = core, 1000, 0, set[int]()
        self.asked: list[int] = []
        self._kept = [
            core.ffi.callback("uint32_t(void *)", lambda context: self.blocks),
            core.ffi.callback("uint8_t(void *, uint32_t, uint8_t *)", self._read),
        ]
        self.medium = core.ffi.new("struct usb_medium *", (core.ffi.NULL, *self._kept))
        self._waited = 0

    @staticmethod
    def block(number: int) -> bytes:
        return number.to_bytes(4, "little") * 128

    def _read(self, context: object, number: int, data: Any) -> int:
        self.asked.append(number)
        if self._waited < self.late:
            self._waited += 1
            return self.LATER
        self._waited = 0
        if number in self.bad:
            return self.FAILED
        self.core.ffi.memmove(data, self.block(number), 512)
        return self.DONE


@dataclass
class DiskDevice(Device):
    """A disk, which a step drives."""

    disk: Any
    medium: Medium

    def step(self, times: int = 1) -> None:
        for _ in range(times):
            self.bus.core.lib.usb_disk_step(self.disk)


@pytest.fixture
def disk(scripted: Core) -> DiskDevice:
    """A disk of 1,000 blocks that a host has configured."""
    bus, medium = ScriptedBus(scripted), Medium(scripted)
    device, function = scripted.new("struct usb_device *"), scripted.new("struct usb_function *")
    disk = scripted.new("struct usb_disk *")
    scripted.lib.usb_disk_init(disk, device, bus.controller, medium.medium, function)
    made = DiskDevice(bus, device, function, [], disk, medium)
    made.start(scripted)
    bus.enumerate()
    return made
