"""neuroflight policy adapt: correct the aircraft from a flight, refine a policy on it, and prove it."""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.compare.controllers import check_ranges
from neuroflight.cli.plugins import add_plugin_argument, load_named, words

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.moments import Factors
    from neuroflight.training.adaptation.adapt import Bench, Proof

STEPS, STEPS_MAX, EPISODES = 20_000_000, 1_000_000_000, 200
VERIFIED = 200  # observations of each kind
AIRCRAFT, POLICY, PROOF = "aircraft.toml", "policy.onnx", "adaptation.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "log", type=Path, metavar="LOG", help="a flight: a trace (.npz) or a blackbox log (FILE:N)"
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="the file to correct")
    parser.add_argument(
        "--policy", type=Path, required=True, metavar="DIR", help="the run whose policy is refined"
    )
    parser.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help=f"a new folder: {AIRCRAFT}, {POLICY}, {PROOF} and the run; only if the proof holds",
    )
    add_plugin_argument(parser)
    parser.add_argument("--steps", type=int, default=STEPS, metavar="N", help=f"default: {STEPS:,}")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of the refinement; default: 1")
    parser.add_argument(
        "--episodes",
        type=int,
        default=EPISODES,
        metavar="N",
        help=f"commands of the proof, five in a flight; default: {EPISODES}",
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="only say what the log tells; nothing is trained or written"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Identify, refine, prove; the folder appears only if the proof holds. Returns 0."""
    from neuroflight.sim.aircraft.model import load_aircraft, parse_aircraft
    from neuroflight.sim.identification.moments import adapted_text, read_turning, turning_factors
    from neuroflight.toolchain.errors import NeuroflightError, TrainingError
    from neuroflight.toolchain.files import write_bytes, write_text
    from neuroflight.training.adaptation.adapt import prove, refine, warm_config

    check_ranges(("--steps", args.steps, 1, STEPS_MAX), ("--episodes", args.episodes, 6, 4096))
    if args.seed < 0:
        raise TrainingError(f"--seed {args.seed}, expected 0 or more")
    if args.out.exists():
        raise NeuroflightError(f"--out {args.out}: exists; name a new folder, so that no policy is replaced")
    load_named(args)
    aircraft = load_aircraft(args.aircraft)
    factors = turning_factors(read_turning(args.log, aircraft.motor_count), aircraft, str(args.log))
    text = adapted_text(args.aircraft, aircraft, factors)
    if args.dry_run:
        _report(args, {"factors": _factors(factors)}, factors, None)
        return 0
    warm_config(args.policy, args.steps, args.seed)  # refuses what cannot be refined before anything flies
    args.out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".adapt-", dir=args.out.parent) as folder:
        aside = Path(folder) / "run"
        aside.mkdir()
        # Meshes of the file are named relative to it; the adapted file has to lie beside them then.
        base = Path(args.aircraft).parent if Path(args.aircraft).is_file() else None
        adapted = parse_aircraft(text, f"{args.out}/{AIRCRAFT}", base)
        refine(adapted, args.policy, args.steps, args.seed, aside, command=_command(args))
        old, new = args.policy / POLICY, aside / POLICY
        proof = prove(old, new, aircraft, adapted, args.episodes, args.seed + 1)
        verdict = _verified(new)
        document = {
            "command": _command(args),
            "aircraft": aircraft.name,
            "factors": _factors(factors),
            "verification": verdict,
            "proof": _proof(proof, aircraft),
            "refused": proof.refusal,
        }
        if proof.refusal is None:
            write_bytes(aside / AIRCRAFT, text)
            write_text(aside / PROOF, json.dumps(document, indent=2) + "\n")
            aside.rename(args.out)
            Path(folder).mkdir(exist_ok=True)
    _report(args, document, factors, proof)
    if proof.refusal is not None:
        raise NeuroflightError(f"refused, nothing was kept: the refined policy {proof.refusal}")
    return 0


def _verified(policy: Path) -> str:
    """Return the verdict of `policy verify` on the machines that are installed. Raises NeuroflightError."""
    from neuroflight.toolchain.codegen.compiler import compile_policy
    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.policy.model import read_policy
    from neuroflight.toolchain.verification.inputs import make_inputs
    from neuroflight.toolchain.verification.verify import all_candidates, verify

    compiled = compile_policy(read_policy(policy))
    with tempfile.TemporaryDirectory(prefix="neuroflight-") as folder:
        machines = all_candidates(
            compiled, policy.read_bytes(), Path(folder), policy.with_name("checkpoint.pt")
        )
        inputs = make_inputs(compiled.policy.observation_count, VERIFIED, 0)
        seen = verify(compiled, machines, inputs, seed=0)
    if seen.finding:
        raise NeuroflightError(f"refused, nothing was kept: {seen.finding.message}")
    return str(seen.verdict)


def _command(args: argparse.Namespace) -> str:
    from neuroflight.cli.output import command_line

    return command_line(
        "policy adapt",
        str(args.log),
        *words(args),
        aircraft=args.aircraft,
        policy=str(args.policy),
        steps=args.steps,
        seed=args.seed,
        episodes=args.episodes,
    )


def _factors(factors: Factors) -> dict[str, Any]:
    from neuroflight.toolchain.contract import AXES

    rows = zip(AXES, factors.value, factors.margin, factors.steady, factors.explained, strict=True)
    return {
        axis: {
            "turns": float(value),
            "margin": float(margin),
            "inertia_over_thrust": float(1.0 / value),
            "steady_rad_s2": float(steady),
            "explained": float(explained),
        }
        for axis, value, margin, steady, explained in rows
    }


def _proof(proof: Proof, aircraft: Aircraft) -> dict[str, Any]:
    from neuroflight.training.evaluation.evaluation import interval

    def figures(one: Bench) -> dict[str, Any]:
        return {"mae": interval(one.mae), "motor_change": one.change}

    return {
        "flights": len(proof.old.scores.output),
        "adapted": {
            "old": figures(proof.old),
            "new": figures(proof.new),
            "gain": interval(proof.gain),
            "drift": interval(proof.drift),
        },
        "original": {
            "aircraft_sha256": aircraft.sha256,
            "old": figures(proof.old_original),
            "new": figures(proof.new_original),
        },
    }


def _report(
    args: argparse.Namespace, document: dict[str, Any], factors: Factors, proof: Proof | None
) -> None:
    from neuroflight.toolchain.contract import AXES

    if args.json:
        print(json.dumps(document, indent=2))
        return
    for axis, value, margin in zip(AXES, factors.value, factors.margin, strict=True):
        print(f"{axis:6} turns {value:.3f} ± {margin:.3f} times as much as the file says")
    if proof is None:
        return
    print(f"verification: {document['verification']}")
    print("                     old policy          refined         MAE deg/s, motor change in 1 ms")
    for name, old, new in (
        ("adapted aircraft", proof.old, proof.new),
        ("aircraft of the file", proof.old_original, proof.new_original),
    ):
        each = (f"{float(one.mae.value):6.3f}  {one.change:.5f}" for one in (old, new))
        print(f"{name:20} {'    '.join(each)}")
    if proof.refusal is None:
        print(
            f"{args.out} holds the refined policy. Nothing was written to a board; that is, as the corrected "
            f"aircraft has another digest,\n"
            f"  neuroflight board policy swap {args.out / POLICY} --other-aircraft --port PORT"
        )
