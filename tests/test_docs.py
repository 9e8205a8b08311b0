"""What the pages promise: no broken link, commands that are understood, a reference as the code is."""

from __future__ import annotations

import argparse
import functools
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuroflight.cli.main import parser as make_parser
from tests import reference
from tests.conftest import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
DECISIONS = [page for page in PAGES if page.parent.name == "decisions" and page.name != "index.md"]
LINK = re.compile(r"\]\(([^)\s]+)\)")
OURS = re.compile(r"^ *(?:\.venv/bin/)?(neuroflight|make) (.*)$")
FILE = re.compile(r"`((?:cli|docs|firmware|flash|sim|tests|toolchain|training)/[a-z0-9_./-]+)`")
SYNOPSIS = re.compile(r"…|\[-|\.\.\.")
QUOTED = re.compile(r"(?<!`)`(?:\.venv/bin/)?neuroflight ([^`\n]+)`")
WORD = re.compile(r"[a-z][a-z-]+")
parser = functools.cache(make_parser)  # it is asked hundreds of times


def lines(page: Path) -> Iterator[tuple[bool, str]]:
    """Yield each line, and whether it stands in a block of code; one that ends in a backslash goes on."""
    code = False
    for line in page.read_text().replace("\\\n", " ").splitlines():
        if line.startswith("```"):
            code = not code
        else:
            yield code or line.startswith("    "), line


def anchors(page: Path) -> set[str]:
    """Return what a link to a heading of the page may name."""
    headings = [line.lstrip("#") for code, line in lines(page) if not code and line.startswith("#")]
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def links() -> list[tuple[Path, str]]:
    """Return page and target of every link that is not of the web."""
    found = [(page, target) for page in PAGES for target in LINK.findall(page.read_text())]
    return [(page, target) for page, target in found if not target.startswith("http")]


def commands(program: str) -> list[tuple[str, str]]:
    """Return page and words of every command of a program in a block of code, synopses left out."""
    found = set()
    for page in PAGES:
        for code, line in lines(page):
            match = OURS.match(line)
            if code and match and match[1] == program and not SYNOPSIS.search(line):
                found.add((page.name, re.split(r" [#>] ", match[2])[0].strip()))
    return sorted(found)


def mentions() -> list[tuple[str, str]]:
    """Return page and words of every command of ours that stands in a line of text."""
    return sorted({(page.name, words) for page in PAGES for words in QUOTED.findall(page.read_text())})


def options(of: argparse.ArgumentParser) -> set[str]:
    """Return the option strings of a command and of those below it."""
    found = set(of._option_string_actions)
    for action in of._actions:
        if isinstance(action, argparse._SubParsersAction):
            found |= {option for sub in action.choices.values() for option in options(sub)}
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings(page: Path) -> None:
    lost = []
    for where, target in links():
        name, _, heading = target.partition("#")
        file = where.parent / name if name else where
        if where == page and not (file.exists() and (not heading or heading in anchors(file))):
            lost.append(target)
    assert not lost


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    for page in PAGES:
        if page.is_relative_to(ROOT / "docs"):
            html = (tmp_path / page.relative_to(ROOT / "docs")).with_suffix(".html").read_text()
            assert not re.search(r'(src|href)="https?://[^"]*\.(js|css)|fonts\.g', html), (
                page
            )  # works offline


@pytest.mark.parametrize(("page", "words"), commands("neuroflight"))
def test_a_printed_command_is_understood(page: str, words: str) -> None:
    parser().parse_args(shlex.split(words))  # ends the process where it is not


@pytest.mark.parametrize(("page", "words"), commands("make"))
def test_a_printed_target_calls_commands_that_are_understood(page: str, words: str) -> None:
    command = ["make", *shlex.split(words), "--dry-run", "--always-make"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for call in re.findall(r"-m \S*cli\.main (.+)", told.replace("\\\n", " ")):
        parser().parse_args(shlex.split(call))


@pytest.mark.parametrize(("page", "words"), mentions())
def test_a_command_in_a_sentence_has_words_and_options_that_are_known(page: str, words: str) -> None:
    below, rest = parser(), words.split()
    while rest and (
        subs := [action for action in below._actions if isinstance(action, argparse._SubParsersAction)]
    ):
        if not WORD.fullmatch(rest[0]):
            break
        assert rest[0] in subs[0].choices, words
        below = subs[0].choices[rest.pop(0)]
    named = re.findall(r"(?<![\w-])--[a-z][\w-]*", " ".join(rest))
    assert set(named) <= options(below), words


def test_pages_have_links_and_commands() -> None:
    assert len(links()) > 100 and len(mentions()) > 100
    pages = {page for page, _ in commands("neuroflight")}
    assert {"flashing.md", "policy-swap.md", "board-bring-up.md", "dynamometer.md"} <= pages


@pytest.mark.parametrize("name", reference.PAGES)
def test_the_reference_says_what_the_code_says(name: str) -> None:
    page = (reference.FOLDER / f"{name}.md").read_text()
    assert page == reference.PAGES[name](), "run: python -m tests.reference"


def test_the_readme_is_short_and_its_first_command_needs_no_board() -> None:
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 60
    first = text.partition("```\n")[2].partition("\n")[0]
    assert first == "make fly" and len(text.partition("```\n")[0].split()) < 200


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_file_that_a_page_names_is_there(page: Path) -> None:
    named = set(FILE.findall(page.read_text()))
    assert not {name for name in named if not (ROOT / name).exists()}


@pytest.mark.parametrize("page", DECISIONS, ids=lambda page: page.name)
def test_a_decision_is_short_and_its_page_indexed(page: Path) -> None:
    entries = page.read_text().split("\n## ")[1:]
    long = [entry.partition("\n")[0] for entry in entries if len(entry.strip().splitlines()) > 9]
    wide = [line for line in page.read_text().splitlines() if len(line) > 120]
    index = page.with_name("index.md").read_text()
    assert entries and not long and not wide and f"({page.name})" in index
