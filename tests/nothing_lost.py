"""Holds the command line against that of an earlier commit: `python -m tests.nothing_lost`.

Every command line that the commit's pages and tests have is parsed by the commit's own parser, by ours as it
stands and by ours in today's words; the three have to say the same. A sample is run by both.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from neuroflight.cli.main import parse
from neuroflight.cli.options import OLD_ON
from neuroflight.cli.tree import find, rewritten
from tests.conftest import ROOT

COMMIT = "4503be63"  # the last one with the words of before
SOURCES = ("README.md", "docs", "tests")
ROOMS = ("cli", "flash", "sim", "toolchain", "training")
PARSED = """
import contextlib, io, json, sys
from cli.main import parser
known = parser()
def words(line):
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            return {name: value if isinstance(value, (int, float, list, tuple, type(None))) else str(value)
                    for name, value in vars(known.parse_args(line)).items() if not callable(value)}
        except (Exception, SystemExit):
            return None
print(json.dumps([words(line) for line in json.load(sys.stdin)], default=str))
"""
NOT_ASKED = (  # names in a namespace that no option gave: words, defaults that the work looks up itself
    *("command", "action", "list", "revert", "rom", "usage_error"),
    "episodes_default",
)
LATER = ("count", "mount", "start")  # whose default the work looks up now
POLICY = "training/policies/nf1"
SAMPLE = (  # what takes seconds; {out}: a folder of the run's own
    "aircraft check nf1 --json",
    "aircraft check hexa",
    f"compile {POLICY}/policy.onnx --out {{out}} --json",
    f"freeze {POLICY}/checkpoint.pt --out {{out}}/policy.onnx",
    f"timing {POLICY}/policy.onnx --inputs 2 --json",
    "train --aircraft nf9 --out {out}/run",
    "msp --port tcp:127.0.0.1:1 info",
    "flash --port tcp:127.0.0.1:1 --list",
    "motor spin 9 --port tcp:127.0.0.1:1",
    "monitor --port tcp:127.0.0.1:1",
    "rescue none.hex --port tcp:127.0.0.1:1",
    "twin noise none.csv",
    "log list none",
)


def earlier(folder: Path) -> None:
    """Write rooms, pages and tests of the earlier commit into a folder."""
    packed = subprocess.run(
        ["git", "archive", COMMIT, *ROOMS, *SOURCES], cwd=ROOT, capture_output=True, check=True
    )
    subprocess.run(["tar", "-x", "-C", folder], input=packed.stdout, check=True)


def lines(folder: Path) -> list[list[str]]:
    """Return every command line of the commit's pages and tests, each once."""
    found: dict[tuple[str, ...], None] = {}
    for path in [
        folder / "README.md",
        *(p for name in SOURCES[1:] for p in sorted((folder / name).rglob("*.*"))),
    ]:
        if path.suffix in (".md", ".py"):
            text = path.read_text()
            read = _of_page(text) if path.suffix == ".md" else _of_tests(text)
            found |= dict.fromkeys(map(tuple, read))
    return [list(line) for line in found]


def _of_page(text: str) -> Iterator[list[str]]:
    for line in text.replace("\\\n", " ").splitlines():
        match = re.match(r"^ *(?:\.venv/bin/)?neuroflight (.*)$", line)
        if match and not re.search(r"…|\[-", line):
            with contextlib.suppress(ValueError):
                yield shlex.split(re.split(r" [#>|] ", match[1])[0])


def _of_tests(text: str) -> Iterator[list[str]]:
    """Yield the lists of words there; `1` for what is not written out: a name, a file and a number."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.List) and node.elts and isinstance(node.elts[0], ast.Constant):
            words = [
                str(one.value) if isinstance(one, ast.Constant) else "1"
                for one in node.elts
                if not isinstance(one, ast.Starred)
            ]
            at = words.index("cli.main") + 1 if "cli.main" in words else 0
            if words[at : at + 2] == ["timing", "1"]:  # which of both its file is, its options tell
                words[at + 1] = "1.bin" if "--count" in words else "1.onnx"
            yield words[at:]


def parsed_before(given: list[list[str]], folder: Path) -> list[dict[str, object] | None]:
    """Return what the earlier commit's parser says; None: it refuses."""
    done = subprocess.run(
        [sys.executable, "-c", PARSED],
        cwd=folder,
        input=json.dumps(given),
        capture_output=True,
        text=True,
        check=True,
    )
    found: list[dict[str, object] | None] = json.loads(done.stdout)
    return found


def parsed(words: list[str]) -> dict[str, object] | None:
    """Return what today's parser says; None: it refuses."""
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        try:
            return {name: value for name, value in vars(parse(words)).items() if name != "renamed"}
        except SystemExit:
            return None


def differs(words: list[str], before: dict[str, object], folder: Path) -> str:
    """Return what a line no longer says; "" where it says the same in its old words and in today's."""
    now = parsed(words)
    if now is None:
        return "refused"
    renamed, _ = rewritten(words)
    if not find(renamed)[0]:
        return "no command"
    again = parsed(renamed)
    if again is None or {k: str(v) for k, v in again.items()} != {k: str(v) for k, v in now.items()}:
        return "otherwise in today's words"
    said = {_plain(value, folder) for value in now.values()}
    lost = {
        name: value
        for name, value in before.items()
        if name not in NOT_ASKED
        and not (name in LATER and now.get(name) is None)
        and value not in (None, False, [], "False")
        and _plain(value, folder) not in (_ways(now[name], folder) if name in now else said | _several(now))
    }
    return str(lost) if lost else ""


def _several(now: dict[str, object]) -> set[str]:
    """Return the values of options that took one value before, and may take several now."""
    return {str(each) for value in now.values() if isinstance(value, list | tuple) for each in value}


def _ways(value: object, folder: Path) -> set[str]:
    """Return a value as text, and as each of several."""
    several = value if isinstance(value, list | tuple) else ()
    return {_plain(value, folder), *(_plain(each, folder) for each in several)}


def _plain(value: object, folder: Path) -> str:
    """Return a value as text, without the place of the tree and by today's names of machines."""
    text = str([str(one) for one in value] if isinstance(value, tuple | list) else value)
    text = text.replace(f"{folder}/", "").replace(f"{folder.resolve()}/", "").replace(f"{ROOT}/", "")
    return OLD_ON.get(text, text)


def run(words: str, tree: Path, module: str, out: Path) -> tuple[int, str, list[str], dict[str, bytes]]:
    """Return exit code, stdout, lines on stderr and products of a command."""
    out.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", module, *shlex.split(words.format(out=out))],
        cwd=tree,
        capture_output=True,
        text=True,
        env={"PYTHONPATH": str(tree), "PATH": "/usr/bin:/bin:/usr/local/bin", "HOME": str(out.parent)},
    )
    products = {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
    return (
        done.returncode,
        " ".join(done.stdout.replace(str(out), "OUT").split()),  # a table may be wider
        done.stderr.replace(str(out), "OUT").splitlines(),
        products,
    )


def main() -> int:
    """Compare. Returns 1 where something was lost."""
    lost = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name, "tree")
        folder.mkdir()
        earlier(folder)
        given = lines(folder)
        before = parsed_before(given, folder)
        understood = [(words, told) for words, told in zip(given, before, strict=True) if told is not None]
        for words, told in understood:
            if why := differs(words, told, folder):
                lost += 1
                print(f"{shlex.join(words)}: {why}")
        for number, sample in enumerate(SAMPLE):
            then = run(sample, folder, "cli.main", Path(name, f"then-{number}"))
            now = run(sample, ROOT, "neuroflight.cli.main", Path(name, f"now-{number}"))
            hint = [line for line in now[2] if " is now " in line]
            rest = [line for line in now[2] if line not in hint]
            same = (then[0], then[1], then[3]) == (now[0], now[1], now[3]) and len(hint) <= 1
            print(f"{'same' if same else 'DIFFERS'}, exit code {now[0]}: {sample}")
            if rest != then[2]:
                print(f"    stderr {rest}, was {then[2]}")
            lost += not same
        print(f"{len(understood)} of {len(given)} lines were understood before; {lost} say something else")
    return int(lost > 0)


if __name__ == "__main__":
    sys.exit(main())
