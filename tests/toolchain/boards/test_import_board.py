"""Boards from Betaflight's files: the same as the table's, and one line about what is wrong."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from neuroflight.toolchain.boards.board_file import board_text, read_board
from neuroflight.toolchain.boards.facts import Board, GyroPlace, Pin
from neuroflight.toolchain.boards.import_board import differences, import_board
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.errors import WiringError
from tests.sampling import examples
from tests.toolchain.boards.betaflight import dump, header

KNOWN = [board for board in boards().values() if board.gyros and board.gyro_kinds]
DUMPED = ("MATEKF722SE", "SPEEDYBEEF7MINI", "KAKUTEF7MINIV3")  # a card; a flash chip; two ports of motors
MATEK = find_board("MATEKF722SE")


def imported(folder: Path, text: str | bytes, name: str = "board.txt") -> Board:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return import_board(path).board


def refusal(folder: Path, text: str | bytes) -> str:
    with pytest.raises(WiringError) as refused:
        imported(folder, text)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 400
    return str(refused.value)


@pytest.mark.parametrize("name", DUMPED)
def test_a_dump_of_a_known_board_is_the_tables(tmp_path: Path, name: str) -> None:
    board = find_board(name)
    got = imported(tmp_path, dump(board))
    assert (
        replace(got, flash_kinds=board.flash_kinds, receiver=board.receiver) == board
    )  # it does not tell these


def test_each_board_is_the_same_after_a_config_h(tmp_path: Path) -> None:
    for board in KNOWN:
        got = imported(tmp_path, header(board))
        assert replace(got, gyro_kinds=board.gyro_kinds) == board, differences(got, board)
        assert set(got.gyro_kinds) == set(board.gyro_kinds)


def test_each_board_is_the_same_after_a_file_of_ours(tmp_path: Path) -> None:
    path = tmp_path / "board.toml"
    for board in KNOWN:
        path.write_text(board_text(board, ("from a test",)))
        assert read_board(path) == board


def test_the_gyro_that_betaflight_uses_comes_first(tmp_path: Path) -> None:
    places = (GyroPlace(1, Pin("B", 2), Pin("C", 4), 7), GyroPlace(2, Pin("C", 15), Pin("C", 3), 4))
    board = replace(MATEK, gyros=places)
    for told in ("set gyro_to_use = SECOND", "set gyro_enabled_bitmask = 2"):
        assert imported(tmp_path, f"{dump(board)}{told}\n").gyros == places[::-1]
    for told in ("set gyro_to_use = FIRST", "set gyro_to_use = BOTH", "set gyro_enabled_bitmask = 3", ""):
        assert imported(tmp_path, f"{dump(board)}{told}\n").gyros == places
    for told, wanted in (("GYRO_CONFIG_USE_GYRO_2", places[::-1]), ("GYRO_CONFIG_USE_GYRO_BOTH", places)):
        assert imported(tmp_path, f"{header(board)}#define DEFAULT_GYRO_TO_USE {told}\n").gyros == wanted


def test_a_receivers_uart_is_that_of_the_serial_line(tmp_path: Path) -> None:
    for line, uart in (
        ("serial 3 64 115200 57600 0 115200", 4),
        ("serial UART6 64 115200 57600 0 115200", 6),
    ):
        assert imported(tmp_path, f"{dump(MATEK)}{line}\n").receiver == uart
    assert imported(tmp_path, dump(MATEK) + "serial 3 1 115200 57600 0 115200\n").receiver is None


def test_a_pin_that_is_named_by_another_name_is_found(tmp_path: Path) -> None:
    text = (
        header(MATEK).replace("GYRO_1_CS_PIN PB2", "GYRO_1_CS_PIN SPI1_NSS_PIN")
        + "#define SPI1_NSS_PIN PB2\n"
    )
    assert imported(tmp_path, text).gyros == MATEK.gyros
    looped = text.replace("SPI1_NSS_PIN PB2", "SPI1_NSS_PIN GYRO_1_CS_PIN")
    assert "GYRO_CS 1: pin" in refusal(tmp_path, looped)


def test_utf_16_of_a_windows_editor_is_read(tmp_path: Path) -> None:
    assert imported(tmp_path, dump(MATEK).encode("utf-16")).motors == MATEK.motors


def test_the_makers_turn_of_a_board_is_taken_over_from_its_maker_alone(tmp_path: Path) -> None:
    path = tmp_path / "config.h"
    path.write_text(header(MATEK) + "#define DEFAULT_ALIGN_BOARD_YAW 315\n")
    found = import_board(path)
    assert found.board.turn_deg == (0, 0, -45)
    assert any("the board by yaw -45 deg is its maker's" in note for note in found.notes)
    path.write_text(dump(MATEK) + "set align_board_roll = 180\nset align_board_yaw = -45\n")
    found = import_board(path)
    assert found.board.turn_deg == (0, 0, 0), "the pilot's: `settings import` brings it"
    assert any("the board by roll 180, yaw -45 deg is the pilot's or" in note for note in found.notes)
    turned = find_board("GEPRC_F722_AIO")
    path.write_text(dump(turned) + "set align_board_yaw = 90\n")
    assert import_board(path).board.turn_deg == turned.turn_deg == (0, 0, 45)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("resource MOTOR 1 B04", "resource MOTOR 1 Z99"), "MOTOR 1: pin 'Z99', expected a port A to H"),
        (("gyro_1_spibus = 1", "gyro_1_spibus = 9"), "gyro_spi 1: got '9', expected SPI1 to SPI3"),
        (("align = CW180FLIP", "align = CUSTOM"), "gyro_align 1: alignment 'CUSTOM', expected CW0_DEG"),
        (
            ("vbat_scale = 110", "vbat_scale = 99999999"),
            "volts_scale: got '99999999', expected a whole number",
        ),
        (("STM32F7X2", "STM32F405"), "processor: STM32F405, expected an STM32F722"),
        (
            ("board_name MATEKF722SE", "board_name ../../etc"),
            "name: name '../../etc', expected 1 to 23 letters",
        ),
        (("board_name MATEKF722SE", ""), "it does not tell the board's name; give one with --name"),
        (("board_name MATEKF722SE", "board_name NOBODYS"), "its gyro is told to be none"),
        (("resource MOTOR", "resource SERVO"), "it tells no motor's pin"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, change: tuple[str, str], words: str) -> None:
    text = dump(MATEK)
    assert change[0] in text
    told = refusal(tmp_path, text.replace(*change))
    assert words in told and told.startswith(str(tmp_path / "board.txt"))


@pytest.mark.parametrize(
    "data",
    [b"", b"\0" * 1000, b"\xff\xfe\x00", b"\xff" * 100, b"MOTOR " * 10_000, b"#define MOTOR1_PIN\n" * 1000],
)
def test_hostile_bytes_are_refused_in_one_line(tmp_path: Path, data: bytes) -> None:
    refusal(tmp_path, data)


def test_a_file_is_refused_that_is_too_large(tmp_path: Path) -> None:
    assert "expected at most 262144" in refusal(tmp_path, b"resource MOTOR 1 B04\n" * 20_000)


WORDS = st.sampled_from(
    (
        *(
            "resource",
            "MOTOR",
            "SERIAL_TX",
            "1",
            "99",
            "B04",
            "NONE",
            "set",
            "gyro_1_spibus",
            "=",
            "-1",
            "64",
        ),
        *("#define", "serial", "MOTOR1_PIN", "PB4", "board_name", "GYRO_1_ALIGN", "CW90", "/*", "LED0_PIN"),
        *("SPI1", "\N{SNOWMAN}"),
    )
)


@settings(max_examples=examples(400), deadline=None)
@given(st.lists(st.lists(WORDS, max_size=6), max_size=30), st.booleans())
def test_lines_of_known_words_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, lines: list[list[str]], behind: bool
) -> None:
    text = "\n".join(" ".join(words) for words in lines)
    path = tmp_path_factory.getbasetemp() / "fuzzed.txt"
    path.write_text(dump(MATEK) + text if behind else text)
    try:
        import_board(path)
    except WiringError as error:
        assert "\n" not in str(error)
