"""Commands that the pages print, run on files such as a user has, but for those of hardware or minutes."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.cli.test_own_aircraft import five_inch
from tests.conftest import ROOT, SHIPPED
from tests.test_docs import commands

pytestmark = pytest.mark.slow
RUN = [sys.executable, "-m", "neuroflight.cli.main"]
QUICK = ("aircraft ", "dyno ", "fly ", "log ", "policy verify ", "policy time ", "view ")
INPUTS = {".BBL", ".bbl", ".npz", ".onnx", ".toml", ".csv", ".img", ".bin", ".urdf", ".TXT", ".BFL", ".json"}
PRODUCTS = {"--out", "--plot", "--csv", "--npz", "--draw", "--write", "--trace", "--blackbox", "--copies"}
LEFT_OUT = {
    "--port",
    "--sensor",
    "--gdb",
    "/media/card",
    "PLACE",
    "FILE",
    "DIR",
}  # hardware, people, placeholders
LIMIT_S = 300.0


def run(folder: Path, words: str) -> None:
    """Run a command as it is printed and see it end as it should."""
    done = subprocess.run(
        [*RUN, *shlex.split(words, comments=True)],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    stopped = 3 if "--fault" in words else 0  # exit status of a flight whose motors stopped
    assert done.returncode == stopped, f"{words}\n{done.stdout}{done.stderr}"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a user's files: logs and a trace of flights, a policy, an aircraft, a table."""
    folder = tmp_path_factory.mktemp("made")
    shutil.copy(SHIPPED, folder / "policy.onnx")
    (folder / "mine.toml").write_text(five_inch())
    fly = "fly --on host --blackbox log.bbl --trace flight.npz --seed"  # what `make host` built
    for seed in (1, 2):
        run(folder, f"{fly} {seed}")
        with (folder / "LOG00001.BBL").open("ab") as both:
            both.write((folder / "log.bbl").read_bytes())
    shutil.copy(folder / "log.bbl", folder / "LOG00002.BBL")
    run(folder, "dyno run --aircraft nf1 --repeats 3 --hold 1 --out nf1.csv")
    shutil.copy(ROOT / "training" / "reproduction" / "gws-5x4.3.csv", folder / "table.csv")
    for name in ("training", "sim", "build"):
        (folder / name).symlink_to(ROOT / name)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """Return a copy of those files: what one command writes is not there for the next."""
    return Path(shutil.copytree(made, tmp_path / "user", symlinks=True))


def is_quick(line: str) -> bool:
    """Return whether a command needs neither hardware, a display nor minutes."""
    window = line.startswith("view ") and "--out" not in line
    asks = line.startswith("aircraft new") and "--weight" not in line
    return line.startswith(QUICK) and not window and not asks and not LEFT_OUT & set(line.split())


def inputs(words: list[str]) -> list[str]:
    """Return the files that a command reads."""
    given = [word for before, word in zip(["", *words], words, strict=False) if before not in PRODUCTS]
    return [word.partition(":")[0] for word in given if Path(word.partition(":")[0]).suffix in INPUTS]


QUICK_ONES = [each for each in commands("neuroflight") if is_quick(each[1])]


@pytest.mark.parametrize(("page", "words"), QUICK_ONES)
def test_a_printed_command_runs(folder: Path, page: str, words: str) -> None:
    missing = [name for name in inputs(shlex.split(words)) if not (folder / name).exists()]
    if missing:
        pytest.skip(f"{', '.join(missing)}: a file of the user's")
    run(folder, words)
