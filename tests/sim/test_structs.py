"""What C and Python share is written once: it follows, or does not compile."""

from __future__ import annotations

import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
from cffi import FFI

from neuroflight.sim.compiled import contract_declarations
from neuroflight.sim.ports import library
from neuroflight.sim.structs import dtype_of, struct_declaration
from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import STRUCTS
from neuroflight.toolchain.rendering.contract_header import render_contract


def compiles(folder: Path) -> str:
    """Compile the contract's header as it is now; return what the compiler says."""
    (folder / "nf_contract.h").write_text(render_contract())
    command = ["gcc", "-std=c11", "-fsyntax-only", "-x", "c", str(folder / "nf_contract.h")]
    return subprocess.run(command, capture_output=True, text=True).stderr


@pytest.mark.parametrize("name", STRUCTS)
def test_a_field_stands_at_one_place_for_c_cffi_and_numpy(name: str) -> None:
    ffi = FFI()
    needed = [one for one in STRUCTS if any(one in field.c_type for field in STRUCTS[name])]
    ffi.cdef("".join(map(struct_declaration, [*needed, name])))
    dtype, fields = dtype_of(name), dict(ffi.typeof(f"struct {name}").fields)
    assert dtype.itemsize == ffi.sizeof(f"struct {name}")
    assert {field: found[1] for field, found in (dtype.fields or {}).items()} == {
        field: inner.offset for field, inner in fields.items()
    }


def test_a_struct_with_a_hole_does_not_compile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert compiles(tmp_path) == ""
    first, *rest = STRUCTS["replay_step"]
    narrow = replace(first, c_type="uint16_t")
    monkeypatch.setitem(contract.STRUCTS, "replay_step", (narrow, *rest))
    assert 'static assertion failed: "voltage_gain"' in compiles(tmp_path)


def test_a_function_of_the_library_is_called_as_its_header_says(tmp_path: Path, host_program: Path) -> None:
    header = tmp_path / "reference.h"
    text = library.HEADER.read_text()
    header.write_text(text.replace("size_t reference_size(void);", "size_t reference_size(unsigned motors);"))
    assert header.read_text() != text
    ffi = FFI()
    ffi.cdef(struct_declaration("reference_trace") + contract_declarations(header))
    with pytest.raises(TypeError, match="expects 1 arguments, got 0"):
        ffi.dlopen(str(host_program.with_name("libneuroflight.so"))).reference_size()
