"""The policy for any aircraft, specialized for the one at hand: wherever a policy is named, so is `any`."""

from __future__ import annotations

import hashlib
from pathlib import Path

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import write_bytes
from neuroflight.toolchain.policy.model import parse_policy, read_file
from neuroflight.toolchain.policy.specialize import specialize

ROOT = Path(__file__).resolve().parents[2]
ANY = "any"
SHIPPED = ROOT / "training" / "policies" / ANY / "policy.onnx"
FOLDER = ROOT / "build" / "any"  # of the files that are made
DIGITS = 8  # of a file's digest, in the name of its folder


def policy_path(named: str | Path) -> Path:
    """Return the file of a policy as a user names it; `any` is the shipped general one."""
    return SHIPPED if str(named) == ANY else Path(named)


def own_policy(named: str | Path, aircraft: Aircraft) -> bytes:
    """Return the policy file that flies `aircraft`: the named one's bytes, a general one's specialized.

    Raises PolicyError naming the file, AircraftError on an aircraft that a general policy cannot fly.
    """
    path = policy_path(named)
    data = read_file(path)
    try:
        policy = parse_policy(data)
        if not policy.general:
            return data
        # The twin's C, which an image of an ordinary policy is built without.
        from neuroflight.sim.control.told import told, told_model

        model = told_model(aircraft, policy.blocks, policy.control_rate_hz)
        return specialize(data, told(aircraft), aircraft.name, aircraft.sha256, model)
    except PolicyError as error:
        raise PolicyError(f"{path}: {error}") from error


def own_file(named: str | Path, aircraft: Aircraft) -> Path:
    """Return the file of `own_policy`, which is written if the named one is general.

    Of the same policy and aircraft it is the same file, beside which its stamp stands.
    """
    path = policy_path(named)
    data = own_policy(path, aircraft)
    if data == read_file(path):
        return path
    digest = hashlib.sha256(data).hexdigest()[:DIGITS]
    made = FOLDER / f"{aircraft.name}-{digest}" / "policy.onnx"
    if not made.is_file() or made.read_bytes() != data:
        write_bytes(made, data)
    return made
