"""A log on the board's card, fetched over its line, is what a computer finds on the card."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from neuroflight.cli.fly import ports as fly_ports
from neuroflight.cli.main import main
from tests.cli.test_board import Running
from tests.flights.test_blackbox_cycle import STORY, new_card


@pytest.mark.slow
def test_the_boards_log_is_fetched_as_the_card_has_it(
    board_image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(fly_ports, "BOARD", board_image.parent)
    card, got, story = new_card(tmp_path / "card.img"), tmp_path / "got", tmp_path / "story.toml"
    got.mkdir()
    story.write_text(STORY)
    assert main(["fly", "--on", "emulator", "--card", str(card), "--scenario", str(story)]) == 0
    capsys.readouterr()
    assert main(["log", "card", str(card), "--list"]) == 0
    assert "1 with a log, 1 empty" in capsys.readouterr().out
    board = Running(board_image.with_suffix(".bin"), "--card", str(card))
    try:
        port = ["--port", f"serial:{board.port}:{board.baud}", "--out", str(got)]
        # Files with logs are looked at behind the first empty one: the tool waits for that.
        assert main(["board", "logs", "fetch", *port]) == 0
    finally:
        board.end()
    taken = ["mcopy", "-i", str(card), "::LOG00001.BBL", str(tmp_path / "whole.bbl")]
    subprocess.run(taken, check=True, timeout=60)
    data, whole = (got / "LOG00001.BBL").read_bytes(), (tmp_path / "whole.bbl").read_bytes()
    assert data.endswith(b"End of log\0") and whole.startswith(data) and not any(whole[len(data) :])
