"""What `make lint` says of the firmware's C."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.image.cppcheck import ANALYSER, FIRMWARE, SOURCES, analyse, main

needs_analyser = pytest.mark.skipif(shutil.which(ANALYSER) is None, reason=f"{ANALYSER} is not installed")


@pytest.fixture
def firmware(tmp_path: Path) -> Path:
    """A firmware of one module, with the project's own exceptions."""
    for source in SOURCES:
        (tmp_path / source).mkdir(parents=True)
        (tmp_path / source / "empty.c").write_text("extern int nothing;\n")
    shutil.copy(FIRMWARE / "cppcheck.txt", tmp_path)
    return tmp_path


@pytest.mark.slow
@needs_analyser
def test_a_finding_alone_names_file_and_line_when_code_is_wrong(firmware: Path, shipped_policy: Path) -> None:
    (firmware / "src" / "wrong.c").write_text(
        "int f(int n);\nint f(int n)\n{\n\tint a[2] = { 0, 0 };\n\n\treturn a[2] + n;\n}\n"
    )
    found = analyse(shipped_policy, firmware)
    assert "src/wrong.c:6: error: " in found
    assert found.count(": error: ") == 1 and "empty.c" not in found


@needs_analyser
@pytest.mark.slow
def test_the_firmware_is_clean_when_analysed(shipped_policy: Path) -> None:
    assert analyse(shipped_policy) == ""


def test_the_one_command_is_said_when_the_analyser_is_missing(
    firmware: Path, shipped_policy: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(firmware))
    with pytest.raises(BuildError, match="cppcheck is not installed; run: sudo apt-get install cppcheck"):
        analyse(shipped_policy, firmware)
    assert main([str(shipped_policy)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
