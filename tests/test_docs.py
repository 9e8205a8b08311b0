"""What the pages of docs/ promise: links that lead somewhere, and commands that are understood."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest

from neuroflight.cli.main import parser
from tests.conftest import ROOT

PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
NEUROFLIGHT = re.compile(r"^ *(?:\.venv/bin/)?neuroflight (.*)$")


def lines(page: Path) -> Iterator[tuple[bool, str]]:
    """Each line, and whether it stands in a block of code; one that ends in a backslash goes on."""
    code = False
    for line in page.read_text().replace("\\\n", " ").splitlines():
        if line.startswith("```"):
            code = not code
        else:
            yield code or line.startswith("    "), line


def anchors(page: Path) -> set[str]:
    """What a link to a heading of the page may name."""
    headings = [line.lstrip("#") for code, line in lines(page) if not code and line.startswith("#")]
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


def links() -> list[tuple[Path, str]]:
    """Page and target of every link that is not of the web."""
    found = [(page, target) for page in PAGES for target in LINK.findall(page.read_text())]
    return [(page, target) for page, target in found if not target.startswith("http")]


def commands() -> list[tuple[str, str]]:
    """Page and words of every command of ours in a block of code, synopses left out."""
    found = []
    for page in PAGES:
        for code, line in lines(page):
            match = NEUROFLIGHT.match(line)
            if code and match and not re.search(r"…|\[-", line):
                found.append((page.name, re.split(r" [#>] ", match[1])[0].strip()))
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


@pytest.mark.parametrize(("page", "words"), sorted(set(commands())))
def test_a_printed_command_is_understood(page: str, words: str) -> None:
    parser().parse_args(shlex.split(words))  # ends the process where it is not


def test_pages_have_links_and_commands() -> None:
    assert len(links()) > 100
    assert {"flashing.md", "policy-swap.md", "board-bring-up.md", "dynamometer.md"} <= {
        p for p, _ in commands()
    }
