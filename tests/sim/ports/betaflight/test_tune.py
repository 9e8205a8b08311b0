"""A pilot's settings of Betaflight: which lines of a file fly, and what files are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.flash.betaflight.diff_file import FILE_BYTES_MAX
from neuroflight.sim.ports.betaflight.tune import read_tune, tune_path, tune_text
from neuroflight.toolchain.errors import LinkError

BOARD = "# Betaflight / STM32F7X2 (S7X2) 4.6.0 Jun  1 2025 / 10:00:00 (norevision) MSP API: 1.47\n"
DIFF = (
    BOARD
    + """
board_name MATEKF722
feature TELEMETRY
set gyro_lpf1_dyn_min_hz = 0
set dyn_notch_count = 1
set osd_vbat_pos = 2433
set align_board_yaw = 90
profile 0
set p_roll = 50
set d_max_roll = 45
profile 1
set p_roll = 60
set simplified_pi_gain = 120
set vbat_sag_compensation = 100
profile 2
rateprofile 0
set roll_rc_rate = 7
# restore original profile selection
profile 1
rateprofile 0
save
"""
)


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.txt"
    path.write_text(text)
    return path


def test_a_diff_gives_common_lines_and_those_of_the_chosen_profile(tmp_path: Path) -> None:
    tune = read_tune(written(tmp_path, DIFF))
    assert tune.lines == ("set gyro_lpf1_dyn_min_hz = 0", "set p_roll = 60")
    assert [place.rpartition(":")[2] for place in tune.places] == ["5", "13"]
    assert tune.without_effect == ("dyn_notch_count", "vbat_sag_compensation")
    assert (tune.name, tune.idle) == ("mine.txt", None)


def test_a_list_without_a_header_is_taken_and_the_last_line_of_a_name_counts(tmp_path: Path) -> None:
    text = "set p_roll = 40\nset motor_idle = 400\nset P_ROLL=55\n"
    tune = read_tune(written(tmp_path, text))
    assert dict(tune.settings) == {"p_roll": "55", "motor_idle": "400"}
    assert tune.idle == pytest.approx(0.04)


def test_what_a_search_writes_is_read_back(tmp_path: Path) -> None:
    settings = {"p_roll": 51, "tpa_rate": 40}
    path = tmp_path / "nf1.betaflight.txt"
    path.write_text(tune_text(settings, ["Found by `neuroflight pid tune --of betaflight`."]))
    tune = read_tune(path)
    assert dict(tune.settings) == {name: str(value) for name, value in settings.items()}
    assert tune.name == "nf1"
    assert tune.sha256 != read_tune(written(tmp_path, tune_text({"p_roll": 51}, []))).sha256


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (BOARD.replace("4.6.0", "4.5.1") + "set p_roll = 50\n", "of Betaflight 4.5.1, expected 4.6"),
        ("# INAV / MATEKF722 8.0.0 Jan  1 2025 /\nset p_roll = 50\n", "written by INAV"),
        (BOARD + "set roll_rc_rate = 7\n", "no line such as `set p_roll = 45`"),
        ("set p_roll = 50; save\n", r"mine.txt:1: 'set p_roll = 50; save', expected `set NAME = VALUE`"),
        ("set p_roll =\n", "expected `set NAME = VALUE`"),
        ("set motor_idle = high\n", "mine.txt:1: motor_idle high, expected 0 to 2000"),
        ("#" * (FILE_BYTES_MAX + 1), f"{FILE_BYTES_MAX} bytes at most"),
    ],
)
def test_a_file_that_cannot_be_flown_is_refused_with_one_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(LinkError, match=said) as failure:
        read_tune(written(tmp_path, text))
    assert "\n" not in str(failure.value)


def test_tuned_lies_beside_the_aircrafts_file_or_the_command_that_finds_it_is_told(tmp_path: Path) -> None:
    mine = tmp_path / "mine.toml"
    with pytest.raises(LinkError, match=r"pid tune --of betaflight --aircraft .*mine\.toml --out mine"):
        tune_path("tuned", str(mine))
    beside = tmp_path / "mine.betaflight.txt"
    beside.write_text("set p_roll = 40\n")
    assert tune_path("tuned", str(mine)) == beside
    assert tune_path("any/file.txt", str(mine)) == Path("any/file.txt")
    assert read_tune(tune_path("tuned", "nf1")).settings  # shipped
