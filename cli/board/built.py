"""The image that was built last, where a user names none."""

from __future__ import annotations

from pathlib import Path

from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import write_text

BUILD = Path(__file__).resolve().parents[2] / "build"
USUAL = "MATEKF722"


HOST_REPORT = Path("HOST", "report.json")
LAST = "built"  # file beside the builds: name of the board that was built for last, and what --target named


def note_built(name: str, target: str) -> None:
    """Note that the board `name` was built for, by `--target target`. Raises OSError."""
    named = Path(target).resolve() if target.endswith(".toml") else target
    write_text(BUILD / LAST, f"{name}\n{named}\n")


def built_last() -> Path:
    """Return the folder of the build for the board that was built for last, of the usual one if none was."""
    try:
        name = (BUILD / LAST).read_text(encoding="utf-8").partition("\n")[0]
    except (OSError, UnicodeDecodeError):
        name = ""
    return BUILD / (name if name and (BUILD / name / "neuroflight.bin").is_file() else USUAL)


def host_is_older() -> bool:
    """Return whether a board was built for later than the host program was."""
    times = [path.stat().st_mtime if path.is_file() else 0.0 for path in (BUILD / LAST, BUILD / HOST_REPORT)]
    return times[0] > times[1]


def built_image(file: str) -> Path:
    """Return that product of the only board that was built for, or of the usual one where none was.

    Raises BuildError, one line: several were.
    """
    found = sorted(path for path in BUILD.glob(f"*/{file}"))
    if len(found) > 1:
        names = ", ".join(path.parent.name for path in found)
        raise BuildError(
            f"images of several boards are built, {names}; name the one that is meant: build/NAME/{file}"
        )
    return found[0] if found else BUILD / USUAL / file
