"""`neuroflight policy import CHECKPOINT|MODEL.onnx --out POLICY.onnx`."""

from __future__ import annotations

import argparse
import json
import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.contract import Mix

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.toolchain.policy.model import PolicyModel
    from neuroflight.toolchain.policy.model_constants import ModelConstants

EPILOG = (
    "A checkpoint of `neuroflight policy train` knows its observation, rate and aircraft. A model of another "
    "trainer (ONNX, raw observation in, motor fractions out) is told them here."
)


RESTING = 0.2  # motor fraction; a policy that leaves the thrust to the pilot rests below


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    parser.add_argument(
        "source", type=Path, metavar="CHECKPOINT|MODEL.onnx", help="checkpoint.pt of a training, or any ONNX"
    )
    parser.add_argument("--out", type=Path, required=True, metavar="POLICY.onnx")
    parser.add_argument("--observation", metavar="BLOCKS", help="what the model observes, e.g. rate,throttle")
    parser.add_argument("--rate", type=int, metavar="HZ", help="control rate it was trained at")
    parser.add_argument("--aircraft", metavar="NAME|FILE", help="shipped name or .toml it was trained for")
    parser.add_argument(
        "--filters", metavar="JSON", help='gyro filters it was trained behind, [] or [["mean"]]; default: []'
    )
    parser.add_argument(
        "--idle",
        type=float,
        metavar="U",
        help="motor fraction without thrust it was trained with; default: 0",
    )
    parser.add_argument(
        "--mix",
        choices=[mix.text for mix in Mix],
        help="how its outputs and the throttle were mixed in training; default: attitude-first",
    )
    parser.add_argument("--output", metavar="NAME", help="which output is the action, if there are several")
    parser.add_argument(
        "--input-order",
        metavar="NAME,NAME",
        help="order in which several inputs make the observation; default: the model's",
    )
    parser.add_argument(
        "--constant",
        action="append",
        metavar="NAME=VALUE",
        help="value of an input that the firmware does not have, such as episode_starts=0; may be repeated",
    )
    parser.add_argument(
        "--output-range",
        metavar="LO,HI",
        help="what its outputs ranged over in training, -1,1 for most trainers; mapped to 0..1",
    )
    # argparse takes what begins with - for an option, but for what this calls a number: -1,1 is two of them.
    parser._negative_number_matcher = re.compile(r"-[\d.]")
    parser.add_argument(
        "--clip",
        action="store_true",
        help="append a Clip to [0, 1] if the model has none: its outputs are motor fractions already",
    )
    parser.add_argument(
        "--unfolded",
        action="store_true",
        help="of a checkpoint: leave its observation scale and output map as operations of their own, to "
        "compare with what is left once they are folded",
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a line")


def run(args: argparse.Namespace) -> int:
    """Write POLICY.onnx and print its contents."""
    from neuroflight.cli.output import check_output
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.passes import size
    from neuroflight.toolchain.policy.freeze import freeze
    from neuroflight.toolchain.policy.import_onnx import is_checkpoint
    from neuroflight.toolchain.policy.model import read_policy

    check_output(args.out, ".onnx")
    changes: Sequence[str] = ()
    if is_checkpoint(args.source):
        _reject_claims(args)
        freeze(args.source, args.out, fold=not args.unfolded)
        policy = read_policy(args.out)
    else:
        if args.unfolded:
            raise PolicyError(
                f"--unfolded: {args.source} is an ONNX model and is kept as it is; leave it out"
            )
        policy, changes = _import(args)
    if args.json:
        document = {
            "source": str(args.source),
            "policy": str(args.out),
            "policy_sha256": policy.source_sha256,
            "network": policy.network.text,
            "graph": asdict(size(policy.network)) | {"file_bytes": args.out.stat().st_size},
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
        print(json.dumps(document, indent=2))
        return 0
    for change in changes:
        print(change)
    print(
        f"{args.source} -> {args.out}: {policy.network.text}, {policy.aircraft}, "
        f"{policy.control_rate_hz} Hz, mix {policy.mix.text}, filters {json.dumps(policy.filters)}"
    )
    print(_rest_words(policy, _at_rest(policy)))
    return 0


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


def _claims(args: argparse.Namespace) -> dict[str, object]:
    """Return the options that only a model of another trainer needs, as given."""
    return {
        "--observation": args.observation,
        "--rate": args.rate,
        "--aircraft": args.aircraft,
        "--filters": args.filters,
        "--idle": args.idle,
        "--mix": args.mix,
        "--output": args.output,
        "--input-order": args.input_order,
        "--constant": args.constant,
        "--output-range": args.output_range,
        "--clip": args.clip or None,
    }


def _reject_claims(args: argparse.Namespace) -> None:
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.policy.freeze import load_checkpoint

    if given := [name for name, value in _claims(args).items() if value is not None]:
        load_checkpoint(args.source)  # which says so if it is another trainer's
        raise PolicyError(
            f"{args.source} is a checkpoint, which knows its own observation, rate, filters, idle, mix "
            f"and aircraft; leave out {', '.join(given)}"
        )


def _import(args: argparse.Namespace) -> tuple[PolicyModel, Sequence[str]]:
    from neuroflight.sim.aircraft.model import load_aircraft
    from neuroflight.toolchain.contract import IDLE_DEFAULT, IDLE_MAX
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.policy.import_onnx import PolicyClaims, import_onnx
    from neuroflight.toolchain.policy.output_map import OutputRange
    from neuroflight.toolchain.verification.original import compare

    needed = ("--observation", "--rate", "--aircraft")
    if missing := [name for name in needed if _claims(args)[name] is None]:
        raise PolicyError(
            f"{args.source} is an ONNX model, of which freeze must be told {', '.join(missing)} "
            "(a checkpoint of `neuroflight policy train` knows them)"
        )
    if args.idle is not None and not 0.0 <= args.idle <= IDLE_MAX:
        raise PolicyError(f"--idle {args.idle}, expected 0 to {IDLE_MAX}")
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
        model=_model(args, aircraft),
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
        constants=dict(map(_constant, args.constant or ())),
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


def _model(args: argparse.Namespace, aircraft: Aircraft) -> ModelConstants | None:
    """Return the constants of the aircraft's model, where the observation is made by one.

    An unknown observation or rate is refused by `import_onnx`.
    """
    from neuroflight.sim.control.estimator import model_constants
    from neuroflight.toolchain.contract import needs_model, observation_blocks

    try:
        needed = args.rate > 0 and needs_model(observation_blocks(args.observation))
    except ValueError:
        return None
    return model_constants(aircraft, args.rate) if needed else None
