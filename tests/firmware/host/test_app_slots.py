"""Modes, ports, motor outputs and names as the Betaflight app saves them."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from flash import layouts
from tests.firmware.host.app import App, connected
from toolchain.contract import Direction, ModeRange, Msp, layout_of
from toolchain.contract.modes import Mode

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
    assert app.refused(12295, b"\3\4mine")
    assert app.refused(12295, bytes(2))
    for channel in range(16):
        row = app.get(77)["channels"][channel]
        app.ask(78, struct.pack("<BBH", channel, row["mode"], row["value"]))
    assert app.refused(78, bytes(4)[:3] + b"\1")
    assert app.settings() == expected


def port_rows(*rows: tuple[int, int, int, int, int, int], rest: bytes = b"") -> bytes:
    """As COMMON_SET_SERIAL_CONFIG has them: port, functions, bauds of MSP, GPS, telemetry, blackbox."""
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
    usb = (20, 1, 5, 0, 0, 5)
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
