"""The structs that Python shares with the firmware (toolchain/contract/structs.py), for numpy and cffi."""

from __future__ import annotations

import numpy as np

from neuroflight.toolchain.contract import STRUCTS, HeaderField

_KINDS = {
    "char": "S1",
    "uint8_t": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "uint32_t": "<u4",
    "float": "<f4",
}


def struct_declaration(name: str) -> str:
    """Return the declaration of the contract's struct of that name, for cffi."""
    members = (
        f"{field.c_type} {field.name}{f'[{field.count}]' if field.count > 1 else ''};"
        for field in STRUCTS[name]
    )
    return f"struct {name} {{ {' '.join(members)} }};\n"


def dtype_of(name: str) -> np.dtype[np.void]:
    """Return the dtype of the contract's struct of that name."""
    return _dtype(STRUCTS[name])


def _dtype(fields: tuple[HeaderField, ...]) -> np.dtype[np.void]:
    kinds = [_dtype(field.members) if field.members else _KINDS[field.c_type] for field in fields]
    return np.dtype(
        [
            (field.name, kind, (field.count,)) if field.count > 1 else (field.name, kind)
            for field, kind in zip(fields, kinds, strict=True)
        ]
    )
