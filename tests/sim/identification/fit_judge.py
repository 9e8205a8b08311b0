"""What `neuroflight aircraft fit` finds of hidden twins, against what is true.

    python -m tests.sim.identification.fit_judge [FOLDER] [--seeds 101,102] [--only NAME,..] [--by KIND,..]

Flies what FOLDER lacks (hidden_flights.py: minutes a flight), has the command fit each log by what its pilot
knows, weight, arm and propellers, and prints one table at the end. What was flown stays, and so do the fits,
for as long as the fit's code is the same: stopped, it goes on where it was.

A parameter is good if it is within GOOD of the true one, or the true one is inside its 95 % interval. One
that the fit says it cannot tell is not among the told. Coverage is the share of told ones whose interval
holds the true value.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binom

from neuroflight.cli.main import main as neuroflight
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.toolchain.files import write_text
from tests.conftest import ROOT
from tests.sim.identification.hidden_flights import BETAFLIGHT_GYRO_HZ, BY, OWN_GYRO_HZ, write
from tests.sim.identification.hidden_pilot import STYLES
from tests.sim.identification.hidden_twins import CLASSES, draw, loop_parameters

GOOD = 0.1  # relative
GOOD_DELAY_S = 0.5e-3  # half a sample of a loop of 1 kHz
# A row of Betaflight's log has the motors that the twin gets 0.34 to 0.39 ms after that row's gyro (measured:
# its log against the flight's trace), and holds for four of its loops of 8 kHz: 0.19 ms more than one.
HOLD_S = 0.55e-3
JUDGED = ("sim/identification", "sim/aircraft", "cli/aircraft/fit.py")  # whose code makes a fit
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
    by: str
    key: str
    true: float
    value: float
    low: float
    high: float
    told: bool
    inside: bool

    @property
    def off(self) -> float:
        """Error: relative, of the delay in seconds."""
        return self.value - self.true if self.key == "delay_s" else self.value / self.true - 1.0

    @property
    def near(self) -> bool:
        return abs(self.off) <= (max(GOOD_DELAY_S, GOOD * self.true) if self.key == "delay_s" else GOOD)

    @property
    def good(self) -> bool:
        return self.near or self.inside

    def row(self) -> str:
        scale, unit = (1e3, " ms") if self.key.endswith("_s") else (1.0, "")
        numbers = (f"{scale * number:9.4g}" for number in (self.true, self.value, self.low, self.high))
        true, value, low, high = numbers
        off = f"{1e3 * self.off:+6.2f} ms" if self.key == "delay_s" else f"{100 * self.off:+6.1f} %"
        verdict = "" if self.inside else ", OUTSIDE" if self.near else ", OUTSIDE, NOT GOOD"
        return (
            f"  {self.log:26} {self.key:16} true {true} fit {value} ({low} to {high}){unit} {off}"
            f"{verdict if self.told else ', not told'}"
        )


def kept_fit(log: Path, facts: dict[str, Any], out: Path) -> dict[str, Any]:
    """Have the command fit a log, or read what it found before; `out`: its file, its document beside it.

    The document of a log that is refused has nothing but "refused".
    """
    kept = out.with_suffix(".json")
    if not kept.exists():
        own = ["--weight", str(facts["told_weight"]), "--arm", str(facts["told_arm"])]
        own += ["--props", facts["told_propeller"]]
        said, complained = io.StringIO(), io.StringIO()
        out.parent.mkdir(parents=True, exist_ok=True)
        out.unlink(missing_ok=True)
        began = time.process_time()
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(complained):
            code = neuroflight(["aircraft", "fit", str(log), *own, "--out", str(out), "--json"])
        document = {"refused": complained.getvalue().strip()} if code else json.loads(said.getvalue())
        write_text(kept, json.dumps(document | {"cpu_s": round(time.process_time() - began, 1)}, indent=1))
    found: dict[str, Any] = json.loads(kept.read_text())
    return found


def judge(log: Path, facts: dict[str, Any], out: Path, document: dict[str, Any]) -> list[Judged]:
    """Hold the file that was fitted to a log, and its intervals, against the true file."""
    aircraft = load_aircraft(out)
    truth = load_aircraft(log.with_name(f"{facts['name']}.true.toml"))
    has_volts = log.suffix == ".bfl" and aircraft.propulsion.supply_voltage is not None
    found = loop_parameters(aircraft, facts["at"], facts["volts"] if has_volts else None)
    true_now = loop_parameters(truth, facts["at"], facts["volts"], facts["shares"])
    # A log cannot tell the lag of the gyro's chip from delay. And a twin, whose rotors' forces are those of
    # the end of its step, is half a step early: the file is told for one of OWN_GYRO_HZ.
    rate_hz = BETAFLIGHT_GYRO_HZ if facts["by"] == "betaflight" else OWN_GYRO_HZ
    true_now["delay_s"] = facts["true"]["delay_s"] + chip_lag(truth, rate_hz) - 0.5 / rate_hz
    true_now["delay_s"] -= chip_lag(aircraft, OWN_GYRO_HZ) - 0.5 / OWN_GYRO_HZ
    true_now["delay_s"] += HOLD_S if facts["by"] == "betaflight" else 0.0
    rows = []
    for key, true in true_now.items():
        told = document["parameters"].get(INTERVALS[key])
        if told is None:
            continue
        low, high = told["range"]
        value = found[key]
        if key == "authority_rise":  # the bend has the interval
            inside = low <= bend(truth) <= high
        elif key == "delay_s":
            inside = low <= true <= high
        else:
            low, high = sorted((value * low / told["value"], value * high / told["value"]))
            inside = low <= true <= high
        rows.append(
            Judged(
                f"{facts['seed']}/{log.stem}", facts["by"], key, true, value, low, high, told["told"], inside
            )
        )
    return rows


def bend(aircraft: Aircraft) -> float:
    a = aircraft.propulsion.speed_curve[0]
    return -a / sum(aircraft.propulsion.speed_curve)


def chip_lag(aircraft: Aircraft, rate_hz: int) -> float:
    """Return the lag [s] of the gyro's chip as a twin steps it."""
    if aircraft.gyro.bandwidth_hz is None:
        return 0.0
    return 1.0 / rate_hz / math.expm1(2 * math.pi * aircraft.gyro.bandwidth_hz / rate_hz)


def between(hits: int, count: int) -> str:
    """Return a share in percent, and its 95 % interval (Clopper and Pearson's)."""
    if count == 0:
        return "-"
    shares = np.linspace(0, 1, 2001)
    usual = shares[(binom.cdf(hits, count, shares) > 0.025) & (binom.sf(hits - 1, count, shares) > 0.025)]
    return f"{100 * hits / count:3.0f} ({100 * usual[0]:3.0f} to {100 * usual[-1]:3.0f}) %"


def table(rows: Sequence[Judged]) -> None:
    """Print coverage and errors by parameter, by who flew, and of all."""
    print(
        f"\n{'':16} {'cases':>5} {'told':>5}  {'told: inside':19} {'good':19} {'all: good':19} median |off|"
    )

    def line(name: str, chosen: Callable[[Judged], bool]) -> None:
        each = [row for row in rows if chosen(row)]
        told = [row for row in each if row.told]
        if not each:
            return
        off = np.median([abs(row.off) for row in told] or [np.nan])
        error = "" if " " in name else f"{1e3 * off:.2f} ms" if name == "delay_s" else f"{100 * off:.1f} %"
        inside = between(sum(row.inside for row in told), len(told))
        good = [between(sum(row.good for row in some), len(some)) for some in (told, each)]
        print(f"{name:16} {len(each):5} {len(told):5}  {inside:20}{good[0]:20}{good[1]:20}{error}")

    for key in INTERVALS:
        line(key, lambda row, key=key: row.key == key)  # type: ignore[misc]
    for by in BY:
        line(f"flown by {by}", lambda row, by=by: row.by == by)  # type: ignore[misc]
    line("all of them", lambda row: True)


def digest() -> str:
    """Return a short name of the code that makes a fit."""
    found = hashlib.sha256()
    for place in JUDGED:
        path = ROOT / place
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            found.update(file.read_bytes())
    return found.hexdigest()[:8]


def main() -> None:
    """Fly what is missing, fit what is new, judge all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "tests" / "hidden")
    parser.add_argument("--seeds", default="101,102")
    parser.add_argument("--only", default="", help="names of classes")
    parser.add_argument("--by", default=",".join(BY))
    parser.add_argument("--style", choices=STYLES, default="freestyle")
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--fly", action="store_true", help="nothing but fly")
    parser.add_argument("--verbose", action="store_true", help="print what is good, too")
    args = parser.parse_args()
    kinds = [kind for kind in CLASSES if not args.only or kind.name in args.only.split(",")]
    plan = [
        (int(seed), kind, by) for seed in args.seeds.split(",") for kind in kinds for by in args.by.split(",")
    ]
    fits = args.folder / f"fits-{digest()}"
    rows: list[Judged] = []
    refused = []
    for number, (seed, kind, by) in enumerate(plan):
        name = f"{seed}/{kind.name}.{by}"
        log = args.folder / f"{name}{BY[by]}"
        said = f"{number + 1:3}/{len(plan)} {name:26}"
        if not log.exists():
            began = time.process_time()
            write(draw(kind, seed), log, by, args.style, args.seconds, seed)
            said += f" flown in {time.process_time() - began:.0f} s,"
        facts = json.loads(log.with_suffix(".json").read_text())
        said += f" rates {np.round(facts['mae'], 1)} deg/s off"
        if args.fly:
            print(said, flush=True)
            continue
        out = fits / f"{name}.toml"
        document = kept_fit(log, facts, out)
        if "refused" in document:
            refused.append(name)
            print(f"{said}, REFUSED: {document['refused']}", flush=True)
            continue
        judged = judge(log, facts, out, document)
        rows += judged
        shares = ["-" if each is None else f"{100 * each:.0f}" for each in document["explained"]]
        print(f"{said}, explained {' '.join(shares)} %, {document['cpu_s']:.0f} s", flush=True)
        for row in judged:
            if args.verbose or (row.told and not row.inside) or not row.good:
                print(row.row(), flush=True)
    if rows:
        table(rows)
    print(f"refused: {', '.join(refused) or 'none'}; fits in {fits}")


if __name__ == "__main__":
    main()
