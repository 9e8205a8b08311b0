"""The Betaflight app's requests at API 1.47, replayed over TCP: connection, tabs, and what a save changes.

Numbers and order of the requests are those that the app was seen to send. Expected values come from the
settings, by SETTING_GET, and from constants written out here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from neuroflight.flash.link import layouts
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.transport import open_transport
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.toolchain.contract import SIM_AMPS_SCALE, SIM_VOLTS_SCALE, Direction, Msp, layout_of
from tests.firmware.host.app import GETS, App, connected, stored

Start = Callable[..., Any]
REFUSED = (88, 135, 120, 241, 189, 84, 132, 106, 107, 164, 205, 246, 225)

# Number of each request and bytes of its reply at API 1.47, None: refused.
HANDSHAKE = {1: 3, 2: 4, 3: 13, 5: 34, 101: 25, 160: 12}
CONNECTED = {36: 4, 32: 13, 80: 11, 70: 13, 79: 11, 110: 9, 130: 11, 116: 36, 150: 25}
TABS: dict[str, dict[int, int | None]] = {
    "setup": {240: 4, 12300: 6, 42: 2, 126: 11, 90: 20, 108: 6},
    "ports": {108: 6, 88: None, 4105: 37},
    "configuration": {36: 4, 184: 9, 61: 4, 96: 5, 44: 39, 90: 20},
    "failsafe": {44: 39, 75: 8, 135: None, 77: 48, 36: 4, 119: 6, 105: 32, 50: 1, 34: 80},
    "pid tuning": {
        **{117: 25, 112: 15, 94: 61, 111: 24, 92: 49, 125: 5, 131: 10, 140: 53, 90: 20, 42: 2, 145: 3},
    },
    "receiver": {36: 4, 105: 32, 50: 1, 111: 24, 64: 8, 125: 5, 44: 39, 42: 2},
    "modes": {105: 32, 101: 25, 34: 80, 238: 61, 119: 6, 50: 1, 4105: 37},
    "motors": {
        **{105: 32, 101: 25, 104: 16, 94: 61, 36: 4, 42: 2, 131: 10, 124: 6, 12289: 9},
        **{90: 20, 92: 49, 61: 4, 102: 18},
    },
    "blackbox": {102: 18, 104: 16, 36: 4, 70: 13, 79: 11, 80: 11, 90: 20, 96: 5, 12298: 6},
    "sensors": {96: 5, 126: 11, 38: 6, 240: 4, 12298: 6, 42: 2, 133: 2, 12301: 2, 108: 6, 109: 6},
    "power": {108: 6, 128: 2, 129: 5, 40: 8, 56: 7, 32: 13},
    "adjustments": {128: 2, 129: 5, 52: 180, 119: 6, 105: 32},
}


@pytest.fixture
def app(start: Start, host_program: Path) -> Iterator[App]:
    """Of the shipped policy, with the PID that stands by."""
    with connected(start("--gyro-hz=1000", build=host_program.parent)) as app:
        yield app


# --- Connecting and looking ------------------------------------------------------------------------------
def test_the_app_connects_when_it_asks_as_it_does(app: App) -> None:
    for command, size in HANDSHAKE.items():
        assert len(app.ask(command)) == size, command
    assert app.ask(2) == b"BTFL"
    assert app.get(4)["board_name"] == "Neuroflight 0.1.0 nf1"
    assert app.ask(3) == b"\x19\x0c\x00\x092025.12.0", "as Betaflight of API 1.47 tells it"
    assert app.ask(Msp.GET_TEXT, b"\6") == b"\6\x11Neuroflight 0.1.0"
    assert app.refused(Msp.GET_TEXT, b"\5"), "the build's key: there is none"
    for kind in (2, 1):
        assert app.ask(Msp.GET_TEXT, bytes([kind])) == bytes([kind, 0])
    assert app.ask(99, b"\1\0") == b""
    for command, size in CONNECTED.items():
        assert len(app.ask(command)) == size, command


@pytest.mark.parametrize("tab", TABS)
def test_each_tab_gets_its_answers_to_the_byte_when_opened(app: App, tab: str) -> None:
    for command, size in TABS[tab].items():
        if size is None:
            assert app.refused(command), command
        else:
            app.get(command)
            assert len(app.ask(command)) == size, command


def test_what_this_firmware_has_not_is_refused_when_asked(app: App) -> None:
    for command in REFUSED:
        assert app.refused(command), command


def test_the_tab_of_rates_shows_betaflights_own_when_nothing_is_set(app: App) -> None:
    rates = app.get(111)
    assert rates["type"] == 3, "actual: in tens of deg/s"
    for axis in ("roll", "pitch", "yaw"):
        assert [rates[f"{axis}_{what}"] for what in ("rate", "max", "expo")] == [7, 67, 0]
        assert rates[f"{axis}_rate_limit"] == 1600


def test_rates_that_ask_for_more_than_is_flown_are_refused_to_the_app(app: App) -> None:
    before = app.settings()
    assert app.refused(204, app.payload(204, roll_max=161))
    assert app.refused(204, app.payload(204, type=0, roll_rate=200, roll_max=80)), "2000 deg/s"
    assert app.settings() == before


def test_tabs_show_the_settings_when_these_are_not_the_defaults(app: App) -> None:
    app.change(failsafe_delay_ms=2500, failsafe_throttle=0.35, failsafe_stage=1, receiver_protocol=1)
    app.change(motor_stop=1, level_limit_deg=60, motor_protocol=0, battery_low_v=3.25, battery_warn_v=3.6)
    app.change(battery_capacity_mah=1500, current_scale=40.0, battery_scale=16.0, roll_rate=200, roll_max=670)
    app.change(roll_expo=0.54, filter1_kind=4, filter1_hz=120, filter3_kind=5, filter3_hz=200, filter3_q=2.0)
    app.change(dynamic_notch_count=2, motors_reversed=1, deadband_us=4, beep_armed=0, uart3_function=1)
    app.change(motor1_output=2, motor2_output=1, board_yaw_deg=90, gyro_alignment=3)
    failsafe, power, rates, filters = app.get(75), app.get(32), app.get(111), app.get(92)
    assert (failsafe["delay"], failsafe["throttle"], failsafe["procedure"]) == (25, 1350, 0)
    assert app.get(36)["features"] == 1 << 3 | 1 << 4 | 1 << 22
    assert app.get(44)["serial_provider"] == 9
    assert (app.get(61)["small_angle"], app.get(90)["motor_protocol"]) == (60, 6)
    assert (power["cell_min"], power["cell_warning"], power["capacity"]) == (325, 360, 1500)
    assert app.get(40)["scale"] == 400
    meter = app.get(56)
    assert meter["scale"] / (meter["divider"] * meter["multiplier"]) == 16.0
    assert (rates["type"], rates["roll_rate"], rates["roll_max"], rates["roll_expo"]) == (3, 20, 67, 54)
    assert (filters["gyro_lowpass_hz"], filters["gyro_lowpass_type"]) == (120, 1)
    assert filters["gyro_notch_hz"] == 200
    cutoff = filters["gyro_notch_cutoff"]
    assert 200 * cutoff / (200**2 - cutoff**2) == pytest.approx(2.0, rel=0.02), "the app's formula"
    assert filters["dynamic_notches"] == 2
    assert app.get(42) == {"mixer": 3, "reversed": 1}
    assert app.get(125)["roll_pitch"] == 4
    assert app.get(184)["off"] & (1 << 4) and not app.get(184)["off"] & (1 << 3)
    assert [port["functions"] for port in app.get(4105)["ports"]] == [1, 64, 1, 1]
    assert [row["output"] for row in app.get(12289)["outputs"]][:2] == [1, 0]
    assert (app.get(38)["yaw"], app.get(126)["gyro_align"]) == (90, 3)


def test_the_board_s_scales_are_told_and_stay_the_board_s_when_they_are_saved(app: App) -> None:
    before = app.settings()
    meter = app.get(56)
    assert meter["scale"] / (meter["divider"] * meter["multiplier"]) == SIM_VOLTS_SCALE
    assert app.get(40)["scale"] == round(SIM_AMPS_SCALE * 10)
    app.ask(57, app.payload(57))
    app.ask(41, app.payload(41))
    assert app.settings() == before
    assert before["battery_scale"] == before["current_scale"] == 0


UNITS = {
    "p": 0.032029,
    "i": 0.244381,
    "d": 0.000529,
}  # of the app's PID numbers, for one deg/s; a sum of 1000 is 1


def test_the_pid_that_stands_by_is_told_and_scaled_in_the_apps_units(app: App) -> None:
    pid = dict(load_aircraft("nf1").pids)["flying"]
    gains = {
        f"{axis}_{term}": gain
        for axis, row in zip(("roll", "pitch", "yaw"), pid.gains, strict=True)
        for term, gain in zip("pid", row, strict=True)
    }
    told = app.get(112)
    assert {name: told[name] for name in gains} == {n: round(g / UNITS[n[-1]]) for n, g in gains.items()}
    assert app.get(92)["d_lowpass_hz"] == app.get(140)["d_lowpass_hz"] == 20
    advanced = app.get(94)
    assert (advanced["tpa_rate"], advanced["tpa_breakpoint"]) == (0, 1000)
    assert app.get(90)["motor_idle"] == 550
    expected = app.settings()
    app.ask(202, app.payload(202, roll_p=45, yaw_i=180))
    settings = app.settings()
    assert settings.pop("pid_roll_p") == pytest.approx(45 * UNITS["p"] / gains["roll_p"], rel=1e-5)
    assert settings.pop("pid_yaw_i") == pytest.approx(180 * UNITS["i"] / gains["yaw_i"], rel=1e-5)
    assert settings == {n: v for n, v in expected.items() if n not in ("pid_roll_p", "pid_yaw_i")}
    assert (app.get(112)["roll_p"], app.get(112)["yaw_i"]) == (45, 180)
    for beyond in ({"roll_p": 5}, {"roll_p": 200}, {"pitch_i": 9}, {"level_p": 50}):
        assert app.refused(202, app.payload(202, **beyond)), beyond


# --- Saving -----------------------------------------------------------------------------------------------


CHANGED: tuple[tuple[int, Mapping[str, int], Mapping[str, float]], ...] = (
    (204, {"pitch_max": 120}, {"pitch_max": 1200.0}),
    (93, {"gyro_lowpass_hz": 150}, {"filter1_kind": 1, "filter1_hz": 150.0}),
    (
        93,
        {"gyro_notch2_hz": 300, "gyro_notch2_cutoff": 250},
        {"filter4_kind": 5, "filter4_hz": 300.0, "filter4_q": 2.7272727},
    ),
    (93, {"dynamic_notches": 1}, {"dynamic_notch_count": 1}),
    (95, {"motor_limit": 80}, {"motor_limit": 0.8}),
    (37, {"features": 1 << 3 | 1 << 4 | 1 << 22}, {"motor_stop": 1}),
    (37, {"features": 1 << 14 | 1 << 22}, {"receiver_protocol": 2}),
    (45, {"serial_provider": 9}, {"receiver_protocol": 1}),
    (45, {"smoothing": 1}, {"interpolation": 1}),
    (62, {"small_angle": 180}, {"level_limit_deg": 0.0}),
    (91, {"motor_protocol": 6}, {"motor_protocol": 0}),
    (185, {"off": 8387877 | 1 << 7}, {"beep_battery_warn": 0}),
    (76, {"delay": 5}, {"failsafe_delay_ms": 500}),
    (76, {"off_delay": 12}, {"failsafe_descend_ms": 12_000}),
    (76, {"procedure": 0}, {"failsafe_stage": 1}),
    (65, {"aux1": 5, "aux2": 4}, {"map_aux1": 5, "map_aux2": 4}),
    (218, {"yaw": 7}, {"yaw_deadband_us": 7}),
    (43, {"reversed": 1}, {"motors_reversed": 1}),
    (220, {"gyro_align": 2}, {"gyro_alignment": 2}),
    (39, {"yaw": -45}, {"board_yaw_deg": -45.0}),
    (57, {"scale": 100}, {"battery_scale": 10.0}),
    (81, {"device": 3}, {"blackbox_device": 1}),
    (81, {"device": 0, "sample_rate": 4}, {"blackbox_device": 0, "blackbox_divider": 16}),
    (81, {"fields_off": 1 << 12 | 1 << 3}, {"blackbox_disabled_mask": 1 << 12 | 1 << 3}),
    (41, {"scale": 250}, {"current_scale": 25.0}),
    (33, {"cell_warning": 365, "capacity": 850}, {"battery_warn_v": 3.65, "battery_capacity_mah": 850}),
)


@pytest.mark.parametrize(("command", "changes", "settings"), CHANGED)
def test_one_setting_changes_for_good_when_the_app_saves_one_value(
    start: Start, tmp_path: Path, command: int, changes: dict[str, int], settings: dict[str, float]
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        expected = app.settings() | settings
        app.ask(command, app.payload(command, **changes))
        assert app.settings() == stored(expected)
        app.ask(250)
    program.end()
    with connected(start(option)) as app:
        assert app.settings() == stored(expected)


def test_all_rates_are_taken_when_their_type_changes(app: App) -> None:
    expected = app.settings() | {"rates_style": 1}
    for axis in ("roll", "pitch", "yaw"):
        expected |= {f"{axis}_rate": 1.2, f"{axis}_max": 0.65, f"{axis}_expo": 0.1}
    each = {
        f"{axis}_{part}": raw
        for axis in ("roll", "pitch", "yaw")
        for part, raw in (("rate", 120), ("max", 65), ("expo", 10))
    }
    app.ask(204, app.payload(204, type=0, **each))
    assert app.settings() == stored(expected)


def test_fields_of_ours_stay_off_when_the_app_chooses_among_its_own(app: App) -> None:
    app.change(blackbox_disabled_mask=0x50001)
    expected = app.settings() | {"blackbox_disabled_mask": 0x58080}
    assert app.get(80)["fields_off"] == 1
    app.ask(81, app.payload(81, fields_off=0x8080))
    assert app.settings() == expected


@pytest.mark.parametrize(
    "changes",
    [
        *({"device": device} for device in (1, 4, 255)),
        *({"sample_rate": rate} for rate in (5, 7, 8, 31, 255)),
        *({"rate_numerator": number} for number in (0, 2)),
        *({"fields_off": 1 << bit} for bit in (16, 19, 31)),
    ],
    ids=str,
)
def test_a_log_that_cannot_be_is_refused_and_the_save_too(app: App, changes: dict[str, int]) -> None:
    before = app.settings()
    assert app.refused(81, app.payload(81, **changes))
    assert app.refused(250)
    assert app.settings() == before


@pytest.mark.parametrize("divider", [1, 2, 4, 8, 16])
def test_the_rate_of_the_log_is_told_in_every_form(app: App, divider: int) -> None:
    app.change(blackbox_divider=divider)
    told = app.get(80)
    assert 2 ** told["sample_rate"] == divider == told["rate_denominator"]
    assert told["p_denominator"] * divider == 32  # control steps from one I frame to the next


ZEROS_CHANGE_NOTHING = {51, 239, 224, 220, 39}  # what they tell is all zeros


@pytest.mark.parametrize("command", sorted(set(GETS)))
def test_zeros_change_nothing_when_the_app_was_told_otherwise(app: App, command: int) -> None:
    app.change(board_yaw_deg=10, gyro_alignment=2)
    app.ask(250)
    before = app.settings()
    zeros = bytes(len(app.payload(command)))
    app.client.close()
    app.client = Client(open_transport(app.client.name))  # one that has read nothing
    if command in ZEROS_CHANGE_NOTHING - {220, 39}:
        app.ask(command, zeros)
    else:
        assert app.refused(command, zeros)
        assert app.refused(250)
    assert app.settings() == before


@pytest.mark.parametrize("command", sorted(set(GETS)))
def test_other_versions_of_the_app_change_nothing_else_when_they_save(app: App, command: int) -> None:
    before = app.settings()
    payload = app.payload(command)
    layout = layout_of(Msp(command), Direction.REQUEST)
    app.ask(command, payload + b"\xff\xff\xff")
    first = layouts.encode(
        layout,
        {field.name: app.get(GETS[Msp(command)])[field.name] for field in layout.fields[: layout.needed]},
    )
    app.ask(command, first)
    assert app.refused(command, b"")
    assert app.settings() == before


# Bytes that a SET had up to API 1.46, from which peers of that age do not depart, whatever API they are told.
OLD_BYTES = {45: 38, 62: 3, 97: 3, 204: 23, 220: 6}


@pytest.mark.parametrize("command", OLD_BYTES)
def test_a_peer_of_api_1_46_changes_nothing_else_when_it_saves(app: App, command: int) -> None:
    app.change(gyro_alignment=3)
    before = app.settings()
    app.ask(command, app.payload(command)[: OLD_BYTES[command]])
    if command == 220:  # in place of the gyros that are on it has one to be used, and two alignments
        app.ask(command, bytes([3, 3, 0, 0, 0, 0]))
    app.ask(250)
    assert app.settings() == before


def test_what_is_good_is_stored_and_the_save_says_that_it_is_not_all_when_some_is_refused(
    start: Start, tmp_path: Path
) -> None:
    option = f"--settings={tmp_path / 'flash.bin'}"
    program = start(option)
    with connected(program) as app:
        before = app.settings()
        app.ask(76, app.payload(76, delay=5))
        assert app.refused(91, app.payload(91, pid_denominator=1, motor_protocol=6))
        assert app.refused(81, app.payload(81, device=3, sample_rate=5, fields_off=1))
        assert app.refused(33, app.payload(33, cell_min=400, capacity=850)), "above the warning"
        assert app.refused(204, app.payload(204, roll_max=161, pitch_max=120))
        assert app.refused(204, app.payload(204, type=1, roll_rate=50)), "of a type that there is not"
        kept = {"failsafe_delay_ms": 500, "motor_protocol": 0, "blackbox_device": 1, "pitch_max": 1200.0}
        kept |= {"blackbox_disabled_mask": 1, "battery_capacity_mah": 850}
        assert app.settings() == before | kept
        with pytest.raises(RefusedError, match="stored, but not all"):
            app.ask(250)
        app.ask(250)
    program.end()
    with connected(start(option)) as app:
        assert app.settings() == before | kept


def test_a_failsafe_save_ends_well_when_it_asks_for_gps_rescue(app: App) -> None:
    for command in (45, 76, 37):
        app.ask(command, app.payload(command))
    frame = b"$M<\x02\xe1\x00\x00\xe3"  # 225, which is not ours: it changed nothing that was to be saved
    app.client._transport.write(frame)
    assert app.client._transport.read(5.0).startswith(b"$M!")
    app.ask(250)
