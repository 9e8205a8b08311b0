"""What pyproject.toml asks for: an image takes the base dependencies alone, extras bring the rest."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from importlib.metadata import packages_distributions, requires
from itertools import pairwise
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from neuroflight.cli.extras import EXTRAS
from tests.conftest import BUILD
from tests.sampling import sampled

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SIZES = ("firmware", "gateway", "sim", "train", "sweep", "dev")  # of extras, from the smallest to the largest
PYTHONS = ("3.11", "3.12", "3.13", "3.14")  # that an image is built with
PROCESSORS = ("x86_64", "aarch64")
ROOMS = ("cli/", "flash/", "sim/", "toolchain/", "training/")
BUILT_FROM = (*ROOMS, "neuroflight.", "pyproject.toml", "README.md", "LICENSE", "setup.py")
GLIBCS = ("2014", "_2_17", "_2_24", "_2_26", "_2_27", "_2_28")  # of manylinux, up to that of Debian 10

# Runs the command line as if nothing but the named top-level packages were installed.
HIDING = """
import sys
from importlib.metadata import packages_distributions
kept, words = set(sys.argv[1].split(",")), sys.argv[2:]
class Hiding:
    def find_spec(self, name, path=None, target=None):
        if path is None and name in hidden:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
hidden = set(packages_distributions()) - kept - {"neuroflight"}
sys.meta_path.insert(0, Hiding())
import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name in hidden else found(name, package)
from neuroflight.cli.main import main
sys.exit(main(words))
"""


def name_of(requirement: str) -> str:
    """The distribution that a requirement names, as the registry writes it."""
    found = re.match(r"[\w.-]+", requirement)
    assert found is not None
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def with_dependencies(names: Iterable[str]) -> set[str]:
    """Distributions and all that they require on this machine."""
    known: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name not in known:
            known.add(name)
            needed = [line for line in requires(name) or [] if "extra ==" not in line]
            waiting += [name_of(line) for line in needed if 'python_version < "3' not in line]
    return known


def light_packages() -> str:
    """What may be imported after `pip install neuroflight`, top-level names with commas between."""
    light = with_dependencies(map(name_of, PROJECT["dependencies"]))
    packages = packages_distributions().items()
    return ",".join(name for name, owners in packages if light.intersection(map(name_of, owners)))


def neuroflight(*words: str) -> subprocess.CompletedProcess[str]:
    """The command with the base dependencies alone."""
    command = [sys.executable, "-c", HIDING, light_packages(), *words]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize("target", sampled(["HOST", "MATEKF722"], "HOST"))
def test_an_image_is_built_when_only_the_base_dependencies_are_installed(target: str) -> None:
    done = neuroflight("image", "build", "--target", target, "--out", str(BUILD / "light"), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["target"] == target


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("board gateway --port /dev/null --mavlink udp:127.0.0.1:14550", "gateway"),
        pytest.param("fly --controller pid", "sim", marks=pytest.mark.slow),
        ("aircraft check nf1", "sim"),
        pytest.param("image emulate", "sim", marks=pytest.mark.slow),
        ("policy verify training/policies/nf1/policy.onnx", "train"),
        pytest.param("evaluate pid", "train", marks=pytest.mark.slow),
        pytest.param("policy train --out OUT", "train", marks=pytest.mark.slow),
    ],
)
def test_one_line_names_the_extra_when_a_package_is_not_installed(
    words: str, extra: str, tmp_path: Path, board_image: Path
) -> None:
    image = ("--build", str(board_image.parent)) if words == "image emulate" else ()
    done = neuroflight(*words.replace("OUT", str(tmp_path / "run")).split(), *image)
    assert done.returncode == 1
    assert re.fullmatch(
        rf"neuroflight: [\w ]+ needs \w+, which is not installed; run: make setup EXTRA={extra}\n",
        done.stderr,
    ), done.stderr


@pytest.mark.parametrize("before", ["", "import neuroflight; "])
def test_gymnasium_knows_the_environment_where_the_package_is_installed(before: str, tmp_path: Path) -> None:
    code = f"{before}import gymnasium; print(gymnasium.spec('neuroflight/Attitude-v0').vector_entry_point)"
    started = [sys.executable, "-c", code]
    if before:  # as from a clone that is not installed: without the file that an installation places
        started[1:1] = ["-S"]
        code = f"import sys; sys.path[:] = {[str(ROOT), *sys.path]}; {code}"
        started[-1] = code
    done = subprocess.run(started, cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "neuroflight.training.envs.gym_vector:AttitudeVectorEnv\n", done.stderr


@pytest.fixture(scope="module")
def installed_wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what `pip install neuroflight` would place into site-packages, dependencies left out."""
    source, folder = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("site")
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    for name in tracked.stdout.split("\0")[:-1]:
        if name.startswith(BUILT_FROM) and (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, source / name)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--target", str(folder), str(source)], check=True)
    return folder


def test_one_name_is_installed(installed_wheel: Path) -> None:
    found = {path.name for path in installed_wheel.iterdir() if not path.name.endswith(".dist-info")}
    assert found - {"bin"} == {"neuroflight"}


@pytest.mark.parametrize("installed", ["wheel", "checkout"])
def test_a_strangers_modules_of_the_same_names_stand_beside_ours(
    installed: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    for name in ("cli", "flash", "sim", "tests", "toolchain"):
        (tmp_path / f"{name}.py").write_text("OWNER = 'stranger'\n")
    (tmp_path / "training").mkdir()  # a package without __init__.py, which any other would hide
    (tmp_path / "training" / "loop.py").write_text("OWNER = 'stranger'\n")
    (tmp_path / "program.py").write_text(
        "import cli, flash, sim, tests, toolchain, training.loop\n"
        "assert all(m.OWNER == 'stranger' for m in (cli, flash, sim, tests, toolchain, training.loop))\n"
        "import neuroflight.sim.aircraft.model, neuroflight.training.envs.gym_env, gymnasium\n"
        "print(neuroflight.sim.__file__)\n"
        "gymnasium.make('neuroflight/Attitude-v0', aircraft='nf1').reset(seed=1)\n"
    )
    folder = ROOT if installed == "checkout" else request.getfixturevalue("installed_wheel")
    path = {} if installed == "checkout" else {"PYTHONPATH": str(folder)}
    done = subprocess.run(
        [sys.executable, "program.py"], cwd=tmp_path, env=os.environ | path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()).is_relative_to(folder)


def test_python_starts_without_gymnasium(tmp_path: Path) -> None:
    waiting = {"gymnasium", "neuroflight.training", "numpy", "typing"}
    code = f"import sys; print({waiting}.intersection(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "set()\n"


def test_the_commands_table_of_packages_is_what_the_extras_bring() -> None:
    owners = packages_distributions()
    for extra, packages in EXTRAS.items():
        asked = map(Requirement, PROJECT["optional-dependencies"][extra])
        listed = {name_of(one.name) for one in asked if one.marker is None or one.marker.evaluate()}
        assert {name_of(owners[package][0]) for package in packages} == listed - {"neuroflight"}


def test_each_extra_brings_the_smaller_one() -> None:
    for smaller, larger in pairwise(SIZES):
        assert f"neuroflight[{smaller}]" in PROJECT["optional-dependencies"][larger]


@pytest.mark.slow
@pytest.mark.parametrize("processor", PROCESSORS)
@pytest.mark.parametrize("version", PYTHONS)
def test_the_registry_has_wheels_of_what_an_image_needs(version: str, processor: str, tmp_path: Path) -> None:
    platforms = [word for glibc in GLIBCS for word in ("--platform", f"manylinux{glibc}_{processor}")]
    pins, report = ROOT / "constraints.txt", tmp_path / "report.json"
    command = [sys.executable, "-m", "pip", "install", "--dry-run", "--ignore-installed", "--quiet"]
    command += ["--target", str(tmp_path), "--report", str(report), "--constraint", str(pins)]
    command += ["--only-binary", ":all:", "--python-version", version, *platforms]
    done = subprocess.run([*command, *PROJECT["dependencies"]], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    installed = json.loads(report.read_text())["install"]
    found = {name_of(entry["metadata"]["name"]) for entry in installed}
    pinned = {name_of(line) for line in pins.read_text().splitlines() if "==" in line}
    assert found <= pinned, "each version is pinned"
    assert found >= set(map(name_of, PROJECT["dependencies"]))
