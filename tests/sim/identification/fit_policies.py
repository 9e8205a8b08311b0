"""What a policy loses by training on a fit: it flies the hidden twin itself, beside one trained on the truth.

    python -m tests.sim.identification.fit_policies [FOLDER] [--only NAME,..] [--by KIND] [--files FILE,..]

Of logs that fit_judge.py flew and fitted in FOLDER. Policies of equal steps are trained on each of FILES and
flown at equal thrust, as the fleet is (training/evaluation/fleet/arena.py), on the aircraft as it is, whose
motors differ. FILES, the first of which the others are held against:

- truth: what a file can say of the aircraft: its motors alike;
- typical: what `aircraft new` writes from what the pilot knows;
- fit: what the command wrote of the log; fit@DIR: of an earlier run of it, kept in FOLDER/DIR;
- fit+GROUP: the fit with one group of its numbers true (GROUPS), which tells the number that costs most.

What was trained stays. --steps 0 trains nothing: the policy for any aircraft is told each file instead.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from neuroflight.cli.main import main as neuroflight
from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import Aircraft, load_aircraft, parse_aircraft
from neuroflight.sim.control.any_policy import ANY, own_policy
from neuroflight.toolchain.files import write_bytes, write_text
from neuroflight.training.evaluation.controllers import load_controller
from neuroflight.training.evaluation.fleet.arena import Figures, Plan, meet
from neuroflight.training.evaluation.fleet.builds import Build
from neuroflight.training.evaluation.fleet.truth import truth_text
from neuroflight.training.evaluation.fleet.unseen import Unseen
from tests.conftest import ROOT
from tests.sim.identification.fit_judge import digest
from tests.sim.identification.hidden_flights import BY, typical_text
from tests.sim.identification.hidden_twins import CLASSES, Hidden, draw

FLIGHTS = Plan(pulses=16, flights=("pulses", "minute"))


def _with(fit: Aircraft, truth: Aircraft, group: str) -> str:
    """Return the file of the fit with a group of the truth's numbers."""
    drive, mass, true = fit.propulsion, fit.mass_properties, truth.propulsion
    told = fit
    match group:
        case "response":
            drive = replace(drive, response=true.response)
        case "delay":
            drive = replace(drive, delay=true.delay)
        case "yaw":
            drive = replace(drive, torque_ratio=true.torque_ratio, rotor_inertia=true.rotor_inertia)
        case "centre":
            centre = (*truth.mass_properties.centre[:2], mass.centre[2])
            mass = MassProperties(mass.mass, np.array(centre), mass.inertia)
        case "authority":
            drive = replace(
                drive,
                speed_curve=true.speed_curve,
                thrust_coefficient=true.thrust_coefficient,
                supply_voltage=true.supply_voltage,
            )
            mass = MassProperties(truth.mass_properties.mass, mass.centre, truth.mass_properties.inertia)
            told = replace(fit, rotors=truth.rotors, battery=truth.battery)
        case "gyro":
            told = replace(fit, gyro=truth.gyro)
    text = truth_text(fit.name, told, mass, drive)
    if group == "gyro":  # whose turn and low-pass that text leaves out
        turned = ", ".join(f"{angle:.6g}" for angle in np.rad2deg(truth.gyro.misalignment))
        more = f"bandwidth_hz = {truth.gyro.bandwidth_hz}\nmisalignment_deg = [{turned}]\n"
        text = text.replace("[gyro]\n", f"[gyro]\n{more}")
    return text


GROUPS = ("none", "response", "delay", "yaw", "centre", "authority", "gyro")


def file_text(name: str, hidden: Hidden, fits: Path, folder: Path, flight: str) -> str:
    """Return the text of one of FILES."""
    kind, _, which = name.partition("@")
    kind, _, group = kind.partition("+")
    if kind == "truth":
        return hidden.text
    if kind == "typical":
        return typical_text(hidden)
    fitted = (folder / which if which else fits) / f"{flight}.toml"
    return _with(load_aircraft(fitted), hidden.aircraft, group) if group else fitted.read_text()


def trained(text: str, folder: Path, name: str, steps: int, seed: int) -> Path:
    """Return the policy of an aircraft file, which is trained unless it was; without steps, `any` told it."""
    key = hashlib.sha256(text.encode()).hexdigest()[:10]
    out = folder / "policies" / f"{name.replace('/', '-')}-{key}-{steps // 1000}k-{seed}"
    policy = out / "policy.onnx"
    if not policy.exists() and steps == 0:
        write_bytes(policy, own_policy(ANY, parse_aircraft(text.encode(), name)))
    elif not policy.exists():
        file = out.with_suffix(".toml")
        write_text(file, text)
        words = ["policy", "train", "--aircraft", str(file), "--steps", str(steps), "--seed", str(seed)]
        words += ["--set", "selection.fit=false"]  # the last step's policy, without the check at the end
        with contextlib.redirect_stdout(io.StringIO()) as said:
            code = neuroflight([*words, "--out", str(out), "--force"])
        if code:
            raise RuntimeError(f"{out}: exit status {code}: {said.getvalue()[-500:]}")
    return policy


def flown(policy: Path, hidden: Hidden) -> dict[str, Figures]:
    """Fly it on the hidden twin as it is; what was flown is kept beside the policy."""
    kept = policy.with_name("flown.json")
    if not kept.exists():
        build = Build(hidden.name, "hidden", hidden.told_weight, 0, 0.0, (0.0, 0.0), "", hidden.told_arm, "")
        truth = hidden.aircraft
        aircraft = Unseen(hidden.name, build, truth, truth, hidden.text, hidden.shares, hidden.charge)
        found = meet(load_controller(str(policy), truth), aircraft, FLIGHTS)
        write_text(kept, json.dumps({kind: figures.document() for kind, figures in found.items()}))
    return {kind: Figures.of(each) for kind, each in json.loads(kept.read_text()).items()}


def main() -> None:
    """Train, fly, print the ratios."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "tests" / "hidden")
    parser.add_argument("--seeds", default="101", help="of the twins")
    parser.add_argument("--only", default="whoop75,inch3,inch5,inch7")
    parser.add_argument("--by", choices=BY, default="rotors")
    parser.add_argument("--files", default="truth,typical,fit")
    parser.add_argument("--steps", type=int, default=8_000_000)
    parser.add_argument("--trainings", default="1", help="their seeds")
    args = parser.parse_args()
    names = args.files.split(",")
    ratios: dict[tuple[str, str], list[list[float]]] = {}
    fits = args.folder / f"fits-{digest()}"
    for seed in map(int, args.seeds.split(",")):
        for kind in (kind for kind in CLASSES if kind.name in args.only.split(",")):
            hidden = draw(kind, seed)
            flight = f"{seed}/{kind.name}.{args.by}"
            first: list[dict[str, Figures]] = []
            for name in names:
                text = file_text(name, hidden, fits, args.folder, flight)
                policies = [
                    trained(text, args.folder, flight, args.steps, int(number))
                    for number in args.trainings.split(",")
                ]
                found = [flown(policy, hidden) for policy in policies]
                first = first or found
                for flights in FLIGHTS.flights:
                    own, true = ([each[flights] for each in some] for some in (found, first))
                    row = [_mean(own, key) / _mean(true, key) for key in ("mae", "mse")]
                    ratios.setdefault((name, flights), []).append(row)
                    print(
                        f"{flight:20} {name:16} {flights:7} MAE {_mean(own, 'mae'):6.2f} x{row[0]:5.2f}  "
                        f"MSE {_mean(own, 'mse'):8.1f} x{row[1]:5.2f}  stands {_mean(own, 'standing'):5.2f}  "
                        f"swing {_mean(own, 'swing'):5.2f}  change {_mean(own, 'change'):.4f}  lost "
                        f"{sum(each.lost for each in own)}",
                        flush=True,
                    )
    print("\nover the first, geometric mean and worst:")
    for (name, flights), rows in ratios.items():
        mean, worst = np.exp(np.log(rows).mean(axis=0)), np.max(rows, axis=0)
        print(
            f"{name:16} {flights:7} MAE {mean[0]:.2f} ({worst[0]:.2f})  MSE {mean[1]:.2f} ({worst[1]:.2f})  "
            f"of {len(rows)} aircraft"
        )


def _mean(figures: Sequence[Figures], key: str) -> float:
    return float(np.mean([getattr(each, key) for each in figures]))


if __name__ == "__main__":
    main()
