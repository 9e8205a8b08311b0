"""A full-speed USB host on the board's time: frames of 1 ms, and transfers as the bus has room for them.

Each transaction takes its bytes' time on a bus of 12 Mbit/s (USB 2.0, 5.6 to 5.8: 13 bytes beside the data,
so that 19 packets of 64 bytes fit into a frame) and reaches the device when it ends. Periodic transfers come
first in a frame, then control, then bulk transfers, one packet each in turn. A NAK is asked again: at once,
then after two, four and at most eight packets' time, and costs as much of the bus as a packet does: a choice
that keeps an idle line cheap. A transaction without an answer is tried three times, as host controllers do.

The host does not interpret what it carries, but for what a host controller and its hub driver must:
addresses, data toggles, and the requests that reset them.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from neuroflight.sim.board.core.context import TIME_HZ, Kept
from neuroflight.sim.board.core.engine import Engine
from neuroflight.sim.board.usb.cable import CONTROL_MAX, Device, Handshake

FRAME = TIME_HZ // 1000  # [cycles]
_BYTE = TIME_HZ * 8 // 12_000_000  # [cycles]
_OVERHEAD = 13  # bytes of a transaction beside its data (USB 2.0, 5.8.4)
_SOF_BYTES = 6  # with its gap
_SETTLE = 100  # frames from the attachment to the reset (USB 2.0, 7.1.7.3)
_RESET = 10  # frames (USB 2.0, 7.1.7.5)
_RECOVERY = 10  # frames after a reset in which nothing is asked (USB 2.0, 7.1.7.5)
_RESUME = 20  # frames (USB 2.0, 7.1.7.7)
_SUSPEND = 3  # frames without a packet
_BACK_OFF_MAX = 8  # packets' times between two tries
_TRIES = 3  # of a transaction without an answer
IN = 0x80  # of an endpoint's address, and of a request's type


class Kind(Enum):
    """Types of transfers."""

    CONTROL = 0
    BULK = 2
    INTERRUPT = 3


class Status(Enum):
    """Ends of a transfer."""

    PENDING = "is under way"
    DONE = "done"
    STALLED = "refused: STALL"
    SILENT = "without an answer"
    BABBLE = "ended by a packet longer than what was left"
    CANCELLED = "cancelled"
    GONE = "ended: the device has gone"


@dataclass(eq=False)
class Transfer:
    """A transfer of bytes between the host and one endpoint."""

    address: int
    endpoint: int  # 0 to 15
    kind: Kind
    inward: bool  # to the host; of a control transfer: its data
    data: bytes = b""  # to send
    length: int = 0  # bytes wanted, if inward
    request: bytes = b""  # the 8 bytes of a control transfer
    packet_size: int = CONTROL_MAX
    interval: int = 1  # frames, of an interrupt transfer
    zero: bool = False  # end with a packet of no bytes where the last one is full
    status: Status = Status.PENDING
    received: bytes = b""
    sent: int = 0  # bytes that were acknowledged
    naks: int = 0
    stage: int = 0  # of a control transfer: 0 request, 1 data, 2 status
    not_before: int = 0  # cycle
    on_end: Callable[[Transfer], None] | None = field(default=None, repr=False)
    _tries: int = 0
    _back_off: int = 0

    @property
    def done(self) -> bool:
        return self.status is not Status.PENDING

    @property
    def key(self) -> tuple[int, int, bool]:
        """Its endpoint: address, number, direction."""
        return self.address, self.endpoint, self.inward

    @property
    def queue(self) -> tuple[int, int, bool]:
        """Endpoint whose transfers come one after another: both directions of a control endpoint are one."""
        return (self.address, self.endpoint, False) if self.kind is Kind.CONTROL else self.key


class Line(Enum):
    """States of the port that the host drives."""

    EMPTY = 0  # no cable
    POWERED = 1  # cable with VBUS, no device has come
    SETTLING = 2
    RESETTING = 3
    RECOVERING = 4
    RUNNING = 5  # frames
    SUSPENDED = 6
    RESUMING = 7


class Host(Kept):
    """The host at the other end of the cable, unplugged at first. It costs nothing until it is plugged in."""

    kept = (
        "line",
        "frame",
        "_frame_at",
        "_free_at",
        "_since",
        "_toggles",
        "_turn",
        "_turns",
        "frames",
        "packets",
    )

    def __init__(self, engine: Engine, device: Device, name: str = "usb") -> None:
        """name: of its alarm."""
        self.engine, self.device = engine, device
        self._alarm = engine.alarm(f"{name}.host", self._ring)
        self.line = Line.EMPTY
        self.frame = 0  # its number, 0 to 2047
        self._frame_at = 0  # cycle at which it began
        self._free_at = 0  # cycle from which the bus is free
        self._since = 0  # frames in the present state of the line
        self._toggles: dict[tuple[int, int, bool], int] = {}
        self._turn = 0  # transactions so far
        self._turns: dict[tuple[int, int, bool], int] = {}  # the last one of each endpoint
        self._polls: dict[tuple[int, int, bool], int] = {}  # cycles of interrupt endpoints' next ones
        self.frames = self.packets = 0  # so far
        self._pending: list[Transfer] = []
        self._current: Transfer | None = None
        self.on_change: Callable[[], None] = lambda: None  # the device has come (and was reset) or gone
        self.poll: Callable[[], None] | None = None  # called about every eighth of a frame, while it is set
        engine.on_system_reset(lambda cause: self._outlive())

    # ---- the cable ----

    @property
    def connected(self) -> bool:
        """True while a device can be talked to."""
        return self.line in (Line.RUNNING, Line.SUSPENDED, Line.RESUMING)

    @property
    def vacant(self) -> bool:
        """True if no device has come for 100 ms."""
        return self.line is Line.EMPTY or (self.line is Line.POWERED and self._since >= _SETTLE)

    def plug(self) -> None:
        """Plug the cable in. A device that comes is reset; then `connected`."""
        if self.line is Line.EMPTY:
            self._enter(Line.POWERED)
            self.device.vbus(True)
            self._frame_at = self.engine.cycle
            self._alarm.set(self._frame_at + FRAME)

    def unplug(self) -> None:
        """Pull the cable: transfers end."""
        if self.line is not Line.EMPTY:
            self._lose(Line.EMPTY)
            self._alarm.cancel()
            self.device.vbus(False)

    def reset(self) -> None:
        """Reset the device for 10 ms; its transfers are cancelled."""
        if self.connected:
            self.cancel_all()
            self._toggles.clear()
            self._enter(Line.RESETTING)
            self.device.bus_reset()

    def suspend(self) -> None:
        """Send no more frames until `resume` or the device's wake-up."""
        if self.line is Line.RUNNING:
            self._enter(Line.SUSPENDED)

    def resume(self) -> None:
        if self.line is Line.SUSPENDED:
            self._enter(Line.RESUMING)
            self.device.resume()

    def _enter(self, line: Line) -> None:
        self.line, self._since = line, 0

    def _lose(self, line: Line) -> None:
        """Note that the device has gone."""
        was = self.connected
        self._enter(line)
        for transfer in list(self._pending):
            self._end(transfer, Status.GONE)
        self._toggles.clear()
        self._polls.clear()
        if was:
            self.on_change()

    # ---- transfers ----

    def submit(self, transfer: Transfer) -> Transfer:
        """Begin a transfer. It ends on the board's time, with `on_end` called then."""
        if not self.connected:
            self._end(transfer, Status.GONE)
            return transfer
        self._pending.append(transfer)
        if self._current is None and self.line is Line.RUNNING:
            self._plan(max(self.engine.cycle, self._free_at))
        return transfer

    def cancel(self, transfer: Transfer) -> None:
        if not transfer.done:
            self._end(transfer, Status.CANCELLED)

    def cancel_all(self) -> None:
        for transfer in list(self._pending):
            self._end(transfer, Status.CANCELLED)

    def clear_toggle(self, address: int, endpoint: int, inward: bool) -> None:
        """Begin with DATA0 again, as after a halt was cleared."""
        self._toggles.pop((address, endpoint, inward), None)

    def control(
        self,
        request: bytes,
        data: bytes = b"",
        *,
        address: int,
        packet_size: int = CONTROL_MAX,
        not_before: int = 0,
        on_end: Callable[[Transfer], None] | None = None,
    ) -> Transfer:
        """Begin a control transfer, not before that cycle; the request tells direction and length."""
        inward = bool(request[0] & IN)
        length = int.from_bytes(request[6:8], "little")
        transfer = Transfer(address, 0, Kind.CONTROL, inward, data[:length], length, request, packet_size)
        transfer.not_before, transfer.on_end = not_before, on_end
        return self.submit(transfer)

    def _end(self, transfer: Transfer, status: Status) -> None:
        transfer.status = status
        if transfer in self._pending:
            self._pending.remove(transfer)
        if self._current is transfer:
            self._current = None
        if status is Status.DONE and transfer.kind is Kind.CONTROL:
            self._note_request(transfer)
        if transfer.on_end is not None:
            transfer.on_end(transfer)

    def _note_request(self, transfer: Transfer) -> None:
        """Reset data toggles where the request did (USB 2.0, 9.1.1.5, 9.4.5 and 9.4.10)."""
        kind, number = transfer.request[0], transfer.request[1]
        value, index = (int.from_bytes(transfer.request[i : i + 2], "little") for i in (2, 4))
        if (kind, number) in ((0x00, 9), (0x01, 11)):  # SET_CONFIGURATION, SET_INTERFACE
            self._toggles = {k: v for k, v in self._toggles.items() if k[0] != transfer.address}
        elif (kind, number, value) == (0x02, 1, 0):  # CLEAR_FEATURE, ENDPOINT_HALT
            self.clear_toggle(transfer.address, index & 15, bool(index & IN))

    # ---- time ----

    def _outlive(self) -> None:
        """Go on after a reset of the chip, which clears the alarms of its side, and ours with them."""
        self._current = None
        if self.line is not Line.EMPTY:
            self._plan(max(self.engine.cycle, self._free_at))

    def _ring(self) -> None:
        now = self.engine.cycle
        if self._current is not None:
            current, self._current = self._current, None
            self._free_at = now
            self._transact(current)
        if self.line is Line.EMPTY:
            return
        if now >= self._frame_at + FRAME:
            self._frame_at += FRAME
            self._begin_frame()
        if self.poll is not None:
            self.poll()
        self._plan(max(now, self._free_at))

    def _begin_frame(self) -> None:
        device, self._since = self.device, self._since + 1
        if self.line not in (Line.EMPTY, Line.POWERED) and not device.attached:
            self._lose(Line.POWERED)
            return
        if self.line is Line.POWERED and device.attached:
            self._enter(Line.SETTLING)
        elif self.line is Line.SETTLING and self._since >= _SETTLE:
            self._enter(Line.RESETTING)
            device.bus_reset()
        elif self.line is Line.RESETTING and self._since >= _RESET:
            self._enter(Line.RECOVERING)
        elif self.line is Line.RECOVERING and self._since >= _RECOVERY:
            self._enter(Line.RUNNING)
            self.on_change()
        elif self.line is Line.SUSPENDED:
            if self._since == _SUSPEND:
                device.suspend()
            if device.wakes:
                self.resume()
        elif self.line is Line.RESUMING and self._since >= _RESUME:
            self._enter(Line.RUNNING)
        if self.line in (Line.RECOVERING, Line.RUNNING):
            self.frame = self.frame + 1 & 0x7FF
            self.frames += 1
            self._free_at = self.engine.cycle + _SOF_BYTES * _BYTE
            device.start_of_frame(self.frame)

    def _plan(self, free: int) -> None:
        """Choose what comes next and wait for its end; for the next frame if nothing fits."""
        if self._current is not None:
            return
        end = self._frame_at + FRAME
        wake = end
        if self.line is Line.RUNNING:
            chosen = self._choose(free)
            if chosen is not None:
                duration = _duration(chosen)
                if free + duration <= end:
                    self._current, wake = chosen, free + duration
            else:
                wake = min([end, *(at for at in map(self._ready_at, self._pending) if at > free)])
                if self.poll is not None:
                    wake = min(wake, free + FRAME // 8)
        self._alarm.set(wake)

    def _ready_at(self, transfer: Transfer) -> int:
        """Return the cycle of the next try: after a NAK, or at the next interval of its endpoint."""
        return max(transfer.not_before, self._polls.get(transfer.queue, 0))

    def _choose(self, now: int) -> Transfer | None:
        """Return the transfer whose turn it is: interrupt, control, bulk; the first of its endpoint."""
        best: tuple[int, int] = (len(_ORDER), 0)
        chosen: Transfer | None = None
        busy: set[tuple[int, int, bool]] = set()
        for transfer in self._pending:
            if transfer.queue in busy:
                continue
            busy.add(transfer.queue)
            order = (_ORDER[transfer.kind], self._turns.get(transfer.queue, 0))
            if self._ready_at(transfer) <= now and order < best:
                best, chosen = order, transfer
        if chosen is not None:
            self._turn += 1
            self._turns[chosen.queue] = self._turn
        return chosen

    # ---- transactions ----

    def _transact(self, transfer: Transfer) -> None:
        self.packets += 1
        if transfer.kind is Kind.INTERRUPT:
            self._polls[transfer.queue] = self._frame_at + transfer.interval * FRAME
        if transfer.kind is Kind.CONTROL:
            self._control_packet(transfer)
        elif transfer.inward:
            self._in_packet(transfer, transfer.key)
        else:
            self._out_packet(transfer, transfer.key)

    def _control_packet(self, transfer: Transfer) -> None:
        address = transfer.address
        if transfer.stage == 0:
            answer = self.device.setup(address, 0, transfer.request)
            if answer is Handshake.ACK:
                self._toggles[address, 0, True] = self._toggles[address, 0, False] = 1
                transfer.stage = 1 if transfer.length else 2
            self._note(transfer, answer)
        elif transfer.stage == 1:
            key = (address, 0, transfer.inward)
            if transfer.inward:
                self._in_packet(transfer, key)
            else:
                self._out_packet(transfer, key)
        else:
            self._status_packet(transfer)

    def _status_packet(self, transfer: Transfer) -> None:
        """Carry out the status stage: DATA1 without bytes, against the direction of the data."""
        if transfer.inward and transfer.length:
            answer = self.device.out(transfer.address, 0, 1, b"")
            if answer is Handshake.ACK:
                self._end(transfer, Status.DONE)
        else:
            found = self.device.take(transfer.address, 0)
            answer = Handshake.ACK if isinstance(found, tuple) else found
            if isinstance(found, tuple):
                self._end(transfer, Status.BABBLE if found[1] else Status.DONE)
        self._note(transfer, answer)

    def _in_packet(self, transfer: Transfer, key: tuple[int, int, bool]) -> None:
        answer = self.device.take(transfer.address, transfer.endpoint)
        if isinstance(answer, Handshake):
            self._note(transfer, answer)
            return
        self._note(transfer, Handshake.ACK)
        toggle, data = answer
        if toggle != self._toggles.get(key, 0):
            return  # its acknowledgement was lost: the device sends it again
        self._toggles[key] = toggle ^ 1
        left = transfer.length - len(transfer.received)
        transfer.received += data[:left]
        if len(data) > left:
            self._end(transfer, Status.BABBLE)
        elif len(data) < transfer.packet_size or len(data) == left:
            self._finish_data(transfer)

    def _out_packet(self, transfer: Transfer, key: tuple[int, int, bool]) -> None:
        packet = transfer.data[transfer.sent : transfer.sent + transfer.packet_size]
        toggle = self._toggles.get(key, 0)
        answer = self.device.out(transfer.address, transfer.endpoint, toggle, packet)
        self._note(transfer, answer)
        if answer is not Handshake.ACK:
            return
        self._toggles[key] = toggle ^ 1
        transfer.sent += len(packet)
        full = len(packet) == transfer.packet_size
        if transfer.sent == len(transfer.data) and not (transfer.zero and full):
            self._finish_data(transfer)

    def _finish_data(self, transfer: Transfer) -> None:
        if transfer.kind is Kind.CONTROL:
            transfer.stage = 2
        else:
            self._end(transfer, Status.DONE)

    def _note(self, transfer: Transfer, answer: Handshake) -> None:
        """Count tries, and set the time of the next one."""
        if transfer.done:
            return
        now = self.engine.cycle
        if answer is Handshake.STALL:
            self._end(transfer, Status.STALLED)
        elif answer is Handshake.SILENT:
            transfer._tries += 1
            if transfer._tries >= _TRIES:
                self._end(transfer, Status.SILENT)
        elif answer is Handshake.NAK:
            transfer.naks += 1
            transfer._tries = 0
            if transfer.kind is not Kind.INTERRUPT:
                transfer._back_off = min(max(2 * transfer._back_off, 1), _BACK_OFF_MAX)
                transfer.not_before = now + (transfer._back_off - 1) * _PACKET
        else:
            transfer._tries = transfer._back_off = 0

    # ---- snapshots ----

    def state(self) -> dict[str, Any]:
        """See Kept. Transfers under way are copied without `on_end`, which is not part of the board."""
        current = None if self._current is None else self._pending.index(self._current)
        pending = [copy.copy(transfer) for transfer in self._pending]
        for transfer in pending:
            transfer.on_end = None
        return {"host": super().state(), "pending": pending, "current": current}

    def restore(self, state: dict[str, Any]) -> None:
        """See Kept. Transfers of before are cancelled; those of `state` go on, to be found in `pending`."""
        self.cancel_all()
        super().restore(state["host"])
        self._pending = [copy.copy(transfer) for transfer in state["pending"]]
        self._current = None if state["current"] is None else self._pending[state["current"]]

    @property
    def pending(self) -> tuple[Transfer, ...]:
        """Transfers that have not ended, in the order of their begin."""
        return tuple(self._pending)


_ORDER = {Kind.INTERRUPT: 0, Kind.CONTROL: 1, Kind.BULK: 2}
_PACKET = (CONTROL_MAX + _OVERHEAD) * _BYTE


def _duration(transfer: Transfer) -> int:
    """Return the time of a transfer's next transaction [cycles]: of its largest packet, if inward."""
    if transfer.kind is Kind.CONTROL and transfer.stage != 1:
        size = 8 if transfer.stage == 0 else 0
    elif transfer.inward:
        size = min(transfer.packet_size, max(transfer.length - len(transfer.received), 0))
    else:
        size = min(transfer.packet_size, len(transfer.data) - transfer.sent)
    return (size + _OVERHEAD) * _BYTE
