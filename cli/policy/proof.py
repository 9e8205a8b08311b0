"""The end of `policy train --from`: the policy before and the new one on the same flights."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from neuroflight.cli.progress import progress_bars

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.fitness.proof import Flown, Proof
    from neuroflight.training.runs.train import Start

PROOF = "proof.json"


class _Asked(Protocol):
    """The request, as far as its end needs it."""

    @property
    def out(self) -> Path: ...
    @property
    def aircraft(self) -> str: ...
    @property
    def json(self) -> bool: ...


def prove_better(args: _Asked, aircraft: Aircraft, start: Start) -> Proof:
    """Fly the policy before and the new one, and write the proof into the folder of the run."""
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.evaluation.controllers import load_controller
    from neuroflight.training.fitness.proof import prove
    from neuroflight.training.runs.train import POLICY

    old, new = (load_controller(str(path), aircraft) for path in (start.folder / POLICY, args.out / POLICY))
    with progress_bars() as bar:
        proof = prove(old, new, aircraft, bar("the policy before and the new one"))
    document = {"from": start.document(), **proof.document()}
    write_text(args.out / PROOF, json.dumps(document, indent=2) + "\n")
    return proof


def end_proof(args: _Asked, proof: Proof, start: Start) -> None:
    """Print the proof. Raises NeuroflightError, and keeps no policy.onnx, where it does not hold."""
    from neuroflight.toolchain.errors import NeuroflightError
    from neuroflight.toolchain.policy.check_stamp import stamp_path
    from neuroflight.toolchain.policy.specialize import is_general
    from neuroflight.training.runs.train import POLICY

    if not args.json:
        _print(args, proof, start)
    if proof.refusal is not None:
        policy = args.out / POLICY
        for path in (policy, stamp_path(policy)):
            path.unlink(missing_ok=True)
        instead = ""
        if is_general(start.folder / POLICY):
            instead = f"; fly {start.name} itself: neuroflight image build --aircraft {args.aircraft}"
        raise NeuroflightError(f"refused, {policy} was not kept: the new policy {proof.refusal}{instead}")


def _print(args: _Asked, proof: Proof, start: Start) -> None:
    from neuroflight.sim.analysis.holding import DRIFT_S
    from neuroflight.training.fitness.proof import COMMANDS
    from neuroflight.training.runs.train import POLICY

    def words(name: str, flown: Flown) -> str:
        return (
            f"  {name:9} {float(flown.mae.value):7.3f}  {float(flown.mse.value):7.2f}  {flown.change:.5f}  "
            f"{flown.drift:6.2f}"
        )

    print(
        f"{COMMANDS} unseen commands in the twin of {args.aircraft}: MAE deg/s, MSE, motors' change in 1 ms, "
        f"drift in {DRIFT_S:g} s deg"
    )
    print(words("before", proof.old))
    print(words("refined", proof.new))
    gain = proof.gain
    print(
        f"MAE is less by {float(gain.value):.3f} deg/s ({float(gain.low):.3f} to {float(gain.high):.3f}, "
        f"95 %). Proven on the file {args.aircraft} alone: for the aircraft it holds as far as its file does"
    )
    if proof.refusal is None:
        other = "" if start.aircraft_sha256 == proof.aircraft.sha256 else " --other-aircraft"
        print(
            f"a board that flies a policy of {start.name}'s architecture takes it: "
            f"neuroflight board policy swap {args.out / POLICY}{other} --port PORT"
        )
