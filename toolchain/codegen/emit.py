"""Writes a plan as C: policy.h and policy.c, which compile alone and compute the interpreter's bits.

This stage knows C and nothing of ONNX; the text itself is in templates/policy.h.j2, policy.c.j2 and
policy_kernels.c.j2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain.codegen.kernel_calls import BufferPlace, Call
from neuroflight.toolchain.codegen.plan import CodePlan
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.policy.blob import PolicyBlob, header_values, model_values, pack
from neuroflight.toolchain.policy.model import PolicyModel
from neuroflight.toolchain.rendering.contract_header import blob_header_fields
from neuroflight.toolchain.rendering.jinja import render

# Compiler option for the C's arithmetic: a product is fused with a sum only where the code says so.
ARITHMETIC = ("-std=c11", "-ffp-contract=off", "-fno-math-errno")
FLOATS_PER_LINE = 6
MEMORIES = {"scratch": "v", "state": "h"}  # C's names for them in policy_step


@dataclass(frozen=True)
class Emission:
    """The two generated files, and the bytes that the first compiles in."""

    source: str
    header: str
    blob: bytes


@dataclass(frozen=True)
class Part:
    """A member of the blob that has a name of its own."""

    name: str
    member: str
    offset: int  # in the blob [bytes]
    bytes: int


def emit(policy: PolicyModel, plan: CodePlan, blob: PolicyBlob) -> Emission:
    """Render the C of `plan` with `blob` compiled in."""
    enter, *calls, leave = plan.calls
    assert enter.target is not None, "the observation is copied into the scratch"
    data, fields = pack(blob), blob_header_fields()
    low, high = leave.constants
    values = {
        "policy": policy,
        "plan": plan,
        "kernels": {call.kernel for call in calls},
        "entrance": _place(enter.target),
        "calls": [_call(call) for call in calls],
        "exit": _place(leave.sources[0]),
        "low": literal(low),
        "high": literal(high),
        "blob_fields": fields,
        "header": header_literals(blob),
        "parts": list(_parts(blob, fields[-1].offset + fields[-1].size)),
        "weights": list(_lines(blob.weights)),
        "selftest_observation": [list(_lines(row)) for row in blob.selftest_observation],
        "selftest_action": [list(_lines(row)) for row in blob.selftest_action],
        "crc32": int.from_bytes(data[-4:], "little"),
    }
    return Emission(render("policy.c.j2", **values), render("policy.h.j2", **values), data)


def header_literals(blob: PolicyBlob) -> dict[str, int | float | bytes | str]:
    """Return the blob's header for the macros of templates/blob_header.j2, with floats as C literals."""
    gains = ", ".join(literal(term.gain) for term in blob.terms)
    floats = {
        name: ", ".join(literal(value) for value in np.frombuffer(bytes(values), "<f4")) or literal(0.0)
        for name, values in model_values(blob.model).items()
        if isinstance(values, bytes)
    }
    return {**header_values(blob), "observation_gains": gains, "idle": literal(blob.idle), **floats}


def literal(value: float | np.float32) -> str:
    """Return a float32 as an exact C literal, in hexadecimal; NaN as C and numpy have it."""
    if not np.isfinite(value):
        return (
            '__builtin_nanf("")'
            if np.isnan(value)
            else "__builtin_inff()"
            if value > 0
            else "-__builtin_inff()"
        )
    mantissa, _, exponent = float(np.float32(value)).hex().partition("p")
    mantissa = mantissa.rstrip("0").removesuffix(".") if "." in mantissa else mantissa
    return f"{mantissa}p{exponent}f"


def _call(call: Call) -> str:
    arguments = [] if call.table is None else [f"w + {call.table}" if call.table else "w"]
    arguments += [_place(source) for source in call.sources]
    assert call.target is not None, "only the last call writes the action"
    match call.kernel:
        case "linear8" | "linear4":
            arguments += [str(call.inputs), _place(call.target), str(call.count)]
        case "copy":
            arguments += [_place(call.target), str(call.count), str(call.inputs)]
        case _:
            arguments += [_place(call.target), str(call.count), *map(literal, call.constants)]
    return f"{call.kernel}({', '.join(arguments)})"


def _place(place: BufferPlace) -> str:
    name = MEMORIES[place.memory]
    return f"({name} + {place.offset})" if place.offset else name


def _parts(blob: PolicyBlob, offset: int) -> Iterator[Part]:
    for member in ("weights", "selftest_observation", "selftest_action"):
        size = getattr(blob, member).nbytes
        yield Part(f"policy_{member}", member, offset, size)
        offset += size


def _lines(values: Float32) -> Iterator[str]:
    for start in range(0, values.size, FLOATS_PER_LINE):
        yield ", ".join(literal(value) for value in values[start : start + FLOATS_PER_LINE])
