"""Variables of an image by their names in the sources: where they lie and how to read them, from its DWARF.

A name is a path such as "firmware.status.trace.step". A field that was renamed, moved or changed in type is
found where it is now, or not at all: nothing here knows a layout.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from elftools.common.exceptions import ELFError
from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.errors import BuildError

_OP_ADDR = 0x03  # DW_OP_addr (DWARF 5, 7.7.1)
_KINDS = {2: "u", 4: "f", 5: "i", 6: "i", 7: "u", 8: "u"}  # DW_ATE_... (DWARF 5, 7.8)
_THROUGH = ("DW_TAG_typedef", "DW_TAG_volatile_type", "DW_TAG_const_type")


@dataclass(frozen=True)
class Variable:
    """A number, an array of them, or a structure, at a fixed place."""

    address: int
    dtype: np.dtype[Any]  # little-endian; an array has a shape, structures and unions fields, a pointer bytes

    @property
    def size(self) -> int:
        """Bytes."""
        return self.dtype.itemsize


def read_variables(elf: Path, *paths: str) -> tuple[Variable, ...]:
    """Find the variables at `paths`. Raises BuildError for an unknown or ambiguous one.

    Results are cached by the file's content.
    """
    return _variables(elf, _content(elf), paths)


@lru_cache(maxsize=64)
def _variables(elf: Path, content: bytes, paths: tuple[str, ...]) -> tuple[Variable, ...]:
    """content: digest of `elf`'s bytes, which makes the cache depend on them."""
    places = [_place(_units(elf, content), path, elf) for path in paths]
    return tuple(Variable(at, _dtype(kind, path)) for path, (at, kind) in zip(paths, places, strict=True))


def pointers_in(elf: Path, path: str) -> tuple[slice, ...]:
    """Return the bytes of each pointer in the variable at `path`, or of the union around it.

    Raises BuildError as `read_variables` does.
    """
    return tuple(_pointers(_place(_units(elf, _content(elf)), path, elf)[1], 0))


def constant(elf: Path, path: str) -> bytes:
    """Read the constant at `path` from the file. Raises BuildError as `read_variables` does."""
    (variable,) = read_variables(elf, path)
    with elf.open("rb") as file:
        for segment in ELFFile(file).iter_segments("PT_LOAD"):
            at = variable.address - segment["p_vaddr"]
            if at >= 0 and at + variable.size <= segment["p_filesz"]:
                return bytes(segment.data()[at : at + variable.size])
    raise BuildError(f"{elf}: {path} is not in the file")


def _content(elf: Path) -> bytes:
    """Return the digest of the file's bytes."""
    try:
        return hashlib.sha256(elf.read_bytes()).digest()
    except OSError as error:
        raise _no_elf(elf, error) from error


@lru_cache(maxsize=2)
def _units(elf: Path, content: bytes) -> list[Any]:
    """Return the compilation units of the image. What was read of them once is kept; content: as above."""
    try:
        with elf.open("rb") as file:
            image = ELFFile(file)
            return list(image.get_dwarf_info().iter_CUs()) if image.has_dwarf_info() else []
    except (OSError, ELFError) as error:
        raise _no_elf(elf, error) from error


def _no_elf(elf: Path, error: Exception) -> BuildError:
    return BuildError(f"{elf}: not an ELF file with debug information ({error})")


def _pointers(kind: Any, at: int) -> Iterator[slice]:  # noqa: ANN401 - pyelftools has no types
    """Yield the bytes of each pointer in a value of `kind` at byte `at`."""
    size = kind.attributes["DW_AT_byte_size"].value if "DW_AT_byte_size" in kind.attributes else 0
    if kind.tag == "DW_TAG_pointer_type":
        yield slice(at, at + size)
    elif kind.tag == "DW_TAG_array_type":
        item = _type(kind)
        each = _dtype(item, "").itemsize
        for i in range(int(np.prod(_bounds(kind)))):
            yield from _pointers(item, at + i * each)
    elif kind.tag == "DW_TAG_union_type":
        if any(True for _, inner, member in _members(kind) for _ in _pointers(member, inner)):
            yield slice(at, at + size)
    else:
        for child in kind.iter_children() if kind.tag == "DW_TAG_structure_type" else ():
            if child.tag == "DW_TAG_member":
                yield from _pointers(_type(child), at + child.attributes["DW_AT_data_member_location"].value)


def _place(units: list[Any], path: str, elf: Path) -> tuple[int, Any]:
    """Return address and type of the variable at `path`."""
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
    if len(location) not in (5, 9) or location[0] != _OP_ADDR:  # an address of 4 bytes, or of a computer's 8
        raise BuildError(f"{elf}: {name} has no fixed place")
    address, kind = int.from_bytes(bytes(location[1:]), "little"), _type(found[0])
    for field in fields:
        members = {name: (at, inner) for name, at, inner in _members(kind)}
        if field not in members:
            raise BuildError(f"{elf}: {path}: there is no {field}, only {', '.join(members) or 'a number'}")
        at, kind = members[field]
        address += at
    return address, kind


def _name(die: Any) -> str:  # noqa: ANN401 - pyelftools has no types
    die = _declaration(die)
    return die.attributes["DW_AT_name"].value.decode() if "DW_AT_name" in die.attributes else ""


def _declaration(die: Any) -> Any:  # noqa: ANN401
    """Return the entry with the name and type of `die`: its declaration, if a header declares it."""
    declared = "DW_AT_specification" in die.attributes
    return die.get_DIE_from_attribute("DW_AT_specification") if declared else die


def _type(die: Any) -> Any:  # noqa: ANN401
    """Return the type of `die`, without names and qualifiers."""
    kind = _declaration(die).get_DIE_from_attribute("DW_AT_type")
    while kind.tag in _THROUGH:
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    return kind


def _members(kind: Any) -> Iterator[tuple[str, int, Any]]:  # noqa: ANN401
    """Return name, place and type of each member, also of members of one without a name."""
    if kind.tag not in ("DW_TAG_structure_type", "DW_TAG_union_type"):
        return
    for child in kind.iter_children():
        if child.tag != "DW_TAG_member":
            continue
        place = child.attributes.get("DW_AT_data_member_location")
        at = 0 if place is None else place.value  # those of a union have none
        if _name(child):
            yield _name(child), at, _type(child)
        else:
            yield from ((name, at + inner, one) for name, inner, one in _members(_type(child)))


def _bounds(kind: Any) -> tuple[int, ...]:  # noqa: ANN401
    """Return the shape of an array."""
    return tuple(child.attributes["DW_AT_upper_bound"].value + 1 for child in kind.iter_children())


def _dtype(kind: Any, path: str) -> np.dtype[Any]:  # noqa: ANN401
    if kind.tag == "DW_TAG_base_type":
        size, encoding = (kind.attributes[f"DW_AT_{name}"].value for name in ("byte_size", "encoding"))
        return np.dtype(f"<{_KINDS[encoding]}{size}")
    if kind.tag == "DW_TAG_array_type":
        return np.dtype((_dtype(_type(kind), path), _bounds(kind)))
    if members := list(_members(kind)):
        return np.dtype(
            {
                "names": [name for name, _, _ in members],
                "formats": [_dtype(inner, f"{path}.{name}") for name, _, inner in members],
                "offsets": [at for _, at, _ in members],
                "itemsize": kind.attributes["DW_AT_byte_size"].value,
            }
        )
    if kind.tag == "DW_TAG_enumeration_type":
        return np.dtype(f"<u{kind.attributes['DW_AT_byte_size'].value}")
    if kind.tag == "DW_TAG_pointer_type":
        return np.dtype(f"V{kind.attributes['DW_AT_byte_size'].value}")
    raise BuildError(f"{path} is a {kind.tag}, expected numbers")
