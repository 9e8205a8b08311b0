"""firmware/Makefile: what it refuses and what it rebuilds."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from neuroflight.toolchain.files import locked
from neuroflight.toolchain.image.build import BOARD_FAMILY
from tests.conftest import ROOT

FIRMWARE = ROOT / "firmware"


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["make", "-C", str(FIRMWARE), *arguments], capture_output=True, text=True)


def test_the_known_targets_are_listed_when_the_target_is_unknown() -> None:
    done = make("TARGET=NONSENSE")
    assert done.returncode != 0
    assert "unknown TARGET 'NONSENSE', known are HOST STM32F722" in done.stderr


def test_what_depends_on_a_header_is_rebuilt_when_it_changes(hexacopter_build: Path) -> None:
    generated = hexacopter_build.parent / "generated"
    folders = (("GENERATED", generated), ("BUILD", hexacopter_build))
    named = (f"{name}={os.path.relpath(path, FIRMWARE)}" for name, path in folders)  # as it was built
    arguments = ("TARGET=HOST", *named)
    assert make("-q", *arguments).returncode == 0, "nothing changed"
    newest = max(path.stat().st_mtime_ns for path in hexacopter_build.rglob("*"))
    policy = generated / "policy.h"
    text = policy.read_text()
    while policy.stat().st_mtime_ns <= newest:
        policy.write_text(text)
    plan = make("-n", *arguments).stdout
    assert "src/firmware.c" in plan and "src/control/mixer.c" in plan
    assert "src/receiver/sbus.c" not in plan


def test_no_image_is_compiled_again_when_only_its_dependencies_are_new(board_image: Path) -> None:
    out = board_image.parents[1] / BOARD_FAMILY
    folders = (
        *(("GENERATED", out / "generated"), ("BUILD", board_image.parent / "make")),
        ("OBJ", out / "make" / "obj"),
    )
    named = [f"{name}={os.path.relpath(path, FIRMWARE)}" for name, path in folders]
    (written,) = (out / "make").rglob("boot.d")  # the compiler's, behind what was compiled before it
    with locked(out):
        plan = make("-n", "-W", os.path.relpath(written, FIRMWARE), f"TARGET={BOARD_FAMILY}", *named)
    assert plan.returncode == 0 and " -c " not in plan.stdout
