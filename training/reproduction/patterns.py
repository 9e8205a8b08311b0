"""Patterns of `experiments.toml`: an entry that stands for several which differ in a word.

`[each.NAME]` has a key for each value of `<NAME>`, with the words of that value: `<NAME.WORD>`. What has
`<NAME>` in its name is there once for each value; so is a key of it with a `<NAME>` that its name lacks.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import product
from typing import Any

USED = re.compile(r"<([a-z]\w*)(?:\.(\w+))?>")
Words = Mapping[str, Mapping[str, Mapping[str, str]]]  # by NAME, value and WORD


class PatternError(ValueError):
    """A word that no value has; the text that uses it stands in the message."""


def expanded(document: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the file with its patterns replaced by their entries. Raises PatternError naming an unknown
    word."""
    each: Words = document.get("each", {})
    patterns, rows_of = document.get("steps", {}).items(), document.get("rows", {}).items()
    steps = dict(pair for name, text in patterns for pair in _each_of(text, name, each))
    rows = dict(pair for name, row in rows_of for pair in _rows(row, name, each))
    return {**{key: value for key, value in document.items() if key != "each"}, "steps": steps, "rows": rows}


def _rows(pattern: Any, name: str, each: Words) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - any TOML value
    """Yield the rows that a pattern stands for; its table of whys has them by the rows' names."""
    rows = dict(_each_of(pattern, name, each))
    whys = pattern.get("why") if isinstance(pattern, dict) else None
    if isinstance(whys, dict):
        if unknown := sorted(set(whys) - set(rows)):
            raise PatternError(f"why {unknown[0]}: no such row, expected one of: {', '.join(rows)}")
        for own, row in rows.items():
            row.pop("why")
            row |= {"why": whys[own]} if own in whys else {}
    yield from rows.items()


def _each_of(pattern: Any, name: str, each: Words) -> Iterator[tuple[str, Any]]:  # noqa: ANN401 - any TOML value
    """Yield the names that `name` stands for, each with its entry."""
    for values in _values(name, each, {}):
        yield _filled(name, values, each), _entry(pattern, values, each)


def _filled(text: str, values: Mapping[str, str], each: Words) -> str:
    """Return a text with the words of `values`."""

    def word(found: re.Match[str]) -> str:
        name, word = found.groups()
        if name not in values:
            raise PatternError(
                f"{text.strip()[:80]!r}: <{name}> is in no name; expected one of: {', '.join(each)}"
            )
        known = each[name][values[name]]
        if word is not None and word not in known:
            raise PatternError(f"{text.strip()[:80]!r}: {name} {values[name]} has no {word}")
        return values[name] if word is None else known[word]

    return USED.sub(word, text)


def _entry(entry: Any, values: Mapping[str, str], each: Words) -> Any:  # noqa: ANN401 - any TOML value
    if isinstance(entry, str):
        return _filled(entry, values, each)
    if not isinstance(entry, dict):
        return entry
    return {
        _filled(key, more, each): _entry(item, more, each)
        for key, item in entry.items()
        for more in _values(key, each, values)
    }


def _values(text: str, each: Words, given: Mapping[str, str]) -> Iterator[Mapping[str, str]]:
    """Yield the values of all names that `text` uses beside those `given`, in every combination."""
    open_names = dict.fromkeys(name for name, _ in USED.findall(text) if name in each and name not in given)
    for chosen in product(*(each[name] for name in open_names)):
        yield {**given, **dict(zip(open_names, chosen, strict=True))}
