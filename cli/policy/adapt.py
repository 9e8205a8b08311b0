"""neuroflight policy adapt: correct the aircraft from a flight, refine a policy on it, and prove it."""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json
from neuroflight.cli.plugins import WithPlugins
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.identification.moments import Factors
    from neuroflight.training.adaptation.adapt import Bench, Proof

STEPS = 20_000_000
VERIFIED = 200  # observations of each kind
AIRCRAFT, POLICY, PROOF = "aircraft.toml", "policy.onnx", "adaptation.json"


@dataclass(frozen=True, kw_only=True)
class Adapt(WithPlugins):
    """A request to refine a policy on what a flight told."""

    log: Annotated[Path, Argument("LOG", "a flight: a trace (.npz) or a blackbox log (FILE:N)")]
    aircraft: Annotated[str, Option("NAME|FILE", "the file to correct")] = "nf1"
    policy: Annotated[Path, Option("DIR", "the run whose policy is refined", name="--run", old=("--policy",))]
    out: Annotated[
        Path,
        Option(
            "DIR",
            f"a new folder: {AIRCRAFT}, {POLICY}, {PROOF} and the run; only if the proof holds",
            recorded=False,
        ),
    ]
    steps: Annotated[int, Option("N", f"default: {STEPS:,}", low=1, high=1_000_000_000)] = STEPS
    seed: Annotated[int, Option("S", "of the refinement; default: 1", low=0)] = 1
    episodes: Annotated[
        int, Option("N", "commands of the proof, five in a flight; default: 200", low=6, high=4096)
    ] = 200
    dry_run: Annotated[
        bool, Option(None, "only say what the log tells; nothing is trained or written", recorded=False)
    ] = False
    json: Json = False

    def run(self) -> int:
        """Identify, refine, prove; the folder appears only if the proof holds. Returns 0."""
        from neuroflight.sim.aircraft.model import load_aircraft, parse_aircraft
        from neuroflight.sim.identification.moments import adapted_text, read_turning, turning_factors
        from neuroflight.toolchain.errors import NeuroflightError
        from neuroflight.toolchain.files import write_bytes, write_text
        from neuroflight.training.adaptation.adapt import prove, refine, warm_config

        if self.out.exists():
            raise NeuroflightError(
                f"--out {self.out}: exists; name a new folder, so that no policy is replaced"
            )
        self.load_named()
        aircraft = load_aircraft(self.aircraft)
        factors = turning_factors(read_turning(self.log, aircraft.motor_count), aircraft, str(self.log))
        text = adapted_text(self.aircraft, aircraft, factors)
        if self.dry_run:
            _report(self, {"factors": _factors(factors)}, factors, None)
            return 0
        warm_config(
            self.policy, self.steps, self.seed
        )  # refuses what cannot be refined before anything flies
        self.out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".adapt-", dir=self.out.parent) as folder:
            aside = Path(folder) / "run"
            aside.mkdir()
            # Meshes of the file are named relative to it; the adapted file has to lie beside them then.
            base = Path(self.aircraft).parent if Path(self.aircraft).is_file() else None
            adapted = parse_aircraft(text, f"{self.out}/{AIRCRAFT}", base)
            refine(adapted, self.policy, self.steps, self.seed, aside, command=self.command)
            old, new = self.policy / POLICY, aside / POLICY
            proof = prove(old, new, aircraft, adapted, self.episodes, self.seed + 1)
            verdict = _verified(new)
            document = {
                "command": self.command,
                "aircraft": aircraft.name,
                "factors": _factors(factors),
                "verification": verdict,
                "proof": _proof(proof, aircraft),
                "refused": proof.refusal,
            }
            if proof.refusal is None:
                write_bytes(aside / AIRCRAFT, text)
                write_text(aside / PROOF, json.dumps(document, indent=2) + "\n")
                aside.rename(self.out)
                Path(folder).mkdir(exist_ok=True)
        _report(self, document, factors, proof)
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
    def figures(one: Bench) -> dict[str, Any]:
        return {"mae": one.mae.document(), "motor_change": one.change}

    return {
        "flights": len(proof.old.scores.output),
        "adapted": {
            "old": figures(proof.old),
            "new": figures(proof.new),
            "gain": proof.gain.document(),
            "drift": proof.drift.document(),
        },
        "original": {
            "aircraft_sha256": aircraft.sha256,
            "old": figures(proof.old_original),
            "new": figures(proof.new_original),
        },
    }


def _report(args: Adapt, document: dict[str, Any], factors: Factors, proof: Proof | None) -> None:
    from neuroflight.toolchain.contract import AXES

    if args.json:
        print_json(document)
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
