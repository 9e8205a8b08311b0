"""The plan of the house, held: imports, includes and links run one way, and files form no circle.

`ROOMS` and `C_ROOMS` list the folders from the bottom up. A file may import or include files of its own room
and of rooms listed before it. What fails names the two files of the offending arrow.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path, PurePosixPath

import pytest

from neuroflight.cli.tree import COMMANDS
from neuroflight.toolchain.image.build import BOARD_FAMILY

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ("toolchain", "flash", "sim", "training", "cli")  # top-level folders with Python code
ROOMS = (
    "neuroflight.py",
    "toolchain/errors.py",
    "toolchain/files.py",
    "toolchain/workers.py",
    "toolchain/strict_toml.py",
    "toolchain/contract",
    "toolchain/__init__.py",
    "toolchain/ir",
    "toolchain/reader",
    "toolchain/policy",
    "toolchain/passes",
    "toolchain/rendering",
    "toolchain/codegen",
    "toolchain/cortex_m7",
    "toolchain/verification",
    "toolchain/boards",
    "toolchain/image",
    "flash/__init__.py",
    "flash/link",
    "flash/board",
    "flash/settings",
    "flash/betaflight",
    "flash/usb",
    "flash/rom",
    "flash/policy",
    "flash/image",
    "flash/motors",
    "flash/channels",
    "flash/logs",
    "flash/monitoring",
    "flash/hold_down",
    "flash/mavlink",
    "flash/card",
    "sim/arrays.py",
    "sim/loopback.py",
    "sim/plotting.py",
    "sim/compiled.py",
    "sim/structs.py",
    "sim/aircraft",
    "sim/physics",
    "sim/control",
    "sim/board/core",
    "sim/board/registers",
    "sim/board/native",
    "sim/board/peripherals",
    "sim/board/devices",
    "sim/board/usb",
    "sim/board/rom",
    "sim/board",
    "sim/board/debug",
    "sim/board/serial",
    "sim/ports",
    "sim/ports/betaflight",
    "sim/flight",
    "sim/analysis",
    "sim/blackbox",
    "sim/replay",
    "sim/recorded",
    "sim/design",
    "sim/viewing",
    "sim/identification",
    "training/tasks",
    "training/plugins.py",
    "training/config",
    "training/envs",
    "training/learners",
    "training/checkpoints",
    "training/runs",
    "training/evaluation",
    "training/fitness",
    "training/pid_tuning",
    "training/sweeps",
    "training/dissertation",
    "training/results_page",
    "training/reproduction",
    "training/__init__.py",
    "cli",
)
C_ROOMS = (
    "firmware/targets",
    "firmware/src/common",
    "firmware/src/port",
    "firmware/src/usb",
    "firmware/hal/stm32f7/core",
    "firmware/hal/stm32f7/peripherals",
    "firmware/src/storage",
    "firmware/src/storage/card",
    "firmware/src/sensing",
    "firmware/src/receiver",
    "firmware/src/control",
    "firmware/src/motors",
    "firmware/src/safety",
    "firmware/src/housekeeping",
    "firmware/src/blackbox",
    "firmware/src/command_line",
    "firmware/src/msp",
    "firmware/hal/stm32f7/devices",
    "firmware/hal/stm32f7",
    "firmware/src",
    "firmware/hal/stm32f7/startup",
    "firmware/hal/host",
    "sim/physics/c",
    "sim/board/core/c/base",
    "sim/board/core/c/code",
    "sim/board/core/c/system",
    "sim/board/core/c/run",
    "sim/board/native/c",
    "sim/control/c",
    "sim/ports/c",
)
# A port inverts the direction: what hal.h and handlers.h declare is defined above; so is what a libc has.
INVERTED = re.compile(r"hal_\w+|\w+_handler|main|mem(cpy|set|cmp|move)")
GROUND = ("toolchain/errors.py", "toolchain/files.py", "toolchain/workers.py", "toolchain/contract")
STRANGERS = {"flash": ("toolchain",), "training": ("flash",)}  # knows nothing of these, the ground excepted

Arrow = tuple[str, str]  # from one file to another, paths in the repository


def module_file(name: str) -> Path | None:
    """The file of the module called `name`; None: not the project's."""
    package, _, inside = name.partition(".")
    if package != "neuroflight":
        return None
    path = ROOT / (inside.replace(".", "/") or "neuroflight")
    return next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)


def imports(tree: ast.AST) -> Iterator[str]:
    """Files of the project that the code in `tree` imports, inside functions too."""
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = node.module or ""
            assert node.level == 0, f"line {node.lineno}: a relative import of {module}"
            whole = [f"{module}.{alias.name}" for alias in node.names]
            names = [name if module_file(name) else module for name in whole]
        for name in dict.fromkeys(names):
            if (found := module_file(name)) is not None:
                yield str(found.relative_to(ROOT))


def includes(path: Path) -> Iterator[str]:
    """Files of the project that a file of C includes."""
    firmware = ROOT / "firmware"
    folders = (path.parent, firmware / "src", firmware, *(firmware / "targets").iterdir(), ROOT)
    for name in re.findall(r'^\s*#\s*include "([^"]+)"', path.read_text(), re.MULTILINE):
        found = next((folder / name for folder in folders if (folder / name).is_file()), None)
        if found is not None:  # else generated
            yield str(found.resolve().relative_to(ROOT))


@cache
def python_arrows() -> list[Arrow]:
    """Who imports whom."""
    files = sorted(path for room in PYTHON for path in (ROOT / room).rglob("*.py"))
    return [
        (str(path.relative_to(ROOT)), target)
        for path in files
        for target in imports(ast.parse(path.read_text()))
    ]


def c_arrows() -> list[Arrow]:
    """Who includes whom; a .c and its .h count as one file, as each needs the other."""
    files = sorted(path for room in ("firmware", "sim") for path in (ROOT / room).rglob("*.[ch]"))
    files = [path for path in files if "generated" not in path.parts]
    return [(str(path.relative_to(ROOT)), target) for path in files for target in includes(path)]


def links(objects: Path, nm: str) -> list[Arrow]:
    """Who calls whom across files, or takes its address: of the sources whose objects lie in `objects`."""
    command = [nm, "--print-file-name", "--extern-only", *map(str, sorted(objects.rglob("*.o")))]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    defined: dict[str, str] = {}
    needed = []
    for place, kind, name in re.findall(r"^(.+)\.o:.* (\w) (\S+)$", listing, re.MULTILINE):
        source = f"firmware/{Path(place).relative_to(objects)}.c"
        if source.startswith("firmware/boot/") or not (ROOT / source).is_file():
            continue  # the boot part has its own copies; the others were generated, or are left from before
        if kind == "U":
            needed.append((source, name))
        else:
            defined[name] = source
    return [
        (source, defined[name]) for source, name in needed if name in defined and not INVERTED.fullmatch(name)
    ]


def room_of(file: str, rooms: Sequence[str]) -> int:
    """The place in `rooms` of the innermost room that holds `file`. Raises KeyError: none does."""
    for place in (file, *map(str, PurePosixPath(file).parents)):
        if place in rooms:
            return rooms.index(place)
    raise KeyError(f"{file} stands in no room of tests/test_rooms.py")


def upward(arrows: Iterable[Arrow], rooms: Sequence[str]) -> list[str]:
    """The arrows that run to a room further up or to a stranger, as "file -> file"."""

    def is_forbidden(source: str, target: str) -> bool:
        there = rooms[room_of(target, rooms)]
        strangers = STRANGERS.get(source.split("/")[0], ())
        return room_of(source, rooms) < room_of(target, rooms) or (
            there.split("/")[0] in strangers and there not in GROUND
        )

    return [f"{source} -> {target}" for source, target in arrows if is_forbidden(source, target)]


def circle(arrows: Iterable[Arrow]) -> str:
    """The files of one circle as "file -> file -> ..."; "" where there is none."""
    graph: dict[str, set[str]] = {}
    for source, target in arrows:
        if source != target:
            graph.setdefault(source, set()).add(target)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return " -> ".join(reversed(error.args[1]))
    return ""


def at_import(tree: ast.Module) -> ast.Module:
    """The statements that run when a module is imported, without those for type checkers."""
    kept = (s for s in tree.body if not isinstance(s, ast.FunctionDef | ast.ClassDef))
    return ast.Module(
        [s for s in kept if not (isinstance(s, ast.If) and "TYPE_CHECKING" in ast.unparse(s.test))], []
    )


def test_imports_run_one_way() -> None:
    assert not upward(python_arrows(), ROOMS)


def test_includes_run_one_way() -> None:
    assert not upward(c_arrows(), C_ROOMS)


def test_files_form_no_circle_when_they_import() -> None:
    assert not circle(python_arrows())


def test_files_form_no_circle_when_they_include() -> None:
    assert not circle((source.rpartition(".")[0], target.rpartition(".")[0]) for source, target in c_arrows())


def test_links_run_one_way_without_a_circle(host_program: Path, board_image: Path) -> None:
    for family, nm in (("HOST", "nm"), (BOARD_FAMILY, "arm-none-eabi-nm")):
        arrows = links(host_program.parents[1] / family / "make" / "obj", nm)
        assert len(arrows) > 500
        assert not upward(arrows, C_ROOMS)
        assert not circle(arrows)


def test_help_loads_no_room() -> None:
    top = [
        (str(path.relative_to(ROOT)), target)
        for path in sorted((ROOT / "cli").rglob("*.py"))
        for target in imports(at_import(ast.parse(path.read_text())))
    ]
    modules = {leaf.request.partition(":")[0] for leaf in COMMANDS.values()}
    loaded = {f"cli/{module.replace('.', '/')}.py" for module in modules}
    assert all((ROOT / file).is_file() for file in loaded)
    while more := {target for source, target in top if source in loaded} - loaded:
        loaded |= more
    assert not [file for file in loaded if not file.startswith(("cli/", *GROUND))]


@pytest.mark.parametrize("name", GROUND)
def test_ground_imports_nothing_of_the_rooms_when_read(name: str) -> None:
    path = ROOT / name
    for file in path.rglob("*.py") if path.is_dir() else [path]:
        assert not [
            target for target in imports(ast.parse(file.read_text())) if not target.startswith(GROUND)
        ]


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("flash/link/client.py", "from neuroflight.toolchain.image.build import build"),
        ("flash/link/client.py", "def f():\n    import neuroflight.sim.physics.twin"),
        ("toolchain/image/build.py", "from neuroflight.sim.physics import twin"),
        ("toolchain/ir/network.py", "import neuroflight.toolchain.codegen.plan"),
        ("sim/physics/twin.py", "from neuroflight.training.tasks.task import Task"),
        ("sim/board/core/engine.py", "from neuroflight.sim.board.board import Board"),
        ("training/envs/sb3_vector.py", "import neuroflight.flash.link.msp"),
        ("training/runs/train.py", "import neuroflight.cli.main"),
    ],
)
def test_arrow_is_named_by_its_two_files_when_it_points_up(file: str, line: str) -> None:
    (target,) = imports(ast.parse(line))
    assert upward([(file, target)], ROOMS) == [f"{file} -> {target}"]


def test_circle_is_named_when_there_is_one() -> None:
    assert circle([("a", "b"), ("b", "c"), ("a", "c"), ("a", "a")]) == ""
    assert circle([("a", "b"), ("b", "c"), ("c", "a")]).count(" -> ") == 3


def test_file_without_a_room_is_refused_when_it_imports() -> None:
    with pytest.raises(KeyError, match=r"sim/new\.py stands in no room"):
        room_of("sim/new.py", ROOMS)
