"""The stamp of a check: what it holds for, and what voids it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy import check_stamp
from neuroflight.toolchain.policy.check_stamp import (
    RULES,
    STAMP_BYTES_MAX,
    fault,
    parse_stamp,
    read_stamp,
    require_fit,
    stamp_document,
    stamp_path,
    write_stamp,
)

POLICY, AIRCRAFT, OTHER = "a" * 64, "b" * 64, "c" * 64
Edit = Callable[[dict[str, Any]], object]


def document(*, fit: bool = True) -> dict[str, Any]:
    return stamp_document(
        policy_sha256=POLICY,
        aircraft="mine",
        aircraft_sha256=AIRCRAFT,
        fit=fit,
        figures={"bars": [{"name": "drift in 10 s", "seen": 47.25, "limit": 13.0, "met": fit}]},
    )


@pytest.fixture
def policy(tmp_path: Path) -> Path:
    return tmp_path / "policy.onnx"


def test_a_stamp_holds_when_policy_aircraft_and_rules_are_those_of_the_check(policy: Path) -> None:
    write_stamp(policy, document())
    assert stamp_path(policy).name == "policy.check.json"
    stamp = require_fit(policy, POLICY, AIRCRAFT, "mine.toml")
    assert (stamp.fit, stamp.rules, stamp.text) == (True, RULES, "fit to fly mine")
    assert require_fit(policy, POLICY, None, "mine.toml").document == document()


@pytest.mark.parametrize(
    ("policy_sha256", "aircraft_sha256", "fit", "words"),
    [
        (OTHER, AIRCRAFT, True, "was changed after its check"),
        (POLICY, OTHER, True, "was checked for another aircraft"),
        (POLICY, AIRCRAFT, False, "is NOT fit to fly mine"),
    ],
)
def test_a_stamp_does_not_hold_when_something_differs(
    policy: Path, policy_sha256: str, aircraft_sha256: str, fit: bool, words: str
) -> None:
    write_stamp(policy, document(fit=fit))
    with pytest.raises(PolicyError) as refused:
        require_fit(policy, policy_sha256, aircraft_sha256, "mine.toml")
    line = str(refused.value)
    assert words in line and "\n" not in line
    assert f"run: neuroflight policy check {policy} --aircraft mine.toml, or add --unchecked" in line


def test_a_policy_without_a_stamp_was_not_checked(policy: Path) -> None:
    assert read_stamp(policy) is None
    with pytest.raises(PolicyError, match="was not checked; run: neuroflight policy check"):
        require_fit(policy, POLICY, AIRCRAFT, "mine.toml")


def test_other_rules_void_a_stamp(monkeypatch: pytest.MonkeyPatch) -> None:
    stamp = parse_stamp(document())
    monkeypatch.setattr(check_stamp, "RULES", RULES + 1)
    assert fault(stamp, POLICY, AIRCRAFT) == f"was checked by rules {RULES}, now there are rules {RULES + 1}"


@pytest.mark.parametrize(
    "edit",
    [
        lambda d: d.update(fit=True),
        lambda d: d.update(fit=True, policy_sha256=OTHER),
        lambda d: d["bars"][0].update(seen=1.0),
        lambda d: d.update(rules=RULES + 1),
        lambda d: d.pop("seal"),
        lambda d: d.update(seal=None),
        lambda d: d.update(more=1),
        lambda d: d.pop("aircraft"),
    ],
)
def test_a_hand_that_edits_a_stamp_voids_it(policy: Path, edit: Edit) -> None:
    edited = document(fit=False)
    edit(edited)
    stamp_path(policy).write_text(json.dumps(edited))
    with pytest.raises(PolicyError, match=r"policy\.check\.json is no stamp of a check: it was changed"):
        read_stamp(policy)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is no stamp of a check"),
        (b"[]", "another format"),
        (b'{"format": 1}', "another format"),
        (b"[" * 100_000, "is no stamp of a check"),
        (b"\xff\xfe", "is no stamp of a check"),
        (b" " * (STAMP_BYTES_MAX + 1), "expected at most"),
    ],
)
def test_a_file_that_is_no_stamp_is_refused_in_one_line(policy: Path, content: bytes, words: str) -> None:
    stamp_path(policy).write_bytes(content)
    with pytest.raises(PolicyError, match=words) as refused:
        require_fit(policy, POLICY, AIRCRAFT, "mine.toml")
    assert "\n" not in str(refused.value) and "--unchecked" in str(refused.value)


@pytest.mark.parametrize("key", ["rules", "fit", "policy_sha256", "aircraft_sha256"])
def test_a_sealed_document_with_another_kind_of_value_is_no_stamp(key: str) -> None:
    figures = {key: [1]}
    sealed = stamp_document(
        policy_sha256=POLICY, aircraft="mine", aircraft_sha256=AIRCRAFT, fit=True, figures=figures
    )
    with pytest.raises(PolicyError, match="does not tell what was checked"):
        parse_stamp(sealed)
