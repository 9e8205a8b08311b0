"""The reasons why a firmware does not fly a policy."""

from __future__ import annotations

from neuroflight.toolchain.contract import FirmwareError

POLICY_ERRORS: dict[int, str] = {
    FirmwareError.ERR_POLICY: "fails its self-test: its answers differ from those that the compiler computed",
    FirmwareError.ERR_BLOB_SHORT: "too short for a policy",
    FirmwareError.ERR_BLOB_MAGIC: "empty",
    FirmwareError.ERR_BLOB_LAYOUT: "of another layout: written for a firmware of another version",
    FirmwareError.ERR_BLOB_SIZE: "its sizes contradict each other: not written by this tool",
    FirmwareError.ERR_BLOB_CRC: "damaged: its checksum does not hold",
    FirmwareError.ERR_BLOB_RATE: "trained for another control rate than this image's",
    FirmwareError.ERR_BLOB_FILTERS: (
        "trained behind other gyro filters than those that are set; `image build` tells what it needs"
    ),
    FirmwareError.ERR_BLOB_ARCHITECTURE: "of another architecture than this image's policy",
    FirmwareError.ERR_BLOB_IDLE: "its idle is beyond what a policy is trained with",
    FirmwareError.ERR_BLOB_MIX: "its mix of outputs and throttle is one that this firmware does not know",
    FirmwareError.ERR_BLOB_MODEL: (
        "its model of the aircraft does not hold, or is not the one that its observation needs"
    ),
    FirmwareError.ERR_BLOB_BUILD: "it came with another image, and is for that alone",
}


def policy_error(number: int) -> str:
    """Return the text of an error."""
    return POLICY_ERRORS.get(number, f"error {number}, which this tool does not know")
