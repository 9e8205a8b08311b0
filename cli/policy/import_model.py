"""`neuroflight policy import CHECKPOINT|MODEL.onnx --out POLICY.onnx`."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option, Request
from neuroflight.toolchain.contract import IDLE_MAX, Mix

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.toolchain.policy.model import PolicyModel
    from neuroflight.toolchain.policy.model_constants import ModelConstants

ABOUT = (
    "A checkpoint of `neuroflight policy train` knows its observation, rate and aircraft. A model of another "
    "trainer (ONNX, raw observation in, motor fractions out) is told them here. Of the policy for any "
    "quadcopter, `any`, it makes the one of --aircraft."
)


CLAIMS = (  # options that only a model of another trainer needs; the first three always
    *("observation", "rate", "aircraft", "filters", "idle", "mix", "output", "input_order", "constant"),
    *("output_range", "clip"),
)
RESTING = 0.2  # motor fraction; a policy that leaves the thrust to the pilot rests below


@dataclass(frozen=True, kw_only=True)
class Import(Request):
    """A request for policy.onnx from a checkpoint or another trainer's model."""

    source: Annotated[Path, Argument("CHECKPOINT|MODEL.onnx", "checkpoint.pt of a training, an ONNX, or any")]
    out: Annotated[Path, Option("POLICY.onnx", "the policy", suffix=".onnx")]
    observation: Annotated[str | None, Option("BLOCKS", "what the model observes, e.g. rate,throttle")] = None
    rate: Annotated[int | None, Option("HZ", "control rate it was trained at")] = None
    aircraft: Annotated[str | None, Option("NAME|FILE", "shipped name or .toml it was trained for")] = None
    filters: Annotated[
        str | None, Option("JSON", 'gyro filters it was trained behind, [] or [["mean"]]; default: []')
    ] = None
    idle: Annotated[
        float | None,
        Option("U", "motor fraction without thrust it was trained with; default: 0", low=0.0, high=IDLE_MAX),
    ] = None
    mix: Annotated[
        str | None,
        Option(
            None,
            "how its outputs and the throttle were mixed in training; default: attitude-first",
            choices=tuple(mix.text for mix in Mix),
        ),
    ] = None
    output: Annotated[str | None, Option("NAME", "which output is the action, if there are several")] = None
    input_order: Annotated[
        str | None,
        Option("NAME,NAME", "order in which several inputs make the observation; default: the model's"),
    ] = None
    constant: Annotated[
        tuple[str, ...],
        Option(
            "NAME=VALUE",
            "value of an input that the firmware does not have, such as episode_starts=0; may be repeated",
            once=True,
        ),
    ] = ()
    output_range: Annotated[
        str | None,
        Option("LO,HI", "what its outputs ranged over in training, -1,1 for most trainers; mapped to 0..1"),
    ] = None
    clip: Annotated[
        bool,
        Option(
            None, "append a Clip to [0, 1] if the model has none: its outputs are motor fractions already"
        ),
    ] = False
    unfolded: Annotated[
        bool,
        Option(
            None,
            "of a checkpoint: leave its observation scale and output map as operations of their own, to "
            "compare with what is left once they are folded",
        ),
    ] = False
    json: Json = False

    more: ClassVar[str] = f". {ABOUT}"

    def run(self) -> int:
        """Write POLICY.onnx and print its contents."""
        from neuroflight.toolchain.errors import PolicyError
        from neuroflight.toolchain.passes import size
        from neuroflight.toolchain.policy.freeze import freeze
        from neuroflight.toolchain.policy.import_onnx import is_checkpoint
        from neuroflight.toolchain.policy.model import read_policy

        changes: Sequence[str] = ()
        if self._specialized():
            policy = read_policy(self.out)
        elif is_checkpoint(self.source):
            _reject_claims(self)
            freeze(self.source, self.out, fold=not self.unfolded)
            policy = read_policy(self.out)
        else:
            if self.unfolded:
                raise PolicyError(
                    f"--unfolded: {self.source} is an ONNX model and is kept as it is; leave it out"
                )
            policy, changes = _import(self)
        if self.json:
            document = {
                "source": str(self.source),
                "policy": str(self.out),
                "policy_sha256": policy.source_sha256,
                "network": policy.network.text,
                "graph": asdict(size(policy.network)) | {"file_bytes": self.out.stat().st_size},
                "observation": policy.observation,
                "control_rate_hz": policy.control_rate_hz,
                "filters": policy.filters,
                "idle": policy.idle,
                "at_rest": _at_rest(policy),
                "mix": policy.mix.text,
                "model": None if policy.model is None else policy.model.document(),
                "aircraft": policy.aircraft,
                "aircraft_sha256": policy.aircraft_sha256,
                "changes": list(changes),
            }
            print_json(document)
            return 0
        for change in changes:
            print(change)
        print(
            f"{self.source} -> {self.out}: {policy.network.text}, {policy.aircraft}, "
            f"{policy.control_rate_hz} Hz, mix {policy.mix.text}, filters {json.dumps(policy.filters)}"
        )
        print(_rest_words(policy, _at_rest(policy)))
        return 0

    def _specialized(self) -> bool:
        """Write the policy of --aircraft, if the source is a policy for any."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.control.any_policy import own_policy, policy_path
        from neuroflight.toolchain.errors import PolicyError
        from neuroflight.toolchain.files import write_bytes
        from neuroflight.toolchain.policy.import_onnx import is_checkpoint
        from neuroflight.toolchain.policy.specialize import is_general

        source = policy_path(self.source)
        if is_checkpoint(source) or not is_general(source):
            return False
        if self.aircraft is None:
            raise PolicyError(f"{source} is a policy for any quadcopter: name yours with --aircraft")
        if given := self.given(*(name for name in CLAIMS if name != "aircraft")):
            raise PolicyError(f"{source} knows its observation and its like; leave out {', '.join(given)}")
        write_bytes(self.out, own_policy(source, load_aircraft(self.aircraft)))
        return True


def _at_rest(policy: PolicyModel) -> list[float]:
    """Return the policy's outputs for an observation of zeros, from its initial state."""
    import numpy as np

    from neuroflight.toolchain.ir.interpreter import evaluate

    observation = np.zeros((1, policy.observation_count), np.float32)
    return [float(value) for value in evaluate(policy.network, observation)[0]]


def _rest_words(policy: PolicyModel, outputs: Sequence[float]) -> str:
    """Describe idle and the outputs at rest, with a warning where they do not suit the mix."""
    listed = " ".join(f"{output:.3f}" for output in outputs)
    words = f"idle {policy.idle:g}; at a zero observation its outputs are {listed}"
    if policy.mix is Mix.ATTITUDE_FIRST and min(outputs) > RESTING:
        words += (
            ": with this mix the motors turn so with the throttle closed; if outputs only turn the aircraft, "
            f"use --mix {Mix.CENTRED.text}"
        )
    return words


def _reject_claims(args: Import) -> None:
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.policy.freeze import load_checkpoint

    if given := args.given(*CLAIMS):
        load_checkpoint(args.source)  # which says so if it is another trainer's
        raise PolicyError(
            f"{args.source} is a checkpoint, which knows its own observation, rate, filters, idle, mix "
            f"and aircraft; leave out {', '.join(given)}"
        )


def _import(args: Import) -> tuple[PolicyModel, Sequence[str]]:
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.toolchain.contract import IDLE_DEFAULT
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.policy.import_onnx import PolicyClaims, import_onnx
    from neuroflight.toolchain.policy.output_map import OutputRange
    from neuroflight.toolchain.verification.original import compare

    if args.observation is None or args.rate is None or args.aircraft is None:
        missing = [f"--{name}" for name in CLAIMS[:3] if getattr(args, name) is None]
        raise PolicyError(
            f"{args.source} is an ONNX model, of which freeze must be told {', '.join(missing)} "
            "(a checkpoint of `neuroflight policy train` knows them)"
        )
    aircraft = load_aircraft(args.aircraft)
    claims = PolicyClaims(
        observation=args.observation,
        control_rate_hz=args.rate,
        filters=args.filters or "[]",
        aircraft=aircraft.name,
        aircraft_sha256=aircraft.sha256,
        motors=aircraft.motor_count,
        idle=IDLE_DEFAULT if args.idle is None else args.idle,
        mix=Mix.of(args.mix or Mix.ATTITUDE_FIRST.text),
        model=_model(args.observation, args.rate, aircraft),
    )
    if args.clip and args.output_range is not None:
        raise PolicyError("--clip and --output-range: the latter clips what it maps; leave out --clip")
    return import_onnx(
        args.source,
        args.out,
        claims,
        clip=args.clip,
        output=args.output,
        output_range=None if args.output_range is None else OutputRange.of(args.output_range),
        input_order=None if args.input_order is None else args.input_order.split(","),
        constants=dict(map(_constant, args.constant)),
        prove=compare,
    )


def _constant(text: str) -> tuple[str, float]:
    """Return name and value of a --constant."""
    from neuroflight.toolchain.errors import PolicyError

    name, _, value = text.rpartition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not name or not math.isfinite(number):
        raise PolicyError(f"--constant {text}, expected NAME=VALUE, the name of an input and a finite number")
    return name, number


def _model(observation: str, rate: int, aircraft: Aircraft) -> ModelConstants | None:
    """Return the constants of the aircraft's model, where the observation is made by one.

    An unknown observation or rate is refused by `import_onnx`.
    """
    from neuroflight.sim.control.estimator import observed_model
    from neuroflight.toolchain.contract import observation_blocks

    try:
        terms = observation_blocks(observation)
    except ValueError:
        return None
    return observed_model(aircraft, terms, rate) if rate > 0 else None
