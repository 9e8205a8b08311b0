"""`neuroflight log quality`: the questions that a log can answer, and those that it cannot."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.cli.log.reading import OfLog, tell_damage
from neuroflight.cli.report import print_json, print_table


@dataclass(frozen=True, kw_only=True)
class Quality(OfLog):
    """A request for the questions that a log can answer."""

    def run(self) -> int:
        """Decode, judge, print."""
        from neuroflight.sim.blackbox.quality import quality

        log = self.read(self.file)
        told = quality(log)
        tell_damage(log)
        if self.json:
            document = {
                "file": str(self.file),
                "log": log.number,
                "firmware": log.maker.value,
                "rows": told.rows,
                "seconds": told.seconds,
                "rate_hz": told.rate_hz,
                "control_rate_hz": told.control_rate_hz,
                "lost_rows": told.lost,
                "longest_gap_s": told.longest_gap_s,
                "gyro_saturated": list(told.gyro_saturated),
                "motors_full": told.motors_full,
                "motors_idle": told.motors_idle,
                "questions": [
                    {"name": one.name, "answer": one.answer.value, "why": one.why} for one in told.questions
                ],
                "warnings": list(told.warnings),
            }
            print_json(document)
            return 0
        rows = [("question", "answer", "")]
        rows += [(one.name, one.answer.value, one.why) for one in told.questions]
        title = f"{self.file.name}: log {log.number}, {log.maker.value}"
        print_table(f"{title}, {told.rows:,} rows in {told.seconds:.1f} s", rows, numbers=())
        for warning in told.warnings:
            print(f"warning: {warning}")
        return 0
