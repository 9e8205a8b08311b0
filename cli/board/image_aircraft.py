"""The aircraft that an image is for, the PID in it, and the aircraft that the board flew before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.errors import BuildError, ImageError

if TYPE_CHECKING:
    from neuroflight.flash.image.plan import InstallPlan

DIGITS = 12  # of a digest, for people
NO_PID = "NONE: where the policy must not fly on, the motors stop"


@dataclass(frozen=True)
class ImageAircraft:
    """The aircraft of an image, and the aircraft that the board flew until now."""

    name: str  # of the aircraft that its policy was trained on
    sha256: str
    pid: str | None  # the aircraft and name of the PID, for people; "": the image has none; None: not known
    flown: str  # by the board until now: that aircraft's name; "" for none
    flown_sha256: str | None  # None: not known

    @property
    def other(self) -> bool:
        """True if the board flew another aircraft's policy, as far as that is known."""
        return bool(self.flown) and (self.name != self.flown or self.flown_sha256 not in (None, self.sha256))

    def rows(self) -> list[tuple[str, str]]:
        """Return the rows of the plan."""
        whose = f"{self.name}, digest {self.sha256[:DIGITS] or 'not known'}"
        if self.other:
            was = "" if self.flown_sha256 is None else f", digest {self.flown_sha256[:DIGITS]}"
            whose += f"; until now the board flew ANOTHER: {self.flown}{was}"
        pid = self.pid
        if pid is None:
            pid = "not known: the report.json of its build does not lie beside the image"
        return [
            ("aircraft", whose),
            ("PID", pid or "NONE: where the policy must not fly on, the motors stop"),
        ]

    def document(self) -> dict[str, object]:
        """Return the facts that --json prints."""
        return {
            "name": self.name,
            "sha256": self.sha256,
            "pid": self.pid,
            "board": self.flown or None,
            "board_sha256": self.flown_sha256,
            "other": self.other,
        }

    def check(self, port: str, *, other_aircraft: bool) -> None:
        """Raise ImageError where the image is for an aircraft of another name, and that is not meant.

        A digest that differs under the same name is told in the plan: its file was corrected, and the image
        brings policy and PID of the corrected one.
        """
        if self.flown and self.name != self.flown and not other_aircraft:
            raise ImageError(
                f"{port}: the board flies the aircraft {self.flown!r}, the image is for {self.name!r}: name "
                "the image of this aircraft, or give --other-aircraft if that is meant"
            )


def image_aircraft(path: Path, plan: InstallPlan) -> ImageAircraft:
    """Return the aircraft of the image at `path`."""
    from neuroflight.cli.board.known_policies import known_policies, one_digest

    flown = plan.board.policies.flown
    known = None if flown is None else known_policies([flown.sha256], Path.cwd()).get(flown.sha256)
    before = None if known is None else known.aircraft_sha256
    if plan.policy is not None:
        name, sha256 = plan.policy.header.aircraft, one_digest(plan.policy.header.aircraft_sha256)
    else:  # the file brings no policy: the board's own is kept
        name, sha256 = plan.board.policies.info.name, before or ""
    return ImageAircraft(
        name=name,
        sha256=sha256,
        pid=_pid(path),
        flown="" if flown is None else flown.aircraft,
        flown_sha256=before,
    )


def _pid(path: Path) -> str | None:
    """Return the PID of the image, by the report of its build."""
    from neuroflight.toolchain.image.report import built

    try:
        found = built(path)
    except BuildError:
        return None
    if found.pid_motors is None:
        return ""
    aircraft = found.aircraft
    if aircraft is None:
        return "built in, of an aircraft that the report does not tell"
    whose = "the policy's own" if aircraft.own else "NOT the one that the policy was trained on"
    return f"of aircraft {aircraft.name}, digest {aircraft.sha256[:DIGITS]}: {whose}"
