"""What tests of the twin have in common."""

from collections.abc import Callable
from typing import Any


def repeat(times: int, step: Callable[..., object], *arguments: Any) -> None:
    for _ in range(times):
        step(*arguments)
