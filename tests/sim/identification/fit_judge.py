"""What `neuroflight aircraft fit` finds of hidden twins, against what is true.

    python -m tests.sim.identification.fit_judge FOLDER... [--only NAME] [--start FILE.toml]

FOLDER holds what hidden_twins wrote. The command is given a log and what its pilot knows: weight, arm,
propellers. A parameter is good if it is within GOOD of the true one, or the true one is inside its 95 %
interval; one that the fit says it cannot tell is counted apart. Coverage is the share of true values
inside, of those that it tells.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import math
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from neuroflight.cli.main import main as neuroflight
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from tests.sim.identification.hidden_twins import loop_parameters

GOOD = 0.1  # relative
GOOD_DELAY_S = 0.5e-3  # half a sample of a loop of 1 kHz
# Loops of 8 kHz in Betaflight hold a sample of 2 kHz: motors in a row are up to three loops ahead
# of those that act.
HOLD_S = 1.5 / 8000
BY = {".bbl": "betaflight", ".bfl": "own", ".npz": "pid"}
# Of what the command reports: the interval of each true parameter, relative to its value.
INTERVALS = {
    "authority_roll": "authority.roll",
    "authority_pitch": "authority.pitch",
    "authority_yaw": "authority.yaw",
    "up_s": "response.up_s",
    "down_s": "response.down_s",
    "delay_s": "delay_s",
    "authority_rise": "curve",
    "kick_yaw": "kick",
}


@dataclass(frozen=True)
class Judged:
    """One parameter of one log."""

    log: str
    key: str
    true: float
    value: float
    low: float
    high: float
    told: bool

    @property
    def off(self) -> float:
        """Error: relative, of the delay in seconds."""
        return self.value - self.true if self.key == "delay_s" else self.value / self.true - 1.0

    @property
    def near(self) -> bool:
        return abs(self.off) <= (max(GOOD_DELAY_S, GOOD * self.true) if self.key == "delay_s" else GOOD)

    @property
    def inside(self) -> bool:
        return self.low <= self.true <= self.high

    @property
    def good(self) -> bool:
        return self.near or self.inside

    def row(self) -> str:
        scale, unit = (1e3, " ms") if self.key.endswith("_s") else (1.0, "")
        numbers = (f"{scale * number:9.4g}" for number in (self.true, self.value, self.low, self.high))
        true, value, low, high = numbers
        off = f"{1e3 * self.off:+6.2f} ms" if self.key == "delay_s" else f"{100 * self.off:+6.1f} %"
        told = "" if self.told else ", not told"
        return (
            f"  {self.key:16} true {true} fit {value} ({low} to {high}){unit} {off} "
            f"{'inside' if self.inside else 'OUTSIDE'}{'' if self.good else ', NOT GOOD'}{told}"
        )


def fitted(log: Path, facts: dict[str, Any], out: Path, start: str | None) -> tuple[dict[str, Any], Aircraft]:
    """Have the command fit a log; returns its document and the aircraft that it wrote."""
    own = [
        "--weight",
        str(facts["told_weight"]),
        "--arm",
        str(facts["told_arm"]),
        "--props",
        facts["told_propeller"],
    ]
    words = ["aircraft", "fit", str(log), *(own if start is None else ["--aircraft", start])]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        code = neuroflight([*words, "--out", str(out), "--json"])
    if code:
        raise RuntimeError(f"{log}: exit status {code}")
    return json.loads(said.getvalue()), load_aircraft(out)


def judge(log: Path, start: str | None = None) -> tuple[list[Judged], dict[str, Any]]:
    """Judge the fit of one log of a hidden twin."""
    facts = json.loads(log.with_suffix(f".{BY[log.suffix]}.json").read_text())
    out = log.with_suffix(log.suffix + ".fit.toml")
    document, aircraft = fitted(log, facts, out, start)
    has_volts = log.suffix == ".bfl" and aircraft.propulsion.supply_voltage is not None
    found = loop_parameters(aircraft, facts["at"], facts["volts"] if has_volts else None)
    truth = load_aircraft(log.with_name(f"{log.name.split('.')[0]}.true.toml"))
    facts["true"]["delay_s"] += chip_lag(truth) - chip_lag(aircraft)
    rows = []
    true_now = loop_parameters(truth, facts["at"], facts["volts"], facts["shares"])
    true_now["delay_s"] = facts["true"]["delay_s"] + (HOLD_S if log.suffix == ".bbl" else 0.0)
    for key, true in true_now.items():
        told = document["parameters"].get(INTERVALS[key])
        if told is None:
            continue
        low, high = told["range"]
        value = found[key]
        if key == "authority_rise":  # the bend has the interval
            a, _, _ = truth.propulsion.speed_curve
            bend = -a / sum(truth.propulsion.speed_curve)
            inside = low <= bend <= high
            low, high = (true, true) if inside else (value, value)
        elif told["value"]:
            low, high = sorted((value * low / told["value"], value * high / told["value"]))
        rows.append(Judged(log.name, key, true, value, low, high, told["told"]))
    return rows, document


def chip_lag(aircraft: Aircraft) -> float:
    """Return the lag [s] of the gyro's chip, which a log cannot tell from delay."""
    return 0.0 if aircraft.gyro.bandwidth_hz is None else 1.0 / (2 * math.pi * aircraft.gyro.bandwidth_hz)


def logs(folders: list[Path], only: str) -> Iterator[Path]:
    for folder in folders:
        for path in sorted(folder.iterdir()):
            chosen = not only or path.stem in only.split(",")
            if path.suffix in BY and chosen and path.with_suffix(f".{BY[path.suffix]}.json").exists():
                yield path


def summary(rows: list[Judged]) -> None:
    """Print coverage and errors by parameter."""
    by: dict[str, list[Judged]] = defaultdict(list)
    for row in rows:
        by[row.key].append(row)
        by["all"].append(row)
    print(f"{'':16} logs  told  inside (of told)  near   good (of told)  good (of all)  median |off|")
    for key, each in by.items():
        told = [row for row in each if row.told]
        count = max(1, len(told))
        off = sorted(abs(row.off) for row in each)[len(each) // 2]
        print(
            f"{key:16} {len(each):4}  {len(told):4}  {100 * sum(row.inside for row in told) / count:6.0f} %"
            f"       {100 * sum(row.near for row in each) / len(each):6.0f} %"
            f"  {100 * sum(row.good for row in told) / count:6.0f} %"
            f"        {100 * sum(row.good for row in each) / len(each):6.0f} %       {off:.4f}"
        )


def main() -> None:
    """Judge the logs of folders."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--start")
    parser.add_argument("--quiet", action="store_true", help="print the summary, and what is not good")
    args = parser.parse_args()
    rows: list[Judged] = []
    for log in logs(args.folders, args.only):
        began = time.process_time()
        try:
            judged, document = judge(log, args.start)
        except (RuntimeError, OSError) as error:
            print(f"{log}: FAILS: {error}", flush=True)
            continue
        rows += judged
        explained = " ".join(f"{100 * share:.0f}" for share in document["explained"])
        print(
            f"{log}: {document['seconds']:.0f} s flown, explained {explained} %, fitted in "
            f"{time.process_time() - began:.0f} s"
        )
        for row in judged:
            if not args.quiet or not row.good or not row.inside:
                print(row.row(), flush=True)
    summary(rows)


if __name__ == "__main__":
    main()
