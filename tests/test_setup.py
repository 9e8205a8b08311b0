"""The Makefile and setup.sh: each target brings the packages that it needs, once."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
SIZES = ("firmware", "gateway", "sim", "train", "sweep", "dev")  # of extras, from the smallest to the largest
NEEDS = {
    "firmware": "firmware",
    "host": "firmware",
    "fly": "sim",
    "emulate": "sim",
    "train": "train",
    "test": "dev",
    "prove": "dev",
    "coverage": "dev",
    "bench": "dev",
    "lint": "dev",
    "setup": "dev",
}
TOOLS = ("sh", "sed", "dirname", "touch", "rm", "mkdir", "mktemp", "cp", "make", "echo", "chmod")
PYTHONS = ("3.11", "3.12", "3.13", "3.14")  # that an image is built with
FLYING = PYTHONS[:3]  # that the twin has wheels for

# An interpreter that writes down how it was called. Its environments are copies of it. With a file `fails` in
# the folder STATE pip fails; with `interrupts` it sends its caller what Ctrl-C sends.
FAKE_PYTHON = """#!/bin/sh
echo "VERSION $*" >> "LOG"
case "$*" in
"-c import sys, "*) echo VERSION ;;
"-m venv "*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" ;;
"-m pip "*) [ ! -e "STATE/interrupts" ] || kill -INT $PPID; [ ! -e "STATE/fails" ] ;;
*) exit 1 ;;
esac
"""


def heed_interrupts() -> None:
    """Undo what a shell does to a job in the background: its children ignore SIGINT and cannot trap it."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


class Machine:
    """A copy of what sets up, and a PATH with the tools that it needs and the interpreters given to it."""

    def __init__(self, folder: Path) -> None:
        """A machine in `folder` without any Python."""
        self.project, self.path, self.state = folder / "project", folder / "bin", folder / "state"
        self.log = folder / "log"
        for made in (self.project, self.path, self.state):
            made.mkdir()
        for name in ("Makefile", "setup.sh", "setup.py", "pyproject.toml", "constraints.txt"):
            shutil.copy2(ROOT / name, self.project)
        for tool in TOOLS:
            self.path.joinpath(tool).symlink_to(shutil.which(tool) or tool)
        self.script("uname", "#!/bin/sh\necho x86_64\n")

    def script(self, name: str, text: str, folder: Path | None = None) -> None:
        """Put an executable on the PATH, or into `folder`."""
        file = (folder or self.path) / name
        file.write_text(text)
        file.chmod(0o755)

    def python(self, version: str, name: str | None = None) -> str:
        """Install an interpreter; returns its text."""
        text = FAKE_PYTHON.replace("VERSION", version).replace("LOG", str(self.log))
        text = text.replace("STATE", str(self.state))
        self.script(name or f"python{version}", text)
        return text

    def make(self, *words: str, path: str = "") -> subprocess.CompletedProcess[str]:
        """Run make there."""
        inherited = {"HOME": str(self.state), "PATH": f"{path}{self.path}"}
        return subprocess.run(
            ["make", *words],
            cwd=self.project,
            capture_output=True,
            text=True,
            env=inherited,
            preexec_fn=heed_interrupts,
        )

    def setup(self, extra: str, *words: str, path: str = "") -> subprocess.CompletedProcess[str]:
        """Set up one extra."""
        return self.make("setup", f"EXTRA={extra}", *words, path=path)

    def calls(self, words: str) -> list[str]:
        """Calls of interpreters with `words` among the arguments, in order; each begins with a version."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        return [line for line in lines if words in line]

    def stamps(self) -> set[str]:
        """The extras that count as installed."""
        return {file.name[1:] for file in (self.project / ".venv").glob(".*")}


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize(("target", "extra"), NEEDS.items())
def test_a_target_asks_once_for_its_own_extra_when_nothing_is_installed(
    machine: Machine, target: str, extra: str
) -> None:
    planned = machine.make("-n", target).stdout
    assert re.findall(r"setup\.sh (\w+)", planned) == [extra]


def test_several_targets_ask_once_for_the_largest_extra(machine: Machine) -> None:
    planned = machine.make("-n", "firmware", "train", "test").stdout
    assert re.findall(r"setup\.sh (\w+)", planned) == ["dev"]


@pytest.mark.parametrize("installed", SIZES)
def test_a_target_installs_nothing_when_its_extra_or_a_larger_one_is_there(
    machine: Machine, installed: str
) -> None:
    machine.python("3.11")
    assert machine.setup(installed).returncode == 0
    enough = SIZES[: SIZES.index(installed) + 1]
    assert machine.stamps() == set(enough)
    for target, extra in NEEDS.items():
        assert ("setup.sh" not in machine.make("-n", target).stdout) == (extra in enough), target


def test_an_extra_is_installed_again_when_its_pins_changed(machine: Machine) -> None:
    machine.python("3.11")
    machine.setup("dev")
    stamp = (machine.project / ".venv" / ".dev").stat().st_mtime_ns
    os.utime(machine.project / "constraints.txt", ns=(stamp + 10**9, stamp + 10**9))
    assert "setup.sh firmware" in machine.make("-n", "firmware").stdout


def test_no_stamp_is_left_when_pip_fails(machine: Machine) -> None:
    machine.python("3.11")
    (machine.state / "fails").touch()
    assert machine.setup("dev").returncode != 0
    assert machine.stamps() == set()
    (machine.state / "fails").unlink()
    assert machine.setup("dev").returncode == 0
    assert machine.stamps() == set(SIZES)
    assert len(machine.calls("-m venv")) == 1, "the environment was made once"


def test_no_stamp_is_left_when_pip_is_interrupted(machine: Machine) -> None:
    machine.python("3.11")
    (machine.state / "interrupts").touch()
    assert machine.setup("firmware").returncode != 0
    assert machine.stamps() == set()


def test_the_python_of_every_target_is_taken_at_once_when_there_are_several(machine: Machine) -> None:
    machine.python("3.13", "python3")
    machine.python("3.11")
    machine.setup("firmware")
    machine.setup("dev")
    assert [call.split()[0] for call in machine.calls("-m venv")] == ["3.11"]


def test_the_next_python_of_the_path_is_taken_when_the_first_does_not_run(machine: Machine) -> None:
    shims = machine.state / "shims"
    shims.mkdir()
    machine.script("python3.11", "#!/bin/sh\nexit 127\n", shims)
    machine.python("3.11")
    assert machine.setup("sim", path=f"{shims}:").returncode == 0


@pytest.mark.parametrize("version", PYTHONS)
def test_an_image_needs_no_other_python(machine: Machine, version: str) -> None:
    machine.python(version, "python3")
    assert machine.setup("firmware").returncode == 0
    assert [call.split()[0] for call in machine.calls("-m venv")] == [version]


@pytest.mark.parametrize("version", FLYING)
def test_the_twin_needs_no_other_python(machine: Machine, version: str) -> None:
    machine.python(version, "python3")
    machine.setup("firmware")
    assert machine.setup("sim").returncode == 0
    assert [call.split()[0] for call in machine.calls("-m venv")] == [version]


@pytest.mark.parametrize(
    ("python", "system", "machine", "name"),
    [
        ("3.11", "linux", "x86_64", "pybullet"),
        ("3.13", "linux", "x86_64", "pybullet-arm64"),
        ("3.14", "linux", "x86_64", "pybullet"),
        ("3.12", "linux", "aarch64", "pybullet"),
        ("3.11", "darwin", "arm64", "pybullet-arm64"),
    ],
)
def test_each_python_gets_one_pybullet(python: str, system: str, machine: str, name: str) -> None:
    told = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]["sim"]
    where = {"python_version": python, "sys_platform": system, "platform_machine": machine}
    asked = [r for r in map(Requirement, told) if r.marker is None or r.marker.evaluate(where)]
    assert [r.name for r in asked if r.name.startswith("pybullet")] == [name]


def test_one_line_says_what_to_install_when_no_python_has_pybullet(machine: Machine) -> None:
    machine.python("3.14", "python3")
    machine.setup("firmware")
    done = machine.setup("dev")
    assert done.returncode != 0
    line, of_make = done.stderr.splitlines()
    assert of_make.startswith("make: ***")
    for word in ("Python 3.11", "install python3.11", "ten minutes", "EXTRA=dev PYTHON=python3"):
        assert word in line
    assert machine.stamps() == {"firmware"}, "the environment of the image stays"


def test_one_line_says_how_to_build_when_no_wheel_is_for_the_processor(machine: Machine) -> None:
    machine.script("uname", "#!/bin/sh\necho aarch64\n")
    machine.python("3.11")
    done = machine.setup("sim")
    assert done.returncode != 0
    assert "this is aarch64" in done.stderr and "EXTRA=sim PYTHON=python3" in done.stderr
    assert not machine.calls("-m venv")


def test_pip_builds_pybullet_when_the_python_is_named(machine: Machine) -> None:
    machine.python("3.14", "python3")
    machine.setup("firmware")
    assert machine.setup("dev", "PYTHON=python3").returncode == 0
    assert len(machine.calls("-m venv")) == 1, "the environment of the image is extended"


def test_the_environment_is_made_anew_when_its_python_has_no_pybullet(machine: Machine) -> None:
    machine.python("3.14", "python3")
    machine.setup("firmware")
    machine.python("3.11")
    done = machine.setup("sim")
    assert done.returncode == 0 and "making it anew" in done.stdout
    assert [call.split()[0] for call in machine.calls("-m venv")] == ["3.14", "3.11"]


def test_uv_fetches_the_python_that_has_pybullet(machine: Machine) -> None:
    fake = machine.python("3.11")
    (machine.path / "python3.11").rename(machine.state / "python3.11")
    machine.python("3.14", "python3")
    put = '"$UV_PYTHON_INSTALL_DIR/cpython-3.11/bin"'
    machine.script("uv", f"#!/bin/sh\nmkdir -p {put}\ncp {machine.state}/python3.11 {put}/\n")
    assert "3.11" in fake
    assert machine.setup("sim").returncode == 0
    assert machine.calls("-m venv")[-1].startswith("3.11 ")


def test_torch_comes_without_accelerators_unless_they_are_asked_for(machine: Machine) -> None:
    machine.python("3.11")
    machine.setup("train")
    (first,) = (call for call in machine.calls(" torch=") if "install" in call)
    assert re.search(r"--no-deps torch==[\d.]+\+cpu$", first)
    machine.setup("train", "TORCH=cuda")
    assert re.search(r"torch===[\d.]+$", machine.calls(" torch=")[-1])
    assert "setup.sh" not in machine.make("-n", "train").stdout
