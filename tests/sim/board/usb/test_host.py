"""The host's frames and transfers, against a device of a few lines, on the engine's time."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest

from neuroflight.sim.board.usb.cable import Connector, Handshake
from neuroflight.sim.board.usb.enumeration import complete, enumerate_device, request, transfer_to
from neuroflight.sim.board.usb.host import FRAME, Host, Line, Status, Transfer
from neuroflight.toolchain.errors import LinkError

if TYPE_CHECKING:
    from tests.sim.board.usb.conftest import Echo

GET_STATUS = request(0x80, 0, length=2)


class Bus:
    """A host with a device in its cable."""

    def __init__(self, bench: Any, echo: Echo) -> None:
        self.context, self.echo = bench.context, echo
        self.host = Host(bench.context.engine, echo, "test")

    def frames(self, count: float) -> None:
        self.context.run_to(self.context.cycle + round(count * FRAME))

    def connect(self) -> None:
        self.host.plug()
        self.frames(125)
        self.description = complete(self.host, enumerate_device(self.host), self.context.run_to)

    def wait(self, transfer: Transfer, frames: int = 100) -> Transfer:
        for _ in range(10 * frames):
            if transfer.done:
                return transfer
            self.frames(0.1)
        raise AssertionError(transfer)


@pytest.fixture
def bus(bench: Any, echo: Echo) -> Bus:
    return Bus(bench, echo)


@pytest.fixture
def connected(bus: Bus) -> Bus:
    bus.connect()
    return bus


def test_nothing_runs_when_no_cable_is_plugged(bus: Bus) -> None:
    bus.frames(50)
    assert bus.host.frames == bus.host.packets == 0
    assert bus.host._alarm.due is None
    assert bus.host.control(GET_STATUS, address=1).status is Status.GONE


def test_a_device_that_comes_is_reset_when_it_has_settled(bus: Bus) -> None:
    changes: list[bool] = []
    bus.host.on_change = lambda: changes.append(bus.host.connected)
    bus.host.plug()
    bus.frames(99)
    assert bus.echo.heard == [] and not bus.echo.frames
    bus.frames(4)
    assert bus.echo.heard == ["reset"]
    bus.frames(7)
    assert not bus.echo.frames  # SE0 for 10 ms
    bus.frames(14)
    assert changes == [True]
    count = len(bus.echo.frames)
    bus.frames(20)
    assert len(bus.echo.frames) == count + 20
    assert bus.echo.frames[-20:] == list(range(bus.echo.frames[-1] - 19, bus.echo.frames[-1] + 1))
    bus.host.unplug()
    assert changes == [True, False] and not bus.echo.attached
    bus.frames(20)
    assert len(bus.echo.frames) == count + 20


def test_enumeration_learns_what_the_descriptors_tell(connected: Bus) -> None:
    found = connected.description
    assert (found.vendor, found.product, found.release, found.packet_size) == (0x1209, 1, 0x100, 64)
    assert found.interfaces == ((255, 0, 0),)
    assert sorted(found.endpoints) == [1, 0x81, 0x82]
    assert (found.endpoints[0x82].kind, found.endpoints[0x82].packet_size) == (3, 2)
    assert connected.echo.address == 1


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (lambda setup: None, r"request 8006000100000800 refused: STALL"),
        (lambda setup: b"\x12\x01\0\2\0\0\0\7", r"packets of 7 bytes at endpoint 0"),
        (lambda setup: b"\x12\x01", r"2 bytes to request 8006000100000800, expected 8"),
    ],
)
def test_enumeration_says_what_is_wrong_when_a_device_answers_badly(bus: Bus, answer: Any, says: str) -> None:
    bus.echo.answer = answer
    with pytest.raises(LinkError, match=says):
        bus.connect()


def test_bytes_come_back_when_both_directions_are_asked(connected: Bus) -> None:
    data = bytes(i * 7 & 255 for i in range(1000))
    for size in (1, 63, 64, 65, 1000):
        out = transfer_to(connected.host, connected.description, 1, data[:size])
        back = transfer_to(connected.host, connected.description, 0x81, length=size)
        connected.wait(back)
        assert (out.status, out.sent) == (Status.DONE, size)
        assert (back.status, back.received) == (Status.DONE, data[:size])


def test_a_short_packet_ends_a_transfer_and_a_long_one_is_babble(connected: Bus) -> None:
    host, found = connected.host, connected.description
    connected.echo.echo = bytes(80)
    assert connected.wait(transfer_to(host, found, 0x81, length=500)).received == bytes(80)
    connected.echo.echo = bytes(64)
    assert connected.wait(transfer_to(host, found, 0x81, length=10)).status is Status.BABBLE


def test_a_frame_holds_19_packets_of_64_bytes_as_on_the_bus(connected: Bus) -> None:
    transfer = transfer_to(connected.host, connected.description, 1, bytes(64 * 200))
    connected.frames(0.01)
    sent = []
    for _ in range(4):
        connected.frames(1)
        sent.append(transfer.sent)
    steps = {after - before for before, after in pairwise(sent)}
    assert steps == {19 * 64}  # USB 2.0, table 5-9


def test_naks_are_asked_again_when_the_device_is_not_ready(connected: Bus) -> None:
    connected.echo.naks = 5
    transfer = connected.wait(transfer_to(connected.host, connected.description, 1, b"late"))
    assert (transfer.naks, transfer.sent, connected.echo.echo) == (5, 4, b"late")
    waiting = transfer_to(connected.host, connected.description, 0x81, length=64)
    connected.echo.echo = b""
    connected.frames(100)
    assert 100 * 2 <= waiting.naks <= 100 * 4  # every eighth packet's time
    connected.host.cancel(waiting)
    assert waiting.status is Status.CANCELLED


def test_a_waiting_endpoint_leaves_the_bus_to_others(connected: Bus) -> None:
    connected.echo.echo = b""
    waiting = transfer_to(connected.host, connected.description, 0x82, length=2)
    assert connected.wait(waiting).received != b""
    control = connected.host.control(request(0x80, 6, 0x100, 0, 18), address=1)
    connected.wait(control, 2)
    assert control.status is Status.DONE and len(control.received) == 18


def test_interrupt_endpoints_are_asked_once_an_interval(connected: Bus) -> None:
    told = []
    for _ in range(4):
        transfer = connected.wait(transfer_to(connected.host, connected.description, 0x82, length=2))
        told.append(int.from_bytes(transfer.received, "little"))
    assert [after - before for before, after in pairwise(told)] == [4, 4, 4]


def test_stalls_and_their_end_reset_the_toggle(connected: Bus) -> None:
    host, found = connected.host, connected.description
    connected.wait(transfer_to(host, found, 1, b"odd"))  # DATA1 is next
    connected.echo.halted = True
    assert connected.wait(transfer_to(host, found, 1, b"x")).status is Status.STALLED
    assert connected.wait(host.control(request(2, 1, 0, 1), address=1)).status is Status.DONE
    connected.wait(transfer_to(host, found, 1, b"y"))
    assert connected.echo.echo == b"oddy"
    assert connected.wait(host.control(GET_STATUS, address=1)).status is Status.STALLED


def test_a_configuration_resets_the_toggles_of_all_endpoints(connected: Bus) -> None:
    host, found = connected.host, connected.description
    connected.wait(transfer_to(host, found, 1, b"odd"))
    connected.wait(transfer_to(host, found, 0x81, length=3))
    connected.wait(host.control(request(0, 9, 1), address=1))
    connected.wait(transfer_to(host, found, 1, b"even"))
    assert connected.wait(transfer_to(host, found, 0x81, length=4)).received == b"even"


def test_a_dead_device_is_told_when_it_does_not_answer(connected: Bus) -> None:
    connected.echo.silent = True
    assert (
        connected.wait(transfer_to(connected.host, connected.description, 1, b"x"), 2).status is Status.SILENT
    )
    assert connected.wait(connected.host.control(GET_STATUS, address=1), 2).status is Status.SILENT


def test_transfers_end_when_the_device_goes(connected: Bus) -> None:
    waiting = transfer_to(connected.host, connected.description, 0x81, length=64)
    connected.echo.attached = False
    connected.frames(2)
    assert waiting.status is Status.GONE and connected.host.line is Line.POWERED
    assert transfer_to(connected.host, connected.description, 0x81, length=64).status is Status.GONE
    connected.echo.attached = True
    connected.frames(130)
    assert connected.host.connected and connected.echo.heard == ["reset", "reset"]


def test_no_frames_pass_when_the_bus_is_suspended(connected: Bus) -> None:
    count = len(connected.echo.frames)
    connected.host.suspend()
    connected.frames(10)
    assert len(connected.echo.frames) == count and connected.echo.heard[-1] == "suspend"
    later = transfer_to(connected.host, connected.description, 1, b"late")
    connected.host.resume()
    connected.frames(15)
    assert not later.done and connected.echo.heard[-1] == "resume"
    connected.frames(10)
    assert later.status is Status.DONE
    connected.host.suspend()
    connected.frames(5)
    connected.echo.wakes = True
    connected.frames(25)
    assert connected.host.line is Line.RUNNING


def test_a_reset_cancels_what_is_under_way(connected: Bus) -> None:
    waiting = transfer_to(connected.host, connected.description, 0x81, length=64)
    connected.host.reset()
    assert waiting.status is Status.CANCELLED
    connected.frames(25)
    assert connected.host.connected and connected.echo.address == 0
    complete(connected.host, enumerate_device(connected.host), connected.context.run_to)


def test_a_transfer_goes_on_when_the_state_is_restored(connected: Bus) -> None:
    connected.echo.naks = 30
    transfer_to(connected.host, connected.description, 1, b"again")
    connected.frames(0.5)
    state = connected.host.state()
    naks = connected.host.pending[0].naks
    connected.frames(20)
    assert not connected.host.pending
    connected.echo.echo, connected.echo.naks = b"", 30 - naks
    connected.echo.toggles[1, False] ^= 1
    connected.host.restore(state)
    connected.host._alarm.set(connected.context.cycle + 1)  # a snapshot of the engine keeps it
    (transfer,) = connected.host.pending
    connected.wait(transfer)
    assert (transfer.naks, connected.echo.echo) == (30, b"again")


def test_the_connector_shows_nobody_for_a_look_when_another_device_takes_over(echo: Echo) -> None:
    other = type(echo)()
    connector = Connector(echo, other)
    connector.vbus(True)
    other.attached = False
    assert [connector.attached for _ in range(3)] == [False, True, True]
    echo.attached, other.attached = False, True
    assert connector.setup(0, 0, GET_STATUS) is Handshake.SILENT
    assert [connector.attached for _ in range(3)] == [False, True, True]
    assert connector.setup(0, 0, GET_STATUS) is Handshake.ACK
    connector.bus_reset()
    assert other.heard == ["reset"]
