"""Standard requests (USB 2.0, chapter 9) to the serial port: as asked for, and as nobody should ask."""

from __future__ import annotations

import struct

import pytest

from tests.firmware.usb.conftest import TEXTS, SerialDevice
from tests.firmware.usb.scripted_bus import (
    CLASS,
    CLEAR_FEATURE,
    DEVICE,
    ENDPOINT,
    GET_CONFIGURATION,
    GET_DESCRIPTOR,
    GET_INTERFACE,
    GET_STATUS,
    IN,
    INTERFACE,
    SET_ADDRESS,
    SET_CONFIGURATION,
    SET_FEATURE,
    SET_INTERFACE,
    Answer,
    ScriptedBus,
)

DEVICE_DESCRIPTOR, CONFIGURATION, STRING, QUALIFIER, BOS = 0x100, 0x200, 0x300, 0x600, 0xF00
ENGLISH = 0x0409
DATA_OUT, DATA_IN, NOTICE = 0x01, 0x81, 0x82


@pytest.fixture
def bus(serial: SerialDevice) -> ScriptedBus:
    """A host that has reset the bus."""
    serial.bus.reset()
    return serial.bus


def describe(bus: ScriptedBus, value: int, length: int = 255, index: int = 0) -> bytes | Answer:
    return bus.ask(IN, GET_DESCRIPTOR, value, index, length)


def parts(configuration: bytes) -> list[bytes]:
    """The descriptors that a configuration is made of."""
    found = []
    while configuration:
        found.append(configuration[: configuration[0]])
        configuration = configuration[configuration[0] :]
    return found


def test_descriptors_are_what_hosts_drivers_look_for_when_asked(bus: ScriptedBus) -> None:
    device = describe(bus, DEVICE_DESCRIPTOR)
    assert isinstance(device, bytes) and len(device) == device[0] == 18
    usb, device_class, packet, vendor, product, _ = struct.unpack("<H3sBHHH", device[2:14])
    assert (usb, packet, vendor, product) == (0x200, 64, 0x0483, 0x5740)
    assert device_class == bytes((0xEF, 2, 1))  # an association follows: Windows' composite driver
    assert device[14:] == bytes((1, 2, 3, 1))
    whole = describe(bus, CONFIGURATION)
    assert isinstance(whole, bytes) and struct.unpack_from("<H", whole, 2)[0] == len(whole) == 75
    found = parts(whole)
    assert [part[1] for part in found] == [2, 11, 4, 0x24, 0x24, 0x24, 0x24, 5, 4, 5, 5]
    association, control, data = found[1], found[2], found[8]
    assert association == bytes((8, 11, 0, 2, 2, 2, 1, 0))
    assert (control[2:9], data[2:9]) == (bytes((0, 0, 1, 2, 2, 1, 0)), bytes((1, 0, 2, 10, 0, 0, 0)))
    ends = {part[2]: (part[3], struct.unpack("<H", part[4:6])[0]) for part in found if part[1] == 5}
    assert ends == {NOTICE: (3, 16), DATA_OUT: (2, 64), DATA_IN: (2, 64)}
    assert found[6] == bytes((5, 0x24, 6, 0, 1))  # the union: control, data


@pytest.mark.parametrize(("number", "text"), list(enumerate(TEXTS, 1)))
def test_texts_are_the_boards_when_asked(bus: ScriptedBus, number: int, text: str) -> None:
    told = describe(bus, STRING | number, index=ENGLISH)
    assert isinstance(told, bytes) and told[:2] == bytes((len(told), 3))
    assert told[2:].decode("utf-16-le") == text


def test_a_long_text_is_cut_when_it_does_not_fit(serial: SerialDevice) -> None:
    long = serial.bus.core.ffi.new("char[]", b"x" * 200)
    serial.kept[-1].product = long
    told = describe(serial.bus, STRING | 2)
    assert isinstance(told, bytes) and len(told) == told[0] == 126


@pytest.mark.parametrize("value", [STRING | 4, STRING | 0xEE, 0x101, 0x201, QUALIFIER, BOS, 0x2100, 0])
def test_what_it_has_not_is_refused_when_asked(bus: ScriptedBus, value: int) -> None:
    assert describe(bus, value) is Answer.STALL
    assert isinstance(describe(bus, DEVICE_DESCRIPTOR), bytes), "and the next request is heard"


@pytest.mark.parametrize("length", [1, 8, 18, 63, 64, 65, 74, 75, 76, 128, 255, 0xFFFF])
def test_a_descriptor_is_as_long_as_asked_for_when_cut_anywhere(bus: ScriptedBus, length: int) -> None:
    whole = describe(bus, CONFIGURATION)
    assert isinstance(whole, bytes)
    assert describe(bus, CONFIGURATION, length) == whole[:length]


def test_an_empty_packet_ends_data_that_end_with_a_full_one_when_more_were_asked_for(
    serial: SerialDevice,
) -> None:
    """2 + 2 * 31 bytes are a packet: a host that asked for 255 waits for the end (USB 2.0, 8.5.3.2)."""
    serial.kept[-1].product = text = serial.bus.core.ffi.new("char[]", b"a" * 31)
    serial.kept.append(text)
    bus = serial.bus
    for length, packets in ((255, [64, 0]), (64, [64])):
        bus.setup(IN, GET_DESCRIPTOR, STRING | 2, ENGLISH, length)
        taken = []
        while isinstance(packet := bus.take(0), bytes):
            taken.append(len(packet))
        assert taken == packets
        assert bus.give(0) is None


def test_the_address_counts_from_the_status_on_when_set(bus: ScriptedBus) -> None:
    bus.setup(0, SET_ADDRESS, 77)
    assert bus.address == 0
    assert bus.take(0) == b"" and bus.address == 77


def test_nothing_but_endpoint_0_is_there_until_configured(bus: ScriptedBus) -> None:
    assert bus.ask(0, SET_CONFIGURATION, 1) is Answer.STALL, "not before it has an address"
    assert bus.ask(0, SET_ADDRESS, 3) == b""
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\0" and not bus.opened
    for request in ((IN | INTERFACE, GET_INTERFACE), (IN | INTERFACE, GET_STATUS)):
        assert bus.ask(*request, 0, 0, 2) is Answer.STALL
    assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, DATA_IN, 2) is Answer.STALL
    assert bus.ask(IN | CLASS | INTERFACE, 0x21, 0, 0, 7) is Answer.STALL
    assert bus.ask(0, SET_CONFIGURATION, 1) == b""
    assert bus.opened == {DATA_OUT: (2, 64), DATA_IN: (2, 64), NOTICE: (3, 16)}
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\1"
    assert bus.ask(0, SET_ADDRESS, 4) is Answer.STALL, "nor another one from then on"
    assert bus.ask(0, SET_CONFIGURATION, 2) is Answer.STALL and len(bus.opened) == 3
    assert bus.ask(0, SET_CONFIGURATION, 0) == b"" and not bus.opened


def test_status_tells_supply_and_halts_when_asked(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.enumerate()
    assert bus.ask(IN, GET_STATUS, length=2) == b"\1\0"  # a supply of its own, as the configuration says
    assert bus.ask(IN | INTERFACE, GET_STATUS, 0, 1, 2) == b"\0\0"
    for endpoint in (DATA_OUT, DATA_IN, NOTICE):
        assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, endpoint, 2) == b"\0\0"
        assert bus.ask(ENDPOINT, SET_FEATURE, 0, endpoint) == b"" and endpoint in bus.stalled
        assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, endpoint, 2) == b"\1\0"
        bus.toggled.clear()
        assert bus.ask(ENDPOINT, CLEAR_FEATURE, 0, endpoint) == b"" and endpoint not in bus.stalled
        assert bus.toggled == [endpoint], "it begins with DATA0"
        assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, endpoint, 2) == b"\0\0"
    assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, IN, 2) == b"\0\0"
    assert bus.ask(ENDPOINT, CLEAR_FEATURE, 0, 0) == b""


def test_a_halt_ends_with_its_configuration(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.enumerate()
    assert bus.ask(ENDPOINT, SET_FEATURE, 0, DATA_IN) == b""
    assert bus.ask(0, SET_CONFIGURATION, 1) == b""
    assert bus.ask(IN | ENDPOINT, GET_STATUS, 0, DATA_IN, 2) == b"\0\0"


def test_only_the_one_setting_of_an_interface_is_taken(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.enumerate()
    assert bus.ask(IN | INTERFACE, GET_INTERFACE, 0, 1, 1) == b"\0"
    bus.toggled.clear()
    assert bus.ask(INTERFACE, SET_INTERFACE, 0, 1) == b""
    assert sorted(bus.toggled) == [DATA_OUT, DATA_IN]
    assert bus.ask(INTERFACE, SET_INTERFACE, 1, 1) is Answer.STALL
    assert bus.ask(INTERFACE, SET_INTERFACE, 0, 2) is Answer.STALL


WRONG = [
    (0, SET_ADDRESS, 128, 0, 0),
    (0, SET_ADDRESS, 1, 1, 0),
    (0, SET_ADDRESS, 1, 0, 1),
    (0, SET_CONFIGURATION, 1, 1, 0),
    (0, SET_CONFIGURATION, 1, 0, 3),
    (0, SET_CONFIGURATION, 0x101, 0, 0),
    (0, SET_FEATURE, 1, 0, 0),  # remote wake-up, which it has not
    (0, CLEAR_FEATURE, 1, 0, 0),
    (0, SET_FEATURE, 2, 0, 0),  # test mode: high speed's
    (0, 7, 0x100, 0, 18),  # SET_DESCRIPTOR
    (0, GET_DESCRIPTOR, 0x100, 0, 0),
    (IN, SET_ADDRESS, 0, 0, 0),
    (IN, GET_STATUS, 1, 0, 2),
    (IN, GET_STATUS, 0, 1, 2),
    (IN, GET_CONFIGURATION, 0, 1, 1),
    (IN | INTERFACE, GET_STATUS, 0, 2, 2),
    (IN | INTERFACE, GET_INTERFACE, 1, 0, 1),
    (INTERFACE, SET_INTERFACE, 0, 0, 1),
    (INTERFACE, SET_FEATURE, 0, 0, 0),
    (IN | ENDPOINT, GET_STATUS, 0, 0x03, 2),
    (IN | ENDPOINT, GET_STATUS, 0, 0x0181, 2),
    (ENDPOINT, SET_FEATURE, 0, 0, 0),
    (ENDPOINT, SET_FEATURE, 1, DATA_IN, 0),
    (ENDPOINT, SET_FEATURE, 0, DATA_IN, 1),
    (ENDPOINT, CLEAR_FEATURE, 0, 0x83, 0),
    (IN | ENDPOINT, 12, 0, DATA_IN, 2),  # SYNCH_FRAME
    (3, GET_STATUS, 0, 0, 0),
    (IN | 3, GET_STATUS, 0, 0, 2),
    (IN | 0x40, 1, 0, 0, 8),  # a vendor's
    (0x40, 1, 0, 0, 0),
    (IN | 0x60, 0, 0, 0, 2),
    (IN | CLASS | DEVICE, 0x21, 0, 0, 7),
    (IN | CLASS | INTERFACE, 0x21, 0, 1, 7),
    (CLASS | INTERFACE, 0x23, 0xFFFF, 0, 0),  # SEND_BREAK, which bmCapabilities does not promise
    (CLASS | INTERFACE, 0x22, 1, 0, 1),
    (CLASS | INTERFACE, 0x22, 1, 9, 0),
]


@pytest.mark.parametrize("request_", WRONG, ids=str)
def test_it_is_refused_and_nothing_changes_when_asked_wrongly(
    serial: SerialDevice, request_: tuple[int, int, int, int, int]
) -> None:
    bus = serial.bus
    bus.enumerate()
    kind, *_, length = request_
    if kind & IN or length == 0:
        assert bus.ask(*request_) is Answer.STALL
    else:
        assert bus.tell(*request_[:4], bytes(length)) is Answer.STALL
    assert (bus.address, len(bus.opened), bus.stalled) == (5, 3, {0})
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\1", "the next one is heard"


def test_it_goes_on_when_every_request_of_two_bytes_is_tried(serial: SerialDevice) -> None:
    """All types and requests, with and without data: none breaks a rule, and the device stays."""
    bus = serial.bus
    for kind in range(256):
        for request in range(0, 40):
            for length in (0, 2):
                bus.enumerate()
                if kind & IN or length == 0:
                    bus.ask(kind, request, 0, 0, length)
                else:
                    bus.tell(kind, request, 0, 0, bytes(length))
    bus.enumerate()
    assert isinstance(describe(bus, CONFIGURATION), bytes)


def test_the_host_may_end_data_early_by_its_status(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.reset()
    bus.setup(IN, GET_DESCRIPTOR, CONFIGURATION, 0, 75)
    assert isinstance(bus.take(0), bytes)
    assert bus.give(0) is None
    assert bus.take(0) is Answer.NAK, "nothing of it is left"
    assert isinstance(describe(bus, DEVICE_DESCRIPTOR), bytes)


def test_a_request_replaces_the_one_under_way_wherever_that_stands(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.enumerate()
    for taken in range(3):
        bus.setup(IN, GET_DESCRIPTOR, CONFIGURATION, 0, 75)
        for _ in range(taken):
            bus.take(0)
        assert describe(bus, DEVICE_DESCRIPTOR, 18) == describe(bus, DEVICE_DESCRIPTOR, 255)
    bus.setup(CLASS | INTERFACE, 0x20, 0, 0, 7)  # its data do not come
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\1"
    bus.setup(0, SET_CONFIGURATION, 1)  # nor is its status taken
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\1"


@pytest.mark.parametrize("taken", range(3))
def test_a_reset_ends_a_request_and_address_and_configuration(serial: SerialDevice, taken: int) -> None:
    bus = serial.bus
    bus.enumerate()
    bus.setup(IN, GET_DESCRIPTOR, CONFIGURATION, 0, 75)
    for _ in range(taken):
        bus.take(0)
    bus.reset()
    assert bus.take(0) is Answer.NAK and bus.give(0) is Answer.NAK
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\0"


def test_data_that_differ_from_what_was_said_are_refused(serial: SerialDevice) -> None:
    bus = serial.bus
    bus.enumerate()
    for said, came in ((7, 6), (7, 8), (8, 0), (129, 64), (0xFFFF, 64)):
        bus.setup(CLASS | INTERFACE, 0x20, 0, 0, said)
        if bus.give(0, bytes(came)) is None:
            assert bus.take(0) is Answer.STALL
        assert 0 in bus.stalled
    assert bus.tell(CLASS | INTERFACE, 0x20, 0, 0, bytes(100)) is Answer.STALL, "100 bytes are no coding"
    assert bus.ask(IN, GET_CONFIGURATION, length=1) == b"\1"
