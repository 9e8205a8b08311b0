"""`neuroflight board target ...`: the list of boards, and a target from a board's own configuration."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from neuroflight.cli.board import built
from neuroflight.cli.main import main
from neuroflight.toolchain.boards.board_file import read_board
from neuroflight.toolchain.boards.table import boards, find_board
from neuroflight.toolchain.image.build import find_target
from tests.toolchain.boards.betaflight import dump, header

Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *words: object) -> str:
    assert main(["board", "target", *map(str, words)]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("neuroflight: ")
    return err


def test_the_list_has_a_line_for_each_board(capsys: Capture) -> None:
    assert main(["board", "target", "list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert {line.split()[0] for line in lines if line[:1].isalnum()} >= boards().keys()
    assert any("of 180 boards can be built for" in line for line in lines)


def test_the_list_as_json_says_why_a_board_is_not_flown(capsys: Capture) -> None:
    assert main(["board", "target", "list", "--json"]) == 0
    told = {one["name"]: one for one in json.loads(capsys.readouterr().out)}
    assert told.keys() == boards().keys()
    assert told["MATEKF722"]["flies"] and told["MATEKF722"]["uarts"] == {"receiver": 2, "msp": 1, "second": 3}
    assert not told["NUCLEOF722"]["flies"] and "gyro" in told["NUCLEOF722"]["fault"]


def test_one_board_is_told_with_what_serves_what(capsys: Capture) -> None:
    assert main(["board", "target", "list", "SPEEDYBEEF7MINI"]) == 0
    told = capsys.readouterr().out
    assert "PB4 PB5 PB0 PB1" in told and "SPI1_RX DMA2 S2" in told
    assert main(["board", "target", "list", "NUCLEOF722"]) == 1
    assert "no: where its gyro is wired to" in capsys.readouterr().out


def test_a_dump_becomes_a_target_that_is_built_as_the_tables(tmp_path: Path, capsys: Capture) -> None:
    board = find_board("SPEEDYBEEF7MINI")
    text, out = tmp_path / "dump.txt", tmp_path / "mine.toml"
    text.write_text(dump(board))
    assert main(["board", "target", "import", str(text), "--out", str(out)]) == 0
    assert f"written: neuroflight image build --target {out}" in capsys.readouterr().out
    assert find_target(str(out)).board is not None
    assert read_board(out).motors == board.motors
    assert main(["board", "target", "list", str(out)]) == 0


def test_a_target_gets_the_name_and_gyro_that_the_user_tells(tmp_path: Path, capsys: Capture) -> None:
    text, out = tmp_path / "config.h", tmp_path / "mine.toml"
    text.write_text(header(find_board("NEUTRONRCF722AIO")))
    assert main(["board", "target", "import", str(text), "--out", str(out)]) == 0
    assert "asks for --gyro-file, bmi270_maximum_fifo.c of" in " ".join(capsys.readouterr().out.split())
    words = ["--name", "MINE", "--gyro", "icm42688p", "--json"]
    assert main(["board", "target", "import", str(text), "--out", str(out), *words]) == 0
    assert json.loads(capsys.readouterr().out)["out"] == str(out)
    assert (read_board(out).name, read_board(out).gyro_kinds) == ("MINE", ("ICM42688P",))


def test_one_line_says_what_is_wrong_and_the_old_file_stays(tmp_path: Path, capsys: Capture) -> None:
    text, out = tmp_path / "dump.txt", tmp_path / "mine.toml"
    out.write_text("old")
    wrong = dump(find_board("SPEEDYBEEF7MINI")).replace("resource MOTOR 2 B05", "resource MOTOR 2 B04")
    text.write_text(wrong)
    assert "motor 2: PB4 serves motor 1; nothing was written" in refused(capsys, "import", text, "--out", out)
    assert "expected one of MPU6500" in refused(capsys, "import", text, "--gyro", "L3GD20")
    assert "name '../up', expected" in refused(capsys, "import", text, "--name", "../up")
    assert "cannot be read" in refused(capsys, "import", tmp_path)
    assert out.read_text() == "old"
    out.write_text('name = "X"\n')
    assert f"{out}: " in refused(capsys, "list", out)


@pytest.mark.parametrize("words", [["flash"], ["rescue"]])
def test_no_image_is_guessed_where_several_boards_are_built(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.setattr(built, "BUILD", tmp_path)
    assert built.built_image("neuroflight.hex") == tmp_path / "MATEKF722" / "neuroflight.hex"
    for name in ("ONE", "OTHER"):
        (tmp_path / name).mkdir()
        for file in ("neuroflight.hex", "neuroflight.nfi"):
            (tmp_path / name / file).write_bytes(b"")
        if name == "ONE":
            assert built.built_image("neuroflight.hex") == tmp_path / "ONE" / "neuroflight.hex"
    assert main(["board", *words, "--port", "tcp:localhost:1"]) == 1
    told = capsys.readouterr().err
    assert "images of several boards are built, ONE, OTHER; name the one" in told
    assert told.count("nothing was written") == 1 == told.count("\n")


def test_what_is_flown_is_the_board_that_was_built_for_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(built, "BUILD", tmp_path)
    assert built.built_last() == tmp_path / "MATEKF722"
    for name, target in (("ONE", "ONE"), ("MINE", "mine.toml")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "neuroflight.bin").write_bytes(b"")
        built.note_built(name, target)
        assert built.built_last() == tmp_path / name
    assert (tmp_path / "built").read_text() == f"MINE\n{Path('mine.toml').resolve()}\n"
    assert built.host_is_older()
    (tmp_path / "HOST").mkdir()
    (tmp_path / built.HOST_REPORT).write_text("")
    os.utime(tmp_path / "built", (1, 1))
    assert not built.host_is_older()
    for wrong in ("GONE\n", "", "\xff"):
        (tmp_path / "built").write_text(wrong, encoding="latin-1")
        assert built.built_last() == tmp_path / "MATEKF722"
