"""The interlock of `build`: an image for a board holds a policy that is fit, unless the user says so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.sim.control.pid_table import Beside
    from neuroflight.toolchain.image.build import Target
    from neuroflight.toolchain.policy.check_stamp import Stamp
    from neuroflight.toolchain.policy.model import PolicyModel


Unchecked = Annotated[
    bool,
    Option(
        None, "build an image though no `neuroflight policy check` found its policy fit to fly the aircraft"
    ),
]


def checked(
    path: Path, policy: PolicyModel, target: Target, stands: Beside, *, unchecked: bool
) -> Stamp | None:
    """Return the stamp that says that the policy in `path` is fit; None: there is none, and none is needed.

    stands: the aircraft that the image is for. The host program turns no motor and needs no stamp. Raises
    PolicyError, one line with the command to run.
    """
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.policy.check_stamp import require_fit

    aircraft = stands.aircraft
    sha256 = policy.aircraft_sha256 if aircraft is None else aircraft.sha256
    try:
        return require_fit(path, policy.source_sha256, sha256, stands.name or policy.aircraft)
    except PolicyError:
        if unchecked or not target.has_board_memory:
            return None
        raise
