"""`neuroflight log decode`: the frames of a log as CSV or NumPy's .npz."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.log.reading import OfLog, tell_damage
from neuroflight.cli.report import print_json, print_table
from neuroflight.cli.requests import Option


@dataclass(frozen=True, kw_only=True)
class Decode(OfLog):
    """A request for the frames of a log."""

    csv: Annotated[
        Path | None,
        Option(
            "FILE.csv",
            "a row each frame, as the format's tools write it; header lines go into FILE.headers.csv, GPS "
            "frames into FILE.gps.csv",
            suffix=".csv",
        ),
    ] = None
    npz: Annotated[
        Path | None, Option("FILE.npz", "columns, and what they are in rad/s, s, V", suffix=".npz")
    ] = None

    def run(self) -> int:
        """Decode, write, tell what there is."""
        from neuroflight.sim.blackbox.export import save_csv, save_gps_csv, save_headers, save_npz

        log = self.read(self.file)
        if self.csv:
            save_csv(self.csv, log)
            save_headers(self.csv, log)
            if log.positions:
                save_gps_csv(self.csv.with_suffix(".gps.csv"), log)
        if self.npz:
            save_npz(self.npz, log)
        tell_damage(log)
        fields = {
            name: {"least": int(column.min()), "largest": int(column.max()), "mean": float(column.mean())}
            for name, column in {
                **log.columns,
                **log.slow,
                **{f"gps/{name}": column for name, column in log.gps.items()},
            }.items()
            if len(column)
        }
        if self.json:
            told = {
                "file": str(self.file),
                "log": log.number,
                "firmware": log.maker.value,
                "rows": len(log),
                "gps_rows": log.positions,
                "seconds": log.seconds,
                "rate_hz": log.rate_hz,
                "lost_rows": log.lost,
                "notes": list(log.notes),
                "events": [{"name": one.name, "row": one.row, **one.values} for one in log.events],
                "headers": log.header,
                "fields": fields,
            }
            print_json(told)
            return 0
        rows = [("field", "least", "largest", "mean")]
        rows += [(n, str(f["least"]), str(f["largest"]), f"{f['mean']:.1f}") for n, f in fields.items()]
        note = f"{len(log)} rows, {log.seconds:.3f} s, {log.rate_hz:,.0f} rows a second, {log.lost} lost"
        if log.positions:
            note += f", {log.positions} GPS rows" + (f" in {self.csv.stem}.gps.csv" if self.csv else "")
        print_table(f"{self.file.name}: log {log.number}, {log.maker.value}", rows, note)
        return 0
