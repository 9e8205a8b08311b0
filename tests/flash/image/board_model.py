"""A board in memory: what the firmware answers while an image is installed, and what its boot part does next.

Its time passes only where a client waits, so that a minute of silence costs nothing. What the host program
and the emulated board can show is tested there; this is for what they cannot: an image that proves itself,
one that fails in each way, another version with other settings.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto

from neuroflight.flash.link.msp import Decoder, Direction, Message, encode
from neuroflight.toolchain.contract import (
    FLASH_BANK_A,
    IMAGE_HEADER_FORMAT,
    IMAGE_LAYOUT,
    Mix,
    Msp,
    Refusal,
    image_checksum,
    image_header,
    policy_header,
)
from neuroflight.toolchain.errors import LinkError

BOARD = "MATEKF722"
BOOT_S = 0.3
PROOF_S = 2.0
ERASE_S = 1.0
HEADER_BYTES = 72  # of the fields


class Fate(Enum):
    """What becomes of a new image."""

    GOOD = auto()
    CRASHES = auto()  # at each start
    CRASHES_LATE = auto()  # it answers, and fails before it has proven itself
    POLICY_BAD = auto()
    UNPROVEN = auto()  # it runs, and never confirms
    SILENT = auto()  # the board does not come back


@dataclass
class Bank:
    """An image and the marks behind it."""

    data: bytes = b""
    numbered: bool = False
    confirmed: bool = False
    rejected: bool = False
    starts: int = 0
    sequence: int = 0


@dataclass
class Setting:
    """A setting that counts."""

    value: float
    low: float = 0.0
    high: float = 100.0
    default: float = 0.0


@dataclass
class BoardModel:
    """The board. `banks[0]` runs and was proven long ago."""

    banks: list[Bank]
    fate: Fate = Fate.GOOD
    armed: bool = False
    battery_level: int = 3  # none: USB alone
    firmware: str = "Neuroflight"
    has_images: bool = True
    settings: dict[str, Setting] = field(
        default_factory=lambda: {"deadband_us": Setting(7), "roll_expo": Setting(1)}
    )
    of_new_image: dict[str, Setting] | None = None  # settings that another version has
    now: float = 0.0
    running: int = 0
    boots: int = 5
    answers_from: float = 0.0
    started_at: float = 0.0
    header: bytes = b""  # of the update under way
    written: int = 0
    erased: int = 0  # times
    layout: int | None = IMAGE_LAYOUT  # of images; None: it does not tell
    slots: list[bytes] = field(default_factory=lambda: [b"", b""])  # blobs
    flown: int = 0  # slot
    aircraft: bytes = b"nf1"  # that the policies are told to be of
    coming: bytes = b""  # of a policy under way
    ended: bool = False
    commands: list[int] = field(default_factory=list)

    # --- What the boot part does ---------------------------------------------------------------------
    def restart(self) -> None:
        """Start anew; a new image meets its fate."""
        self.header, self.written, self.coming, self.ended = b"", 0, b"", False
        self.boots += 1
        other = 1 - self.running
        new = self.banks[other]
        newer = new.numbered and new.sequence > self.banks[self.running].sequence and not new.rejected
        delay = BOOT_S
        if newer and self.fate in (Fate.CRASHES, Fate.SILENT):
            new.starts, self.boots, delay = 2, self.boots + 2, 3 * BOOT_S
            delay = delay if self.fate is Fate.CRASHES else 1e9
        elif newer:
            new.starts, self.running = 1, other
            self.choose()
            if self.of_new_image is not None:
                self.settings = self.of_new_image
        self.started_at = self.answers_from = self.now + delay

    def advance(self, seconds: float) -> None:
        """Let time pass."""
        self.now += seconds
        bank = self.banks[self.running]
        if bank.confirmed or self.now < self.started_at + PROOF_S:
            return
        if self.fate is Fate.CRASHES_LATE and bank.starts:
            bank.rejected, self.running = True, 1 - self.running
            self.restart()
            self.choose()
        elif self.fate is not Fate.UNPROVEN:
            bank.confirmed = True

    def fits(self, slot: int, bank: int) -> bool:
        """Whether that bank's image flies what is in a slot."""
        policy, image = policy_header(self.slots[slot]), image_header(self.banks[bank].data)
        return policy is not None and image is not None and policy.build in (bytes(8), image.build)

    def choose(self) -> None:
        """The newest policy that the running image flies."""
        fitting = [slot for slot in range(2) if self.fits(slot, self.running)]
        assert fitting, "an image without a policy was switched to"
        self.flown = max(fitting, key=self.number)

    def number(self, slot: int) -> int:
        header = policy_header(self.slots[slot])
        return -1 if header is None else header.sequence

    # --- What the firmware answers -------------------------------------------------------------------
    def answer(self, message: Message) -> Message:
        """Carry out a request."""
        self.commands.append(message.command)
        handler = HANDLERS.get(message.command)
        result = Refusal.NONE if handler is None else handler(self, message.payload)
        if isinstance(result, bytes):
            return Message(message.version, Direction.REPLY, message.command, result)
        payload = b"" if handler is None else struct.pack("<Bh", result, 0)
        return Message(message.version, Direction.ERROR, message.command, payload)

    def identity(self, _: bytes) -> bytes | Refusal:
        if self.firmware != "Neuroflight":
            return Refusal.ABSENT
        target = BOARD.encode()
        return b"\x0bNeuroflight" + bytes((0, 1, 0, 1, 47, len(target))) + target + b"BTFL\x03nf1" + bytes(32)

    def status(self, _: bytes) -> bytes:
        return struct.pack("<HHHIBHBBBBI", 250, 0, 0, int(self.armed), 0, 10, 1, 0, 0, 20, 0)

    def battery(self, _: bytes) -> bytes:
        return struct.pack("<BHBHhBH", 4, 1300, 128, 0, 0, self.battery_level, 1284)

    def policy(self, _: bytes) -> bytes:
        bad = self.fate is Fate.POLICY_BAD and self.running == 1
        head = struct.pack("<IHHIHHB", 1, 6, 4, 100, 1000, 4000, not bad)
        return (
            head
            + self.named()
            + bytes(32)
            + struct.pack(
                "<fBI2bB", 0.1, self.flown, self.number(self.flown), *map(self.found, range(2)), Mix.CENTRED
            )
        )

    def named(self) -> bytes:
        return bytes([len(self.aircraft)]) + self.aircraft

    def found(self, slot: int) -> int:
        if policy_header(self.slots[slot]) is None:
            return -7
        return 0 if self.fits(slot, self.running) else -27

    def slot_info(self, payload: bytes) -> bytes:
        slot = payload[0]
        header = policy_header(self.slots[slot])
        told = struct.pack("<bB", self.found(slot), slot == self.flown)
        if header is None:
            return told + bytes(4 * 5 + 1 + 32 + 8)
        told += struct.pack("<4If", header.sequence, header.architecture_hash, header.filters_hash, 1000, 0.1)
        return told + self.named() + bytes.fromhex(header.policy_sha256) + header.build

    def slot_begin(self, payload: bytes) -> bytes | Refusal:
        spare, now = self.banks[1 - self.running], self.banks[self.running]
        if spare.numbered and not spare.rejected and spare.sequence > now.sequence:
            return Refusal.ORDER
        self.slots[1 - self.flown], self.coming, self.ended = b"", b"", False
        self.answers_from = self.now + ERASE_S
        return struct.pack("<I", self.number(self.flown) + 1)

    def slot_write(self, payload: bytes) -> bytes | Refusal:
        offset, data = struct.unpack_from("<I", payload)[0], payload[4:]
        if offset + len(data) == len(self.coming) and self.coming[offset:] == data:
            return b""
        if offset != len(self.coming):
            return Refusal.ORDER
        self.coming += data
        return b""

    def slot_end(self, _: bytes) -> bytes | Refusal:
        if self.ended:
            return b""
        policy, image = policy_header(self.coming), image_header(self.banks[1 - self.running].data)
        if policy is None or len(self.coming) != policy.total_bytes:
            return Refusal.ORDER
        if image is None or policy.build != image.build:
            return Refusal.BLOB
        self.slots[1 - self.flown], self.ended = self.coming, True
        return b""

    def version(self, _: bytes) -> bytes:
        header = image_header(self.banks[self.running].data)
        assert header is not None
        return bytes(int(part) for part in header.version.split("."))

    def setting(self, payload: bytes) -> tuple[str, Setting] | None:
        index = struct.unpack_from("<H", payload)[0]
        return list(self.settings.items())[index] if index < len(self.settings) else None

    def setting_info(self, payload: bytes) -> bytes | Refusal:
        if (found := self.setting(payload)) is None:
            return Refusal.INDEX
        name, one = found
        head = struct.pack("<HB3f", len(self.settings), 1, one.low, one.high, one.default)
        return head + bytes([len(name)]) + name.encode() + b"\x011"

    def setting_get(self, payload: bytes) -> bytes | Refusal:
        found = self.setting(payload)
        return Refusal.INDEX if found is None else struct.pack("<Bf", 1, found[1].value)

    def setting_set(self, payload: bytes) -> bytes | Refusal:
        if (found := self.setting(payload)) is None:
            return Refusal.INDEX
        found[1].value = struct.unpack_from("<f", payload, 2)[0]
        return b""

    def image_info(self, _: bytes) -> bytes | Refusal:
        if not self.has_images:
            return Refusal.ABSENT
        told = bytes((self.running, len(self.banks)))
        for bank in self.banks:
            header = image_header(bank.data)
            if header is None:
                told += bytes(26)
                continue
            flags = 1 | bank.numbered << 1 | bank.confirmed << 2 | bank.rejected << 3
            told += struct.pack("<BBIII", flags, bank.starts, bank.sequence, header.image_bytes, header.crc)
            told += bytes((*map(int, header.version.split(".")), 0)) + header.build
        return told if self.layout is None else told + bytes([self.layout])

    def image_begin(self, payload: bytes) -> bytes | Refusal:
        if self.armed:
            return Refusal.ARMED
        if self.banks[1 - self.running].confirmed and not self.banks[self.running].confirmed:
            return Refusal.ORDER
        if payload != self.header:
            self.header, self.written, self.banks[1 - self.running] = payload, 0, Bank()
            self.erased += 1
            self.answers_from = self.now + ERASE_S
        return struct.pack("<I", self.written)

    def image_write(self, payload: bytes) -> bytes | Refusal:
        offset, data = struct.unpack_from("<I", payload)[0], payload[4:]
        bank = self.banks[1 - self.running]
        if offset + len(data) == self.written and bank.data[offset:] == data:
            return b""
        if not self.header or offset != self.written:
            return Refusal.ORDER
        bank.data += data
        self.written += len(data)
        return b""

    def image_end(self, _: bytes) -> bytes | Refusal:
        data = self.banks[1 - self.running].data
        header = image_header(data)
        if not self.header or header is None or len(data) != header.image_bytes:
            return Refusal.ORDER
        if image_checksum(data) != header.crc:
            self.header = b""
            return Refusal.IMAGE
        return struct.pack("<I", header.crc)

    def image_hash(self, payload: bytes) -> bytes | Refusal:
        data = self.banks[payload[0]].data
        return hashlib.sha256(data).digest() if data else Refusal.IMAGE

    def image_switch(self, payload: bytes) -> bytes | Refusal:
        bank = self.banks[1 - self.running]
        if hashlib.sha256(bank.data).digest() != payload[:32]:
            return Refusal.IMAGE
        if not any(self.fits(slot, 1 - self.running) for slot in range(2)):
            return Refusal.BLOB
        bank.numbered, bank.sequence = True, self.banks[self.running].sequence + 1
        return struct.pack("<I", bank.sequence)

    def reboot(self, _: bytes) -> bytes:
        self.restart()
        return b""


HANDLERS: dict[int, Callable[[BoardModel, bytes], bytes | Refusal]] = {
    Msp.API_VERSION: lambda board, _: b"\x00\x01\x2e",
    Msp.IDENTITY: BoardModel.identity,
    Msp.FC_VARIANT: lambda board, _: b"BTFL",
    Msp.FC_VERSION: BoardModel.version,
    Msp.BOARD_INFO: lambda board, _: b"S7X2" + bytes(4) + b"\x09MATEKF722" + b"\0\0",
    Msp.UID: lambda board, _: struct.pack("<3I", 1, 2, 3),
    Msp.STATUS_EX: BoardModel.status,
    Msp.BATTERY_STATE: BoardModel.battery,
    Msp.POLICY_INFO: BoardModel.policy,
    Msp.POLICY_SLOT_INFO: BoardModel.slot_info,
    Msp.POLICY_SLOT_BEGIN: BoardModel.slot_begin,
    Msp.POLICY_SLOT_WRITE: BoardModel.slot_write,
    Msp.POLICY_SLOT_END: BoardModel.slot_end,
    Msp.FAULTS: lambda board, _: struct.pack("<IB", board.boots, 0),
    Msp.SETTING_INFO: BoardModel.setting_info,
    Msp.SETTING_GET: BoardModel.setting_get,
    Msp.SETTING_SET: BoardModel.setting_set,
    Msp.EEPROM_WRITE: lambda board, _: b"",
    Msp.IMAGE_INFO: BoardModel.image_info,
    Msp.IMAGE_BEGIN: BoardModel.image_begin,
    Msp.IMAGE_WRITE: BoardModel.image_write,
    Msp.IMAGE_END: BoardModel.image_end,
    Msp.IMAGE_HASH: BoardModel.image_hash,
    Msp.IMAGE_SWITCH: BoardModel.image_switch,
    Msp.REBOOT: BoardModel.reboot,
}
Change = Callable[[bytes], bytes]


class ModelLine:
    """A Transport to the model; `down` and `up` change what goes each way."""

    name = "serial:/dev/model:115200"

    def __init__(self, board: BoardModel, down: Change = bytes, up: Change = bytes) -> None:
        self.board, self._down, self._up = board, down, up
        self._decoder = Decoder(payload_max=FLASH_BANK_A.size)
        self._coming: list[tuple[float, bytes]] = []
        self.closed = False

    def write(self, data: bytes) -> None:
        if self.closed:
            raise LinkError(f"{self.name}: the line is closed")
        for event in self._decoder.feed(self._down(data)):
            if isinstance(event, Message) and self.board.now >= self.board.answers_from:
                answered = encode(self.board.answer(event))
                self._coming.append((max(self.board.now, self.board.answers_from), self._up(answered)))

    def read(self, timeout: float) -> bytes:
        end = self.board.now + timeout
        if self._coming and self._coming[0][0] <= end:
            at, data = self._coming.pop(0)
            self.board.advance(max(0.001, at - self.board.now))
            return data
        self._decoder.flush()
        self.board.advance(timeout)
        return b""

    def close(self) -> None:
        self.closed = True

    def clock(self) -> float:
        return self.board.now


def board_with(image: bytes, policy: bytes, **facts: object) -> BoardModel:
    """A board that has run `image` well in bank A, with that policy in slot A."""
    bank = Bank(image, numbered=True, confirmed=True, sequence=3)
    slots = [policy, b""]
    return BoardModel([bank, Bank()], started_at=-100.0, slots=slots, **facts)  # type: ignore[arg-type]


assert struct.calcsize(IMAGE_HEADER_FORMAT) == HEADER_BYTES
