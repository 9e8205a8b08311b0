"""What the core may not contain: heap, maths library, statics that change, preprocessor switches."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "firmware" / "src"
MODULES = sorted(
    str(path.relative_to(SOURCE).with_suffix("")) for path in SOURCE.rglob("*.c") if path.name != "main.c"
)
MEMORY = {"memcpy", "memset", "memcmp", "memmove"}  # the compiler itself may ask for these four

TEXT = {"strchr"}  # the host's reader of NAME=VALUE


def symbols(path: Path, *options: str) -> list[tuple[str, str]]:
    """(kind, name) of each symbol."""
    done = subprocess.run(["nm", *options, str(path)], capture_output=True, text=True, check=True)
    return [(words[-2], words[-1].split("@")[0]) for words in map(str.split, done.stdout.splitlines())]


@pytest.fixture(scope="module")
def objects(scripted_build: Path) -> dict[str, list[tuple[str, str]]]:
    """Symbols of each core module."""
    return {module: symbols(scripted_build / "obj" / "src" / f"{module}.o") for module in MODULES}


def test_the_core_calls_only_itself_and_the_policy_when_linked(
    scripted_build: Path, objects: dict[str, list[tuple[str, str]]]
) -> None:
    everything = [*objects.values(), symbols(scripted_build / "obj" / "policy.o")]
    defined = {name for module in everything for kind, name in module if kind.isupper() and kind != "U"}
    linkage = {"_GLOBAL_OFFSET_TABLE_"}
    wanted = {name for module in objects.values() for kind, name in module if kind == "U"}
    assert wanted - defined - linkage <= MEMORY


def test_the_library_calls_no_heap_and_no_maths_when_loaded(scripted_build: Path) -> None:
    called = {name for kind, name in symbols(scripted_build / "libneuroflight.so", "-D") if kind == "U"}
    assert called <= MEMORY | TEXT | {"__memcpy_chk"}, called


def mutable(path: Path) -> set[str]:
    """Variables of an object that can be written; tables that hold addresses are relocated, then constant."""
    table = subprocess.run(["objdump", "-t", str(path)], capture_output=True, text=True, check=True).stdout
    writable = r"^\S+ .{7} \.(?:bss|data(?!\.rel\.ro))\S*\s\S+ (\w+)$"
    return set(re.findall(writable, table, re.MULTILINE))


def test_only_main_has_variables_of_its_own_when_compiled(scripted_build: Path) -> None:
    folder = scripted_build / "obj" / "src"
    found = {str(path.relative_to(folder).with_suffix("")): mutable(path) for path in folder.rglob("*.o")}
    assert found.pop("main") == {
        "firmware",
        "weights",
        "stats",
        "info",
        "fault",
        "background",
        "log_ring",
        "runtime",
    }
    assert set(found) == set(MODULES)
    assert not any(found.values()), found


def test_the_core_is_the_same_for_every_target_when_preprocessed() -> None:
    for path in sorted([*SOURCE.rglob("*.c"), *SOURCE.rglob("*.h")]):
        text = path.read_text()
        conditions = re.findall(r"^\s*#\s*(?:if|ifdef|ifndef|elif)\b.*", text, re.MULTILINE)
        guards = 1 if path.suffix == ".h" else 0
        assert len(conditions) == guards, f"{path.name}: {conditions}"


def test_only_the_top_of_the_core_knows_the_hardware_boundary_when_read() -> None:
    users = {path.name for path in SOURCE.rglob("*.[ch]") if '#include "port/hal.h"' in path.read_text()}
    assert users == {"main.c", "runtime.h", "background.h"}


def test_no_two_static_functions_share_a_name_when_read() -> None:
    definition = re.compile(r"^static .*?\b(?!__attribute__)(\w+)\([^;{]*\)\n\{", re.MULTILINE)
    names = [
        name
        for path in sorted(SOURCE.parent.rglob("*.[ch]"))
        if "generated" not in path.parts
        for name in definition.findall(path.read_text())
    ]
    assert len(names) > 300
    assert sorted(set(names)) == sorted(names)
