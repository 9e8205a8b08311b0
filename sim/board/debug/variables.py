"""Variables of an image by their names in the sources: where they lie and how to read them, from its DWARF.

A name is a path such as "firmware.status.trace.step". A field that was renamed, moved or changed in type is
found where it is now, or not at all: nothing here knows a layout.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from toolchain.errors import BuildError

_OP_ADDR = 0x03  # DW_OP_addr (DWARF 5, 7.7.1)
_KINDS = {2: "u", 4: "f", 5: "i", 6: "i", 7: "u", 8: "u"}  # DW_ATE_... (DWARF 5, 7.8)
_THROUGH = ("DW_TAG_typedef", "DW_TAG_volatile_type", "DW_TAG_const_type")


@dataclass(frozen=True)
class Variable:
    """A number, an array of them, or a structure, at a fixed place."""

    address: int
    dtype: np.dtype[Any]  # little-endian; an array has a shape, a structure fields

    @property
    def size(self) -> int:
        """Bytes."""
        return self.dtype.itemsize


def read_variables(elf: Path, *paths: str) -> tuple[Variable, ...]:
    """The variables at `paths`. Raises BuildError when the ELF says nothing of one, or of two alike."""
    try:
        with elf.open("rb") as file:
            image = ELFFile(file)
            units = list(image.get_dwarf_info().iter_CUs()) if image.has_dwarf_info() else []
            return tuple(_find(units, path, elf) for path in paths)
    except (OSError, ELFError) as error:
        raise BuildError(f"{elf}: not an ELF file with debug information ({error})") from error


def _find(units: list[Any], path: str, elf: Path) -> Variable:
    name, *fields = path.split(".")
    found = [
        die
        for unit in units
        for die in unit.get_top_DIE().iter_children()
        if die.tag == "DW_TAG_variable" and _name(die) == name and "DW_AT_location" in die.attributes
    ]
    if len(found) != 1:
        raise BuildError(f"{elf}: {len(found)} variables named {name}, expected one")
    location = found[0].attributes["DW_AT_location"].value
    if len(location) != 5 or location[0] != _OP_ADDR:
        raise BuildError(f"{elf}: {name} has no fixed place")
    address, kind = int.from_bytes(bytes(location[1:]), "little"), _type(found[0])
    for field in fields:
        members = {_name(member): member for member in _members(kind)}
        if field not in members:
            raise BuildError(f"{elf}: {path}: there is no {field}, only {', '.join(members) or 'a number'}")
        address += members[field].attributes["DW_AT_data_member_location"].value
        kind = _type(members[field])
    return Variable(address, _dtype(kind, path))


def _name(die: Any) -> str:  # noqa: ANN401 - pyelftools has no types
    return die.attributes["DW_AT_name"].value.decode() if "DW_AT_name" in die.attributes else ""


def _type(die: Any) -> Any:  # noqa: ANN401
    """What `die` is of, without names and qualifiers."""
    kind = die.get_DIE_from_attribute("DW_AT_type")
    while kind.tag in _THROUGH:
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    return kind


def _members(kind: Any) -> list[Any]:  # noqa: ANN401
    if kind.tag != "DW_TAG_structure_type":
        return []
    return [child for child in kind.iter_children() if child.tag == "DW_TAG_member"]


def _dtype(kind: Any, path: str) -> np.dtype[Any]:  # noqa: ANN401
    if kind.tag == "DW_TAG_base_type":
        size, encoding = (kind.attributes[f"DW_AT_{name}"].value for name in ("byte_size", "encoding"))
        return np.dtype(f"<{_KINDS[encoding]}{size}")
    if kind.tag == "DW_TAG_array_type":
        bounds = [child.attributes["DW_AT_upper_bound"].value + 1 for child in kind.iter_children()]
        return np.dtype((_dtype(_type(kind), path), tuple(bounds)))
    if kind.tag == "DW_TAG_structure_type":
        members = _members(kind)
        return np.dtype(
            {
                "names": [_name(member) for member in members],
                "formats": [_dtype(_type(member), f"{path}.{_name(member)}") for member in members],
                "offsets": [member.attributes["DW_AT_data_member_location"].value for member in members],
                "itemsize": kind.attributes["DW_AT_byte_size"].value,
            }
        )
    raise BuildError(f"{path} is a {kind.tag}, expected numbers")
