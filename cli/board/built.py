"""The image that was built last, where a user names none."""

from __future__ import annotations

from pathlib import Path

from neuroflight.toolchain.errors import BuildError

BUILD = Path(__file__).resolve().parents[2] / "build"
USUAL = "MATEKF722"


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
