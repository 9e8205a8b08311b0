"""Every message of the contract: its layout packs and unpacks what it says, many times each."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

from neuroflight.flash.link.layouts import decode, encode
from neuroflight.toolchain.contract.msp_fields import NUMBERS, MspField, MspGroup
from neuroflight.toolchain.contract.msp_layouts import MspLayout
from neuroflight.toolchain.contract.msp_messages import LAYOUTS
from neuroflight.toolchain.errors import LinkError
from tests.sampling import examples

MANY = settings(
    max_examples=examples(40), deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)
THOUSAND = settings(MANY, max_examples=examples(1000))
WIDTHS = {"B": 8, "b": 8, "H": 16, "h": 16, "I": 32, "i": 32}
CHARACTERS = st.characters(min_codepoint=32, max_codepoint=126)
NAMES = [f"{layout.message.name}-{layout.direction.value}" for layout in LAYOUTS]


def numbers(kind: str) -> st.SearchStrategy[Any]:
    """All numbers that a field of this kind holds."""
    letter = NUMBERS[kind]
    if letter == "f":
        return st.floats(width=32, allow_nan=False)
    low = 0 if letter.isupper() else -(2 ** (WIDTHS[letter] - 1))
    return st.integers(low, low + 2 ** WIDTHS[letter] - 1)


def values_of(field: MspField | MspGroup) -> st.SearchStrategy[Any]:
    """What a field may be."""
    if isinstance(field, MspGroup):
        items = st.fixed_dictionaries({inner.name: values_of(inner) for inner in field.fields})
        return st.lists(items, min_size=field.count, max_size=field.count or 20)
    match field.kind:
        case "text":
            return st.text(CHARACTERS, max_size=field.count or 40)
        case "counted":
            return st.text(CHARACTERS, max_size=255)
        case "bytes":
            return st.binary(min_size=field.count, max_size=field.count or 40)
    one = numbers(field.kind)
    return one if field.count == 1 else st.tuples(*[one] * field.count)


def messages(layout: MspLayout) -> st.SearchStrategy[dict[str, Any]]:
    """Values of all fields of a message."""
    return st.fixed_dictionaries({field.name: values_of(field) for field in layout.fields})


def check_round_trip(layout: MspLayout, many: settings) -> None:
    @many
    @given(messages(layout))
    def check(values: dict[str, Any]) -> None:
        note(layout.message.name)
        payload = encode(layout, values)
        assert decode(layout, payload, whole=True) == values
        assert encode(layout, decode(layout, payload)) == payload

    check()


def test_a_message_comes_out_as_it_went_in() -> None:
    for layout in LAYOUTS:
        check_round_trip(layout, MANY)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS, ids=NAMES)
def test_a_thousand_of_each_come_out_as_they_went_in(layout: MspLayout) -> None:
    check_round_trip(layout, THOUSAND)


def check_any_bytes(layout: MspLayout, many: settings) -> None:
    @many
    @given(st.binary(max_size=300))
    def check(payload: bytes) -> None:
        note(layout.message.name)
        try:
            values = decode(layout, payload, whole=True)
        except LinkError as error:
            assert layout.message.name in str(error) and "\n" not in str(error)
            return
        assert repr(decode(layout, encode(layout, values), whole=True)) == repr(values)  # NaN is itself here

    check()


def test_any_bytes_are_read_or_refused_in_one_line() -> None:
    for layout in LAYOUTS:
        check_any_bytes(layout, MANY)


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS, ids=NAMES)
def test_a_thousand_of_any_bytes_are_read_or_refused_in_one_line(layout: MspLayout) -> None:
    check_any_bytes(layout, THOUSAND)
