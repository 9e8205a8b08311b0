"""Results as they are stored: only what the page, its plot and its guards read of a command's output."""

from __future__ import annotations

from typing import Any

from neuroflight.training.results_page.page import render
from neuroflight.training.results_page.stored_results import Stored
from neuroflight.training.results_page.studies import drawn_points

OF_WHAT = ("command", "seed", "sha256")  # ends of keys that stay: they tell what was measured


class _Watched(dict[str, Any]):
    """An object of JSON that knows which of its keys were asked for."""

    def __init__(self, document: dict[str, Any]) -> None:
        super().__init__({key: _watched(value) for key, value in document.items()})
        self.read = {key for key in document if key.endswith(OF_WHAT)}

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401 - any JSON value
        self.read.add(key)
        return super().__getitem__(key)


def summary(name: str, document: dict[str, Any]) -> dict[str, Any]:
    """Return what the page reads of the output of a command. Raises ResultsError on what is no result."""
    stored = Stored(name, _Watched(document))
    render([stored])
    drawn_points(stored)
    found: dict[str, Any] = _read(stored.document)
    return found


def _watched(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, dict):
        return _Watched(value)
    return [_watched(each) for each in value] if isinstance(value, list) else value


def _read(value: Any) -> Any:  # noqa: ANN401 - any JSON value
    if isinstance(value, _Watched):
        return {key: _read(each) for key, each in value.items() if key in value.read}
    return [_read(each) for each in value] if isinstance(value, list) else value
