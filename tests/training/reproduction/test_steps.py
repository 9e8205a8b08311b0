"""Steps run once, in order, and go on after a failure or an interruption."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from neuroflight.cli.training.pages import renewed
from neuroflight.training.reproduction.experiments import Experiments, ReproduceError, Step, parse
from neuroflight.training.reproduction.inputs import inputs
from neuroflight.training.reproduction.steps import Done, StepOutputs, Watcher, execute_here, run_steps

TEXT = """
[steps]
train = "policy train --steps <10|1000> --out {out}"
fly = "compare {train}/policy.onnx --plot {plot}"
alone = '''
dyno run
  --episodes 5'''
[rows."3.9-ppo"]
title = "Table 3.9: Rise time: PPO"
picture = "fly"
"m = 1" = { quote = "3.9/ppo-1", ours = "fly a.b", aim = "lower" }
"it" = { ours = "alone c" }
[rows."4.7"]
title = "Table 4.7: Real flights"
hardware = "no aircraft"
"""


@pytest.fixture
def known() -> Experiments:
    """Three steps and two rows."""
    return parse(TEXT, "test")


class Commands:
    """Answers commands; those that name a word of `broken` fail."""

    def __init__(self, *broken: str) -> None:
        self.seen: list[list[str]] = []
        self.broken = broken
        self._lock = threading.Lock()

    def __call__(self, words: Sequence[str], folder: Path, stop: Callable[[], bool]) -> str:
        """Run a command."""
        with self._lock:
            self.seen.append(list(words))
        if words[0] in self.broken:
            raise ReproduceError(f"{words[0]} ended with 1")
        if "--plot" in words:
            (folder / words[words.index("--plot") + 1]).write_bytes(b"png")
        return json.dumps({"a": {"b": 5.0}, "c": 7, "words": list(words)})


class Seen(Watcher):
    """Keeps what it is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    def outdated(self, step: Step, name: str) -> None:
        """See Watcher."""
        self.told.append(f"{step.name}: {name} changed")

    def finished(self, done: Done, *, again: bool) -> None:
        """See Watcher."""
        self.told.append(f"{done.step.name} {'ran' if again else 'was there'}")

    def failed(self, step: Step, reason: str) -> None:
        """See Watcher."""
        self.told.append(f"{step.name} failed: {reason}")


def run(
    known: Experiments, out: Path, commands: Commands, *, force: bool = False, jobs: int = 1
) -> list[str]:
    """Run all rows' steps; what was told."""
    seen = Seen()
    outputs = StepOutputs(out, out, "quick")
    run_steps(known.plan(known.rows), outputs, jobs=jobs, force=force, execute=commands, watcher=seen)
    return seen.told


def test_what_a_step_needs_runs_before_it(known: Experiments, tmp_path: Path) -> None:
    commands = Commands()
    told = run(known, tmp_path, commands, jobs=2)
    assert told.index("train ran") < told.index("fly ran")
    words = {words[0]: words for words in commands.seen}
    assert words["compare"][1] == "quick/train/policy.onnx"
    assert words["policy"][-1] == "--json"
    assert words["dyno"] == ["dyno", "run", "--episodes", "5", "--json"]


def test_what_lies_outside_the_project_has_its_whole_path(known: Experiments, tmp_path: Path) -> None:
    outputs = StepOutputs(tmp_path / "project", tmp_path / "results", "quick")
    assert outputs.words(known.steps["fly"])[1] == str(tmp_path / "results/quick/train/policy.onnx")


def test_finished_steps_are_not_repeated_unless_forced(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands())
    again = Commands()
    assert sorted(run(known, tmp_path, again)) == ["alone was there", "fly was there", "train was there"]
    assert again.seen == []
    run(known, tmp_path, again, force=True)
    assert len(again.seen) == 3


def test_another_command_is_another_result(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands())
    changed = parse(TEXT.replace("--episodes 5", "--episodes 6"), "test")
    again = Commands()
    run(changed, tmp_path, again)
    assert [words[0] for words in again.seen] == ["dyno"]


RECIPE = TEXT.replace("train --steps <10|1000> ", "train --config recipe.toml ")


def test_another_content_of_a_recipe_is_another_result(tmp_path: Path) -> None:
    known = parse(RECIPE, "test")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text("steps = 5")
    run(known, tmp_path, Commands())
    recipe.write_text("# five\nsteps  = 5\n")
    again = Commands()
    assert sorted(run(known, tmp_path, again)) == ["alone was there", "fly was there", "train was there"]
    recipe.write_text("steps = 6")
    told = run(known, tmp_path, again)
    assert sorted(told) == ["alone was there", "fly ran", "train ran", "train: recipe.toml changed"]
    recipe.unlink()
    assert "train: recipe.toml changed" in run(known, tmp_path, again)


def test_the_output_of_another_step_that_was_replaced_is_another_input(
    known: Experiments, tmp_path: Path
) -> None:
    run(known, tmp_path, Commands())
    policy = tmp_path / "quick/train/policy.onnx"
    policy.parent.mkdir(exist_ok=True)
    policy.write_bytes(b"another")
    told = run(known, tmp_path, Commands())
    assert "fly: quick/train/policy.onnx changed" in told and "train was there" in told


def test_a_checkpoint_of_another_recipe_is_removed(tmp_path: Path) -> None:
    known = parse(RECIPE, "test")
    recipe = tmp_path / "recipe.toml"
    recipe.write_text("steps = 5")
    run(known, tmp_path, Commands("policy"))
    checkpoint = tmp_path / "quick/train/checkpoint.pt"
    checkpoint.parent.mkdir(exist_ok=True)
    checkpoint.write_bytes(b"half")
    recipe.write_text("steps = 6")
    again = Commands()
    run(known, tmp_path, again)
    assert "--resume" not in again.seen[0] and not checkpoint.exists()


def test_recipes_and_aircraft_of_the_project_are_inputs_by_their_names(tmp_path: Path) -> None:
    words = ["train", "--aircraft", "iris", "--config", "dissertation-5", "--set", "x" * 5000, "a\0b", "nf1"]
    words += ["--aircraft", "y" * 5000]
    assert sorted(inputs(words, tmp_path)) == ["dissertation-5", "iris"]
    assert inputs(["--aircraft", "nf1"], tmp_path) != inputs(["--config", "nf1"], tmp_path)


def test_a_result_without_inputs_is_run_again(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands())
    record = tmp_path / "quick/alone.json"
    good = json.loads(record.read_text())
    assert "alone was there" in run(known, tmp_path, Commands())
    without = {key: value for key, value in good.items() if key != "inputs"}
    wrong: object
    for wrong in (without, None, [], {**good, "inputs": [1]}, {**good, "words": 5}):
        record.write_text(json.dumps(wrong))
        assert "alone ran" in run(known, tmp_path, Commands())


def test_results_of_a_command_by_its_name_of_before_are_known(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands("compare"))
    for name in ("train.json", "train.started"):
        path = tmp_path / "quick" / name
        record = json.loads(path.read_text())
        assert renewed(record["words"][1:]) == record["words"]
        path.write_text(json.dumps({**record, "words": record["words"][1:]}))
    outputs = StepOutputs(tmp_path, tmp_path, "quick", renewed)
    again = Commands()
    run_steps(known.plan(known.rows), outputs, jobs=1, execute=again)
    assert [words[0] for words in again.seen] == ["compare"]
    (tmp_path / "quick/train.json").unlink()
    (tmp_path / "quick/train").mkdir()
    (tmp_path / "quick/train/checkpoint.pt").write_bytes(b"half")
    run_steps(known.plan(known.rows), outputs, jobs=1, execute=again)
    assert again.seen[1][-2:] == ["--resume", "--json"]


def test_a_failed_step_takes_with_it_only_those_that_need_it(known: Experiments, tmp_path: Path) -> None:
    told = run(known, tmp_path, Commands("policy"))
    assert "train failed: policy ended with 1" in told
    assert "fly failed: needs train" in told
    assert "alone ran" in told


def test_a_training_goes_on_with_its_last_checkpoint(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands("policy"))
    folder = tmp_path / "quick/train"
    folder.mkdir(exist_ok=True)
    (folder / "checkpoint.pt").write_bytes(b"half")
    again = Commands()
    run(known, tmp_path, again)
    assert again.seen[0][-2:] == ["--resume", "--json"]
    assert (folder / "checkpoint.pt").is_file()


def test_a_checkpoint_of_another_command_is_removed(known: Experiments, tmp_path: Path) -> None:
    run(known, tmp_path, Commands("policy"))
    folder = tmp_path / "quick/train"
    folder.mkdir(exist_ok=True)
    (folder / "checkpoint.pt").write_bytes(b"half")
    changed = parse(TEXT.replace("--steps <10|", "--steps <11|"), "test")
    again = Commands()
    run(changed, tmp_path, again)
    assert "--resume" not in again.seen[0]
    assert not (folder / "checkpoint.pt").exists()


def test_a_command_that_fails_is_told_with_its_last_line(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[3]
    with pytest.raises(ReproduceError, match=r"no-such.*ended with 2: neuroflight: no command 'no-such'"):
        execute_here(["no-such", "--aircraft", "nf1"], root, lambda: False)


def test_a_command_is_stopped_on_request() -> None:
    root = Path(__file__).resolve().parents[3]
    with pytest.raises(ReproduceError, match="stopped"):
        execute_here(["evaluate", "pid", "--episodes", "1000", "--json"], root, lambda: True)


PATTERNS = """
[each.way]
up = { word = "--up", label = "Up" }
down = { word = "", label = "Down" }
[each.m]
1 = {}
2 = {}
[steps]
"<way>-<m>" = "train <way.word> --set m=<m> <--seeds 2|--seed 4 --seeds 3> --out {out}"
"<way>-<m>-flown" = "compare pid {<way>-<m>/*} --episodes <2|30>"
[rows."3.9-<way>"]
title = "Table 3.9: Rise: <way.label>"
"m = <m>" = { quote = "3.9/ppo-<m>", ours = "<way>-<m>-flown a", aim = "lower" }
"once" = { ours = "<way>-1-flown b" }
"""


def test_a_pattern_stands_for_each_of_its_values() -> None:
    known = parse(PATTERNS, "test")
    assert list(known.steps) == [
        f"{way}-{m}{end}" for end in ("", "-flown") for way in ("up", "down") for m in (1, 2)
    ]
    assert known.steps["up-2"].quick == "train --up --set m=2 --seeds 2 --out {out}"
    assert known.steps["down-1"].full == "train --set m=1 --seed 4 --seeds 3 --out {out}"
    flown = known.steps["up-2-flown"]
    assert flown.quick == "compare pid {up-2}/seed-1/policy.onnx {up-2}/seed-2/policy.onnx --episodes 2"
    seeds = " ".join(f"{{up-2}}/seed-{seed}/policy.onnx" for seed in (4, 5, 6))
    assert flown.full == f"compare pid {seeds} --episodes 30"
    assert flown.needs == ("up-2",)
    rows = {row.name: row for row in known.rows}
    assert [row.title for row in rows.values()] == ["Rise: Up", "Rise: Down"]
    figures = [(each.what, each.ours.step) for each in rows["3.9-down"].figures]
    assert figures == [("m = 1", "down-1-flown"), ("m = 2", "down-2-flown"), ("once", "down-1-flown")]


def test_a_training_of_one_seed_leaves_its_policy_in_its_own_folder() -> None:
    known = parse(PATTERNS.replace("--seed 4 --seeds 3", "--seeds 1"), "test")
    assert known.steps["up-2-flown"].full == "compare pid {up-2}/policy.onnx --episodes 30"


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ("<way.word>", "<way.wrd>", "way up has no wrd"),
        ('"3.9-<way>"', '"3.9-x"', "<way> is in no name"),
        (
            'title = "Table 3.9: Rise: <way.label>"',
            'title = "Table 3.9"\nwhy = { "3.9-left" = "x" }',
            "why 3.9-left: no such row",
        ),
    ],
)
def test_a_mistake_in_a_pattern_is_named(before: str, after: str, named: str) -> None:
    assert before in PATTERNS
    with pytest.raises(ReproduceError) as caught:
        parse(PATTERNS.replace(before, after), "test")
    assert named in str(caught.value)


@pytest.mark.parametrize(
    ("before", "after", "named"),
    [
        ("{train}/policy", "{trian}/policy", "needs {trian}, which is no step"),
        ('"policy train --steps <10|1000> --out {out}"', '"train {fly}"', "needs itself"),
        ('quote = "3.9/ppo-1"', 'quote = "3.9/ppo-9"', "no quote '3.9/ppo-9'"),
        ('ours = "fly a.b"', 'ours = "fyl a.b"', "fyl"),
        ('aim = "lower"', 'aim = "better"', "expected one of: lower"),
        (', aim = "lower"', "", "expected one of: an aim, unlike = 'why', or a row of input"),
        ('aim = "lower"', 'aim = "lower", unlike = "x"', "unlike: unknown key"),
        ('ours = "alone c"', 'ours = "alone c", aim = "lower"', "no quote to reach"),
        ('quote = "3.9/ppo-1"', 'quote = "3.9/ppo-1", quote_per = "3.12/pid"', "may be 0"),
        ('picture = "fly"', 'picture = "alone"', r"expected a step whose command has {plot}"),
        ('rows."4.7"', "rows.nine", "expected such as 3.9"),
        ('"Table 4.7: Real flights"', '"Real flights"', "expected PLACE: TITLE"),
        ('hardware = "no aircraft"', 'hardwear = "no aircraft"', "hardwear"),
        ('hardware = "no aircraft"', "", "4.7.title: 0 figures below it, expected 1 to"),
        ('"it" = { ours = "alone c" }', "", "alone: no row"),
    ],
)
def test_a_mistake_in_the_file_is_named(before: str, after: str, named: str) -> None:
    assert before in TEXT
    with pytest.raises(ReproduceError) as caught:
        parse(TEXT.replace(before, after), "test")
    assert named in str(caught.value)
