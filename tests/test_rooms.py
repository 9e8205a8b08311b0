"""The law of the house: dependencies point down, and only the command line joins rooms, lazily."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("toolchain", "flash", "sim", "training", "cli")
GROUND = {"toolchain.contract", "toolchain.errors", "toolchain.files"}  # what every room stands on
BELOW = {  # the rooms that a room may look down on
    "toolchain": {"toolchain"},
    "flash": {"flash"},
    "sim": {"sim", "toolchain", "flash"},
    "training": {"training", "sim", "toolchain"},
}
FILES = sorted(path for room in BELOW for path in (ROOT / room).rglob("*.py"))
COMMANDS = sorted(p for p in (ROOT / "cli").rglob("*.py") if p.name != "train_display.py")  # imported late


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules of the project that the code in `tree` imports, wherever it does."""
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            module = node.module or ""
            names = [f"{module}.{alias.name}" for alias in node.names] if module in ROOMS else [module]
        yield from (name for name in names if name.split(".")[0] in ROOMS)


def at_import(tree: ast.Module) -> list[ast.stmt]:
    """The statements that run when the module is imported, without those for type checkers."""
    kept = (s for s in tree.body if not isinstance(s, ast.FunctionDef | ast.ClassDef))
    return [s for s in kept if not (isinstance(s, ast.If) and "TYPE_CHECKING" in ast.unparse(s.test))]


def forbidden(room: str, names: Iterator[str]) -> list[str]:
    """Those of `names` that a module of `room` may not import."""
    return [name for name in names if name not in GROUND and name.split(".")[0] not in BELOW[room]]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_imports_only_rooms_below_when_it_is_no_command(path: Path) -> None:
    room = path.relative_to(ROOT).parts[0]
    names = list(imported(ast.parse(path.read_text())))
    assert not forbidden(room, iter(names))


@pytest.mark.parametrize("path", COMMANDS, ids=lambda p: str(p.relative_to(ROOT)))
def test_command_joins_rooms_only_inside_functions_when_it_is_imported(path: Path) -> None:
    top = ast.Module(at_import(ast.parse(path.read_text())), [])
    # What commands share is held to the same law by a case of its own.
    joined = {name for name in imported(top) if not name.startswith("cli.")}
    assert joined <= GROUND


@pytest.mark.parametrize("name", ["contract", "errors", "files"])
def test_ground_imports_nothing_of_the_project_when_read(name: str) -> None:
    place = ROOT / "toolchain" / name
    files = sorted(place.glob("*.py")) or [place.with_suffix(".py")]
    found = [module for path in files for module in imported(ast.parse(path.read_text()))]
    assert not [module for module in found if not module.startswith(f"toolchain.{name}.")]


@pytest.mark.parametrize(
    ("room", "line"),
    [
        ("flash", "from toolchain.image.build import build"),
        ("flash", "def f():\n    import sim.physics.twin"),
        ("toolchain", "from sim import twin"),
        ("toolchain", "import flash.msp"),
        ("sim", "from training.tasks.task import PulseTask"),
        ("training", "import flash"),
    ],
)
def test_law_finds_the_import_when_it_points_up(room: str, line: str) -> None:
    assert forbidden(room, imported(ast.parse(line)))
