"""The short name of a policy file, in tables, plots and verdicts."""

from __future__ import annotations

from pathlib import Path


def policy_label(path: str | Path) -> str:
    """Return "policy " and the file's name, or its folder's where the file is called policy.onnx."""
    file = Path(path)
    return f"policy {file.parent.name if file.stem == 'policy' and file.parent.name else file.stem}"
