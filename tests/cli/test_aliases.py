"""Words of before: each is an alias, told in one line, and says the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from neuroflight.cli.main import main, parse
from neuroflight.cli.tree import ALIASES, COMMANDS, NOUNS, find, leaf_parser, rewritten
from tests import nothing_lost

Capture = pytest.CaptureFixture[str]


def test_every_old_word_leads_to_a_command() -> None:
    for old in ALIASES:
        words = [word.replace("*", "image") for word in old.split()]
        line, told = rewritten([*words, "x"] if words[-1].startswith("--") else words)
        assert find(line)[0] in COMMANDS or " ".join(line) in NOUNS, old
        assert told.startswith("'") and " is now '" in told, old


def test_words_of_today_are_no_alias_and_have_help(capsys: Capture) -> None:
    for words in COMMANDS:
        assert rewritten([*words.split(), "--help"]) == ([*words.split(), "--help"], "")
        with pytest.raises(SystemExit) as ended:
            main([*words.split(), "--help"])
        assert ended.value.code == 0 and f"usage: neuroflight {words} " in capsys.readouterr().out, words
        assert leaf_parser(words).description, words


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("board", "image emulate"),
        ("board --image a.bin --seconds 3", "image emulate --image a.bin --seconds 3"),
        ("msp --port P set a=1 b=2 --save", "board settings set a=1 b=2 --save --port P"),
        ("msp get a -- b", "board settings get a -- b"),
        ("msp --port=P info", "board info --port=P"),
        ("flash --port P --policy a.onnx --dry-run", "board policy swap a.onnx --dry-run --port P"),
        ("flash --policy=a.onnx", "board policy swap a.onnx"),
        ("flash --list --port P", "board policy list --port P"),
        ("flash a.hex --rom", "board rescue a.hex"),
        ("log list --port P", "board logs list --port P"),
        ("timing a/b.bin --count 2", "image time a/b.bin --count 2"),
        ("timing a.onnx", "policy time a.onnx"),
    ],
)
def test_a_line_of_before_is_the_line_of_today(old: str, new: str) -> None:
    assert rewritten(old.split())[0] == new.split()


def test_a_line_of_today_keeps_its_words() -> None:
    for line in ("board info --port P", "log list a.bbl", "board --help", "policy check a --aircraft b"):
        assert rewritten(line.split()) == (line.split(), "")
    assert parse(["board", "--port", "P", "info"]).port == "P"


def test_one_line_tells_the_new_words_where_all_went_well(tmp_path: Path, capsys: Capture) -> None:
    assert main(["compile", "training/policies/nf1/policy.onnx", "--out", str(tmp_path)]) == 0
    assert capsys.readouterr().err == "neuroflight: 'compile' is now 'policy compile'\n"
    assert main(["twin", "noise", "none.csv"]) == 1
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("polcy", "did you mean policy?"),
        ("policy trian", "did you mean train?"),
        ("decode a.bbl", "did you mean log decode?"),
        ("fly --sceanrio roll", "did you mean --scenario?"),
        ("fly --on hsot", "did you mean host?"),
        ("adapt flight.npz", "'adapt' is gone: aircraft sync LOG"),
        ("policy adapt flight.npz", "neuroflight policy: 'adapt' is gone: aircraft sync LOG"),
        ("", "usage: neuroflight COMMAND"),
        ("board settings", "usage: neuroflight board settings COMMAND"),
    ],
)
def test_what_is_meant_is_suggested(line: str, told: str, capsys: Capture) -> None:
    with pytest.raises(SystemExit) as ended:
        main(line.split())
    assert ended.value.code == 2 and told in capsys.readouterr().err


def test_the_help_of_all_fits_a_screen(capsys: Capture) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and "  policy " in "\n".join(lines)


@pytest.mark.slow
def test_nothing_is_lost_since_the_words_of_before() -> None:
    assert nothing_lost.main() == 0
