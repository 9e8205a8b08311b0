"""The shipped experiments: rows, commands that are understood, and a page that says what is stored."""

from __future__ import annotations

import re
import shlex
import tomllib
from decimal import Decimal
from pathlib import Path

import pytest

from neuroflight.cli.main import main, parse
from neuroflight.cli.training import reproduce
from neuroflight.cli.training.pages import renewed
from neuroflight.sim.identification.propeller import fit_propeller
from neuroflight.sim.identification.propeller_tables import read_tables
from neuroflight.training.dissertation.quotes import quotes
from neuroflight.training.reproduction.experiments import BUDGETS, experiments
from neuroflight.training.reproduction.page import render
from neuroflight.training.reproduction.steps import PICTURES, StepOutputs
from neuroflight.training.reproduction.stored import read_stored, row_result, sources
from neuroflight.training.reproduction.verdict import Verdict, bar

ROOT = Path(__file__).resolve().parents[3]
STORED = ROOT / "docs" / "results" / "dissertation"
DRAWN = ROOT / "docs" / "dissertation"
PAGE = ROOT / "docs" / "dissertation.md"
EXTENDED = ROOT / "training" / "reproduction" / "nf1-extended.toml"
ROWS_LEAST = 60
QUOTES_LEAST = 100
VERDICTS_LEAST = 150
QUOTES = ROOT / "training" / "dissertation" / "quotes.toml"
AXES = ("roll", "pitch", "yaw")


def test_rows_cover_every_table_that_the_dissertation_measured() -> None:
    rows = experiments().rows
    assert len(rows) >= ROWS_LEAST
    tables = {place for quote in quotes() if "." in (place := quote.id.partition("/")[0])}
    named = {row.name.partition("-")[0] for row in rows}
    assert tables <= named


@pytest.mark.parametrize("budget", BUDGETS)
def test_every_command_is_one_that_the_command_line_understands(budget: str) -> None:
    outputs = StepOutputs(ROOT, Path("out"), "quick" if budget == "quick" else "full")
    for step in experiments().steps.values():
        words = outputs.words(step)
        parse([*words, *(() if words[0] in PICTURES else ("--json",))])


@pytest.mark.parametrize("budget", BUDGETS)
def test_every_flight_of_the_firmware_is_of_a_build_that_the_experiments_made(budget: str) -> None:
    steps = experiments().steps
    flights = [step for step in steps.values() if step.words("full")[0] == "fly"]
    assert flights
    for step in flights:
        words = step.words("quick" if budget == "quick" else "full")
        assert words[words.index("--build") + 1] == "{host}/HOST", step.name
        assert "host" in step.needs
    assert steps["host"].words("full")[:4] == ["image", "build", "--target", "HOST"]


SIZES = ("steps", "episodes", "count", "seeds", "seconds")  # of a command, defaults included


def sizes(words: list[str]) -> dict[str, float]:
    """The command's sizes by name; of a list how many it has."""
    args = vars(parse(words))
    given = {name: args[name] for name in SIZES if args.get(name) is not None}
    return {name: len(value) if isinstance(value, list) else float(value) for name, value in given.items()}


def test_quick_is_never_more_than_full() -> None:
    compared = set()
    for step in experiments().steps.values():
        quick, full = (sizes(StepOutputs(ROOT, Path("out"), budget).words(step)) for budget in BUDGETS)
        assert {name for name in quick if name in full and quick[name] > full[name]} == set(), step.name
        compared |= quick.keys() & full.keys()
    assert compared == set(SIZES)


def test_figures_of_the_page_are_printed_as_the_file_of_quotes_has_them() -> None:
    """Read as text, so that no zero is lost on the way."""
    document = tomllib.loads(QUOTES.read_text(), parse_float=str)
    texts: dict[str, list[str]] = {}
    for place, table in document.items():
        for name, cells in table.items() if "." in place else ():
            if name != "columns":
                pairs = [[str(n) for n in (cell if isinstance(cell, list) else [cell])] for cell in cells]
                texts[f"{place}/{name}"] = [
                    " / ".join(pair[i] for pair in pairs[:3]) for i in range(len(pairs[0]))
                ]
    cells = [line.split(" | ") for line in PAGE.read_text().splitlines() if line.startswith("| ")]
    shown = {cell[1].replace(",", "") for cell in cells if len(cell) > 2}
    figures = [figure for row in experiments().rows for figure in row.figures if figure.quote]
    whole = {figure.quote.name for figure in figures if figure.quote and figure.quote.name in texts}
    assert len(whole) >= QUOTES_LEAST
    for name in whole:
        value, *margin = texts[name]
        parts = set(margin[0].split(" / ")) if margin else set()
        text = f"{value} ± {margin[0] if len(parts) > 1 else parts.pop()}" if margin else value
        assert text in shown, name


LINE = re.compile(r"^\| .* \|$", re.MULTILINE)
BAR = re.compile(r"(<=|>=|within) ([-\d.,/ ]+?)(?: of ([-\d.,/ e]+))?")


def numbers(text: str, count: int = 0) -> list[Decimal]:
    """Those of a cell, its confidence left out; one that stands for all axes is there for each of `count`."""
    found = [Decimal(each.replace(",", "")) for each in text.partition(" ± ")[0].split(" / ")]
    return found * count if len(found) == 1 and count else found


def verdict_of(printed: str, bar: str, ours: str) -> str:
    """What follows from three cells of the page and the rule in its head, in exact decimals."""
    parts = BAR.fullmatch(bar)
    assert parts, bar
    kind, limits, ideals = parts.groups()
    his, own = numbers(printed), numbers(ours.removesuffix(" (quick)"))
    assert len(his) == len(own)
    results = []
    for theirs, mine, most, goal in zip(
        his, own, numbers(limits, len(his)), numbers(ideals or "0", len(his)), strict=True
    ):
        # What is better the less it is.
        limit, bad, printed_bad = {
            "<=": (most, mine, theirs),
            ">=": (-most, -mine, -theirs),
            "within": (most, abs(mine - goal), abs(theirs - goal)),
        }[kind]
        margin = limit - printed_bad
        assert margin > 0
        results.append("reached" if bad >= printed_bad - margin else "surpassed")
        if bad > limit:
            results[-1] = "not reached"
    missed = [axis for axis, result in zip(AXES, results, strict=False) if result == "not reached"]
    if missed:
        return "not reached" + (f": {', '.join(missed)}" if len(results) == 3 and len(missed) < 3 else "")
    return "surpassed" if set(results) == {"surpassed"} else "reached"


def test_every_verdict_follows_from_what_the_page_shows() -> None:
    judged = 0
    for table in PAGE.read_text().split("\n\n"):
        head, *lines = [line.strip("| ").split(" | ") for line in LINE.findall(table)] or [[]]
        if "bar" not in head:
            continue
        for line in lines[1:]:
            # The first cell is empty in the heading, which loses it.
            cells = dict(zip(["what", *head], [each.strip() for each in line], strict=False))
            if not cells.get("bar") or cells["ours"] == "not run":
                continue
            assert cells["verdict"] == verdict_of(cells["dissertation"], cells["bar"], cells["ours"]), line
            judged += 1
    counted = re.search(r"Of (\d+) figures with a verdict", PAGE.read_text())
    assert counted and judged == int(counted[1]) >= VERDICTS_LEAST


def test_every_printed_figure_that_is_not_an_input_has_a_bar_or_a_reason() -> None:
    for row in experiments().rows:
        for figure in row.figures:
            if figure.quote is not None and not figure.input:
                assert (bar(figure) is None) is bool(figure.unlike), (row.name, figure.what)


def test_the_page_is_what_the_stored_figures_give() -> None:
    assert PAGE.read_text() == render(experiments(), read_stored(STORED), DRAWN.name)


def test_commands_of_the_page_run_what_stands_above_them_and_nothing_else() -> None:
    known = experiments()
    places = list(dict.fromkeys(row.place for row in known.rows if not row.hardware))
    sections = re.split(
        r"^###? ", PAGE.read_text().partition("\n## What no run fills")[0], flags=re.MULTILINE
    )
    commands = [
        re.findall(r"^`neuroflight reproduce (.*) --budget full`$", each, re.MULTILINE) for each in sections
    ]
    for place, (names,) in zip(places, filter(None, commands), strict=True):
        chosen = {row.name for row in known.chosen(names.split())}
        own = {row.name for row in known.rows if row.place == place}
        # A name with which others begin chooses those, too.
        assert own <= chosen <= own | {name for name in chosen if name.partition("-")[0] in own}


def test_stored_figures_are_those_that_rows_read() -> None:
    known, kept = experiments(), read_stored(STORED)
    read = {(source.step, source.path) for row in known.rows for source in sources(row)}
    for name, step in kept.items():
        assert name in known.steps
        assert {(name, path) for path in step.figures} <= read
    lacking = {name for name, path in read if name not in kept or path not in kept[name].figures}
    assert lacking == set()


def test_stored_figures_are_of_the_commands_as_they_are_now() -> None:
    known = experiments()
    for name, step in read_stored(STORED).items():
        words = StepOutputs(ROOT, ROOT / reproduce.OUT, step.budget).words(known.steps[name])
        assert renewed(shlex.split(step.command)[1:]) == words, name


def test_pictures_of_the_page_are_there() -> None:
    drawn = {row.picture for row in experiments().rows if row.picture}
    assert {path.stem for path in DRAWN.glob("*.png")} == drawn
    assert sum(path.stat().st_size for path in DRAWN.glob("*.png")) < 4 << 20


def test_the_extended_nf1_has_the_fit_of_its_table() -> None:
    fit = fit_propeller(read_tables([EXTENDED.with_name("gws-5x4.3.csv")]).wind, degree=1)
    table = tomllib.loads(EXTENDED.read_text())
    advance = {"thrust": list(fit.advance.thrust), "torque": list(fit.advance.torque)}
    assert table["propulsion"] == {"advance_ratio": advance}
    assert set(table) == {"format", "base", "name", "description", "propulsion", "esc"}


def test_a_row_that_is_not_reached_at_the_full_budget_says_why() -> None:
    kept = read_stored(STORED)
    silent = [
        row.name
        for row in experiments().rows
        if not row.why
        and (result := row_result(row, kept)).verdict is Verdict.NOT_REACHED
        and "quick" not in result.budgets
    ]
    assert silent == []


def test_headline_rows_are_of_the_full_budget() -> None:
    kept = read_stored(STORED)
    for name in ("iris-ppo-1-flown", "nf5-flown", "nf4-flown", "timing"):
        assert kept[name].budget == "full"


def test_list_names_rows_figures_and_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "--list", "--budget", "full"]) == 0
    printed = capsys.readouterr().out.splitlines()
    rows = experiments().rows
    assert len(rows) >= 60
    for row in rows:
        assert f"{row.name}  {row.place}: {row.title}" in printed
        command = f"    neuroflight reproduce {row.name} --budget full"
        assert (command in printed) is not bool(row.hardware)
    verdict = re.compile(
        r" {4}IAE: [\d.,/ ±]+; dissertation 3,311 / 2,235 / 2,075: (reached|not reached.*); differs: .+"
    )
    assert any(verdict.fullmatch(line) for line in printed)


def test_list_of_a_row_tells_what_it_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "--list", "3.9-ppo"]) == 0
    printed = capsys.readouterr().out
    for part in (
        "Table 3.9",
        "full, not reached",
        "m = 1: ",
        "iris-ppo-1: neuroflight policy train --aircraft ",
    ):
        assert part in printed


def test_a_listed_command_can_be_typed_when_a_word_of_it_has_spaces(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["reproduce", "--list", "3.4f-ppo"]) == 0
    (line,) = (each for each in capsys.readouterr().out.splitlines() if "iris-ppo-curves: " in each)
    typed = line.partition("neuroflight ")[2]
    assert shlex.split(typed) == experiments().steps["iris-ppo-curves"].words("quick")
    assert "PPO, m = 1" in shlex.split(typed)


def test_an_unknown_row_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reproduce", "9.9"]) == 1
    assert "row '9.9': not there" in capsys.readouterr().err


def test_check_tells_whether_the_page_is_up_to_date(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", "--check"]) == 0
    stale = tmp_path / "page.md"
    stale.write_text(PAGE.read_text().replace("surpassed", "reached", 1))
    monkeypatch.setattr("neuroflight.cli.training.reproduce.PAGE", stale)
    assert main(["reproduce", "--check"]) == 1
    assert "not what the files" in capsys.readouterr().err


def test_units_in_brackets_are_printed(capsys: pytest.CaptureFixture[str]) -> None:
    (row,) = experiments().chosen(["3.4-ppo"])
    reproduce._print([row_result(row, read_stored(STORED))])
    assert "Table 3.4: Rise time [ms], mean of all agents: PPO" in capsys.readouterr().out


def test_no_text_of_a_table_is_cut(capsys: pytest.CaptureFixture[str]) -> None:
    reproduce._print([row_result(row, read_stored(STORED)) for row in experiments().rows if row.figures])
    printed = capsys.readouterr().out
    for row in experiments().rows:
        for figure in row.figures:
            assert figure.what in printed
            assert not figure.unlike or figure.unlike in printed.replace("\n", " ")
