"""`neuroflight log metrics`: the figures of a flight, of a log or of a trace, by the same functions."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.log.reading import OfLog, since, tell_damage
from neuroflight.cli.options import OfPart
from neuroflight.cli.report import print_table
from neuroflight.cli.requests import Option
from neuroflight.toolchain.contract import Mix
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.analysis.flight_report import Flight

NOTE = "errors are setpoint minus gyro: no log has the true rate"


@dataclass(frozen=True, kw_only=True)
class Metrics(OfPart, OfLog):
    """A request for the figures of a flight; `file` may be a trace of `fly --trace`."""

    start: Annotated[float | None, since("the first armed row")] = None
    episodes: Annotated[int, Option("N", "average over N equal parts (1)", low=1)] = 1
    idle: Annotated[float | None, Option("U", "motor fraction at zero thrust; default: as the log says")] = (
        None
    )
    mix: Annotated[
        str | None,
        Option(
            None,
            "of outputs and throttle; default: as the log says, attitude-first of a trace",
            choices=tuple(mix.text for mix in Mix),
        ),
    ] = None

    def run(self) -> int:
        """Decode, compute, print. A trace is seen as a log sees it."""
        from neuroflight.cli.output import plain
        from neuroflight.sim.analysis.flight_report import table

        if self.idle is not None and not 0.0 <= self.idle < 1.0:
            raise NeuroflightError(f"--idle {self.idle:g}, expected a part of full power, 0 to below 1")
        flight = self._trace() if self.file.suffix == ".npz" else self._logged()
        if self.json:
            told = {
                "file": str(self.file),
                "rows": len(flight.trace.t),
                "episodes": self.episodes,
                "armed": flight.armed,
                **asdict(flight.figures),
            }
            print(json.dumps(plain(told), indent=2, default=plain))
            return 0
        length = f"{len(flight.trace.t)} rows at {flight.trace.control_rate_hz} Hz"
        print_table(f"{self.file.name}: {flight.name}, {length}", table([flight]), NOTE)
        return 0

    @property
    def _mix(self) -> Mix | None:
        return None if self.mix is None else Mix.of(self.mix)

    def _logged(self) -> Flight:
        from neuroflight.sim.blackbox.flight import log_flight

        chosen = self.part
        log = self.read(self.file)
        flight = log_flight(log, chosen, self.episodes, self.idle, self._mix)
        tell_damage(log)
        return flight

    def _trace(self) -> Flight:
        from neuroflight.sim.blackbox.flight import cut, trace_flight
        from neuroflight.sim.flight.trace import load_trace

        trace = cut(load_trace(self.file), self.part)
        return trace_flight("trace", trace, self.episodes, self.idle, self._mix or Mix.ATTITUDE_FIRST)
