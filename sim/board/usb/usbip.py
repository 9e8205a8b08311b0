"""A USB/IP server for emulated boards' connectors, on this computer only: other programs are their hosts.

USB/IP 1.1.1 (the Linux kernel's Documentation/usb/usbip_protocol.rst, as remembered and as its clients speak
it): a client lists devices, imports one, and sends requests (URBs), which become transfers of a `Host` on the
board's time. The server has no thread and never waits: whoever runs the board calls `exchange` between two
slices; what a transfer brings is sent as soon as it ends, and a client of a device is heard within a slice.

The server is what a computer's bus driver is: it enumerates a device that comes, under address 1, and chooses
its first configuration. A client that goes leaves a device that is reset. Isochronous URBs are refused.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

from neuroflight.sim.board.usb.enumeration import Description, Steps, enumerate_device
from neuroflight.sim.board.usb.host import IN, Host, Kind, Status, Transfer
from neuroflight.sim.loopback import listen
from neuroflight.toolchain.errors import LinkError

VERSION = 0x0111
PORT = 3240  # USB/IP's own
CLIENTS_MAX = 8
TRANSFER_MAX = 1 << 20  # bytes of one URB
URBS_MAX = 128  # of a client at a time
WANTED_MAX = 4 << 20  # bytes that a client's URBs ask for, and its answers that it has not read
READ_MAX = 64 * 1024  # bytes taken from a client at once
ENUMERATIONS = 3  # of a device that does not answer as it must

_OP = struct.Struct(">HHI")  # version, code, status
_LIST, _IMPORT, _REQUEST = 5, 3, 0x8000
_DEVICE = struct.Struct(">256s32sIIIHHHBBBBBB")
_BUSID_BYTES = 32
_DEVICE_NUMBER, _FULL_SPEED = 2, 2
_GRANTED, _BUSY, _NO_DEVICE = 0, 2, 4  # status of an import

_HEADER = struct.Struct(">5I")  # command, number, device, direction, endpoint
_HEADER_BYTES = 48
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_SUBMIT_TAIL = struct.Struct(">IiiII8s")  # flags, length, start frame, packets, interval, request
_RETURN_TAIL = struct.Struct(">5i8x")  # status, length, start frame, packets, errors
_ZERO_PACKET, _SHORT_NOT_OK = 0x40, 0x01  # flags of a URB
_NO_PACKETS = (0, 0xFFFFFFFF)  # of a URB that is not isochronous

# Status of a URB: Linux's error numbers, which is what the protocol carries.
_ENOENT, _ENODEV, _EINVAL, _EPIPE, _EPROTO, _EOVERFLOW = -2, -19, -22, -32, -71, -75
_ECONNRESET, _ESHUTDOWN, _EREMOTEIO = -104, -108, -121
_ERRORS = {
    Status.DONE: 0,
    Status.STALLED: _EPIPE,
    Status.SILENT: _EPROTO,
    Status.BABBLE: _EOVERFLOW,
    Status.CANCELLED: _ECONNRESET,
    Status.GONE: _ESHUTDOWN,
}
_SET_ADDRESS = bytes([0, 5])
_PORT_RESET = bytes([0x23, 3, 4, 0])  # SET_FEATURE, PORT_RESET: so Linux's clients ask for a reset


class _RefusedError(Exception):
    """A client has said what the protocol does not allow."""


@dataclass(eq=False)
class _Client:
    """A connection."""

    connection: socket.socket
    received: bytearray = field(default_factory=bytearray)
    unsent: bytearray = field(default_factory=bytearray)
    port: _Port | None = None  # whose device it has imported
    urbs: dict[int, Transfer] = field(default_factory=dict)  # by number
    resets: list[int] = field(default_factory=list)  # URBs that wait for the device to be enumerated again
    wanted: int = 0  # bytes that its URBs ask for
    gone: bool = False

    @property
    def full(self) -> bool:
        """True while it has to wait before it asks for more."""
        return len(self.urbs) >= URBS_MAX or self.wanted + len(self.unsent) >= WANTED_MAX


@dataclass(eq=False)
class _Port:
    """A connector, and the device in it."""

    number: int  # from 1
    host: Host
    description: Description | None = None
    steps: Steps[Description] | None = None  # of its enumeration
    tried: int = 0  # enumerations
    client: _Client | None = None

    @property
    def busid(self) -> str:
        return f"{self.number}-1"

    @property
    def settled(self) -> bool:
        """True if its device is enumerated, or nothing has come."""
        return self.steps is None and (
            self.description is not None
            or self.host.vacant
            or (self.host.connected and self.tried >= ENUMERATIONS)
        )

    def row(self, description: Description) -> bytes:
        """Return `struct usbip_usb_device`."""
        device, configuration = description.device, description.configuration
        return _DEVICE.pack(
            f"/sys/devices/emulated/usb{self.number}/{self.busid}".encode(),
            self.busid.encode(),
            self.number,
            _DEVICE_NUMBER,
            _FULL_SPEED,
            description.vendor,
            description.product,
            description.release,
            *device[4:7],
            configuration[5],
            device[17],
            configuration[4],
        )


class UsbIpServer:
    """A server for the connectors of one or several boards, from its making on."""

    def __init__(self, hosts: Sequence[Host], port: int = PORT) -> None:
        """hosts: of each connector; their cables are plugged in. port: 0 for any free one.

        Raises LinkError if the port is taken.
        """
        self._listener = listen("USB/IP", port)
        self.port: int = self._listener.getsockname()[1]
        self._clients: list[_Client] = []
        self.refusal = ""  # why the last connection was ended, if it was
        self._ports = [_Port(i, host) for i, host in enumerate(hosts, 1)]
        for each in self._ports:
            each.host.on_change = partial(self._change, each)
            each.host.plug()

    @property
    def name(self) -> str:
        return f"127.0.0.1:{self.port}"

    def exchange(self, cycles: int = 0) -> None:
        """Carry what has come, either way, before the boards run for `cycles`, which does not matter here."""
        try:
            connection, _ = self._listener.accept()
        except BlockingIOError:
            pass
        else:
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if len(self._clients) < CLIENTS_MAX:
                self._clients.append(_Client(connection))
            else:
                self.refusal = f"a USB/IP client beside {CLIENTS_MAX} others, expected no more"
                connection.close()
        for client in list(self._clients):
            self._serve(client)

    def close(self) -> None:
        """End all connections and pull the cables."""
        for client in list(self._clients):
            self._drop(client)
        self._listener.close()
        for port in self._ports:
            port.host.on_change, port.host.poll = lambda: None, None
            port.host.unplug()

    # ---- connections ----

    def _serve(self, client: _Client) -> None:
        try:
            while not (client.full or client.gone):
                data = client.connection.recv(READ_MAX)
                if not data:
                    client.gone = True
                    break
                client.received += data
                self._parse(client)
                if len(client.received) > TRANSFER_MAX + _HEADER_BYTES:
                    break
        except BlockingIOError:
            self._parse(client)
        except OSError:
            client.gone = True
        self._flush(client)

    def _parse(self, client: _Client) -> None:
        try:
            while not client.full and (self._message(client) if client.port else self._operation(client)):
                pass
        except _RefusedError as error:
            self.refusal = str(error)
            client.gone = True

    def _flush(self, client: _Client) -> None:
        try:
            while client.unsent:
                del client.unsent[: client.connection.send(client.unsent)]
        except BlockingIOError:
            pass
        except OSError:
            client.gone = True
        if client.gone:
            self._drop(client)

    def _drop(self, client: _Client) -> None:
        """End a connection; its device is reset, so that nothing of it goes on."""
        if client not in self._clients:
            return
        self._clients.remove(client)
        client.connection.close()
        client.urbs = {}
        port, client.port = client.port, None
        if port is not None:
            port.client, port.host.poll = None, None
            self._reset(port)  # which cancels its transfers

    # ---- devices ----

    def _change(self, port: _Port) -> None:
        """Handle that a device has come, or come back from a reset, or has gone."""
        port.description, port.steps = None, None
        if port.host.connected:
            self._enumerate(port)
        else:
            port.tried = 0
            if port.client is not None:
                port.client.gone = True
                self._flush(port.client)

    def _reset(self, port: _Port) -> None:
        """Reset the device; it is enumerated again afterwards."""
        port.description, port.steps = None, None
        port.tried = 0
        port.host.reset()

    def _enumerate(self, port: _Port) -> None:
        port.tried += 1
        port.steps = enumerate_device(port.host)
        self._go_on(port)

    def _go_on(self, port: _Port, ended: Transfer | None = None) -> None:
        """Take the next step of an enumeration."""
        if port.steps is None:
            return
        try:
            step = next(port.steps)
        except StopIteration as stop:
            port.steps, port.tried, port.description = None, 0, stop.value
            self._answer_resets(port, 0)
        except LinkError as error:
            port.steps = None
            self.refusal = str(error)
            if port.host.connected and port.tried < ENUMERATIONS:
                port.host.reset()
            else:
                self._answer_resets(port, _ENODEV)
        else:
            if step.done:
                self._go_on(port)
            else:
                step.on_end = partial(self._go_on, port)

    def _answer_resets(self, port: _Port, status: int) -> None:
        client = port.client
        if client is not None:
            for number in client.resets:
                self._return(client, number, status)
            client.resets.clear()

    # ---- before an import ----

    def _operation(self, client: _Client) -> bool:
        """Answer the next operation. Returns False until it is whole, or the devices have settled."""
        if len(client.received) < _OP.size:
            return False
        version, code, _ = _OP.unpack_from(client.received)
        if version != VERSION or code not in (_REQUEST | _LIST, _REQUEST | _IMPORT):
            raise _RefusedError(
                f"USB/IP version 0x{version:04X} operation 0x{code:04X}, expected a list (0x8005) or an "
                f"import (0x8003) of version 0x{VERSION:04X}"
            )
        size = _OP.size + (_BUSID_BYTES if code == _REQUEST | _IMPORT else 0)
        if len(client.received) < size or not all(port.settled for port in self._ports):
            return False
        data = bytes(client.received[_OP.size : size])
        del client.received[:size]
        if code == _REQUEST | _LIST:
            self._list(client)
        else:
            self._import(client, data.split(b"\0")[0].decode("ascii", "replace"))
        return True

    def _list(self, client: _Client) -> None:
        found = [(port, port.description) for port in self._ports if port.description is not None]
        client.unsent += _OP.pack(VERSION, _LIST, 0) + struct.pack(">I", len(found))
        for port, description in found:
            client.unsent += port.row(description)
            for interface in description.interfaces[: description.configuration[4]]:
                client.unsent += bytes([*interface, 0])

    def _import(self, client: _Client, busid: str) -> None:
        port = next((port for port in self._ports if port.busid == busid), None)
        if port is None or port.description is None:
            client.unsent += _OP.pack(VERSION, _IMPORT, _NO_DEVICE)
        elif port.client is not None:
            client.unsent += _OP.pack(VERSION, _IMPORT, _BUSY)
        else:
            port.client, client.port = client, port
            port.host.poll = partial(self._serve, client)  # its answers lead to more within the same slice
            client.unsent += _OP.pack(VERSION, _IMPORT, _GRANTED) + port.row(port.description)

    # ---- after it ----

    def _message(self, client: _Client) -> bool:
        """Carry out the next message. Returns False until it is whole."""
        if len(client.received) < _HEADER_BYTES:
            return False
        head = bytes(client.received[:_HEADER_BYTES])
        command, number, device, direction, endpoint = _HEADER.unpack_from(head)
        if command == _UNLINK:
            del client.received[:_HEADER_BYTES]
            self._unlink(client, number, int.from_bytes(head[20:24], "big"))
            return True
        flags, length, _, packets, _, setup = _SUBMIT_TAIL.unpack_from(head, _HEADER.size)
        if command != _SUBMIT or direction > 1 or not 0 <= length <= TRANSFER_MAX or number in client.urbs:
            raise _RefusedError(
                f"USB/IP command {command} of {length} bytes, number {number}, expected a URB of a new "
                f"number and {TRANSFER_MAX} bytes at most, or an unlink"
            )
        size = _HEADER_BYTES + (0 if direction else length)
        if len(client.received) < size:
            return False
        data = bytes(client.received[_HEADER_BYTES:size])
        del client.received[:size]
        port = client.port
        assert port is not None
        if device != port.number << 16 | _DEVICE_NUMBER:
            self._return(client, number, _ENODEV)
        elif packets not in _NO_PACKETS:
            self._return(client, number, _EINVAL)
        elif endpoint == 0:
            self._control(client, port, number, setup, data, length)
        else:
            self._transfer(client, port, number, endpoint | IN * direction, data, length, flags)
        return True

    def _unlink(self, client: _Client, number: int, wanted: int) -> None:
        transfer = client.urbs.pop(wanted, None)
        if transfer is not None and client.port is not None:
            client.wanted -= transfer.length
            client.port.host.cancel(transfer)
        head = _HEADER.pack(_UNLINKED, number, 0, 0, 0)
        status = 0 if transfer is None else _ECONNRESET
        client.unsent += (head + status.to_bytes(4, "big", signed=True)).ljust(_HEADER_BYTES, b"\0")

    def _control(
        self, client: _Client, port: _Port, number: int, setup: bytes, data: bytes, length: int
    ) -> None:
        wanted = int.from_bytes(setup[6:8], "little")
        if setup[:4] == _PORT_RESET:
            client.resets.append(number)
            self._reset(port)
        elif setup[:2] == _SET_ADDRESS:
            self._return(client, number, 0)  # the device has the address that this server gave it
        elif port.description is None:
            self._return(client, number, _ESHUTDOWN)
        elif length < wanted or (not setup[0] & IN and len(data) < wanted):
            self._return(client, number, _EINVAL)
        else:
            transfer = Transfer(
                port.description.address,
                0,
                Kind.CONTROL,
                bool(setup[0] & IN),
                data[:wanted],
                wanted,
                setup,
                port.description.packet_size,
            )
            self._begin(client, port, number, transfer)

    def _transfer(
        self, client: _Client, port: _Port, number: int, endpoint: int, data: bytes, length: int, flags: int
    ) -> None:
        description = port.description
        found = None if description is None else description.endpoints.get(endpoint)
        if description is None or found is None:
            self._return(client, number, _ESHUTDOWN if description is None else _ENOENT)
        elif found.kind not in (Kind.BULK.value, Kind.INTERRUPT.value):
            self._return(client, number, _EINVAL)
        else:
            inward = bool(endpoint & IN)
            transfer = Transfer(
                description.address,
                endpoint & 15,
                Kind(found.kind),
                inward,
                data,
                length if inward else 0,
                packet_size=found.packet_size,
                interval=found.interval,
                zero=bool(flags & _ZERO_PACKET),
            )
            self._begin(client, port, number, transfer, short_ok=not flags & _SHORT_NOT_OK)

    def _begin(
        self, client: _Client, port: _Port, number: int, transfer: Transfer, *, short_ok: bool = True
    ) -> None:
        client.urbs[number] = transfer
        client.wanted += transfer.length
        transfer.on_end = partial(self._end, client, number, short_ok)
        port.host.submit(transfer)

    def _end(self, client: _Client, number: int, short_ok: bool, transfer: Transfer) -> None:
        """Answer a URB whose transfer has ended, unless it was unlinked or its client has gone."""
        if client.urbs.pop(number, None) is None:
            return
        client.wanted -= transfer.length
        status = _ERRORS[transfer.status]
        if not status and transfer.inward and not short_ok and len(transfer.received) < transfer.length:
            status = _EREMOTEIO
        self._return(client, number, status, transfer)
        self._flush(client)

    def _return(self, client: _Client, number: int, status: int, transfer: Transfer | None = None) -> None:
        data = transfer.received if transfer is not None and transfer.inward else b""
        length = 0 if transfer is None else len(data) if transfer.inward else transfer.sent
        head = _HEADER.pack(_SUBMITTED, number, 0, 0, 0)
        client.unsent += head + _RETURN_TAIL.pack(status, length, 0, 0, 0) + data
