"""The interlock of `board flash` and `board rescue`: a policy that no check found fit goes onto no board,
unless / the user says so.

The stamp of a policy file lies beside it, that of an image in the report.json beside it, where `image build`
put what it had found. Both are held against the SHA-256 in the policy's own header.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import BuildError, PolicyError

if TYPE_CHECKING:
    from neuroflight.toolchain.policy.check_stamp import Stamp

OPTION = "--unchecked"
TOLD = "UNCHECKED: nobody knows whether this policy flies"
Unchecked = Annotated[
    bool, Option(None, "write it though no `neuroflight policy check` found its policy fit to fly")
]


def checked_image(image: Path, policy_sha256: str | None, *, unchecked: bool) -> str:
    """Return the verdict of the check on the policy in an image file, for the plan.

    policy_sha256: of the policy that the file brings; None: it brings none. Raises PolicyError, one line with
    the command to run, where that is not known to be fit, unless `unchecked`.
    """
    from neuroflight.toolchain.image.report import read_check
    from neuroflight.toolchain.policy.check_stamp import fault

    stamp, why = None, None
    try:
        stamp = read_check(image)
    except (BuildError, PolicyError) as error:
        why = str(error)
    why = why or fault(stamp, policy_sha256 or "", None)
    if why is None:
        assert stamp is not None
        return _told(stamp)
    if unchecked:
        return TOLD
    raise PolicyError(
        f"{image}: its policy {why}; run `neuroflight policy check POLICY --aircraft FILE` and build it "
        f"anew, or add {OPTION}"
    )


def checked_policy(
    policy: Path, policy_sha256: str, aircraft_sha256: str | None, aircraft: str, *, unchecked: bool
) -> str:
    """Return the verdict of the check on a policy file, for the plan.

    aircraft_sha256: None: any aircraft that it was checked for. Raises PolicyError as `checked_image` does.
    """
    from neuroflight.toolchain.policy.check_stamp import require_fit

    if unchecked:
        return TOLD
    return _told(require_fit(policy, policy_sha256, aircraft_sha256, aircraft))


def _told(stamp: Stamp) -> str:
    return f"{stamp.text}, by rules {stamp.rules}"
