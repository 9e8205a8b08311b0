"""What the lines of Betaflight's files ask for: each right, each accounted for."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.betaflight.diff_file import read_diff
from neuroflight.flash.betaflight.plan import ImportPlan
from neuroflight.flash.betaflight.planner import plan_import
from neuroflight.flash.settings.text import default_of, value_text
from neuroflight.toolchain.contract import SETTINGS
from neuroflight.toolchain.errors import LinkError
from tests.flights.wiring import board_axes
from tests.sampling import examples

OUTPUTS = ("C06", "C07", "C08", "C09", "B01", "A08", "B08", "A02")  # of a MATEKF722
DEFAULTS = {setting.name: default_of(setting) for setting in SETTINGS}
Make = Callable[..., ImportPlan]
AXES = ("roll", "pitch", "yaw")


def header(version: str = "4.2.0", board: str = "MATEKF722") -> str:
    return f"# Betaflight / {board} (MKF7) {version} Mar  8 2019 / 11:37:03 (52c4e96c8) MSP API: 1.41\n"


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Return a function that plans a file of the given lines, for a firmware at its defaults by default."""

    def make(
        text: str,
        version: str = "4.2.0",
        board: str = "MATEKF722",
        here: str = "MATEKF722",
        rate_profile: int | None = None,
        turn: tuple[int, int, int] | None = (0, 0, 0),
        **present: float | str,
    ) -> ImportPlan:
        file = tmp_path / "diff.txt"
        file.write_text(header(version, board) + text)
        outputs = OUTPUTS if board.startswith("MATEKF722") else ()
        return plan_import(read_diff(file), here, DEFAULTS | present, rate_profile, outputs, turn)

    return make


def changes(plan: ImportPlan) -> dict[str, str]:
    """Return the changes as text, without the motors' order, which every file of the same board changes."""
    return {
        name: value_text(name, value)
        for name, value in plan.changes.items()
        if not re.match(r"motor\d_", name)
    }


def left(plan: ImportPlan) -> dict[str, str]:
    return {one.line.text: one.reason for one in plan.left}


@pytest.mark.parametrize(
    ("makers", "lines", "pilots"),
    [
        ((0, 0, 45), {"yaw": 45}, (0, 0, 0)),  # a dump: nothing but what the maker presets
        ((0, 0, -45), {"yaw": 315, "roll": 0}, (0, 0, 0)),
        ((0, 0, -45), {"yaw": 0}, (0, 0, 45)),
        ((0, 0, -45), {"yaw": 135}, (0, 0, 180)),
        ((0, 0, 45), {"roll": 180}, (180, 0, 90)),  # upside down, its maker's yaw left as it was
        ((180, 0, 90), {"yaw": 180}, (0, 0, 90)),
        ((180, 0, 90), {"roll": 0}, (0, 180, 0)),  # the same as roll 180, yaw 180
        ((0, 0, 45), {"pitch": 90}, None),
    ],
)
def test_the_pilots_turn_is_what_is_left_of_the_makers(
    make: Make, makers: tuple[int, int, int], lines: dict[str, int], pilots: tuple[int, int, int] | None
) -> None:
    plan = make("\n".join(f"set align_board_{axis} = {turn}" for axis, turn in lines.items()), turn=makers)
    found = [float(changes(plan)[f"board_{axis}_deg"]) for axis in AXES]
    whole = [lines.get(axis, turn) for axis, turn in zip(AXES, makers, strict=True)]
    np.testing.assert_allclose(board_axes(found) @ board_axes(makers), board_axes(whole), atol=2e-4)
    if pilots is not None:
        np.testing.assert_allclose(board_axes(found), board_axes(pilots), atol=1e-9)


def test_a_turn_is_left_where_its_makers_is_not_known(make: Make) -> None:
    plan = make("set align_board_yaw = 45", turn=None)
    assert not changes(plan) and "set board_yaw_deg" in left(plan)["set align_board_yaw = 45"]


# --- One line --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("name my quad", {"craft_name": "my quad"}),
        ("name -", {"craft_name": "-"}),
        ("set craft_name = A = b # 1", {"craft_name": "A = b # 1"}),
        ("SET Name = Q", {"craft_name": "Q"}),
        ("set pilot_name = Ada", {"pilot_name": "Ada"}),
        ("display_name Ada", {"pilot_name": "Ada"}),
        ("set serialrx_provider = CRSF", {"receiver_protocol": "crsf"}),
        ("set serialrx_provider = sbus", {"receiver_protocol": "sbus"}),
        ("feature RX_MSP", {"receiver_protocol": "msp"}),
        ("feature MOTOR_STOP", {"motor_stop": "on"}),
        ("feature -MOTOR_STOP", {"motor_stop": "off"}),
        ("set yaw_motors_reversed = ON", {"motors_reversed": "on"}),
        ("set yaw_motor_direction = -1", {"motors_reversed": "on"}),
        ("set yaw_motor_direction = 1", {"motors_reversed": "off"}),
        ("set motor_pwm_protocol = DSHOT300", {"motor_protocol": "dshot300"}),
        ("set motor_pwm_protocol = DSHOT150", {"motor_protocol": "dshot150"}),
        ("set motor_output_limit = 80", {"motor_limit": "0.8"}),
        ("set failsafe_procedure = AUTO-LAND", {"failsafe_stage": "descend"}),
        ("set failsafe_procedure = DROP", {"failsafe_stage": "drop"}),
        ("set failsafe_delay = 15", {"failsafe_delay_ms": "1500"}),
        ("set failsafe_off_delay = 25", {"failsafe_descend_ms": "2500"}),
        ("set failsafe_landing_time = 60", {"failsafe_descend_ms": "60000"}),
        ("set failsafe_throttle = 1270", {"failsafe_throttle": "0.27"}),
        ("set failsafe_throttle = 2000", {"failsafe_throttle": "1.0"}),
        ("set small_angle = 180", {"level_limit_deg": "180"}),
        ("set deadband = 5", {"deadband_us": "5"}),
        ("set yaw_deadband = 7", {"yaw_deadband_us": "7"}),
        ("set bat_capacity = 1300", {"battery_capacity_mah": "1300"}),
        ("set force_battery_cell_count = 4", {"battery_cells": "4"}),
        ("set vbat_warning_cell_voltage = 36", {"battery_warn_v": "3.6"}),
        ("set vbat_warning_cell_voltage = 362", {"battery_warn_v": "3.62"}),
        ("set vbat_min_cell_voltage = 33", {"battery_low_v": "3.3"}),
        ("set vbat_scale = 112", {"battery_scale": "11.2"}),
        ("set vbat_scale = 160\nset vbat_divider = 16\nset vbat_multiplier = 2", {"battery_scale": "5"}),
        ("set ibata_scale = 250", {"current_scale": "25"}),
        ("set align_board_yaw = 315", {"board_yaw_deg": "-45"}),
        (
            "set align_board_roll = 180\nset align_board_pitch = -7",
            {"board_roll_deg": "180", "board_pitch_deg": "-7"},
        ),
        ("set gyro_1_sensor_align = CW270", {"gyro_alignment": "cw270"}),
        ("set gyro_1_sensor_align = CW90FLIP", {"gyro_alignment": "cw90_flip"}),
        ("set align_gyro = DEFAULT", {"gyro_alignment": "board"}),
        ("beeper -RX_LOST", {"beep_receiver_lost": "off"}),
        (
            "beeper -ALL\nbeeper ARMING",
            {
                **{
                    f"beep_{name}": "off"
                    for name in ("receiver_lost", "disarmed", "battery_low", "battery_warn")
                },
                "beep_armed": "on",
            },
        ),
        ("set bat_capacity = 1\nset bat_capacity = 2", {"battery_capacity_mah": "2"}),
    ],
)
def test_a_setting_becomes_its_counterpart(make: Make, line: str, wanted: dict[str, str]) -> None:
    assert changes(make(line + "\n")) == wanted


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("set osd_vbat_pos = 2423", "there is no on-screen display"),
        ("set vtx_band = 5", "video transmitter"),
        ("set p_roll = 45", "the policy has no gains"),
        ("set gyro_lowpass2_hz = 375", "the gyro filters that it was trained with"),
        ("set dshot_idle_value = 450", "the controller's"),
        ("set thr_expo = 20", "the throttle has no curve"),
        ("feature AIRMODE", "the attitude always comes before the throttle"),
        ("beeper -ON_USB", "the beeper has no such condition"),
        ("serial 2 32 115200 57600 0 115200", "UART3: SmartPort telemetry"),
        ("serial UART4 64 115200 57600 0 115200", "UART4: receiver"),
        ("rxfail 4 h", "until the failsafe stage rates are centred"),
        ("resource BEEPER 1 C13", "built into the image"),
        ("set small_angle = 0", "0 forbids arming in Betaflight"),
        (
            "set motor_pwm_protocol = ONESHOT125",
            "ONESHOT125: ESCs here are told by DShot150, DShot300 or DShot600",
        ),
        ("set serialrx_provider = IBUS", "IBUS: receivers here speak SBUS or CRSF"),
        ("set failsafe_procedure = GPS-RESCUE", "GPS-RESCUE: the failsafe here drops or descends"),
        ("set gyro_1_sensor_align = CUSTOM", "CUSTOM: chips here are turned by quarters"),
        ("set failsafe_delay = soon", "got 'soon', expected a whole number"),
        ("set craft_name = Flügel", "expected at most 16 characters of ASCII"),
        ("map TAER123", "expected each of AETR1234 once"),
        ("aux 0 0 13 1700 2100 0 0", "ARM on AUX 14: there are AUX 1 to 12 here"),
        ("aux 1 1 2 1750 2100 0 0", "ANGLE: there is no such mode here"),
        ("aux 1 40 2 1750 2100 0 0", "USER1: there is no such mode here"),
        ("aux 2 13 0 900 900 0 1", "BEEPER follows another mode (ANGLE)"),
        ("aux 3 0 0 900 900 0 0", "an unused slot"),
        ("aux 3 0 x", "got 'x', expected a whole number"),
        ("aux 3 0 1", "expected aux SLOT MODE AUX LOW HIGH"),
        ("Entering CLI Mode, type 'exit' to return, or 'help'", "no command of Betaflight's"),
        ("import os", "no command of Betaflight's"),
        ("batch start", "of the file or its board"),
        ("set vbat_divider = 11", "vbat_scale is not in the file"),
    ],
)
def test_a_line_without_a_counterpart_is_left_with_the_reason(make: Make, line: str, reason: str) -> None:
    plan = make(line + "\n")
    assert changes(plan) == {}
    assert reason in left(plan)[line]


def test_the_channel_map_is_by_the_letters_places(make: Make) -> None:
    told = changes(make("map TAER1234\n"))
    assert told == {
        **{"map_throttle": "0", "map_roll": "1", "map_pitch": "2", "map_yaw": "3"},
        **{f"map_aux{aux}": str(3 + aux) for aux in range(1, 5)},
    }


# --- Facts of a board ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "line",
    [
        "resource MOTOR 1 C09",
        "set vbat_scale = 112",
        "set ibata_scale = 250",
        "set gyro_1_sensor_align = CW270",
    ],
)
@pytest.mark.parametrize(
    ("board", "here"), [("MATEKF722SE", "MATEKF722"), ("OMNIBUS", "HOST"), ("MATEKF722", "OTHER")]
)
def test_a_fact_of_another_board_is_left(make: Make, line: str, board: str, here: str) -> None:
    plan = make(line + "\n", board=board, here=here)
    assert plan.changes == {}
    assert f"a fact of the board {board}, and this is another" in left(plan)[line]


def test_the_host_program_stands_for_a_board_that_there_is_an_image_for(make: Make) -> None:
    assert changes(make("set vbat_scale = 112\n", here="HOST")) == {"battery_scale": "11.2"}


@pytest.mark.parametrize(
    ("lines", "outputs"),
    [
        ("", "1234"),
        ("resource MOTOR 1 C09\nresource MOTOR 2 C08\nresource MOTOR 3 C07\nresource MOTOR 4 C06\n", "4321"),
        ("resource MOTOR 1 NONE\nresource MOTOR 1 C09\nresource MOTOR 4 c06\nmixer QUADX\n", "4231"),
        ("set motor_output_reordering = 3,1,2,0,4,5,6,7\n", "4231"),
        ("resource MOTOR 1 C07\nresource MOTOR 2 PC6\nset motor_output_reordering = 1,0,2,3\n", "1234"),
        ("resource MOTOR 5 B01\nresource MOTOR 6 A08\n", "1234"),
    ],
)
def test_motors_are_at_the_outputs_of_their_pins(make: Make, lines: str, outputs: str) -> None:
    plan = make(lines)
    assert [plan.changes[f"motor{motor}_output"] for motor in range(1, 5)] == [float(one) for one in outputs]


@pytest.mark.parametrize(
    ("lines", "reason"),
    [
        ("resource MOTOR 1 B01\n", "the motors are on B01, C07, C08, C09"),
        ("resource MOTOR 1 C07\n", "the motors are on C07, C07, C08, C09"),
        ("resource MOTOR 1 NONE\n", "the motors are on NONE, C07, C08, C09"),
        ("resource MOTOR 1 C06\nmixer HEX6X\n", "the mixer HEX6X may number motors otherwise"),
        ("resource MOTOR 1 C06\nmmix 0 1.0 -1.0 1.0 -1.0\n", "the mixer CUSTOM may number motors otherwise"),
        ("set motor_output_reordering = 4,1,2,3\n", "motor_output_reordering names others than the first 4"),
    ],
)
def test_an_order_that_cannot_be_wired_here_is_left(make: Make, lines: str, reason: str) -> None:
    plan = make(lines)
    assert plan.changes == {}
    assert reason in left(plan)[lines.splitlines()[0]]


# --- Modes ------------------------------------------------------------------------------------------------
def test_a_mode_has_the_files_ranges_and_no_others(make: Make) -> None:
    lines = "aux 0 0 0 1300 2100 0 0\naux 2 13 2 1300 1600 0 0\naux 5 13 6 900 1000 1\n"
    plan = make(lines)
    assert changes(plan) == {
        "mode1": "arm aux1 1300 2100",
        "mode3": "beeper aux3 1300 1600",
        "mode5": "beeper aux7 900 1000 and",
    }


def test_a_range_too_many_is_taken_away(make: Make) -> None:
    spare = {"mode7": float(DEFAULTS["mode1"]), "mode8": float(DEFAULTS["mode1"]) + (1 << 8)}
    assert changes(make("aux 0 0 4 1700 2100\n", **spare)) == {
        "mode1": "arm aux5 1700 2100",
        "mode7": "none",
        "mode8": "none",
    }


def test_ends_are_kept_as_betaflight_keeps_them(make: Make) -> None:
    assert changes(make("aux 0 0 0 1710 2500 0 0\n")) == {"mode1": "arm aux1 1700 2100"}


def test_a_range_that_others_have_to_hold_with_is_not_brought_over_alone(make: Make) -> None:
    plan = make("aux 0 0 0 1700 2100 1 0\naux 1 0 13 1700 2100 1 0\n")
    assert plan.changes == make("").changes
    assert "alone it would hold too often" in left(plan)["aux 0 0 0 1700 2100 1 0"]


def test_the_pilot_is_told_of_a_switch_that_means_another_thing_now(make: Make) -> None:
    plan = make("aux 0 0 0 1700 2100 0 0\naux 1 1 1 1300 2100 0 0\naux 2 36 2 1300 2100 0 0\n")
    assert "mode2 = pid aux2 1700 2100 stays, and in the file AUX 2 switched ANGLE" in plan.notes
    assert "Betaflight armed only with PREARM on besides: here the arm switch alone arms" in plan.notes
    (told,) = make("aux 0 0 0 900 2100 0 0\n").notes
    assert "it never arms" in told


# --- Rates --------------------------------------------------------------------------------------------------
def rates(plan: ImportPlan) -> list[str]:
    names = [
        "rates_style",
        *(f"{axis}_{what}" for axis in ("roll", "pitch", "yaw") for what in ("rate", "max", "expo")),
    ]
    told = changes(plan)
    return [told[name] for name in names if name in told]


BF_DEFAULT = ["betaflight", *["1.0", "0.7", "0"] * 3]
ACTUAL_DEFAULT = ["actual", *["70", "670", "0"] * 3]


@pytest.mark.parametrize("version", ["3.0.1", "3.1.7", "3.2.5", "3.3.3", "3.5.7", "4.0.6", "4.1.7", "4.2.11"])
def test_what_a_file_leaves_out_is_the_old_default_to_4_2(make: Make, version: str) -> None:
    assert rates(make("rateprofile 0\n", version)) == BF_DEFAULT
    expo = "yaw_expo" if version > "3.3" else "rc_yaw_expo"
    told = rates(make(f"rateprofile 0\nset roll_srate = 75\nset {expo} = 1\n", version))
    assert told == ["betaflight", "1.0", "0.75", "0", "1.0", "0.7", "0", "1.0", "0.7", "0.01"]


@pytest.mark.parametrize(
    "version", ["4.3.0-RC1", "4.3.2", "4.4.3", "4.5.2", "4.6.0", "2025.12.5", "2026.6.1"]
)
def test_what_a_file_leaves_out_is_the_new_default_from_4_3(make: Make, version: str) -> None:
    assert rates(make("rateprofile 0\n", version)) == ACTUAL_DEFAULT
    assert rates(make("rateprofile 0\nset roll_srate = 75\nset roll_expo = 1\n", version)) == [
        *("actual", "70", "750", "0.01", "70", "670", "0", "70", "670", "0")
    ]


@pytest.mark.parametrize("version", ["2.9.1", "2031.1.0"])
def test_what_a_file_leaves_out_is_asked_for_where_the_version_is_unknown(make: Make, version: str) -> None:
    plan = make("rateprofile 0\nset roll_srate = 75\n", version)
    assert rates(plan) == []
    assert any(f"what Betaflight {version} has by default is not known here" in note for note in plan.notes)
    whole = "".join(
        f"set {axis}_{name} = 50\n"
        for axis in ("roll", "pitch", "yaw")
        for name in ("rc_rate", "srate", "expo")
    )
    assert rates(make(f"rateprofile 0\nset rates_type = BETAFLIGHT\n{whole}", version))[0] == "betaflight"


def test_no_rates_are_brought_over_where_the_file_has_none(make: Make) -> None:
    plan = make("# master\nset small_angle = 180\n")
    assert rates(plan) == []
    assert plan.notes == ()


def test_old_names_of_rates_mean_both_axes(make: Make) -> None:
    lines = (
        "rateprofile 0\nset rc_rate = 139\nset rc_rate_yaw = 120\nset rc_expo = 35\nset rc_expo_yaw = 20\n"
    )
    assert rates(make(lines, "3.2.0")) == [
        "betaflight",
        "1.39",
        "0.7",
        "0.35",
        "1.39",
        "0.7",
        "0.35",
        "1.2",
        "0.7",
        "0.2",
    ]


ALL_PROFILES = "".join(f"rateprofile {at}\nset roll_srate = {at + 1}0\n" for at in range(3))


@pytest.mark.parametrize(("behind", "wanted"), [("rateprofile 1\n", "0.2"), ("rateprofile 2\n", "0.3")])
def test_the_rates_are_those_of_the_profile_that_is_selected_last(
    make: Make, behind: str, wanted: str
) -> None:
    assert rates(make(ALL_PROFILES + behind))[2] == wanted


def test_a_rate_profile_is_asked_for_where_the_file_does_not_tell_which_was_flown(make: Make) -> None:
    plan = make(ALL_PROFILES)
    assert rates(plan) == []
    assert plan.notes == (
        "rates stay as they are: which rate profile was flown does not show; give --rate-profile N",
    )
    assert rates(make(ALL_PROFILES, rate_profile=1))[2] == "0.2"
    with pytest.raises(LinkError, match=r"--rate-profile got 7, expected one of the file's: 0, 1, 2"):
        make(ALL_PROFILES, rate_profile=7)


def test_rate_profiles_belong_to_profiles_before_3_2(make: Make) -> None:
    lines = "".join(
        f"profile {at}\nrateprofile 0\nset roll_srate = {at + 1}0\nrateprofile 0\n" for at in range(2)
    )
    assert rates(make(lines + "profile 0\n", "3.1.7"))[2] == "0.1"
    assert rates(make(lines + "profile 0\n", "3.2.0"))[2] == "0.2"


def test_other_kinds_become_the_nearest_style_and_the_pilot_is_told(make: Make) -> None:
    kiss = "rateprofile 0\nset rates_type = KISS\n" + "".join(
        f"set {axis}_rc_rate = 145\nset {axis}_srate = 75\nset {axis}_expo = {{}}\n"
        for axis in ("roll", "pitch", "yaw")
    )
    plan = make(kiss.replace("{}", "0"))
    assert rates(plan) == ["betaflight", *["1.45", "0.75", "0"] * 3]
    assert plan.notes == ()
    (told,) = make(kiss.replace("{}", "22")).notes
    assert re.fullmatch(
        r"KISS rates: the nearest of the style \w+ differ by \d+ deg/s at most \(\w+, at \d+% stick\)", told
    )


def test_rates_beyond_what_is_flown_stay_and_the_rest_is_brought_over(make: Make) -> None:
    plan = make("set small_angle = 180\nrateprofile 0\nset roll_rc_rate = 200\nset roll_srate = 80\n")
    assert changes(plan) == {"level_limit_deg": "180"}
    assert any("they ask for 1998 deg/s at full stick on roll" in note for note in plan.notes)


# --- All lines, whatever they are ------------------------------------------------------------------
WORDS = (
    *("aux", "map", "set", "feature", "beeper", "serial", "resource", "MOTOR", "mixer", "mmix", "name"),
    *("rateprofile", "=", "-", "0", "1", "13", "99", "-5", "1700", "2100", "C09", "NONE", "TAER1234"),
    *("roll_srate", "yaw_expo", "rates_type", "KISS", "QUICK", "craft_name", "vbat_scale", "#", "ON"),
    *("motor_output_reordering", "3,2,1,0", "-ALL", "ARMING", "RX_MSP", "\x07", "é", "vbat_divider"),
    *("1e9", "99999999999999999999", "motor_output_limit", "deadband", "serialrx_provider", "nan"),
)
LINES = (
    *("set roll_rc_rate = {n}", "set pitch_srate = {n}", "set yaw_expo = {n}", "set rates_type = {kind}"),
    *("aux {slot} {box} {aux} {us} {us} {bit} 0", "resource MOTOR {slot} C0{pin}", "beeper -{beep}"),
    *("set vbat_scale = {n}", "set motor_output_limit = {n}", "rateprofile {slot}", "profile {slot}"),
    *("feature {feature}", "set bat_capacity = {n}", "set align_board_yaw = {n}", "set failsafe_delay = {n}"),
    "serial {slot} {n} 0 0 0 0",
)


def invented(rng: random.Random) -> str:
    """Return a file of lines that are right, half right and nonsense."""
    lines = []
    for _ in range(rng.randint(0, 40)):
        if rng.random() < 0.5:
            lines.append(" ".join(rng.choices(WORDS, k=rng.randint(1, 7))))
            continue
        lines.append(
            rng.choice(LINES).format(
                n=rng.choice([0, 1, 7, 60, 100, 255, -1, 70000]),
                kind=rng.choice(["BETAFLIGHT", "KISS", "ACTUAL", "QUICK", "RACEFLIGHT", "3", "NEW"]),
                slot=rng.randint(0, 6),
                box=rng.choice([0, 1, 13, 26, 36, 40, 55, 200]),
                aux=rng.randint(0, 15),
                us=rng.choice([900, 1300, 1700, 2100, 3000]),
                bit=rng.randint(0, 2),
                pin=rng.randint(5, 9),
                beep=rng.choice(["ALL", "ARMING", "ON_USB"]),
                feature=rng.choice(["MOTOR_STOP", "-MOTOR_STOP", "RX_MSP", "OSD", "3D"]),
            )
        )
    return rng.choice(["\n", "\r\n"]).join(lines)


def test_every_line_is_brought_over_or_left_with_a_reason(make: Make) -> None:
    """Their lines are counted from the text, not by the code under test."""
    rng = random.Random(1)
    for _ in range(examples(1600)):
        text, version = invented(rng), rng.choice(["3.1.7", "4.0.0", "4.5.1", "2025.12.1", "9.9"])
        plan = make(text, version, board=rng.choice(["MATEKF722", "OMNIBUS"]))
        whole = (header(version) + text).split("\n")
        wanted = [
            at for at, one in enumerate(whole, start=1) if one.strip() and not one.strip().startswith("#")
        ]
        brought = [line.number for group in plan.groups for line in group.lines]
        told = [one.line.number for one in plan.left]
        assert sorted(brought + told) == wanted, text
        assert all(one.reason and "\n" not in one.reason for one in plan.left)
        assert all(name in DEFAULTS for name in plan.changes)
