"""pybullet, without the line that it prints on stderr when it is first imported."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def _nothing_on_stderr() -> Iterator[None]:
    """Discard the process's stderr: the line is printed by C."""
    if sys.stderr is not None:
        sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


with _nothing_on_stderr():
    import pybullet as pybullet
