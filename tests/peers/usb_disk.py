"""A host of USB mass storage (bulk-only transport 1.0, SCSI) by pyusb: it copies a disk into a file."""

from __future__ import annotations

import struct
import time
from pathlib import Path
from typing import Any

import usb.core
import usb.util

DISK = (0x0483, 0x5720)
OUT, IN = 0x01, 0x81
_WRAPPER = struct.Struct("<4sIIBBB16s")
_STATUS = struct.Struct("<4sIIB")
BLOCKS = 128  # of one READ(10)


class Disk:
    """The only board that shows its card."""

    def __init__(self) -> None:
        self.device: Any = usb.core.find(idVendor=DISK[0], idProduct=DISK[1])
        assert self.device is not None
        self.device.set_configuration()
        self._tag = 0

    def command(self, block: bytes, length: int = 0) -> tuple[int, bytes]:
        """A command that reads: its status and data."""
        self._tag += 1
        wrapper = _WRAPPER.pack(b"USBC", self._tag, length, 0x80, 0, len(block), block)
        assert self.device.write(OUT, wrapper, 5000) == len(wrapper)
        data = bytes(self.device.read(IN, length, 20000)) if length else b""
        mark, tag, residue, status = _STATUS.unpack(bytes(self.device.read(IN, _STATUS.size, 5000)))
        assert (mark, tag) == (b"USBS", self._tag) and residue == length - len(data)
        return status, data

    def capacity(self) -> tuple[int, int]:
        """Number of blocks, and the bytes of one, once the unit is ready."""
        while self.command(bytes(6))[0]:  # TEST UNIT READY
            assert self.command(bytes([3, 0, 0, 0, 18, 0]), 18)[0] == 0  # REQUEST SENSE
            time.sleep(0.05)
        status, data = self.command(bytes([0x25]) + bytes(9), 8)
        last, size = struct.unpack(">II", data)
        assert status == 0
        return last + 1, size

    def read(self, block: int, count: int) -> bytes:
        """READ(10)."""
        status, data = self.command(struct.pack(">BBIBHB", 0x28, 0, block, 0, count, 0), 512 * count)
        assert status == 0
        return data

    def write_protected(self) -> bool:
        """MODE SENSE(6): the device-specific parameter's bit 7."""
        status, data = self.command(bytes([0x1A, 0, 0x3F, 0, 4, 0]), 4)
        assert status == 0
        return bool(data[2] & 0x80)

    def copy(self, path: Path, blocks: int) -> float:
        """Copy the first blocks of the disk into a file; its bytes a second."""
        there, size = self.capacity()
        assert size == 512 and there >= blocks
        begin = time.monotonic()
        with path.open("wb") as file:
            for block in range(0, blocks, BLOCKS):
                file.write(self.read(block, min(BLOCKS, blocks - block)))
        return blocks * size / (time.monotonic() - begin)

    def eject(self) -> None:
        """START STOP UNIT: stop, eject."""
        assert self.command(bytes([0x1B, 0, 0, 0, 0x02, 0]))[0] == 0
