"""The files of a policy: metadata of policy.onnx, the header of a policy blob, checkpoints."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

from neuroflight.toolchain.contract.frame_time_sensors import MOTOR_COUNT_MAX
from neuroflight.toolchain.contract.observation import OBSERVATION_TERMS_MAX

# --- policy.onnx: its metadata_props ---------------------------------------------------------
POLICY_FORMAT_VERSION = "1"
POLICY_INPUT, POLICY_OUTPUT = "observation", "action"
META_VERSION = "neuroflight.version"
META_OBSERVATION = "neuroflight.observation"
META_CONTROL_RATE = "neuroflight.control_rate_hz"
META_FILTERS = "neuroflight.filters"
META_IDLE = "neuroflight.idle"  # absent: IDLE_DEFAULT
META_MIX = "neuroflight.mix"  # absent: attitude-first
META_MODEL = "neuroflight.model"  # JSON object; where the observation needs it, see model_constants.py
META_AIRCRAFT = "neuroflight.aircraft"
META_AIRCRAFT_SHA256 = "neuroflight.aircraft_sha256"
META_TRAINING = "neuroflight.training"
META_GENERAL = "neuroflight.general"  # of a policy for any aircraft; see toolchain/policy/specialize.py
META_SPECIALIZED = (
    "neuroflight.specialized"  # of one that was made of it: JSON, what was told of the aircraft
)
POLICY_FILE_BYTES_MAX = 4 << 20
SELFTEST_COUNT = 16

# --- Policy blob: the bytes that a policy slot holds (docs/reference/policy-blob.md) ---------------------
# header | float32 weights | float32 self-test observations | float32 self-test actions | CRC-32, each part
# behind the one before without a gap, all little-endian.
POLICY_BLOB_MAGIC = 0x4250464E  # "NFPB"
POLICY_BLOB_LAYOUT = 5
POLICY_BLOB_AIRCRAFT_BYTES = 32
POLICY_BLOB_CRC_BYTES = 4
POLICY_FILTERS_NONE = 0x0D4CBB29  # CRC-32 of "[]": no gyro filter
POLICY_FILTER_MEAN = "mean"  # the filter [["mean"]]: the mean of the samples of a control period is seen
SHA256_BYTES = 32
IMAGE_BUILD_BYTES = 8  # of what names a build: image_format.py


@dataclass(frozen=True)
class HeaderField:
    """One field of the blob's header; an array where `count` is above 1."""

    c_type: str
    name: str
    unit: str
    meaning: str
    count: int = 1
    members: tuple[HeaderField, ...] = ()  # of a struct

    @property
    def format(self) -> str:
        """The field for `struct`; an array counts as its bytes."""
        if self.members:
            return f"{self.count * struct.calcsize(struct_format(self.members))}s"
        code = _CODES[self.c_type]
        return f"{self.count * struct.calcsize(code)}s" if self.count > 1 else code


_CODES = {"char": "B", "uint8_t": "B", "int16_t": "h", "uint16_t": "H", "uint32_t": "I", "float": "f"}


def struct_format(fields: tuple[HeaderField, ...]) -> str:
    """Return the fields for `struct`, little-endian and without holes; arrays count as their bytes."""
    return "<" + "".join(field.format for field in fields)


POLICY_BLOB_FIELDS = (
    HeaderField("uint32_t", "magic", "", "NFPB, in that order in memory"),
    HeaderField("uint16_t", "layout", "", "version of this layout"),
    HeaderField("uint16_t", "header_bytes", "bytes", "where the weights begin, a multiple of 8"),
    HeaderField("uint32_t", "total_bytes", "bytes", "of the whole blob, CRC included"),
    HeaderField("uint32_t", "sequence", "", "0: as built; of valid slots the newest is flown"),
    HeaderField("uint32_t", "architecture_hash", "", "same: weights may be exchanged"),
    HeaderField("uint32_t", "filters_hash", "", "CRC-32 of the gyro filters' JSON list"),
    HeaderField("uint32_t", "control_rate_hz", "Hz", "of policy_step, at least 1"),
    HeaderField("uint16_t", "observation_count", "floats", "of an observation, at least 1"),
    HeaderField("uint16_t", "action_count", "floats", "of an action: the motors, at least 1"),
    HeaderField("uint32_t", "weight_offset", "bytes", "of the weights from the blob's begin"),
    HeaderField("uint32_t", "weight_count", "floats", "of the table, tables of functions included"),
    HeaderField("uint32_t", "selftest_offset", "bytes", "of the observations; the actions follow them"),
    HeaderField("uint16_t", "selftest_count", "rows", "of observations and of actions, at least 1"),
    HeaderField("uint16_t", "selftest_steps", "rows", "from one policy_init to the next; divides the count"),
    HeaderField("uint32_t", "observation_term_count", "", "used entries of the next three, at least 1"),
    HeaderField("uint8_t", "observation_blocks", "", "codes in order, then 0", OBSERVATION_TERMS_MAX),
    HeaderField("uint8_t", "observation_ages", "steps", "of each term, then 0", OBSERVATION_TERMS_MAX),
    HeaderField("float", "observation_gains", "", "of each low-pass, 0: none", OBSERVATION_TERMS_MAX),
    HeaderField("char", "aircraft", "", "ASCII, then 0; a name may fill it", POLICY_BLOB_AIRCRAFT_BYTES),
    HeaderField("uint8_t", "aircraft_sha256", "", "of the aircraft trained for", SHA256_BYTES),
    HeaderField("uint8_t", "policy_sha256", "", "of the ONNX file", SHA256_BYTES),
    HeaderField("float", "idle", "", "motor fraction at zero thrust, 0 to 0.5"),
    HeaderField("uint32_t", "mix", "", "how outputs and throttle become motor fractions: enum nf_mix"),
    HeaderField("uint32_t", "model_delay", "steps", "from output to rotor; 0: there is no model"),
    HeaderField("float", "model_rotor", "rad/s, 1", "a, b, c, rise, fall, gain, loss, correction", 8),
    HeaderField("float", "model_turn", "s/rad", "roll, pitch, yaw, a value a motor", 3 * MOTOR_COUNT_MAX),
    HeaderField("float", "model_reaction", "1", "likewise", 3 * MOTOR_COUNT_MAX),
    HeaderField(
        "uint8_t",
        "build",
        "",
        "of the image that it came with; zeros: for any of its architecture",
        IMAGE_BUILD_BYTES,
    ),
)
POLICY_BLOB_HEADER_FORMAT = "<" + "".join(field.format for field in POLICY_BLOB_FIELDS)


@dataclass(frozen=True)
class PolicyHeader:
    """The header of a blob, unchecked except for its magic number."""

    layout: int
    total_bytes: int
    sequence: int
    architecture_hash: int
    filters_hash: int
    control_rate_hz: int
    observation_count: int
    action_count: int
    weight_count: int
    aircraft: str  # whatever is not printable shows as ?
    aircraft_sha256: str  # of the one that it was trained on
    policy_sha256: str
    build: bytes  # of the image that it came with; zeros: any


def policy_header(blob: bytes | bytearray) -> PolicyHeader | None:
    """Decode the header at the start of `blob`; None if there is none."""
    if len(blob) < struct.calcsize(POLICY_BLOB_HEADER_FORMAT):
        return None
    values = struct.unpack_from(POLICY_BLOB_HEADER_FORMAT, blob)
    told = dict(zip((field.name for field in POLICY_BLOB_FIELDS), values, strict=True))
    if told["magic"] != POLICY_BLOB_MAGIC:
        return None
    aircraft = told["aircraft"].rstrip(b"\0").decode("latin-1")
    told["aircraft"] = "".join(c if " " <= c <= "~" else "?" for c in aircraft)
    for name in ("aircraft_sha256", "policy_sha256"):
        told[name] = told[name].hex()
    return PolicyHeader(**{name: told[name] for name in PolicyHeader.__dataclass_fields__})


def policy_checksum(blob: bytes | bytearray) -> int:
    """Compute the CRC-32 that a blob has to end with."""
    return zlib.crc32(blob[:-POLICY_BLOB_CRC_BYTES])


def bound_policy(blob: bytes | bytearray, build: bytes, sequence: int = 0) -> bytes:
    """Return the blob for a slot beside the image of `build`, with that sequence number."""
    values = list(struct.unpack_from(POLICY_BLOB_HEADER_FORMAT, blob))
    names = [field.name for field in POLICY_BLOB_FIELDS]
    values[names.index("build")], values[names.index("sequence")] = build, sequence
    header = struct.pack(POLICY_BLOB_HEADER_FORMAT, *values)
    bound = header + bytes(blob[len(header) :])
    return bound[:-POLICY_BLOB_CRC_BYTES] + struct.pack("<I", policy_checksum(bound))


# --- Checkpoint (torch.save of plain containers and tensors, loaded with weights_only) --------
CHECKPOINT_FORMAT = "neuroflight.checkpoint"
CHECKPOINT_VERSION = 1
CHECKPOINT_FILE_BYTES_MAX = 64 << 20
