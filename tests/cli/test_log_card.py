"""`neuroflight log card` as a user calls it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from neuroflight.cli.main import main
from tests.flash.card.conftest import MEBIBYTE, MakeImage, fsck, put
from tests.flash.card.conftest import card_image as card_image

LOG = b"H Product:Blackbox\n" + bytes(range(1, 256)) * 30


def log_card(capsys: pytest.CaptureFixture[str], *words: str | Path) -> tuple[int, str, str]:
    """Exit code and what was printed."""
    code = main(["log", "card", *map(str, words)])
    told = capsys.readouterr()
    return code, told.out, told.err


def test_a_card_is_prepared_listed_and_emptied_of_what_was_copied(
    card_image: MakeImage, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = card_image()
    assert log_card(capsys, image, "--list")[1].startswith(f"{image}: no file for logs")
    code, told, _ = log_card(capsys, image, "--files", "2", "--size", "1")
    assert (code, told) == (0, f"{image}: 2 new, of 1 MB each; 0 with a log, 2 empty\n")
    put(image, "LOG00001.BBL", LOG)
    code, told, _ = log_card(capsys, image, "--files", "2", "--size", "1")
    assert "kept: LOG00001.BBL, a log is in it\n" in told and "1 new" in told
    code, told, _ = log_card(capsys, image, "--list", "--json")
    assert json.loads(told)[0] == {"name": "LOG00001.BBL", "bytes": MEBIBYTE, "log": True, "whole": True}
    copies = tmp_path / "copies"
    copies.mkdir()
    code, told, _ = log_card(capsys, image, "--clear", "--copies", copies)
    assert code == 0 and "kept, no whole copy" in told and "nothing to empty" in told
    (copies / "LOG00001.BBL").write_bytes(LOG)
    before = image.read_bytes()
    code, _, line = log_card(capsys, image, "--clear", "--copies", copies)
    assert code == 1 and "give --yes; nothing was written" in line
    assert image.read_bytes() == before
    code, told, _ = log_card(capsys, image, "--clear", "--copies", copies, "--yes", "--json")
    emptied = {"copies": {"LOG00001.BBL": str(copies / "LOG00001.BBL")}, "emptied": ["LOG00001.BBL"]}
    assert code == 0 and json.loads(told) == emptied
    assert log_card(capsys, image, "--list")[1].endswith("0 with a log, 3 empty\n")
    fsck(image)


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (("--size", "0"), "--size 0, expected 1 to 4095 MB"),
        (("--files", "0"), "--files 0, expected 1"),
        ((), "expected a card's with FAT32; name the folder where the card is mounted"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: tuple[str, ...], line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, told, error = log_card(capsys, tmp_path, *words)
    assert code == 1 and told == "" and line in error and error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
