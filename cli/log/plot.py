"""`neuroflight log plot`: a flight as a picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.log.reading import OfLog, since, tell_damage
from neuroflight.cli.options import OfPart
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Option


@dataclass(frozen=True, kw_only=True)
class Plot(OfPart, OfLog):
    """A request for the picture of a flight."""

    plot: Annotated[Path, Option("FILE.png", "where the picture goes", old=("--out",), suffix=".png")]
    start: Annotated[float | None, since("the log's first row")] = None

    def run(self) -> int:
        """Decode and draw."""
        from neuroflight.sim.blackbox.plot import draw_log
        from neuroflight.sim.plotting import save_png

        part = self.part
        log = self.read(self.file)
        title = f"{self.file.name}: log {log.number}, {log.maker.value}"
        save_png(self.plot, draw_log(log, title, part.start_s, part.stop_s))
        tell_damage(log)
        if self.json:
            print_json(
                {"file": str(self.file), "log": log.number, "out": str(self.plot), "notes": list(log.notes)}
            )
        else:
            print(self.plot)
        return 0
