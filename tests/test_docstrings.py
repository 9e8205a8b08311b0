"""Docstrings in plain English: a function's begins with a verb, that of a type, property or room with a noun.

ruff's D401 knows verbs and articles; these words, which begin a noun clause, it passes.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
ROOMS = ("cli", "flash", "sim", "toolchain", "training")
CLAUSES = "how|of|what|when|where|whether|which|who|whose|why"
NO_VERBS = (
    f"{CLAUSES}|a|after|all|an|any|as|at|before|behind|both|by|each|every|for|from|in|it|its|likewise|nothing|on"
    "|one|once|so|that|the|these|this|those|three|to|two|until|with|without"
)


def wrong(source: str) -> Iterator[str]:
    """Yield line and docstring of each function, type and module that begins with the wrong kind of word."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef | ast.Module):
            continue
        text = ast.get_docstring(node) or "Return."
        acts = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not any(
            "property" in ast.unparse(decorator) for decorator in node.decorator_list
        )
        if re.match(rf"({NO_VERBS if acts else CLAUSES})\b", text, re.IGNORECASE):
            yield f"{getattr(node, 'lineno', 1)}: {text.splitlines()[0]}"


@pytest.mark.parametrize("room", ROOMS)
def test_docstrings_begin_with_a_verb_or_a_noun(room: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sorted((ROOT / room).rglob("*.py"))
        for line in wrong(path.read_text())
    ]
    assert not found, "\n".join(found)


def test_noun_clauses_are_found_in_functions_types_and_modules() -> None:
    source = (
        '"""Why."""\nclass A:\n    """What is."""\n    @property\n    def a(self):\n        """The a."""\n'
    )
    assert [line.split(":")[0] for line in wrong(source)] == ["1", "2"]
    assert list(wrong('def f():\n    """Whether it is."""\n')) == ["1: Whether it is."]
