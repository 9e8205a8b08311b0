"""A board's TOML file: what is wrong in it is told by key, in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.toolchain.boards.board_file import board_beside, board_text, named_board, read_board
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.boards.verdict import Verdict, judge
from neuroflight.toolchain.errors import WiringError

TEXT = board_text(find_board("MATEKF722SE"))
REFUSED = {  # a part of the reason, and the boards of the table that it keeps from being built for
    "where its gyro is wired to": "NUCLEOF722",
}


def test_all_boards_of_the_table_are_flown_but_these() -> None:
    refused = {name: verdict.fault for name, verdict in map(_judged, boards()) if verdict.allocation is None}
    assert refused.keys() == {name for names in REFUSED.values() for name in names.split()}
    for reason, names in REFUSED.items():
        assert all(reason in refused[name] for name in names.split())


def test_these_boards_ask_for_the_file_of_their_gyros_maker() -> None:
    asking = {name for name, verdict in map(_judged, boards()) if verdict.file}
    assert asking == {
        *("JBF7_V2", "NBD_CRICKETF7V2", "NEUTRONRCF722AIO", "RRIOT_F722"),
        *("SPEEDYBEEF7MINIV2", "SPEEDYBEEF7V3"),
    }


def _judged(name: str) -> tuple[str, Verdict]:
    return name, judge(find_board(name))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('name = "MATEKF722SE"', 'name = "HOST"', "name: got name 'HOST', expected"),
        ('name = "MATEKF722SE"', 'name = "../../x"', "name: got name '../../x', expected"),
        ('maker = "MTKS"', 'maker = "TOO-LONG"', "maker: got maker 'TOO-LONG', expected up to 7"),
        ('select = "PB2"', 'select = "PB99"', "select: got pin 'PB99', expected a port A to H"),
        ("spi = 1", "spi = 7", "spi: got 7, expected a whole number from 0 to 3"),
        (
            "[spi.1]",
            "[turn]\nyaw_deg = 45.5\n[spi.1]",
            "turn.yaw_deg: got 45.5, expected a whole",
        ),
        ('"MPU6000"', '"mpu 6000"', "gyro_kinds: got 'mpu 6000', expected a chip's name"),
        (
            'alignment = "CW180_DEG_FLIP"',
            'alignment = "CW45"',
            "alignment: got 'CW45', expected one of: CW0_DEG",
        ),
        ("volts_scale = 110", "volts_scale = 70000", "volts_scale: got 70000, expected a whole number"),
        ("[spi.3]", "[spi.4]", "spi.4: unknown key; known here: 1, 2, 3"),
        ('kind = "card"', 'kind = "tape"', "log.kind: got 'tape', expected one of: card, flash"),
        ('on = "low"', 'on = "maybe"', "led.on: got 'maybe', expected one of: low, high"),
        ("motors = [", "motors = 5 # [", "motors: got 5, expected a list of 1 to 8 texts"),
        ("motors = [", 'motors = [1, 2, "PB4"] # [', "motors.0: got 1, expected one line"),
        ("[[gyro]]", "[[gyros]]", "gyros: unknown key; known here: "),
        ("maker", "colour", "colour: unknown key"),
        ('name = "', 'name = """', "not TOML"),
    ],
)
def test_what_is_wrong_is_told_by_its_key(tmp_path: Path, old: str, new: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new, 1))
    with pytest.raises(WiringError) as refused:
        named_board(str(path))
    assert words in str(refused.value)
    assert str(refused.value).startswith(str(path)) and "\n" not in str(refused.value)


@pytest.mark.parametrize("data", [b"", b"\0", b"\xff\xfe", b"name = 'X'\n", b"x" * 70_000, b"[" * 5_000])
def test_hostile_bytes_are_refused_in_one_line(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(data)
    with pytest.raises(WiringError) as refused:
        read_board(path)
    assert "\n" not in str(refused.value) and len(str(refused.value)) < 400


def test_an_image_is_wired_as_the_file_beside_it_where_that_is_of_its_board(tmp_path: Path) -> None:
    image = tmp_path / "neuroflight.bin"
    assert board_beside(image, "MATEKF722SE") == find_board("MATEKF722SE")
    image.with_name("board.toml").write_text(TEXT.replace('"PB2"', '"PB6"', 1).replace("SE", "OWN", 1))
    assert str(board_beside(image, "MATEKF722OWN").gyros[0].select) == "PB6"
    assert board_beside(image, "MATEKF722") == find_board("MATEKF722")
    with pytest.raises(WiringError, match="unknown board 'ANOTHER'"):
        board_beside(image, "ANOTHER")
