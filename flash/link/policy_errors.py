"""The reasons why a firmware does not fly a policy, by the numbers of firmware/src/common/nf_err.h."""

from __future__ import annotations

POLICY_ERRORS = {
    -5: "fails its self-test: its answers differ from those that the compiler computed",
    -6: "too short for a policy",
    -7: "empty",
    -8: "of another layout: written for a firmware of another version",
    -9: "its sizes contradict each other: not written by this tool",
    -10: "damaged: its checksum does not hold",
    -11: "trained for another control rate than this image's",
    -12: "trained behind other gyro filters than those that are set",
    -13: "of another architecture than this image's policy",
    -14: "its idle is beyond what a policy is trained with",
    -25: "its mix of outputs and throttle is one that this firmware does not know",
    -26: "its model of the aircraft does not hold, or is not the one that its observation needs",
    -27: "it came with another image, and is for that alone",
}


def policy_error(number: int) -> str:
    """Return the text of an error."""
    return POLICY_ERRORS.get(number, f"error {number} of nf_err.h, which this tool does not know")
