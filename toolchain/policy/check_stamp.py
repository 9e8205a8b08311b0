"""The stamp of a checked policy: a file beside it that says whether it is fit to fly an aircraft.

`neuroflight policy check` writes it; `build` and `flash` ask for it. It holds for the policy's bytes, the
aircraft's physics and the rules of the check together: another of these, and it is void. It protects from
mistakes, not from forgery: its seal is a digest that anybody can compute, which a hand that edits a figure
does not.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.files import file_size, write_text

RULES = 2  # of training/fitness: counted up with every change of its bars or of what is flown
FORMAT = "neuroflight policy check"
SUFFIX = ".check.json"  # instead of the policy's own
STAMP_BYTES_MAX = 1 << 20
SEAL = "seal"
UNCHECKED = "--unchecked"


@dataclass(frozen=True, eq=False)
class Stamp:
    """The result of a check."""

    policy_sha256: str  # of the ONNX file's bytes
    aircraft: str  # its name
    aircraft_sha256: str  # `Aircraft.sha256`
    rules: int
    fit: bool
    document: Mapping[str, Any]  # as it is written: with the figures

    @property
    def text(self) -> str:
        """Text for a report."""
        return f"{'fit' if self.fit else 'NOT fit'} to fly {self.aircraft}"


def stamp_path(policy: Path) -> Path:
    """Return the path of a policy file's stamp."""
    return policy.with_suffix(SUFFIX)


def stamp_document(
    *, policy_sha256: str, aircraft: str, aircraft_sha256: str, fit: bool, figures: Mapping[str, Any]
) -> dict[str, Any]:
    """Build the sealed document of a check by the present rules; figures: further results."""
    document = {
        "format": FORMAT,
        "rules": RULES,
        "fit": fit,
        "policy_sha256": policy_sha256,
        "aircraft": aircraft,
        "aircraft_sha256": aircraft_sha256,
        **figures,
    }
    return {**document, SEAL: _seal(document)}


def write_stamp(policy: Path, document: Mapping[str, Any]) -> None:
    """Write a sealed document beside the policy, in one step."""
    write_text(stamp_path(policy), json.dumps(document, indent=1, allow_nan=False) + "\n")


def read_stamp(policy: Path) -> Stamp | None:
    """Read the stamp beside a policy file, or None. Raises PolicyError, one line, for a broken one."""
    path = stamp_path(policy)
    try:
        if (size := file_size(path)) > STAMP_BYTES_MAX:
            raise PolicyError(f"{path}: {size} bytes, expected at most {STAMP_BYTES_MAX}")
        return parse_stamp(json.loads(path.read_bytes()))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise PolicyError(f"cannot read {path}: {error.strerror}") from error
    except (PolicyError, ValueError, RecursionError) as error:
        raise PolicyError(f"{path} is no stamp of a check: {error}") from error


def parse_stamp(document: object) -> Stamp:
    """Parse a sealed document. Raises PolicyError, without a file's name."""
    if not isinstance(document, dict) or document.get("format") != FORMAT:
        raise PolicyError("it has another format")
    if document.get(SEAL) != _seal({key: value for key, value in document.items() if key != SEAL}):
        raise PolicyError("it was changed after the check")
    rules, fit = document.get("rules"), document.get("fit")
    texts = [document.get(key) for key in ("policy_sha256", "aircraft", "aircraft_sha256")]
    if type(rules) is not int or type(fit) is not bool or not all(isinstance(text, str) for text in texts):
        raise PolicyError("it does not tell what was checked")
    policy_sha256, aircraft, aircraft_sha256 = map(str, texts)
    return Stamp(policy_sha256, aircraft, aircraft_sha256, rules, fit, document)


def fault(stamp: Stamp | None, policy_sha256: str, aircraft_sha256: str | None) -> str | None:
    """Return why a stamp does not hold for these bytes and this aircraft; None if it does.

    aircraft_sha256: None if the aircraft is unknown, or any will do.
    """
    if stamp is None:
        return "was not checked"
    if stamp.policy_sha256 != policy_sha256:
        return "was changed after its check"
    if aircraft_sha256 is not None and stamp.aircraft_sha256 != aircraft_sha256:
        return f"was checked for another aircraft or another state of its file ({stamp.aircraft})"
    if stamp.rules != RULES:
        return f"was checked by rules {stamp.rules}, now there are rules {RULES}"
    if not stamp.fit:
        return f"is NOT fit to fly {stamp.aircraft}, as its check says"
    return None


def require_fit(policy: Path, policy_sha256: str, aircraft_sha256: str | None, aircraft: str) -> Stamp:
    """Return the stamp beside a policy file if it is fit.

    aircraft: as the command takes it. Raises PolicyError, one line with the command to run, otherwise.
    """
    command = check_command(policy, aircraft)
    try:
        stamp = read_stamp(policy)
    except PolicyError as error:
        raise PolicyError(f"{error}; run: {command}, or add {UNCHECKED}") from error
    if (why := fault(stamp, policy_sha256, aircraft_sha256)) is not None:
        raise PolicyError(f"{policy} {why}; run: {command}, or add {UNCHECKED}")
    assert stamp is not None
    return stamp


def check_command(policy: Path | str, aircraft: str) -> str:
    """Return the command that checks a policy."""
    return f"neuroflight policy check {policy} --aircraft {aircraft}"


def _seal(document: Mapping[str, Any]) -> str:
    text = json.dumps(document, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
