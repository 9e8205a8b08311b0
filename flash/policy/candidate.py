"""A compiled policy, compared with the image that would fly it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from neuroflight.flash.policy.slots import SHA_SHOWN, Policies
from neuroflight.toolchain.contract import IMAGE_BUILD_BYTES, Mix
from neuroflight.toolchain.errors import LinkError


@dataclass(frozen=True)
class Candidate:
    """A compiled policy."""

    file: str  # as the user wrote it
    network: str  # such as 19-64-64-4 tanh
    observation: str  # its terms, comma-separated
    observation_count: int
    action_count: int
    weight_count: int
    architecture_hash: int
    filters_hash: int
    control_rate_hz: int
    mix: Mix  # of outputs and throttle
    idle: float  # motor fraction at zero thrust
    aircraft: str
    aircraft_sha256: str  # of what its twin flies
    sha256: str  # of the ONNX file
    blob: Callable[[int], bytes]  # its bytes with that sequence number, always as many

    @property
    def build(self) -> bytes:
        """Build it belongs to: any image of its architecture."""
        return bytes(IMAGE_BUILD_BYTES)

    @property
    def size(self) -> int:
        """Bytes of its blob."""
        return len(self.blob(0))


def differences(candidate: Candidate, policies: Policies) -> list[str]:
    """List what keeps the running image from flying it: the policy's value and the image's."""
    info, flown = policies.info, policies.flown
    figures = (
        ("control rate [Hz]", candidate.control_rate_hz, info.control_rate_hz),
        ("observed values", candidate.observation_count, info.observation_count),
        ("motors", candidate.action_count, info.action_count),
        ("weights", candidate.weight_count, info.weight_count),
    )
    told = [f"{what} {has}, the image {asks}" for what, has, asks in figures if has != asks]
    if flown is not None and flown.good and candidate.filters_hash != flown.filters_hash:
        told.append(f"gyro filters {candidate.filters_hash:08x} (CRC-32), the image {flown.filters_hash:08x}")
    if not told and candidate.architecture_hash != info.architecture_hash:
        told.append(
            f"as many values, weights and motors as the image's, but other layers or observed terms "
            f"({candidate.observation}; architecture {candidate.architecture_hash:08x}, the image "
            f"{info.architecture_hash:08x})"
        )
    return told


def check_fits(
    candidate: Candidate,
    policies: Policies,
    *,
    network: str | None,
    aircraft_sha256: str | None,
    mend: str,
    other_aircraft: bool,
) -> None:
    """Raise LinkError, one line, unless the running image can fly it and it is for the same aircraft.

    network, aircraft_sha256: of the policy that is flown, where its file is known. mend: the command that
    builds an image with it. other_aircraft: a policy for another aircraft is meant.
    """
    if told := differences(candidate, policies):
        flies = f" ({network})" if network else ""
        raise LinkError(
            f"{candidate.file}: {candidate.network} does not fit the image that runs{flies}: "
            f"{'; '.join(told)}; nothing was written: build an image with it: {mend}"
        )
    if policies.flown is None or other_aircraft:
        return
    named = candidate.aircraft == policies.info.name
    if not named or aircraft_sha256 not in (None, candidate.aircraft_sha256):
        here, there = (
            ("", "")
            if aircraft_sha256 is None or not named
            else (f" ({digest[:SHA_SHOWN]})" for digest in (candidate.aircraft_sha256, aircraft_sha256))
        )
        raise LinkError(
            f"{candidate.file}: trained for the aircraft {candidate.aircraft!r}{here}, the policy that the "
            f"board flies is for {policies.info.name!r}{there}; nothing was written: choose a policy for "
            "this aircraft, or give --other-aircraft if that is meant"
        )
