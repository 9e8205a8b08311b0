"""OTG_FS as a device: the Synopsys core that the STM32F722 has, in slave mode, from its registers (RM0431).

The program reads and writes registers and FIFOs; the host at the other end of the cable (cable.py) brings
resets, frames and transactions. What the program sets up wrongly is an error at the place where it matters:
at the first reset of the bus, at a FIFO's first use, with a word too many. What the host does is never an
error: it gets no answer, NAK or STALL, as from the chip.

Not modelled: the host's side, isochronous endpoints, LPM, charger detection, test modes, DMA (the chip's
FS core has none), STSPHSRX and the wake-up line EXTI18. VBUS sensing by the core (GCCFG VBDEN) looks at PA9,
which is USART1's on this board: it never sees a session; the program overrides it (GOTGCTL BVALOEN).
"""

from __future__ import annotations

from functools import partial
from typing import Any

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.peripherals.gpio import Pins
from neuroflight.sim.board.peripherals.rcc import Rcc
from neuroflight.sim.board.registers.bus import Device, load_table
from neuroflight.sim.board.registers.usb_registers import ENDPOINTS
from neuroflight.sim.board.usb.cable import Answer, Handshake
from neuroflight.sim.board.usb.fifos import (
    DEPTH_MIN,
    GLOBAL_OUT_NAK,
    OUT_DATA,
    OUT_DONE,
    RAM_WORDS,
    SETUP_DATA,
    SETUP_DONE,
    ReceiveFifo,
    TransmitFifo,
    words_of,
)
from neuroflight.toolchain.boards.facts import Pin

USB_HZ = 48_000_000
_USB_TOLERANCE = 0.0025  # of a full-speed device (USB 2.0, 7.1.11)
_AHB_MIN = 14_200_000  # [Hz] (RM0431, OTG_FS: AHB frequency)
_FRAME = TIME_HZ // 1000  # [cycles]
_IDLE = 3 * _FRAME  # without a packet: early suspend; as long again: suspend (RM0431, suspended state)
_CORE_RESET = TIME_HZ // 1_000_000  # until CSRST and the flushes clear themselves: our choice
_FRAME_PART = (80, 85, 90, 95)  # percent of a frame at which EOPF comes (DCFG PFIVL)
_FULL_SPEED = 3  # of DCFG DSPD and DSTS ENUMSPD: with the core's own transceiver at 48 MHz
_MPS0 = (64, 32, 16, 8)  # bytes, by MPSIZ of endpoint 0
_ISOCHRONOUS = 1  # of EPTYP
_ALL_FIFOS = 16  # of GRSTCTL TXFNUM

# Slowest turnaround time TRDT by the AHB's frequency [MHz] (RM0431, TRDT values (FS)).
_TURNAROUND = ((32.0, 6), (27.5, 7), (24.0, 8), (21.8, 9), (20.0, 10), (18.5, 11), (17.2, 12), (16.0, 13),
               (15.0, 14), (14.2, 15))  # fmt: skip

# Flags of GINTSTS.
_OTGINT, _SOF, _RXFLVL, _GINAKEFF, _GONAKEFF = 1 << 2, 1 << 3, 1 << 4, 1 << 6, 1 << 7
_ESUSP, _USBSUSP, _USBRST, _ENUMDNE, _EOPF = (1 << i for i in range(10, 16) if i != 14)
_IEPINT, _OEPINT, _SRQINT, _WKUPINT = 1 << 18, 1 << 19, 1 << 30, 1 << 31
_LIVE = _OTGINT | _RXFLVL | _GINAKEFF | _IEPINT | _OEPINT  # conditions, not events
# Flags of DIEPINT and DOEPINT.
_XFRC, _EPDISD, _STUP, _ITTXFE, _OTEPDIS, _B2BSTUP, _INEPNE, _TXFE = (
    1 << i for i in (0, 1, 3, 4, 4, 6, 6, 7)
)
# Bits of DIEPCTL and DOEPCTL.
_USBAEP, _DPID, _NAKSTS, _STALL = 1 << 15, 1 << 16, 1 << 17, 1 << 21
_CNAK, _SNAK, _SD0PID, _SD1PID, _EPDIS, _EPENA = (1 << i for i in range(26, 32))
_COMMANDS = _CNAK | _SNAK | _SD0PID | _SD1PID | _EPDIS | _EPENA
_MPS, _TXFNUM = 0x7FF, 22
_SEDET = 1 << 2  # of GOTGINT
_SGINAK, _CGINAK, _SGONAK, _CGONAK = (1 << i for i in range(7, 11))  # of DCTL


# Registers that read the same until a store, an event of the bus or a popped status: what programs poll.
POLLED = {
    "OTG_FS_GLOBAL": ("GINTSTS",),
    "OTG_FS_DEVICE": ("DCTL", "DSTS", "DAINT", *(f"DIEPINT{i}" for i in range(4))),
}


class _Block(Device):
    """A block whose registers the engine answers for: not without a clock."""

    @property
    def clocked(self) -> bool:  # type: ignore[override]
        return self._clocked

    @clocked.setter
    def clocked(self, on: bool) -> None:
        self._clocked = on
        self.engine.forget_answers()


class _Endpoint:
    """One direction of an endpoint: its registers in the device block, and the packet sizes they tell."""

    def __init__(self, block: Device, way: str, number: int) -> None:
        """way: "I" (to the host) or "O"."""
        self._words_of = block
        self.number, self.way = number, way
        self.control, self.flags = f"D{way}EPCTL{number}", f"D{way}EPINT{number}"
        self.size = f"D{way}EPTSIZ{number}"
        self._registers = block.block.registers
        fields = self._registers[self.size].fields
        self._xfrsiz, self._pktcnt = fields["XFRSIZ"], fields["PKTCNT"]

    @property
    def words(self) -> dict[str, int]:
        return self._words_of.words

    @property
    def status(self) -> int:
        """Content of its control register."""
        return self.words[self.control]

    @property
    def packet_size(self) -> int:
        """Largest packet [bytes]. Endpoint 0 has one size for both directions, the IN register's."""
        if self.number == 0:
            return _MPS0[self.words["DIEPCTL0"] & 3]
        return self.words[self.control] & _MPS

    @property
    def active(self) -> bool:
        return self.number == 0 or bool(self.words[self.control] & _USBAEP)

    @property
    def toggle(self) -> int:
        return int(bool(self.words[self.control] & _DPID))

    def set(self, bits: int, on: bool = True) -> None:
        self.words[self.control] = self.words[self.control] & ~bits | (bits if on else 0)

    def raise_flag(self, flag: int) -> None:
        self.words[self.flags] |= flag

    @property
    def left(self) -> int:
        """XFRSIZ: bytes of the transfer that are left."""
        return self.words[self.size] & self._xfrsiz.mask

    @left.setter
    def left(self, value: int) -> None:
        self.words[self.size] = self.words[self.size] & ~self._xfrsiz.mask | value

    @property
    def packets(self) -> int:
        """PKTCNT: packets of the transfer that are left."""
        return (self.words[self.size] & self._pktcnt.mask) >> self._pktcnt.lsb

    @packets.setter
    def packets(self, value: int) -> None:
        self.words[self.size] = self.words[self.size] & ~self._pktcnt.mask | value << self._pktcnt.lsb


class Otg(Kept):
    """The core: a `cable.Device` on one side, registers on the other."""

    kept = (
        "vbus_present", "_toggles0", "_setup_pending", "_setups", "_address",
        "_in_request", "_reset_seen", "_session", "_clear_at",
        "_idle_seen",  "_global_in_nak", "_global_out_nak", "_asserted",
    )  # fmt: skip

    def __init__(self, engine: Engine, pins: Pins, rcc: Rcc, supply: Pin | None) -> None:
        self.engine, self._pins, self._rcc, self._supply = engine, pins, rcc, supply
        self.core = _Block(engine, "OTG_FS_GLOBAL")
        self.device = _Block(engine, "OTG_FS_DEVICE")
        self.power = Device(engine, "OTG_FS_PWRCLK")
        self.core.clears = frozenset(("GINTSTS", "GOTGINT"))
        self.device.clears = frozenset(f"D{way}EPINT{i}" for way in "IO" for i in range(ENDPOINTS))
        self.windows = tuple(Device(engine, f"OTG_FS_FIFO{i}") for i in range(ENDPOINTS))
        self._irq = load_table().interrupt("OTG_FS")
        self._idle = engine.alarm("otg.idle", self._fall_idle)
        self._end_of_frame = engine.alarm("otg.frame", self._near_frame_end)
        self.ins = tuple(_Endpoint(self.device, "I", i) for i in range(ENDPOINTS))
        self.outs = tuple(_Endpoint(self.device, "O", i) for i in range(ENDPOINTS))
        self.receive = ReceiveFifo(engine.fail)
        self.transmit = tuple(TransmitFifo() for _ in range(ENDPOINTS))
        self.vbus_present = False
        self._begin()
        self._connect()
        self.core.reset = self._reset_core  # type: ignore[method-assign]
        self._show_supply(False)

    @property
    def devices(self) -> tuple[Device, ...]:
        """Its blocks of registers, for the bus."""
        return (self.core, self.device, self.power, *self.windows)

    def state(self) -> dict[str, Any]:
        fifos = [fifo.state() for fifo in (self.receive, *self.transmit)]
        return {"otg": super().state(), "fifos": fifos}

    def restore(self, state: dict[str, Any]) -> None:
        self.engine.forget_answers()
        super().restore(state["otg"])
        for fifo, saved in zip((self.receive, *self.transmit), state["fifos"], strict=True):
            fifo.restore(saved)

    def _begin(self) -> None:
        self.receive.clear()
        for fifo in self.transmit:
            fifo.clear()
        self._toggles0 = [0, 0]  # of endpoint 0, IN and OUT: its registers do not show them
        self._setup_pending = False  # its end is told with the next token
        self._setups = 0  # one after another
        self._address = 0  # a new one counts from the status stage of the request that brought it
        self._in_request = False
        self._reset_seen = False  # ENUMDNE is due with the reset's end
        self._session = False
        self._clear_at = 0  # cycle at which the self-clearing bits of GRSTCTL are 0 again
        self._idle_seen = False  # for 3 ms
        self._global_in_nak = self._global_out_nak = False
        self._asserted = False

    def _reset_core(self) -> None:
        """Reset everything, as the chip's reset or OTGFSRST does."""
        Device.reset(self.core)
        self.device.reset()
        self.power.reset()
        self._begin()
        self._idle.cancel()
        self._end_of_frame.cancel()
        self.engine.forget_answers()
        self.engine.irq(self._irq, False)

    def _connect(self) -> None:
        """Let the registers that do more than keep a value call this object."""
        core, device = self.core, self.device
        for name in ("GOTGCTL", "GINTSTS", "GRXSTSR", "GRXSTSP", "GRSTCTL"):
            setattr(core, f"read_{name.lower()}", getattr(self, f"_read_{name.lower()}"))
        for name in ("GOTGCTL", "GOTGINT", "GAHBCFG", "GINTSTS", "GINTMSK", "GRSTCTL", "CID"):
            setattr(core, f"write_{name.lower()}", getattr(self, f"_write_{name.lower()}"))
        for name in ("DCFG", "DCTL", "DIEPMSK", "DOEPMSK", "DAINTMSK", "DIEPEMPMSK"):
            setattr(device, f"write_{name.lower()}", partial(self._write_device, name))
        device.read_daint = self._read_daint  # type: ignore[attr-defined]
        device.read_dctl = self._read_dctl  # type: ignore[attr-defined]
        for i in range(ENDPOINTS):
            setattr(device, f"write_diepctl{i}", partial(self._write_control, self.ins[i]))
            setattr(device, f"write_doepctl{i}", partial(self._write_control, self.outs[i]))
            setattr(device, f"write_dieptsiz{i}", partial(self._write_size, self.ins[i]))
            setattr(device, f"write_doeptsiz{i}", partial(self._write_size, self.outs[i]))
            setattr(device, f"read_diepint{i}", partial(self._read_in_flags, self.ins[i]))
            setattr(device, f"write_diepint{i}", partial(self._write_flags, self.ins[i]))
            setattr(device, f"write_doepint{i}", partial(self._write_flags, self.outs[i]))
            setattr(device, f"read_dtxfsts{i}", partial(self._read_space, self.ins[i]))
            self.windows[i].read_dfifo = self._read_fifo  # type: ignore[attr-defined]
            self.windows[i].write_dfifo = partial(self._write_fifo, self.ins[i])  # type: ignore[attr-defined]

    # ---- the cable's side ----

    @property
    def attached(self) -> bool:
        """See cable.Device."""
        return (
            self.vbus_present
            and self.core.clocked
            and not self.device.words["DCTL"] & 2
            and bool(self.core.words["GCCFG"] & 1 << 16)
            and self._session
        )

    @property
    def wakes(self) -> bool:
        """See cable.Device."""
        return bool(self.device.words["DCTL"] & self.device.words["DSTS"] & 1)

    def vbus(self, present: bool) -> None:
        """See cable.Device. The core itself does not see it (module docstring)."""
        self.vbus_present = present
        self._show_supply(present)
        self._idle_seen = False
        self._idle.set(self.engine.cycle + _IDLE)

    def _show_supply(self, present: bool) -> None:
        """Set the pin that shows VBUS by the board's divider, where there is one."""
        if self._supply is not None:
            self._pins.drive(str(self._supply), present)

    def bus_reset(self) -> None:
        """See cable.Device."""
        if not self._hears():
            return
        self._validate()
        self.device.words["DSTS"] &= ~1
        for endpoint in (*self.ins, *self.outs):
            endpoint.set(_EPENA | _EPDIS, False)
            endpoint.set(_NAKSTS)
            if endpoint.number:
                endpoint.set(_USBAEP, False)
        self._setup_pending, self._setups, self._in_request = False, 0, False
        self._address = self.device.get("DCFG", "DAD")
        self._reset_seen = True
        self._idle.cancel()
        self._idle_seen = False
        self._event(_USBRST)

    def suspend(self) -> None:
        """See cable.Device. The core counts the idle time itself."""

    def resume(self) -> None:
        """See cable.Device."""
        self._idle.cancel()
        if self.device.words["DSTS"] & 1 and self.core.clocked:
            self.device.words["DSTS"] &= ~1
            self._event(_WKUPINT)

    def start_of_frame(self, number: int) -> None:
        """See cable.Device."""
        if not self._hears():
            return
        now = self.engine.cycle
        self._idle.set(now + _IDLE)
        self._idle_seen = False
        flags = _SOF
        if self._reset_seen:
            self._reset_seen = False
            self.device.put("DSTS", "ENUMSPD", _FULL_SPEED)
            flags |= _ENUMDNE
        self.device.words["DSTS"] = self.device.words["DSTS"] & ~(0x3FFF << 8 | 1) | number << 8
        self._end_of_frame.set(now + _FRAME * _FRAME_PART[self.device.get("DCFG", "PFIVL")] // 100)
        self._event(flags)

    def setup(self, address: int, endpoint: int, data: bytes) -> Handshake:
        """See cable.Device."""
        if not self._hears(address) or endpoint:
            return Handshake.SILENT
        self._check_ram()
        if not self.receive.room(self._receive_depth(), 2 + words_of(len(data))):
            return Handshake.SILENT
        self.receive.push(SETUP_DATA, 0, self._frame, data)
        self._in_request = True
        out = self.outs[0]
        for one in (self.ins[0], out):
            one.set(_STALL, False)
            one.set(_NAKSTS)
        self._toggles0 = [1, 1]
        count = self.device.get("DOEPTSIZ0", "STUPCNT")
        self.device.put("DOEPTSIZ0", "STUPCNT", max(count - 1, 0))
        self._setups = self._setups + 1 if self._setup_pending else 1
        if self._setups > 3:
            out.raise_flag(_B2BSTUP)
        self._setup_pending = True
        self._update()
        return Handshake.ACK

    def out(self, address: int, endpoint: int, toggle: int, data: bytes) -> Handshake:
        """See cable.Device."""
        if not self._hears(address) or endpoint >= ENDPOINTS or not self.outs[endpoint].active:
            return Handshake.SILENT
        out = self.outs[endpoint]
        if endpoint == 0:
            self._end_setup()
        if out.status & _STALL:
            return Handshake.STALL
        if out.status & _NAKSTS or not out.status & _EPENA or self._global_out_nak:
            if endpoint == 0 and not out.status & _EPENA:
                out.raise_flag(_OTEPDIS)
                self._update()
            return Handshake.NAK
        if toggle != self._toggle(out):
            return Handshake.ACK  # the host had missed the acknowledgement of the one before
        if not self.receive.room(self._receive_depth(), 2 + words_of(len(data))):
            return Handshake.NAK
        self._flip(out)
        self._in_request = self._in_request and (endpoint != 0 or bool(data))
        self.receive.push(OUT_DATA, endpoint, self._frame, data, toggle)
        if len(data) > out.left:
            self.engine.note(
                f"{out.size} XFRSIZ is {out.left}, but the host sent a packet of {len(data)} bytes"
            )
        out.left = max(out.left - len(data), 0)
        out.packets = max(out.packets - 1, 0)
        if not out.packets or len(data) < out.packet_size:
            self.receive.push(OUT_DONE, endpoint, self._frame)
            out.set(_EPENA, False)
            out.set(_NAKSTS)
        self._update()
        return Handshake.ACK

    def take(self, address: int, endpoint: int) -> Answer:
        """See cable.Device."""
        if not self._hears(address) or endpoint >= ENDPOINTS or not self.ins[endpoint].active:
            return Handshake.SILENT
        one = self.ins[endpoint]
        if endpoint == 0:
            self._end_setup()
        if one.status & _STALL:
            return Handshake.STALL
        if one.status & _NAKSTS or not one.status & _EPENA or self._global_in_nak:
            return self._refuse(one)
        fifo = self._fifo(one)
        if fifo.packets:
            data = fifo.take()
        elif one.packets and not one.left and not fifo.partial:
            data = b""
        else:
            return self._refuse(one)
        toggle = self._toggle(one)
        self._flip(one)
        one.packets -= 1
        if endpoint == 0 and not data:
            self._in_request, self._address = False, self.device.get("DCFG", "DAD")
        if not one.packets:
            one.set(_EPENA, False)
            one.raise_flag(_XFRC)
        self._update()
        return toggle, data

    def _refuse(self, one: _Endpoint) -> Handshake:
        if not self._fifo(one).used and not one.words[one.flags] & _ITTXFE:
            one.raise_flag(_ITTXFE)
            self._update()
        return Handshake.NAK

    def _end_setup(self) -> None:
        """Tell that the packets of a request have ended: a token for something else has come."""
        if self._setup_pending:
            self._setup_pending = False
            self.receive.push(SETUP_DONE, 0, self._frame)
            self._update()

    def _hears(self, address: int | None = None) -> bool:
        """Return True if the core takes part in the bus, under `address` if one is given."""
        if not self.attached or self.power.words["PCGCCTL"] & 1 or not self._rcc.usb_hz:
            return False
        return address is None or address == self._address

    @property
    def _frame(self) -> int:
        return self.device.words["DSTS"] >> 8 & 0x3FFF

    def _toggle(self, one: _Endpoint) -> int:
        return self._toggles0[one.way == "O"] if one.number == 0 else one.toggle

    def _flip(self, one: _Endpoint) -> None:
        if one.number == 0:
            self._toggles0[one.way == "O"] ^= 1
        else:
            one.words[one.control] ^= _DPID

    def _fall_idle(self) -> None:
        """Note that no packet has come for 3 ms, and then for 6 ms."""
        if self.device.words["DSTS"] & 1 or not self.core.clocked:
            return
        if self._idle_seen:
            self.device.words["DSTS"] |= 1
            self._event(_USBSUSP)
            return
        self._idle_seen = True
        self._event(_ESUSP)
        self._idle.set(self.engine.cycle + _IDLE)

    def _near_frame_end(self) -> None:
        self._event(_EOPF)

    # ---- rules of the set-up ----

    def _validate(self) -> None:
        """Fail unless clocks, pins and speed are those of a full-speed device."""
        fail, hz, ahb = self.engine.fail, self._rcc.usb_hz, self._rcc.clocks.core
        if abs(hz - USB_HZ) > USB_HZ * _USB_TOLERANCE:
            fail(f"OTG_FS is clocked with {hz / 1e6:g} MHz, expected 48 MHz (RCC_PLLCFGR PLLQ)")
        if ahb < _AHB_MIN:
            fail(f"the AHB runs at {ahb / 1e6:g} MHz, OTG_FS needs {_AHB_MIN / 1e6:g} MHz or more")
        least = next(trdt for mhz, trdt in _TURNAROUND if ahb >= mhz * 1e6)
        if (trdt := self.core.get("GUSBCFG", "TRDT")) < least:
            fail(f"OTG_FS_GUSBCFG TRDT is {trdt}, expected {least} or more with an AHB of {ahb / 1e6:g} MHz")
        if (speed := self.device.get("DCFG", "DSPD")) != _FULL_SPEED:
            fail(f"OTG_FS_DCFG DSPD is {speed}, expected 3: full speed with the core's transceiver")
        for line in ("OTG_FS_DM", "OTG_FS_DP"):
            self._pins.expect(line, "OTG_FS is on the bus")

    def _check_ram(self) -> None:
        """Fail unless the receive FIFO and those of active IN endpoints share the RAM without overlap."""
        places = [(0, self._receive_depth(), "OTG_FS_GRXFSIZ")]
        numbers: dict[int, _Endpoint] = {}
        for one in self.ins:
            if not one.active:
                continue
            number = one.status >> _TXFNUM & 15
            if number in numbers or number >= ENDPOINTS:
                self.engine.fail(
                    f"{one.control} TXFNUM is {number}, expected a FIFO of its own, 0 to {ENDPOINTS - 1}"
                )
            numbers[number] = one
            word = self.core.words[f"DIEPTXF{number}"]
            places.append((word & 0xFFFF, word >> 16, f"OTG_FS_DIEPTXF{number}"))
        places.sort()
        end, before = 0, "the RAM's begin"
        for begin, depth, name in places:
            if depth < DEPTH_MIN:  # others' drivers do so, and work on the chip
                self.engine.note(f"{name} has a depth of {depth} words, expected {DEPTH_MIN} or more")
            if begin < end:
                self.engine.fail(f"{name} begins at word {begin}, inside {before}, which ends at {end}")
            end, before = begin + depth, name
            if end > RAM_WORDS:
                self.engine.fail(f"{name} ends at word {end}, the FIFOs' RAM has {RAM_WORDS}")

    def _receive_depth(self) -> int:
        return self.core.words["GRXFSIZ"] & 0xFFFF

    def _fifo(self, one: _Endpoint) -> TransmitFifo:
        return self.transmit[min(one.status >> _TXFNUM & 15, ENDPOINTS - 1)]

    def _depth(self, one: _Endpoint) -> int:
        return self.core.words[f"DIEPTXF{min(one.status >> _TXFNUM & 15, ENDPOINTS - 1)}"] >> 16

    # ---- interrupts ----

    def _event(self, flags: int) -> None:
        self.core.words["GINTSTS"] |= flags
        self._update()

    def _update(self) -> None:
        """Note a change; set the interrupt line, for which a program that polls does not pay."""
        self.engine.forget_answers()
        on = bool(self.core.words["GAHBCFG"] & 1 and self._flags() & self.core.words["GINTMSK"])
        if on != self._asserted:
            self._asserted = on
            self.engine.irq(self._irq, on)

    def _flags(self) -> int:
        flags = self.core.words["GINTSTS"] & ~_LIVE
        if self.receive.entries:
            flags |= _RXFLVL
        if self.core.words["GOTGINT"]:
            flags |= _OTGINT
        if self._global_in_nak:
            flags |= _GINAKEFF
        wanted = self.device.words["DAINTMSK"]
        if wanted:
            pending = self._endpoint_flags() & wanted
            if pending & 0xFFFF:
                flags |= _IEPINT
            if pending >> 16:
                flags |= _OEPINT
        return flags

    def _endpoint_flags(self) -> int:
        words, found = self.device.words, 0
        ins, outs, empty = words["DIEPMSK"] & ~_TXFE, words["DOEPMSK"], words["DIEPEMPMSK"]
        if ins or empty:
            for one in self.ins:
                if words[one.flags] & ins or (empty >> one.number & 1 and self._is_empty(one)):
                    found |= 1 << one.number
        if outs:
            for out in self.outs:
                if words[out.flags] & outs:
                    found |= 1 << 16 + out.number
        return found

    def _is_empty(self, one: _Endpoint) -> bool:
        """Return TXFE: half of the FIFO, or all of it, is free (GAHBCFG TXFELVL)."""
        used = self._fifo(one).used
        return used == 0 if self.core.words["GAHBCFG"] & 1 << 7 else 2 * used <= self._depth(one)

    # ---- registers: the core's ----

    def _read_gotgctl(self) -> int:
        return self.core.words["GOTGCTL"] & ~(1 << 19) | self._session << 19

    def _write_gotgctl(self, value: int) -> None:
        self.core.keep("GOTGCTL", value)
        session = self.core.words["GOTGCTL"] & 0xC0 == 0xC0  # BVALOEN and BVALOVAL
        before, self._session = self._session, session
        if session and not before:
            self._event(_SRQINT)
        elif before and not session:
            self.core.words["GOTGINT"] |= _SEDET
            self._update()

    def _write_gotgint(self, value: int) -> None:
        self.core.words["GOTGINT"] &= ~value
        self._update()

    def _write_gahbcfg(self, value: int) -> None:
        self.core.keep("GAHBCFG", value)
        self._update()

    def _write_gintmsk(self, value: int) -> None:
        self.core.keep("GINTMSK", value)
        self._update()

    def _read_gintsts(self) -> int:
        return self._flags()

    def _write_gintsts(self, value: int) -> None:
        self.core.words["GINTSTS"] &= ~(value & self.core.block.registers["GINTSTS"].writable)
        self._update()

    def _write_cid(self, value: int) -> None:
        self.core.keep("CID", value)

    def _read_grxstsr(self) -> int:
        return self.receive.peek()

    def _read_grxstsp(self) -> int:
        word = self.receive.pop()
        status, number = word >> 17 & 15, word & 15
        if status == OUT_DONE:
            self.outs[number].raise_flag(_XFRC)
        elif status == SETUP_DONE:
            self.outs[number].set(_EPENA, False)
            self.outs[number].raise_flag(_STUP)
        elif status == GLOBAL_OUT_NAK:
            self.core.words["GINTSTS"] |= _GONAKEFF
        self._update()
        return word

    def _read_grstctl(self) -> int:
        if self.engine.cycle >= self._clear_at:
            self.core.words["GRSTCTL"] &= ~self.core.mask("GRSTCTL", "CSRST", "RXFFLSH", "TXFFLSH")
        return self.core.words["GRSTCTL"]

    def _write_grstctl(self, value: int) -> None:
        self._read_grstctl()
        keep = self.core.mask("GRSTCTL", "CSRST", "RXFFLSH", "TXFFLSH")
        begun = value & keep & ~self.core.words["GRSTCTL"]
        if value & self.core.mask("GRSTCTL", "CSRST"):
            self._soft_reset()
        if begun & self.core.mask("GRSTCTL", "RXFFLSH"):
            self.receive.clear()
        if begun & self.core.mask("GRSTCTL", "TXFFLSH"):
            number = (value & self.core.mask("GRSTCTL", "TXFNUM")) >> 6
            chosen = self.transmit if number == _ALL_FIFOS else self.transmit[number : number + 1]
            if not chosen:
                self.engine.fail(
                    f"OTG_FS_GRSTCTL TXFNUM is {number}, expected 0 to {ENDPOINTS - 1} or {_ALL_FIFOS}"
                )
            for fifo in chosen:
                fifo.clear()
        self.core.keep("GRSTCTL", value)
        if begun:
            self._clear_at = self.engine.cycle + _CORE_RESET
        self._update()

    def _soft_reset(self) -> None:
        """Reset the core by CSRST: all but GCCFG, DSPD, SDIS and the clock gates (RM0431, OTG_GRSTCTL)."""
        kept = self.core.words["GCCFG"], self.device.get("DCFG", "DSPD"), self.device.get("DCTL", "SDIS")
        gates = self.power.words["PCGCCTL"]
        self._reset_core()
        self.core.words["GCCFG"], self.power.words["PCGCCTL"] = kept[0], gates
        self.device.put("DCFG", "DSPD", kept[1])
        self.device.put("DCTL", "SDIS", kept[2])

    # ---- registers: the device's ----

    def _write_device(self, name: str, value: int) -> None:
        if name == "DCTL":
            self._write_dctl(value)
        else:
            self.device.keep(name, value)
        if name == "DCFG" and not self._in_request:
            self._address = self.device.get("DCFG", "DAD")
        self._update()

    def _read_dctl(self) -> int:
        return self.device.words["DCTL"] & ~0xC | self._global_in_nak << 2 | self._global_out_nak << 3

    def _write_dctl(self, value: int) -> None:
        self.device.keep("DCTL", value & ~(_SGINAK | _CGINAK | _SGONAK | _CGONAK))
        if value & _SGINAK:
            self._global_in_nak = True
        if value & _CGINAK:
            self._global_in_nak = False
        if value & _SGONAK and not self._global_out_nak:
            self._global_out_nak = True
            self.receive.push(GLOBAL_OUT_NAK, 0, self._frame)
        if value & _CGONAK:
            self._global_out_nak = False
            self.core.words["GINTSTS"] &= ~_GONAKEFF

    def _read_daint(self) -> int:
        return self._endpoint_flags()

    def _read_in_flags(self, one: _Endpoint) -> int:
        return one.words[one.flags] & ~_TXFE | (_TXFE if self._is_empty(one) else 0)

    def _write_flags(self, endpoint: _Endpoint, value: int) -> None:
        endpoint.words[endpoint.flags] &= ~value
        self._update()

    def _read_space(self, one: _Endpoint) -> int:
        return max(self._depth(one) - self._fifo(one).used, 0)

    def _write_size(self, endpoint: _Endpoint, value: int) -> None:
        if endpoint.status & _EPENA and endpoint.number:
            self.engine.fail(f"OTG_FS_{endpoint.size} is written while {endpoint.control} EPENA is 1")
        self.device.keep(endpoint.size, value)

    def _write_control(self, endpoint: _Endpoint, value: int) -> None:
        before = endpoint.status
        name = endpoint.control
        if before & _USBAEP and endpoint.number and (before ^ value) & _MPS and before & _EPENA:
            self.engine.fail(f"OTG_FS_{name} MPSIZ is changed while EPENA is 1")
        if endpoint.number == 0:
            value |= before & _STALL  # the core alone clears it, with the next request
        self.device.keep(name, value & ~_COMMANDS | before & (_EPENA | _EPDIS))
        if endpoint.number and value & _USBAEP and value >> 18 & 3 == _ISOCHRONOUS:
            self.engine.fail(f"OTG_FS_{name} EPTYP is isochronous, which the emulator does not model")
        if value & _SD0PID:
            endpoint.set(_DPID, False)
        if value & _SD1PID:
            endpoint.set(_DPID)
        if value & _SNAK:
            endpoint.set(_NAKSTS)
            if endpoint.way == "I":
                endpoint.raise_flag(_INEPNE)
        if value & _CNAK:
            endpoint.set(_NAKSTS, False)
            if endpoint.way == "I":
                endpoint.words[endpoint.flags] &= ~_INEPNE
        if value & _EPDIS:
            self._disable(endpoint)
        elif value & _EPENA and not before & _EPENA:
            self._enable(endpoint)
        self._update()

    def _enable(self, endpoint: _Endpoint) -> None:
        if not endpoint.active:
            self.engine.fail(f"OTG_FS_{endpoint.control} EPENA is set while USBAEP is 0")
        if endpoint.way == "I":
            self._check_ram()
            if self._fifo(endpoint).used:
                self.engine.fail(
                    f"OTG_FS_{endpoint.control} EPENA is set while its FIFO holds an earlier transfer, "
                    "expected it sent or flushed"
                )
            size, count = endpoint.packet_size, max(-(-endpoint.left // max(endpoint.packet_size, 1)), 1)
            if size == 0 or endpoint.packets not in (count, count + 1):
                self.engine.fail(
                    f"OTG_FS_{endpoint.size} has {endpoint.packets} packets for {endpoint.left} bytes, "
                    f"expected {count} of up to {size} bytes"
                )
        endpoint.set(_EPENA)

    def _disable(self, endpoint: _Endpoint) -> None:
        """Stop a transfer; of an OUT endpoint only while all of them are refused (RM0431, disabling one)."""
        if not endpoint.status & _EPENA:
            return
        if endpoint.way == "O" and not self._global_out_nak:
            self.engine.fail(
                f"OTG_FS_{endpoint.control} EPDIS is set without global OUT NAK, expected DCTL SGONAK and "
                "GINTSTS GONAKEFF before"
            )
        endpoint.set(_EPENA | _EPDIS, False)
        endpoint.set(_NAKSTS)
        endpoint.raise_flag(_EPDISD)

    # ---- FIFO windows ----

    def _read_fifo(self) -> int:
        return self.receive.read()

    def _write_fifo(self, one: _Endpoint, value: int) -> None:
        fifo, name = self._fifo(one), f"OTG_FS_FIFO{one.number}"
        if not one.status & _EPENA:
            self.engine.fail(f"{name} is written while {one.control} EPENA is 0")
        if not one.left:
            self.engine.fail(f"{name} is written beyond the transfer's {one.size} XFRSIZ")
        if fifo.used >= self._depth(one):
            self.engine.fail(f"{name} is written while it is full, expected room in DTXFSTS{one.number}")
        length = min(one.left, one.packet_size)
        if fifo.write(value, length):
            one.left -= length
            self._update()
