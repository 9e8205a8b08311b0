"""Packages that not every command needs: the extras of pyproject.toml, and how to install one."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = {  # each brings what those above it bring; packages under the names they are imported by
    "gateway": ("pymavlink",),
    "sim": ("PIL", "cffi", "matplotlib", "pybullet", "scipy", "trimesh"),
    "train": (
        "gymnasium",
        "onnxruntime",
        "onnxscript",
        "sb3_contrib",
        "stable_baselines3",
        "tensorboard",
        "torch",
    ),
    "sweep": ("ray",),
}


def install_command(extra: str) -> str:
    """Return the line that installs an extra: of a checkout, or of the wheel that is installed."""
    if (ROOT / "setup.sh").is_file():
        return f"make setup EXTRA={extra}"
    return f"pip install 'neuroflight[{extra}] @ WHEEL', WHEEL being the file that it was installed from"
