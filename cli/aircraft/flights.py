"""Options and words that `neuroflight aircraft fit` and `aircraft sync` share: both take logs of flights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Header, Json, OfPart
from neuroflight.cli.requests import Argument
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.identification.fit.flight import Flight
    from neuroflight.sim.identification.fit.result import Fit


@dataclass(frozen=True, kw_only=True)
class OfFlights(OfPart):
    """A request about logs of one aircraft's flights."""

    logs: Annotated[
        tuple[Path, ...],
        Argument(
            "LOG",
            "one or more flights: blackbox logs, Betaflight's or ours (FILE:N is log N "
            "of a file), or traces of fly (.npz)",
        ),
    ]
    header: Header = ()
    json: Json = False

    def flights(self, motors: int) -> list[Flight]:
        """Read the flights. Raises TraceError on a log that is none, or of another number of motors."""
        from neuroflight.sim.identification.fit.flight import read_flight

        return [read_flight(path, motors, self.part, self.lines) for path in self.logs]

    def check_new(self, out: Path | None, aircraft: str | None) -> None:
        """Raise NeuroflightError if `out` is there, and is not the file that the fit begins with."""
        if out is None or not out.exists():
            return
        if aircraft is None or out.resolve() != Path(aircraft).resolve():
            raise NeuroflightError(
                f"--out {out}: exists; name a new file, or begin with this one: --aircraft {out}"
            )

    @property
    def lines(self) -> dict[str, str]:
        """The lines of --header, by name."""
        return dict(line.partition("=")[::2] for line in self.header)


def print_limits(fit: Fit) -> None:
    """Print what the logs cannot tell, with the manoeuvre that would, and the notes."""
    for words, manoeuvre in fit.cannot:
        print(f"cannot tell: {words}; would: {manoeuvre}")
    for note in fit.notes:
        print(f"note: {note}")
