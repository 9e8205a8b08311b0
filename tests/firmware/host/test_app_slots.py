"""Modes, ports, motor outputs and names as the Betaflight app saves them."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from neuroflight.flash.link import layouts
from neuroflight.flash.link.client import NoAnswerError
from neuroflight.toolchain.contract import Direction, ModeRange, Msp, layout_of
from neuroflight.toolchain.contract.modes import Mode
from tests.firmware.host.app import GETS, App, connected
from tests.sampling import sampled

Start = Callable[..., Any]


@pytest.fixture
def app(start: Start) -> Iterator[App]:
    with connected(start("--gyro-hz=1000")) as app:
        yield app


def mode_payload(slot: int, packed: int) -> bytes:
    unpacked = ModeRange.unpack(packed)
    if unpacked is None:
        return bytes([slot, 0, 0, 0, 0, 0, 0])
    steps = ((us - 900) // 25 for us in (unpacked.low_us, unpacked.high_us))
    return bytes([slot, unpacked.mode, unpacked.aux - 1, *steps, unpacked.and_others, 0])


def test_modes_are_saved_slot_by_slot_when_all_twenty_are_sent(app: App) -> None:
    before = app.settings()
    new = ModeRange(Mode.BEEPER, 5, 1300, 1500, and_others=True).packed
    assert app.refused(35, bytes(7)), "who has not read may not clear a slot"
    assert app.refused(250)
    app.get(34)
    for slot in range(20):
        app.ask(35, mode_payload(slot, new if slot == 7 else int(before[f"mode{slot + 1}"])))
    app.ask(250)
    assert app.settings() == before | {"mode8": new}
    assert app.get(238)["ranges"][7] == {"mode": 13, "logic": 1, "linked": 0}
    for bad in ([20, 0, 0, 0, 0, 0, 0], [0, 0, 0, 32]):  # no such slot, half a range
        assert app.refused(35, bytes(bad)), bad
    assert app.settings() == before | {"mode8": new}


@pytest.mark.parametrize(
    "range_",
    [
        pytest.param((0, 255, 16, 32, 0, 0), id="left at AUTO"),
        pytest.param((1, 0, 32, 48, 0, 0), id="no mode"),
        pytest.param((0, 12, 32, 48, 0, 0), id="no channel"),
        pytest.param((0, 0, 32, 49, 0, 0), id="beyond the end"),
        pytest.param((0, 0, 32, 48, 2, 0), id="no logic"),
        pytest.param((0, 0, 32, 48, 0, 1), id="linked"),
    ],
)
def test_a_refused_range_leaves_none_behind_that_the_pilot_took_away(
    app: App, range_: tuple[int, ...]
) -> None:
    before = app.settings()
    app.get(34)
    app.ask(35, mode_payload(8, ModeRange(Mode.ARM, 3, 1700, 2100).packed))
    assert app.settings() != before
    # The pilot deletes that one, and puts another into its place.
    assert app.refused(35, bytes([8, *range_]))
    app.ask(35, mode_payload(9, ModeRange(Mode.BEEPER, 3, 1700, 2100).packed))
    expected = before | {"mode9": 0, "mode10": ModeRange(Mode.BEEPER, 3, 1700, 2100).packed}
    assert app.settings() == expected
    assert app.refused(250), "not all is stored"
    assert app.settings() == expected


def test_ports_outputs_and_names_change_one_thing_when_saved(app: App) -> None:
    expected = app.settings()
    ports = layout_of(Msp.COMMON_SET_SERIAL_CONFIG, Direction.REQUEST)
    told = app.get(4105)
    assert [(row["port"], row["functions"]) for row in told["ports"]] == [(0, 1), (1, 64), (2, 0), (20, 1)]
    app.ask(4106, layouts.encode(ports, told))
    assert app.settings() == expected
    told["ports"][2] |= {"functions": 1, "msp_baud": 6}
    app.ask(4106, layouts.encode(ports, told))
    expected |= {"uart3_function": 1, "uart3_baud": 230400}
    assert app.settings() == expected
    told["ports"][2] |= {"functions": 1 << 7, "blackbox_baud": 12}
    app.ask(4106, layouts.encode(ports, told))
    expected |= {"uart3_function": 2, "blackbox_baud": 1_000_000}
    assert app.settings() == expected
    assert app.get(4105) == told
    for port, bad in (
        *((2, {"functions": functions}) for functions in (1 | 1 << 7, 1 << 6, 1 << 8, 1 << 31)),
        *((2, {"blackbox_baud": index}) for index in (0, 1, 4, 7, 10, 15, 255)),
        *((0, {"msp_baud": index}) for index in (0, 7, 12, 14)),
        *((port, {"functions": 1 << 7}) for port in (0, 1)),
    ):
        ports_now = app.get(4105)
        ports_now["ports"][port] |= bad
        assert app.refused(4106, layouts.encode(ports, ports_now)), (port, bad)
    assert app.settings() == expected
    told["ports"][0]["functions"] = 0
    assert app.refused(4106, layouts.encode(ports, told)), "the line that is spoken over"
    assert app.refused(4106, b"\0")
    app.ask(12290, bytes([4, 1, 0, 2, 3]))
    expected |= {"motor1_output": 2, "motor2_output": 1}
    app.ask(12295, b"\2\5Kitty")
    app.ask(12295, b"\3\7standby")
    app.ask(12295, b"\4\0")
    expected |= {"craft_name": "Kitty"}
    assert app.settings() == expected
    assert app.refused(12290, bytes([4, 0, 0, 2, 3]))
    assert app.refused(12290, bytes([4, 0, 1, 2, 200])), "half an order is another order"
    assert app.refused(12295, b"\3\4mine")
    assert app.refused(12295, bytes(2))
    for channel in range(16):
        row = app.get(77)["channels"][channel]
        app.ask(78, struct.pack("<BBH", channel, row["mode"], row["value"]))
    assert app.refused(78, bytes(4)[:3] + b"\1")
    assert app.settings() == expected


def port_rows(*rows: tuple[int, int, int, int, int, int], rest: bytes = b"") -> bytes:
    """Pack COMMON_SET_SERIAL_CONFIG: port, functions, baud indices of MSP, GPS, telemetry, log."""
    return bytes([len(rows)]) + b"".join(struct.pack("<BIBBBB", *row) + rest for row in rows)


# As the tab Ports sends what it was told: GPS at 57600 for AUTO, the blackbox at 115200.
UART1, UART2, UART3 = (0, 1, 5, 4, 0, 5), (1, 1 << 6, 0, 4, 0, 5), (2, 0, 5, 4, 0, 5)


@pytest.mark.parametrize("more", [b"", b"\0", b"\1\2\3"], ids=["", "a byte more each", "three"])
def test_msp_on_uart3_is_saved_when_the_app_tells_bauds_of_functions_that_no_line_has(
    start: Start, tmp_path: Any, more: bytes
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        expected = app.settings()
        app.get(4105)
        app.ask(4106, port_rows(UART1, UART2, UART3, rest=more))
        assert app.settings() == expected
        app.ask(4106, port_rows(UART1, UART2, (2, 1, 6, 4, 0, 5), rest=more))
        app.ask(37, app.payload(37))
        app.ask(250)
        expected |= {"uart3_function": 1, "uart3_baud": 230400}
        assert app.settings() == expected
    program.end()
    with connected(start(option)) as app:
        assert app.settings() == expected
        told = app.get(4105)["ports"][2]
        assert (told["functions"], told["msp_baud"], told["gps_baud"]) == (1, 6, 0)


def test_a_port_is_set_beside_those_that_are_refused(app: App) -> None:
    expected = app.settings()
    app.get(4105)
    usb = (20, 1, 9, 4, 0, 5)  # at whatever rate
    app.ask(4106, port_rows(usb))
    for other in ((20, 0, 5, 4, 0, 5), (20, 1 << 7, 5, 4, 0, 5), (3, 1, 5, 4, 0, 5), (19, 1, 5, 4, 0, 5)):
        assert app.refused(4106, port_rows(other)), other
    assert app.settings() == expected
    assert app.refused(4106, port_rows(usb, (0, 1 | 1 << 1, 6, 4, 0, 5), UART2, (2, 1, 6, 4, 0, 5)))
    expected |= {"uart3_function": 1, "uart3_baud": 230400}
    assert app.settings() == expected
    app.ask(4106, port_rows((2, 1 << 7, 7, 4, 0, 12)))  # the others are not told
    expected |= {"uart3_function": 2, "blackbox_baud": 1_000_000}
    app.ask(37, struct.pack("<I", app.get(36)["features"] | 1 << 19))  # as the app does with that port
    assert app.settings() == expected
    for functions in (1 << 1, 1 << 5, 1 | 1 << 17, 1 << 10, 1 << 31, 0xFFFFFFFF):
        assert app.refused(4106, port_rows((0, 1, 11, 4, 0, 5), (2, functions, 9, 4, 0, 9))), functions
        assert app.settings() == expected | {"msp_baud": 921600}
        app.ask(4106, port_rows(UART1))
    for short in (b"", b"\0", b"\3", port_rows(UART1, UART2)[:-1], b"\x40" + port_rows(UART3)[1:]):
        assert app.refused(4106, short), short
    assert app.settings() == expected


def test_the_receivers_of_the_features_are_kept_when_others_come_with_them(app: App) -> None:
    expected = app.settings()
    told = app.get(36)["features"]
    for bit in (7, 10, 16, 18, 27):  # GPS, telemetry, LED strip, OSD, ESC sensor
        assert app.refused(37, struct.pack("<I", told | 1 << bit | 1 << 4)), bit
        assert app.settings() == expected | {"motor_stop": 1}
        app.ask(37, struct.pack("<I", told))
    assert app.refused(37, struct.pack("<I", told ^ 1 << 3)), "no receiver"
    assert app.refused(37, struct.pack("<I", told | 1 << 14)), "two of them"
    assert app.settings() == expected


# What each SET of a list is of the reply of its counterpart; those of fields are held in test_app_tabs.py.
def parts(app: App) -> list[tuple[int, list[bytes]]]:
    """Each SET of a list, and the payloads that bring what its counterpart tells."""
    modes, logic = app.get(34)["ranges"], app.get(238)["ranges"]
    ranges = [
        bytes([slot, *row.values(), more["logic"], more["linked"]])
        for slot, (row, more) in enumerate(zip(modes, logic, strict=True))
    ]
    failsafe = app.get(77)["channels"]
    channels = [struct.pack("<BBH", n, row["mode"], row["value"]) for n, row in enumerate(failsafe)]
    texts = [app.ask(Msp.GET_TEXT, bytes([kind])) for kind in (1, 2, 3, 4)]
    return [(35, ranges), (78, channels), (4106, [app.ask(4105)]), (12290, [app.ask(12289)]), (12295, texts)]


def test_lists_change_nothing_when_what_they_told_is_sent_back(app: App) -> None:
    sets = {int(message) for message in Msp if re.search("(^|_)SET_", message.name)}
    acts = {Msp.SET_RAW_RC, Msp.SET_MOTOR}
    assert {command for command, _ in parts(app)} | {*GETS} == sets - acts, "each SET is held, here or there"
    app.change(uart3_function=2, blackbox_baud=1_000_000, motor1_output=2, motor2_output=1)
    app.ask(12295, b"\2\3NF1")
    app.get(34)
    app.ask(35, bytes([7, 13, 4, 16, 24, 1, 0]))
    before = app.settings()
    for command, payloads in parts(app):
        for payload in payloads:
            app.ask(command, payload)
            assert app.settings() == before, (command, payload)
    app.ask(250)
    for command, payloads in parts(app):
        for payload in payloads:
            for length in range(len(payload)):
                app.refused(command, payload[:length])
        assert app.settings() == before, command


@pytest.mark.parametrize(
    "name", ["M\xfcller".encode(), "M\xfcller".encode("latin-1"), b"\x1b[31m", b"a\0b", b"x" * 17, b"\x7f"]
)
def test_a_name_that_is_no_ascii_is_refused_and_what_was_changed_beside_it_is_stored(
    start: Start, tmp_path: Any, name: bytes
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        before = app.settings()
        app.ask(12295, b"\2\5Kitty")
        assert app.refused(12295, bytes([2, len(name)]) + name)
        assert app.refused(12295, b"\3\4race"), "the PID's profile has a name of its own"
        app.ask(62, app.payload(62, small_angle=40))
        assert app.refused(250)
    program.end()
    with connected(start(option)) as app:
        assert app.settings() == before | {"craft_name": "Kitty", "level_limit_deg": 40.0}


def test_a_range_left_at_auto_is_refused_and_the_ones_beside_it_are_stored(
    start: Start, tmp_path: Any
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        before = app.settings()
        app.get(34)
        app.ask(35, bytes([0, 0, 2, 20, 48, 0, 0]))
        assert app.refused(35, bytes.fromhex("020dff10200000")), "aux 255, as the app sends it"
        app.ask(35, bytes([8, 13, 5, 20, 48, 0, 0]))
        assert app.refused(250)
    program.end()
    arm, beeper = (ModeRange(mode, aux, 1400, 2100).packed for mode, aux in ((Mode.ARM, 3), (Mode.BEEPER, 6)))
    with connected(start(option)) as app:
        assert app.settings() == before | {"mode1": arm, "mode3": 0, "mode9": beeper}


NOISE = (
    b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9*47\r\n",
    b"RRRR",
    bytes(range(256)),
    b"$",
    b"\xb5\x62$M",
)


@pytest.mark.parametrize(
    "noise", sampled(NOISE, *NOISE[:2], NOISE[4]), ids=["NMEA", "R", "every byte", "dollar", "half a frame"]
)
def test_a_save_stores_what_was_set_when_noise_comes_between(app: App, noise: bytes) -> None:
    """A public report: a save wiped everything, as bytes between two frames asked for the boot loader."""
    before = app.settings()
    payload = app.payload(76, delay=5)
    for command, data in ((76, payload), (250, b"")):
        app.client._transport.write(noise)
        for _ in range(100):
            try:
                app.ask(command, data)
                break
            except NoAnswerError:
                continue
    assert app.settings() == before | {"failsafe_delay_ms": 500}
