"""OTG_FS set up by its registers as a program does, and a device of a few lines for hosts to talk to."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from neuroflight.sim.board.usb.cable import Answer, Handshake

MPS = 64
OUT_DATA, OUT_DONE, SETUP_DONE, SETUP_DATA = 2, 3, 4, 6  # GRXSTSP PKTSTS


class Program:
    """What a driver does with OTG_FS, without a stack above it."""

    def __init__(self, bench: Any) -> None:
        self.bench, self.otg = bench, bench.hardware.otg
        bench.set("RCC_AHB2ENR", OTGFSEN=1)
        bench.alternate("PA11", 10)
        bench.alternate("PA12", 10)

    def start(self, *, trdt: int = 6, receive: int = 128) -> None:
        """The core on the bus as a full-speed device; FIFOs: `receive` words, 16 of endpoint 0, 64 of 1."""
        bench = self.bench
        bench.set("OTG_FS_GLOBAL_GUSBCFG", FDMOD=1, TRDT=trdt)
        bench.set("OTG_FS_GLOBAL_GCCFG", PWRDWN=1)
        bench.set("OTG_FS_GLOBAL_GOTGCTL", BVALOEN=1, BVALOVAL=1)
        bench.set("OTG_FS_DEVICE_DCFG", DSPD=3)
        bench.write("OTG_FS_GLOBAL_GRXFSIZ", receive)
        bench.write("OTG_FS_GLOBAL_DIEPTXF0", 16 << 16 | receive)
        bench.write("OTG_FS_GLOBAL_DIEPTXF1", 64 << 16 | receive + 16)
        bench.set("OTG_FS_DEVICE_DCTL", SDIS=0)

    def open(self, number: int = 1) -> None:
        """Bulk endpoints `number` of both directions."""
        for way in "IO":
            fields = {"MPSIZ": MPS, "EPTYP": 2, "USBAEP": 1, "SD0PID_SEVNFRM": 1}
            if way == "I":
                fields["TXFNUM"] = number
            self.bench.set(f"OTG_FS_DEVICE_D{way}EPCTL{number}", **fields)

    def receive(self, number: int, packets: int, size: int | None = None) -> None:
        """Let an OUT endpoint take packets."""
        bench = self.bench
        bench.write(
            f"OTG_FS_DEVICE_DOEPTSIZ{number}", packets << 19 | (packets * MPS if size is None else size)
        )
        bench.set(f"OTG_FS_DEVICE_DOEPCTL{number}", EPENA=1, CNAK=1)

    def send(self, number: int, data: bytes, *, write: bool = True) -> None:
        bench, packets = self.bench, max(-(-len(data) // MPS), 1)
        bench.write(f"OTG_FS_DEVICE_DIEPTSIZ{number}", packets << 19 | len(data))
        bench.set(f"OTG_FS_DEVICE_DIEPCTL{number}", EPENA=1, CNAK=1)
        for i in range(0, len(data) if write else 0, 4):
            bench.write(f"OTG_FS_FIFO{number}_DFIFO", int.from_bytes(data[i : i + 4], "little"))

    def pop(self) -> tuple[int, int, bytes]:
        """PKTSTS, endpoint and bytes of what came first."""
        word = self.bench.read("OTG_FS_GLOBAL_GRXSTSP")
        count = word >> 4 & 0x7FF
        words = [self.bench.read("OTG_FS_FIFO0_DFIFO") for _ in range((count + 3) // 4)]
        return word >> 17 & 15, word & 15, b"".join(w.to_bytes(4, "little") for w in words)[:count]

    def flags(self) -> int:
        return int(self.bench.read("OTG_FS_GLOBAL_GINTSTS"))

    def clear(self, *names: str) -> None:
        self.bench.write("OTG_FS_GLOBAL_GINTSTS", self.bench.bits("OTG_FS_GLOBAL_GINTSTS", *names))

    def has(self, name: str, register: str = "GLOBAL_GINTSTS") -> bool:
        return bool(self.bench.get(f"OTG_FS_{register}", name))

    def plug(self) -> None:
        """VBUS, a reset of the bus, the first frame; what they flag is cleared."""
        self.otg.vbus(True)
        self.otg.bus_reset()
        self.otg.start_of_frame(1)
        self.clear("USBRST", "ENUMDNE", "SOF")


@pytest.fixture
def program(fast: Any) -> Program:
    """A started core in a cable, past its first reset, endpoint 0 of 64 bytes."""
    made = Program(fast)
    made.start()
    made.plug()
    return made


@pytest.fixture
def unplugged(fast: Any) -> Program:
    """A chip at 216 MHz whose core is clocked, no more."""
    return Program(fast)


class Echo:
    """A device that answers requests by itself: bulk endpoint 1 echoes, endpoint 2 counts in interrupts."""

    def __init__(self) -> None:
        self.attached = self.present = False
        self.wakes = False
        self.address, self.new_address = 0, 0
        self.heard: list[str] = []
        self.naks = 0  # to give before the next answer at endpoint 1
        self.halted = False
        self.silent = False
        self.echo = b""
        self.toggles = {(0, True): 0, (0, False): 0}
        self.reply, self.sent, self.taken = b"", 0, b""
        self.setup_data, self.refused = b"", False
        self.frames: list[int] = []
        self.answer: Callable[[bytes], bytes | None] = describe

    def vbus(self, present: bool) -> None:
        self.present = self.attached = present

    def bus_reset(self) -> None:
        self.heard.append("reset")
        self.address, self.echo, self.halted = 0, b"", False
        self.toggles = {}

    def suspend(self) -> None:
        self.heard.append("suspend")

    def resume(self) -> None:
        self.heard.append("resume")

    def start_of_frame(self, number: int) -> None:
        self.frames.append(number)

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        if self.silent or address != self.address:
            return Handshake.SILENT
        self.setup_data, self.sent, self.taken = data, 0, b""
        self.toggles[0, True] = self.toggles[0, False] = 1
        length = int.from_bytes(data[6:8], "little")
        answer = self.answer(data)
        self.refused = answer is None
        self.reply = (answer or b"")[:length]
        return Handshake.ACK

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        if self.silent or address != self.address or endpoint > 1:
            return Handshake.SILENT
        if (endpoint and self.halted) or (not endpoint and self.refused):
            return Handshake.STALL
        if endpoint and self.naks:
            self.naks -= 1
            return Handshake.NAK
        if toggle != self.toggles.get((endpoint, False), 0):
            return Handshake.ACK
        self.toggles[endpoint, False] = toggle ^ 1
        if endpoint:
            self.echo += data
        else:
            self.taken += data
        return Handshake.ACK

    def take(self, address: int, endpoint: int) -> Answer:
        if self.silent or address != self.address or endpoint > 2:
            return Handshake.SILENT
        toggle = self.toggles.get((endpoint, True), 0)
        if endpoint == 2:
            data = len(self.frames).to_bytes(2, "little")
        elif endpoint:
            if self.halted:
                return Handshake.STALL
            if self.naks or not self.echo:
                self.naks = max(self.naks - 1, 0)
                return Handshake.NAK
            data, self.echo = self.echo[:MPS], self.echo[MPS:]
        else:
            if self.refused:
                return Handshake.STALL
            data = self.reply[self.sent : self.sent + MPS]
            self.sent += len(data)
            if self.setup_data[:2] == bytes([0, 5]):
                self.address = self.setup_data[2]
            if self.setup_data[:2] == bytes([0, 9]):
                self.toggles = {key: bit for key, bit in self.toggles.items() if not key[0]}
            if self.setup_data[:4] == bytes([2, 1, 0, 0]):
                self.halted = False
                self.toggles.pop((self.setup_data[4] & 15, bool(self.setup_data[4] & 0x80)), None)
        self.toggles[endpoint, True] = toggle ^ 1
        return toggle, data


DEVICE = bytes.fromhex("12 01 00 02 00 00 00 40 09 12 01 00 00 01 01 02 03 01")
CONFIGURATION = bytes.fromhex(
    "09 02 27 00 01 01 00 c0 32  09 04 00 00 03 ff 00 00 00"
    "07 05 01 02 40 00 00  07 05 81 02 40 00 00  07 05 82 03 02 00 04"
)


def describe(setup: bytes) -> bytes | None:
    """Answers of a device with two bulk endpoints and an interrupt one; None: unknown."""
    if setup[:2] == bytes([0x80, 6]):
        return {1: DEVICE, 2: CONFIGURATION}.get(setup[3])
    return b"" if setup[0] & 0x80 == 0 and setup[1] in (1, 5, 9) else None


@pytest.fixture
def echo() -> Echo:
    return Echo()
