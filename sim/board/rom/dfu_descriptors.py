"""Descriptors of the ROM's DFU device, as `lsusb -v` lists those of STM32 with this protocol."""

from __future__ import annotations

import struct

VENDOR, PRODUCT, RELEASE = 0x0483, 0xDF11, 0x2200
TRANSFER_BYTES = 2048  # wTransferSize
STRINGS = (  # from 1 on; the interfaces' as `dfu-util -l` lists them of an F722
    "STMicroelectronics",
    "STM32  BOOTLOADER",
    "STM32FxSTM32",
    "@Internal Flash  /0x08000000/04*016Kg,01*64Kg,03*128Kg",
    "@Option Bytes  /0x1FFF0000/01*048 e",
    "@OTP Memory /0x1FF07800/01*528e",
    "@Device Feature/0xFFFF0000/01*004 e",
)
ALTERNATES = len(STRINGS) - 3
DEVICE_KIND, CONFIGURATION_KIND, STRING_KIND, FUNCTIONAL_KIND = 1, 2, 3, 0x21  # bDescriptorType
FUNCTIONAL = struct.pack("<BBBHHH", 9, FUNCTIONAL_KIND, 0x0B, 255, TRANSFER_BYTES, 0x011A)
DEVICE = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0100, 0, 0, 0, 64, VENDOR, PRODUCT, RELEASE, 1, 2, 3, 1)
_INTERFACES = b"".join(
    bytes([9, 4, 0, alternate, 0, 0xFE, 1, 2, 4 + alternate]) for alternate in range(ALTERNATES)
)
_BEHIND = _INTERFACES + FUNCTIONAL
CONFIGURATION = struct.pack("<BBHBBBBB", 9, 2, 9 + len(_BEHIND), 1, 1, 0, 0xC0, 50) + _BEHIND
_ENGLISH = 0x0409


def descriptor(value: int) -> bytes | None:
    """Return the descriptor of GET_DESCRIPTOR's wValue: kind and index; None: there is none."""
    kind, index = value >> 8, value & 0xFF
    if kind == STRING_KIND:
        return _string(index)
    return {DEVICE_KIND: DEVICE, CONFIGURATION_KIND: CONFIGURATION, FUNCTIONAL_KIND: FUNCTIONAL}.get(kind)


def _string(index: int) -> bytes | None:
    if index > len(STRINGS):
        return None
    text = STRINGS[index - 1].encode("utf-16-le") if index else struct.pack("<H", _ENGLISH)
    return bytes([2 + len(text), STRING_KIND]) + text
