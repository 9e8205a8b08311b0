"""What `neuroflight compare` refuses: in one line, before anything is flown or written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.refusal import refused

Capture = pytest.CaptureFixture[str]
LOAD = "60@0.04,0,0.02"
REFUSED = {  # by the words before: words after, what is told
    "compare pid": (
        ("pid", "2 controllers, 1 of them different, expected 1 to 8 different ones"),
        (" ".join(f"{n}.onnx" for n in range(8)), "9 controllers, 9 of them different"),
        ("--throttle 0 1.5", "--throttle 1.5, expected 0 to 1"),
        (f"--throttle{21 * ' 0.5'}", "--throttle: 21 values, expected 1 to 20"),
        ("--thrust 1 --throttle 1", "--throttle: --thrust finds each controller's throttle"),
        ("--episodes 0", "--episodes 0, expected 1 to 4096"),
        ("--episodes 99999", "--episodes 99999, expected 1 to 4096"),
        ("--seed -1", "--seed -1, expected 0 or more"),
        ("--delay nan", "--delay nan, expected 0 to 0.1 s"),
        ("--idle nan", "--idle nan, expected 0 to 0.5"),
        ("none.onnx", "none.onnx"),
        ("pid:best", "no PID 'best'"),
        ("pilot.csv", "no ONNX model: it is text"),
        ("--envelope a.png", "--envelope: draws --task envelope, without --thrust"),
        ("--envelope a.pdf", "a.pdf: expected a name that ends in .png"),
        ("--plot a.pdf", "a.pdf: expected a name that ends in .png"),
        ("--command 10 0 3000", "--command 3000.0, expected -1000 to 1000"),
        ("--command 0 0 nan", "--command nan"),
        ("--command 0 0 0", "expected a rate other than 0"),
        ("--task continuous --command 1 2 3", "got continuous"),
        ("--task episodic --limit 9 --command 1 2 3", "--max-rate: of random commands"),
        ("--length 15", "--length 15.0, expected 20 to 600"),
        ("--task pulse --length 5", "or the pilot's with --sigma, got pulse"),
        ("--max-rate 50", "--max-rate: of the episodic and the continuous task, got flight"),
        ("--task flight --command 1 2 3", "got flight"),
        ("--episodes 1700", "170 episodes of 60 s, expected at most 10000 s together"),
        ("--task continuous --length 0", "--length 0.0, expected 0.1 to 600"),
        ("--task continuous --length 600 --episodes 17", "17 episodes of 600 s"),
        ("--average", "--average: 0 policies, expected at least 2"),
        ("--suite pulses --task pulse", "--task: --suite pulses says what is flown"),
        ("--one --throttle 0 1", "--one: expected one controller"),
        ("pid:tuned --one", "--one: expected one controller"),
        ("--commands pilot.csv --limit 5", "--max-rate: the commands are those of pilot.csv"),
        ("--commands pilot.csv --task pulse", "--task: the commands are those of pilot.csv; leave it out"),
        ("--commands pilot.csv --episodes 3", "--episodes: the commands are those of pilot.csv"),
        ("--commands pilot.csv --piece 0.01", "--piece 0.01, expected 0.1 to 3600"),
        ("--commands none.csv", "recording none.csv: no such file"),
        ("--piece 3", "--piece: of recorded commands; give them with --commands"),
        ("--from 1", "--from: of recorded commands; give them with --commands"),
        ("--commands pilot.csv --from 9", "pilot has no row from 9 s to its end; it is 0.010 s long"),
        ("--commands pilot.csv --header rates", "--header: got 'rates', expected NAME=VALUE"),
    ),
    "compare --one pid": (
        ("--throttle 1.5", "--throttle 1.5"),
        ("--battery 2", "--battery 2, expected 0 to 1"),
    ),
    "compare --suite manoeuvres pid": (
        ("pid", "2 controllers, 1 of them different"),
        ("pid:none", "no PID 'none'"),
        ("nowhere.onnx", "nowhere.onnx"),
        ("--seeds 0", "--seeds 0, expected 1 to 100"),
        ("--battery 1.5", "--battery 1.5, expected 0 to 1"),
        ("--gust -1", "--gust -1"),
        ("--jobs 0", "--jobs 0, expected 1 to 1024"),
        ("--plot rates.pdf", "ends in .png"),
    ),
    "compare --suite failures pid": (
        ("--fail 5=1", "--fail 5=1: expected MOTOR=SHARE, a motor of 1 to 4"),
        ("--fail 1=0", "--fail 1=0: expected MOTOR=SHARE"),
        ("--fail 1=1.5", "--fail 1=1.5: expected MOTOR=SHARE"),
        ("--fail 1=nan", "--fail 1=nan: expected MOTOR=SHARE"),
        ("--fail first", "--fail first: expected MOTOR=SHARE"),
        ("--fail 1=0.5 --fail 1=0.5", "2 cases, 1 of them different"),
        ("--payload heavy", "heavy"),
        ("--drop 50@0.04,0", "50@0.04,0"),
        (f"--shift {LOAD}", "60"),
        ("--at nan", "--at nan, expected 0.1 to 60"),
        ("--after 0.1", "--after 0.1, expected 0.5 to 60"),
        ("--episodes 0", "--episodes 0, expected 1 to 4096"),
        ("--throttle 1.1", "--throttle 1.1, expected 0 to 1"),
        ("--limit 900", "--max-rate 900, expected 0 to 500"),
        ("--seed -1", "--seed -1, expected 0 or more"),
        ("betaflight --give-up-yaw", "--give-up-yaw: Betaflight cannot be told to"),
        ("--plot errors.pdf", "ends in .png"),
        ("--aircraft none.toml", "none.toml"),
    ),
    "compare --suite robustness pid": (
        ("--episodes 1", "--episodes 1, expected 2 to 1500"),
        ("--task pulse --episodes 5000", "--episodes 5000, expected 2 to 4096"),
        ("--task pulse --draws 820", "--draws 820, expected 0 to 819"),
        ("--draws 301", "--draws 301, expected 0 to 300"),
        ("--throttle-max nan", "--throttle-max nan, expected 0 to 1"),
        ("--seed -1", "--seed -1, expected 0 or more"),
    ),
    "compare --suite power": (
        ("", "no controller; expected policies, pid, pid:NAME, or betaflight"),
        ("pid --battery nan", "--battery nan, expected 0 to 1"),
        ("pid --seconds 0", "--seconds 0, expected 0.1 to 60"),
        ("pid --thrust 21", "--thrust 21, expected 0 to 20"),
        ("pid --plot power.jpg", "power.jpg: expected a name that ends in .png"),
    ),
}


@pytest.mark.parametrize(
    ("words", "message"),
    [(f"{first} {words}", told) for first, cases in REFUSED.items() for words, told in cases],
)
def test_a_mistake_is_one_line_before_anything_is_flown(
    words: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pilot.csv").write_text(
        "t_s,roll_deg_s,pitch_deg_s,yaw_deg_s,throttle\n0,0,0,0,0\n0.01,0,0,0,0"
    )
    monkeypatch.setattr(
        "neuroflight.training.evaluation.controllers.record", lambda *_, **__: pytest.fail("it was flown")
    )
    assert message in refused(capsys, words.split())
    assert [path.name for path in tmp_path.iterdir()] == ["pilot.csv"]
