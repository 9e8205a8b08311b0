"""What the pages promise: no broken link, commands that are understood, a reference as the code is."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

from neuroflight.cli import tree
from neuroflight.cli.main import parse
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


def test_links_lead_to_files_and_headings() -> None:
    found = {page: anchors(page) for page in PAGES}
    lost = []
    for where, target in links():
        name, _, heading = target.partition("#")
        file = (where.parent / name).resolve() if name else where
        if not file.exists() or (heading and heading not in found[file]):
            lost.append((where.name, target))
    assert not lost


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the site's folder, built without a warning."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    return folder


def test_the_site_has_every_page_and_asks_nothing_of_the_network(site: Path) -> None:
    for page in PAGES:
        if page.is_relative_to(ROOT / "docs"):
            html = (site / page.relative_to(ROOT / "docs")).with_suffix(".html").read_text()
            assert not re.search(r'(src|href)="https?://[^"]*\.(js|css)|fonts\.g', html), page


@pytest.mark.slow
def test_the_search_answers_on_a_page_that_is_opened_from_a_file(site: Path) -> None:
    program = shutil.which("chromium")
    assert program, "chromium is missing; run: make chromium"
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = browser.new_page()
        page.goto((site / "guides" / "logs.html").as_uri())
        page.locator("input.md-search__input").click()
        page.get_by_text("Type to start searching").wait_for()
        page.keyboard.type("brown-out")
        page.locator("a.md-search-result__link", has_text="brown-out detector").first.wait_for()
        browser.close()


def test_printed_commands_are_understood() -> None:
    for _, words in commands("neuroflight"):
        parse(shlex.split(words))  # ends the process where it is not, with a line that quotes the words


@pytest.mark.parametrize(("page", "words"), commands("make"))
def test_a_printed_target_calls_commands_that_are_understood(page: str, words: str) -> None:
    command = ["make", *shlex.split(words), "--dry-run", "--always-make"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for call in re.findall(r"-m \S*cli\.main (.+)", told.replace("\\\n", " ")):
        parse(shlex.split(call))


def test_a_command_in_a_sentence_has_words_and_options_that_are_known() -> None:
    wrong = []
    for page, words in mentions():
        line, _ = tree.rewritten(words.split())
        command, rest = tree.find(line)
        if command:
            named = re.findall(r"(?<![\w-])--[a-z][\w-]*", " ".join(rest))
            known = set(named) <= set(tree.leaf_parser(command, rest)._option_string_actions)
        else:
            known = " ".join(word for word in line if WORD.fullmatch(word)) in ("", *tree.NOUNS)
        if not known:
            wrong.append((page, words))
    assert not wrong


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


def test_files_that_pages_name_are_there() -> None:
    named = {(page.name, name) for page in PAGES for name in FILE.findall(page.read_text())}
    assert not {(page, name) for page, name in named if not (ROOT / name).exists()}


def test_decisions_are_short_and_their_pages_indexed() -> None:
    for page in DECISIONS:
        entries = page.read_text().split("\n## ")[1:]
        long = [entry.partition("\n")[0] for entry in entries if len(entry.strip().splitlines()) > 9]
        wide = [line for line in page.read_text().splitlines() if len(line) > 120]
        index = page.with_name("index.md").read_text()
        assert entries and not long and not wide and f"({page.name})" in index, page.name
