"""What the core may not contain: heap, maths library, statics that change, preprocessor switches."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SOURCE = ROOT / "firmware" / "src"
MODULES = sorted(
    str(path.relative_to(SOURCE).with_suffix("")) for path in SOURCE.rglob("*.c") if path.name != "main.c"
)
MEMORY = {"memcpy", "memset", "memcmp", "memmove"}  # the compiler itself may ask for these four

TEXT = {"strchr"}  # the host's reader of NAME=VALUE


def symbols(*arguments: str | Path) -> list[tuple[str, str]]:
    """(kind, name) of each symbol that nm tells of these files."""
    done = subprocess.run(["nm", "--print-file-name", *arguments], capture_output=True, text=True, check=True)
    return [(words[-2], words[-1].split("@")[0]) for words in map(str.split, done.stdout.splitlines())]


def test_the_core_calls_only_itself_and_the_policy_when_linked(scripted_build: Path) -> None:
    core = symbols(*(scripted_build / "obj" / "src" / f"{module}.o" for module in MODULES))
    policy = symbols(scripted_build / "obj" / "policy.o")
    defined = {name for kind, name in (*core, *policy) if kind.isupper() and kind != "U"}
    linkage = {"_GLOBAL_OFFSET_TABLE_"}
    assert {name for kind, name in core if kind == "U"} - defined - linkage <= MEMORY


def test_the_library_calls_no_heap_and_no_maths_when_loaded(scripted_build: Path) -> None:
    called = {name for kind, name in symbols("-D", scripted_build / "libneuroflight.so") if kind == "U"}
    assert called <= MEMORY | TEXT | {"__memcpy_chk"}, called


def mutable(path: Path) -> set[str]:
    """Variables of an object that can be written; tables that hold addresses are relocated, then constant."""
    table = subprocess.run(["objdump", "-t", str(path)], capture_output=True, text=True, check=True).stdout
    writable = r"^\S+ .{7} \.(?:bss|data(?!\.rel\.ro))\S*\s\S+ (\w+)$"
    return set(re.findall(writable, table, re.MULTILINE))


def test_only_main_has_variables_of_its_own_when_compiled(scripted_build: Path) -> None:
    folder = scripted_build / "obj" / "src"
    found = {module: mutable(folder / f"{module}.o") for module in ("main", *MODULES)}
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
    assert not any(found.values()), found


def test_the_core_is_the_same_for_every_target_when_preprocessed() -> None:
    for path in sorted([*SOURCE.rglob("*.c"), *SOURCE.rglob("*.h")]):
        text = path.read_text()
        conditions = re.findall(r"^\s*#\s*(?:if|ifdef|ifndef|elif)\b.*", text, re.MULTILINE)
        assert not conditions, f"{path.name}: {conditions}"
        assert path.suffix != ".h" or text.count("#pragma once\n") == 1, path.name


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
