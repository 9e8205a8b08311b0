"""The policy blob: weights and self-test of a policy as the bytes that a slot holds.

Packs and parses it without loss: docs/reference/policy-blob.md. A blob holds no code. It
runs only in an image that was built around a policy of the same architecture;
firmware/src/storage/policy_blob.c decides.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuroflight.toolchain import contract
from neuroflight.toolchain.contract import Mix, ObservationBlock, ObservationTerm
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.policy.model import AIRCRAFT_NAME, SHA256
from neuroflight.toolchain.policy.model_constants import ModelConstants

HEADER = struct.Struct(contract.POLICY_BLOB_HEADER_FORMAT)
CRC = struct.Struct("<I")
FLOAT = np.dtype("<f4")
ANY_BUILD = bytes(contract.IMAGE_BUILD_BYTES)  # it is for any image of its architecture
U16_MAX, U32_MAX = 0xFFFF, 0xFFFFFFFF
MEND = "write it again with `neuroflight policy compile`"


@dataclass(frozen=True)
class BlobTerm:
    """A term of the observation as the firmware computes it: the low-pass by its gain, not by its cutoff."""

    block: ObservationBlock
    age: int  # control steps
    gain: float  # exactly a float32, above 0 and below 1; 0: no low-pass


@dataclass(frozen=True, eq=False)
class PolicyBlob:
    """The content of a policy blob. Counts are those of the arrays."""

    sequence: int  # 0: as built; it counts swaps and wraps, the newest valid one is flown
    architecture_hash: int  # CRC-32 of all but the weights: toolchain.codegen.plan
    filters_hash: int  # of the gyro filter chain that it was trained behind: `filters_hash`
    control_rate_hz: int
    terms: tuple[BlobTerm, ...]  # of the observation, in order: `blob_terms`
    aircraft: str
    aircraft_sha256: str  # 64 hexadecimal digits
    policy_sha256: str  # of the ONNX file, 64 hexadecimal digits
    idle: float  # motor fraction without thrust, 0 to 0.5, exactly a float32
    weights: Float32  # (weight count,), finite: the whole table that policy_init takes
    selftest_observation: Float32  # (T, observation count)
    selftest_action: Float32  # (T, action count), the exact answers, in [0, 1]
    selftest_steps: int  # rows from one policy_init to the next: recurrent state carries over between them
    mix: Mix = Mix.ATTITUDE_FIRST  # of its outputs with the pilot's thrust
    model: ModelConstants | None = None  # of its aircraft; None: the observation needs none
    build: bytes = ANY_BUILD  # of the image that it came with

    def __post_init__(self) -> None:
        """Raise ValueError unless the arrays are float32 and of shapes (W,), (T, n) and (T, m)."""
        arrays = (self.weights, self.selftest_observation, self.selftest_action)
        shapes = [array.shape for array in arrays]
        if [len(shape) for shape in shapes] != [1, 2, 2] or shapes[1][0] != shapes[2][0]:
            raise ValueError(f"a blob of arrays {shapes}, expected (W,), (T, n) and (T, m)")
        if any(array.dtype != np.float32 for array in arrays):
            raise ValueError(f"a blob of {[str(array.dtype) for array in arrays]}, expected float32")

    @property
    def observation_count(self) -> int:
        """Floats of an observation."""
        return int(self.selftest_observation.shape[1])

    @property
    def action_count(self) -> int:
        """Floats of an action: the motors."""
        return int(self.selftest_action.shape[1])


def blob_terms(terms: Sequence[ObservationTerm], control_rate_hz: int) -> tuple[BlobTerm, ...]:
    """Return `terms` as computed by a policy of this control rate."""
    return tuple(BlobTerm(term.block, term.age, term.gain(control_rate_hz)) for term in terms)


def filters_hash(filters: Sequence[object]) -> int:
    """Compute the CRC-32 of a policy's gyro filter chain, as JSON without blanks and with sorted keys."""
    return zlib.crc32(json.dumps(list(filters), separators=(",", ":"), sort_keys=True).encode())


def pack(blob: PolicyBlob) -> bytes:
    """Encode `blob`, the same in every run. Raises PolicyError for values that the layout cannot hold."""
    _reject_unsayable(blob)
    body = HEADER.pack(*header_values(blob).values())
    for array in (blob.weights, blob.selftest_observation, blob.selftest_action):
        body += np.ascontiguousarray(array, FLOAT).tobytes()
    return body + CRC.pack(zlib.crc32(body))


def header_values(blob: PolicyBlob) -> dict[str, int | float | bytes]:
    """Return the value of each field of the header, in order; arrays end before trailing zeros."""
    weight_bytes = FLOAT.itemsize * blob.weights.size
    selftest_bytes = FLOAT.itemsize * (blob.selftest_observation.size + blob.selftest_action.size)
    return {
        "magic": contract.POLICY_BLOB_MAGIC,
        "layout": contract.POLICY_BLOB_LAYOUT,
        "header_bytes": HEADER.size,
        "total_bytes": HEADER.size + weight_bytes + selftest_bytes + CRC.size,
        "sequence": blob.sequence,
        "architecture_hash": blob.architecture_hash,
        "filters_hash": blob.filters_hash,
        "control_rate_hz": blob.control_rate_hz,
        "observation_count": blob.observation_count,
        "action_count": blob.action_count,
        "weight_offset": HEADER.size,
        "weight_count": blob.weights.size,
        "selftest_offset": HEADER.size + weight_bytes,
        "selftest_count": len(blob.selftest_observation),
        "selftest_steps": blob.selftest_steps,
        "observation_term_count": len(blob.terms),
        "observation_blocks": bytes(term.block.code for term in blob.terms),
        "observation_ages": bytes(term.age for term in blob.terms),
        "observation_gains": np.array([term.gain for term in blob.terms], FLOAT).tobytes(),
        "aircraft": blob.aircraft.encode("ascii"),
        "aircraft_sha256": bytes.fromhex(blob.aircraft_sha256),
        "policy_sha256": bytes.fromhex(blob.policy_sha256),
        "idle": blob.idle,
        "mix": int(blob.mix),
        **model_values(blob.model),
        "build": blob.build,
    }


def model_values(model: ModelConstants | None) -> dict[str, int | bytes]:
    """Return the header's fields of a model: MOTOR_COUNT_MAX values an axis; zeros without a model."""
    if model is None:
        return {"model_delay": 0, "model_rotor": b"", "model_turn": b"", "model_reaction": b""}
    rows = np.zeros((2, 3, contract.MOTOR_COUNT_MAX), FLOAT)
    rows[:, :, : model.motor_count] = model.turn, model.reaction
    turn, reaction = (part.tobytes() for part in rows)
    return {
        "model_delay": model.delay_steps,
        "model_rotor": np.array(model.rotor, FLOAT).tobytes(),
        "model_turn": turn,
        "model_reaction": reaction,
    }


def parse(data: bytes) -> PolicyBlob:
    """Parse the blob in `data`, which must hold nothing else. Raises PolicyError, one line.

    Checked in this order: length, magic, layout version, sizes, CRC, then the fields. No length in the data
    is
    used before it is compared with the data.
    """
    header, arrays, idle = _read_header(data)
    _reject_sizes(header, len(data))
    (told,) = CRC.unpack_from(data, len(data) - CRC.size)
    if (found := zlib.crc32(data[: -CRC.size])) != told:
        raise PolicyError(f"the blob has the CRC-32 {found:08x}, expected {told:08x}: it is damaged; {MEND}")
    rows, n, m = (header[name] for name in ("selftest_count", "observation_count", "action_count"))
    floats = np.frombuffer(data, FLOAT, offset=HEADER.size, count=_float_count(header)).astype(np.float32)
    weights, observation, action = np.split(floats, np.cumsum([header["weight_count"], rows * n]))
    blob = PolicyBlob(
        sequence=header["sequence"],
        architecture_hash=header["architecture_hash"],
        filters_hash=header["filters_hash"],
        control_rate_hz=header["control_rate_hz"],
        terms=_read_terms(arrays, header["observation_term_count"]),
        aircraft=arrays["aircraft"].rstrip(b"\0").decode("ascii", "replace"),
        aircraft_sha256=arrays["aircraft_sha256"].hex(),
        policy_sha256=arrays["policy_sha256"].hex(),
        idle=idle,
        mix=_read_mix(header["mix"]),
        model=_read_model(header["model_delay"], arrays, m),
        build=arrays["build"],
        weights=weights,
        selftest_observation=observation.reshape(rows, n),
        selftest_action=action.reshape(rows, m),
        selftest_steps=header["selftest_steps"],
    )
    _reject_unsayable(blob)
    return blob


def _read_header(data: bytes) -> tuple[dict[str, int], dict[str, bytes], float]:
    """Read the header's whole numbers, arrays and idle; only the version of the layout has been checked."""
    if len(data) < HEADER.size + CRC.size:
        raise PolicyError(
            f"the blob is {len(data)} bytes, expected at least {HEADER.size + CRC.size}; is it a policy blob?"
        )
    names = (field.name for field in contract.POLICY_BLOB_FIELDS)
    values = dict(zip(names, HEADER.unpack_from(data), strict=True))
    if values["magic"] != contract.POLICY_BLOB_MAGIC:
        expected = contract.POLICY_BLOB_MAGIC.to_bytes(4, "little")
        raise PolicyError(f"the blob begins with {data[:4]!r}, expected {expected!r}; is it a policy blob?")
    if values["layout"] != contract.POLICY_BLOB_LAYOUT:
        raise PolicyError(
            f"the blob has layout version {values['layout']}, expected {contract.POLICY_BLOB_LAYOUT}; {MEND}"
        )
    numbers = {name: value for name, value in values.items() if isinstance(value, int)}
    arrays = {name: value for name, value in values.items() if isinstance(value, bytes)}
    return numbers, arrays, float(values["idle"])


def _float_count(header: dict[str, int]) -> int:
    """Return the number of floats between header and CRC."""
    row = header["observation_count"] + header["action_count"]
    return header["weight_count"] + header["selftest_count"] * row


def _reject_sizes(header: dict[str, int], length: int) -> None:
    """Raise PolicyError unless the header's sizes and offsets are those of this layout and of the data."""
    body = HEADER.size + FLOAT.itemsize * _float_count(header)
    expected = {
        "header_bytes": HEADER.size,
        "weight_offset": HEADER.size,
        "selftest_offset": HEADER.size + FLOAT.itemsize * header["weight_count"],
        "total_bytes": body + CRC.size,
    }
    for name, value in expected.items():
        if header[name] != value:
            raise PolicyError(f"the blob's {name} is {header[name]}, expected {value} by its counts; {MEND}")
    if length != header["total_bytes"]:
        raise PolicyError(
            f"the blob is {length} bytes, expected {header['total_bytes']} by its header; {MEND}"
        )


def _read_terms(arrays: dict[str, bytes], count: int) -> tuple[BlobTerm, ...]:
    known = {block.code: block for block in contract.OBSERVATION_BLOCKS}
    codes, ages = arrays["observation_blocks"], arrays["observation_ages"]
    gains = np.frombuffer(arrays["observation_gains"], FLOAT).tolist()
    if count > len(codes) or any(codes[count:]) or any(ages[count:]) or any(gains[count:]):
        raise PolicyError(f"the blob's {count} observation terms are not those of its lists; {MEND}")
    for code in codes[:count]:
        if code not in known:
            raise PolicyError(f"the blob's observation block {code} is unknown, known are {sorted(known)}")
    rows = zip(codes[:count], ages, gains, strict=False)
    return tuple(BlobTerm(known[code], age, gain) for code, age, gain in rows)


def _read_mix(code: int) -> Mix:
    try:
        return Mix(code)
    except ValueError as error:
        raise PolicyError(
            f"the blob's mix is {code}, known are {[int(mix) for mix in Mix]}; {MEND}"
        ) from error


def _read_model(delay: int, arrays: dict[str, bytes], motors: int) -> ModelConstants | None:
    names = ("model_rotor", "model_turn", "model_reaction")
    rotor, turn, reaction = (np.frombuffer(arrays[name], FLOAT) for name in names)
    if delay == 0:
        if any(arrays[name].strip(b"\0") for name in names):
            raise PolicyError(f"the blob has no model, but constants of one; {MEND}")
        return None
    *curve, rise, fall, gain, loss, correction = rotor.tolist()
    shares = {"rise": rise, "fall": fall, "gain_max": gain, "loss_max": loss, "correction": correction}
    rows = [part.reshape(3, contract.MOTOR_COUNT_MAX) for part in (turn, reaction)]
    if any(part[:, motors:].tobytes().strip(b"\0") for part in rows):
        raise PolicyError(f"the blob's model has values of more motors than the {motors} it drives; {MEND}")
    try:
        axes = {"turn": rows[0][:, :motors].tolist(), "reaction": rows[1][:, :motors].tolist()}
        return ModelConstants.of({"delay_steps": delay, "speed_curve": curve, **shares, **axes})
    except ValueError as error:
        raise PolicyError(f"the blob's model: {error}; {MEND}") from error


def _reject_unsayable(blob: PolicyBlob) -> None:
    """Raise PolicyError naming the first value that the layout has no room for or that cannot be flown."""
    rows = len(blob.selftest_observation)
    widths = sum(term.block.count(blob.action_count) for term in blob.terms)
    for name, value, low, high in (
        ("sequence number", blob.sequence, 0, U32_MAX),
        ("architecture hash", blob.architecture_hash, 0, U32_MAX),
        ("filters hash", blob.filters_hash, 0, U32_MAX),
        ("control rate", blob.control_rate_hz, 1, U32_MAX),
        ("number of observed values", blob.observation_count, 1, U16_MAX),
        ("number of actions", blob.action_count, 1, U16_MAX),
        ("number of observation terms", len(blob.terms), 1, contract.OBSERVATION_TERMS_MAX),
        ("number of self-test vectors", rows, 1, U16_MAX),
        ("number of self-test steps", blob.selftest_steps, 1, rows),
    ):
        if not low <= value <= high:
            raise PolicyError(f"the policy's {name} is {value}, expected {low} to {high}")
    if rows % blob.selftest_steps:
        raise PolicyError(f"{rows} self-test vectors are no multiple of {blob.selftest_steps} steps")
    if widths != blob.observation_count:
        raise PolicyError(f"the policy takes {blob.observation_count} values, but its blocks make {widths}")
    for term in blob.terms:
        if not 0 <= term.age <= contract.OBSERVATION_AGE_MAX:
            most = contract.OBSERVATION_AGE_MAX
            raise PolicyError(
                f"the policy observes {term.block.name} {term.age} steps old, expected 0 to {most}"
            )
        if not 0.0 <= term.gain < 1.0:
            raise PolicyError(
                f"the policy's low-pass of {term.block.name} has the gain {term.gain}, expected 0 to 1"
            )
    if not 0.0 <= blob.idle <= contract.IDLE_MAX:
        raise PolicyError(f"the policy's idle is {blob.idle}, expected 0 to {contract.IDLE_MAX}")
    if blob.model is None and any(term.block.name in contract.MODEL_BLOCKS for term in blob.terms):
        raise PolicyError(f"the policy observes what a model of its aircraft tells, but has none; {MEND}")
    if blob.model is not None and blob.model.motor_count != blob.action_count:
        raise PolicyError(
            f"the policy's model is of {blob.model.motor_count} motors, it drives {blob.action_count}"
        )
    _reject_names(blob)
    if not np.isfinite(blob.weights).all():
        count = int((~np.isfinite(blob.weights)).sum())
        raise PolicyError(f"the policy's weights hold {count} NaN or infinite values, expected finite ones")
    if not ((blob.selftest_action >= 0) & (blob.selftest_action <= 1)).all():
        raise PolicyError("the policy's self-test holds an action outside 0 to 1; compile it again")


def _reject_names(blob: PolicyBlob) -> None:
    if not AIRCRAFT_NAME.fullmatch(blob.aircraft):
        raise PolicyError(
            f"the policy's aircraft is {blob.aircraft[:60]!r}, "
            f"expected at most {contract.POLICY_BLOB_AIRCRAFT_BYTES} letters, digits, dots and dashes"
        )
    for name, digits in (("aircraft", blob.aircraft_sha256), ("policy", blob.policy_sha256)):
        if not SHA256.fullmatch(digits):
            raise PolicyError(f"the SHA-256 of the {name} is {digits[:70]!r}, expected 64 hexadecimal digits")
