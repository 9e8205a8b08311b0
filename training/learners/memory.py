"""The size of a replay buffer in a checkpoint, checked before a step is flown."""

from __future__ import annotations

from neuroflight.toolchain.contract import CHECKPOINT_FILE_BYTES_MAX
from neuroflight.toolchain.errors import TrainingError

NUMBER_BYTES = 4  # float32


def check_memory(buffer: int, steps: int, numbers: int) -> None:
    """Raise TrainingError if a buffer is too large for a checkpoint, of which it is part.

    buffer: its control steps. steps: of the whole run, which may be fewer. numbers: kept of each step.
    """
    size = min(buffer, steps) * numbers * NUMBER_BYTES
    if size > CHECKPOINT_FILE_BYTES_MAX:
        most = CHECKPOINT_FILE_BYTES_MAX // (numbers * NUMBER_BYTES)
        raise TrainingError(
            f"algorithm.buffer {buffer}: a checkpoint would have {size} bytes of it, expected at most "
            f"{CHECKPOINT_FILE_BYTES_MAX}; choose at most {most}"
        )
