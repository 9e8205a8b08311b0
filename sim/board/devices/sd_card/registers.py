"""The registers of an SD card in SPI mode, its checksums, responses and tokens.

Source: SD Specifications Part 1, Physical Layer Simplified Specification: 4.5 (checksums), 5 (registers), 7.3
(responses and tokens).
"""

from __future__ import annotations

import binascii

BLOCK = 512  # bytes
CAPACITY_UNIT = 512 * 1024  # bytes that C_SIZE of a CSD of version 2 counts (5.3.3)
AU_BYTES = 4 * 1024 * 1024  # allocation unit: what the card erases at once, as SD status tells it

# R1 (7.3.2.1)
IDLE, ERASE_RESET, ILLEGAL, COMMAND_CRC, ERASE_SEQUENCE, PARAMETER = 0x01, 0x02, 0x04, 0x08, 0x10, 0x40
# The second byte of R2 (7.3.2.3)
ERROR, ERASE_PARAMETER, OUT_OF_RANGE = 0x04, 0x40, 0x80
# Data responses with the bits that are not defined as 1 (7.3.3.1), and tokens (7.3.3.2, 7.3.3.3)
ACCEPTED, CRC_ERROR, WRITE_ERROR = 0xE5, 0xEB, 0xED
START, START_MULTIPLE, STOP = 0xFE, 0xFC, 0xFD
RANGE_TOKEN, ERROR_TOKEN = 0x08, 0x02  # data error tokens: out of range, card controller error
RELEASED, BUSY = 0xFF, 0x00  # the line: pulled up, held down

HIGH_CAPACITY = 1 << 30  # HCS of ACMD41's argument, CCS of OCR
VOLTAGES = 0x00FF8000  # OCR: 2.7 to 3.6 V
POWERED_UP = 1 << 31  # OCR


def _crc7_table() -> tuple[int, ...]:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1) ^ (0x12 if value & 0x80 else 0)
        table.append(value & 0xFF)
    return tuple(table)


_CRC7 = _crc7_table()


def crc7(data: bytes) -> int:
    """Compute the last byte of a command and of CID and CSD: x^7 + x^3 + 1, then the end bit."""
    value = 0
    for byte in data:
        value = _CRC7[value ^ byte]
    return value | 1


def crc16(data: bytes) -> bytes:
    """Compute a data block's checksum: x^16 + x^12 + x^5 + 1, the upper byte first."""
    return binascii.crc_hqx(data, 0).to_bytes(2, "big")


def csd(blocks: int) -> bytes:
    """Encode card-specific data, version 2 (5.3.3), of `blocks` blocks, rounded down to 512 KiB."""
    size = blocks * BLOCK // CAPACITY_UNIT - 1
    body = bytes(
        (
            *(0x40, 0x0E, 0x00),  # version 2, TAAC, NSAC: fixed
            *(0x32, 0x5B, 0x59, 0x00),  # 25 MHz; command classes 0, 2, 4, 5, 7, 8, 10; blocks of 512 bytes
            *(size >> 16 & 0x3F, size >> 8 & 0xFF, size & 0xFF),
            *(0x7F, 0x80, 0x0A, 0x40, 0x00),  # single blocks can be erased; fixed values
        )
    )
    return body + bytes([crc7(body)])


def cid(serial: int) -> bytes:
    """Encode the card identification (5.2): no maker's number, name EMUSD, revision 1.0, January 2026."""
    body = b"\x00NFEMUSD\x10" + (serial & 0xFFFFFFFF).to_bytes(4, "big") + bytes((0x01, 0xA1))
    return body + bytes([crc7(body)])


def scr(erased: int) -> bytes:
    """Encode the SD configuration (5.6): version 3; erased: value of erased bytes, 0x00 or 0xFF."""
    return bytes((0x02, (0x80 if erased else 0x00) | 0x35, 0x80, 0, 0, 0, 0, 0))


def sd_status() -> bytes:
    """Encode the SD status (4.10.2): speed class 10, allocation units of 4 MiB."""
    status = bytearray(64)
    status[8], status[10] = 4, 9 << 4
    return bytes(status)


def ocr(ready: bool) -> bytes:
    """Encode the operation conditions (5.1)."""
    return (VOLTAGES | (POWERED_UP | HIGH_CAPACITY if ready else 0)).to_bytes(4, "big")
