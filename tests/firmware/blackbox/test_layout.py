"""struct firmware lies alike in the image and on a computer: a log begins with its bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from elftools.elf.elffile import ELFFile

POINTERS = 7  # of struct firmware: each has 8 bytes to itself (held.h)
THROUGH = ("DW_TAG_typedef", "DW_TAG_volatile_type", "DW_TAG_const_type")
STRUCTS = ("DW_TAG_structure_type", "DW_TAG_union_type")


def kind_of(die: Any) -> Any:
    kind = die.get_DIE_from_attribute("DW_AT_type")
    while kind.tag in THROUGH:
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    return kind


def value(die: Any, name: str) -> Any:
    return die.attributes[name].value if name in die.attributes else None


def members(kind: Any, path: str, offset: int) -> dict[str, tuple[int, int]]:
    """Offset and size of each number below `kind`; of an array the first one's, bounds in its name."""
    found: dict[str, tuple[int, int]] = {}
    for member in kind.iter_children():
        if member.tag != "DW_TAG_member":
            continue
        name = (value(member, "DW_AT_name") or b"").decode()
        at, of = offset + (value(member, "DW_AT_data_member_location") or 0), kind_of(member)
        where = f"{path}.{name}" if name else path
        while of.tag == "DW_TAG_array_type":
            bounds = [value(child, "DW_AT_upper_bound") for child in of.iter_children()]
            where += "".join(f"[{bound}]" for bound in bounds)
            of = kind_of(of)
        if of.tag in STRUCTS:
            found[f"{where} whole"] = (at, value(of, "DW_AT_byte_size"))
            found |= members(of, where, at)
        elif of.tag == "DW_TAG_pointer_type":
            found[f"{where} pointer"] = (at, 8)
        else:
            found[where] = (at, value(of, "DW_AT_byte_size"))
    return found


def layout(path: Path, name: str) -> dict[str, tuple[int, int]]:
    with path.open("rb") as file:
        for unit in ELFFile(file).get_dwarf_info().iter_CUs():
            for die in unit.get_top_DIE().iter_children():
                whole = value(die, "DW_AT_byte_size")
                named = value(die, "DW_AT_name") == name.encode()
                if die.tag == "DW_TAG_structure_type" and named and whole:
                    return {"whole": (0, whole)} | members(die, name, 0)
    raise AssertionError(f"{path}: no struct {name}")


@pytest.mark.parametrize("name", ["firmware", "log_record"])
def test_every_member_lies_where_it_does_in_the_image(
    name: str, board_image: Path, reference_library: Path
) -> None:
    image, computer = layout(board_image, name), layout(reference_library, name)
    assert len(image) > 40
    assert image == computer
    if name == "firmware":
        assert sum(path.endswith("pointer") for path in image) == POINTERS
