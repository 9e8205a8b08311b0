"""`python -m tests.bench`: measure everything, or what --only names, and print it."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from neuroflight.cli.main import THREADS

RECIPES = ("nf1", "ppo")  # pathwise gradient and PPO
SUBJECTS = ("twin", "envs", "training", "compiler", "firmware", "board", "usb", "flights")


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="tests.bench", description="speed and cost, in one run")
    parser.add_argument("--only", nargs="+", choices=SUBJECTS, default=SUBJECTS, metavar="|".join(SUBJECTS))
    parser.add_argument("--seconds", type=float, default=3.0, help="for each figure of twin and environments")
    parser.add_argument("--steps", type=int, default=1_000_000, help="to take training's speed with")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1], metavar="S", help="of training")
    parser.add_argument("--inputs", type=int, default=10_000, help="of each compiled network; armed steps")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    for name in THREADS:  # as the command sets them
        os.environ.setdefault(name, "1")
    document: dict[str, Any] = {}
    if "twin" in args.only:
        document |= measure_twin(args)
    if "envs" in args.only:
        document |= measure_envs(args)
    if "training" in args.only:
        document |= measure_training(args)
    if "compiler" in args.only:
        document |= measure_compiler(args)
    if "firmware" in args.only:
        document |= measure_firmware(args)
    if "board" in args.only:
        document |= measure_board(args)
    if "usb" in args.only:
        document |= measure_usb(args)
    if "flights" in args.only:
        document |= measure_flights(args)
    if args.json:
        print(json.dumps(document))
    return 0


def measure_twin(args: argparse.Namespace) -> dict[str, Any]:
    """Aircraft steps a second of the twin."""
    from tests.bench.twin import twin_speeds

    speeds = twin_speeds(args.seconds)
    if not args.json:
        print(f"{'':44}of bare pybullet, as many aircraft  aircraft steps a second")
        for speed in speeds:
            print(f"{speed.name:44}{speed.value / speed.floor:>34.2f}{speed.value:>25,.0f}")
    return {"aircraft_steps_a_second": {speed.name: round(speed.value) for speed in speeds}}


def measure_envs(args: argparse.Namespace) -> dict[str, Any]:
    """Measure aircraft steps a second of the environments for other learners, beside their batch."""
    from tests.bench.envs import env_speeds

    speeds = env_speeds(args.seconds)
    if not args.json:
        print(f"{'':44}of the batch, as many aircraft  aircraft steps a second")
        for speed in speeds:
            print(f"{speed.name:44}{speed.value / speed.batch:>30.2f}{speed.value:>25,.0f}")
    return {"environment_steps_a_second": {speed.name: round(speed.value) for speed in speeds}}


def measure_training(args: argparse.Namespace) -> dict[str, Any]:
    """Steps a second of training, and what a minute of it comes to, seed by seed."""
    from tests.bench.twin import learning

    rows = []
    for recipe in RECIPES:
        for seed in args.seeds:
            row = learning(recipe, args.steps, args.seconds, seed)
            rows.append({"seed": seed, **asdict(row)})
            if not args.json:
                print(
                    f"{recipe}, seed {seed}: {row.of_bare_pybullet:.2f} of bare pybullet, "
                    f"{row.of_the_twin:.2f} of the twin alone, {row.steps_a_second:,.0f} steps a second; "
                    f"{row.steps_in_a_minute:,} in {row.seconds:.0f} s: "
                    f"MAE {row.mae_deg_s:.2f} deg/s, at worst {row.worst_mae_deg_s:.1f}, on unseen pulses"
                )
    return {"training": rows}


def measure_compiler(args: argparse.Namespace) -> dict[str, Any]:
    """What compiled networks take on the Cortex-M7, beside another compiler's."""
    from tests.bench.compiler import print_table, rows

    measured, notes = rows(args.inputs)
    if not args.json:
        print_table(measured, notes)
    return {"compiler": {"rows": [asdict(row) for row in measured], "notes": notes}}


def measure_firmware(args: argparse.Namespace) -> dict[str, Any]:
    """What the whole control task takes on the Cortex-M7."""
    from tests.bench.firmware import print_table, rows

    measured = rows(args.inputs, lambda text: print(text, file=sys.stderr))
    if not args.json:
        print_table(measured)
    return {"firmware": [asdict(row) | {"varies": row.varies} for row in measured]}


def measure_board(args: argparse.Namespace) -> dict[str, Any]:
    """How fast the emulated board flies, and where the time goes."""
    from tests.bench.board import document, measure, print_table

    speed = measure(lambda text: print(text, file=sys.stderr))
    if not args.json:
        print_table(speed)
    return {"board": document(speed)}


def measure_usb(args: argparse.Namespace) -> dict[str, Any]:
    """How fast the image is over USB, in the board's own time."""
    from tests.bench.usb import print_table, rows

    measured = rows(lambda text: print(text, file=sys.stderr))
    if not args.json:
        print_table(measured)
    return {"usb": [asdict(row) for row in measured]}


def measure_flights(args: argparse.Namespace) -> dict[str, Any]:
    """How fast firmwares fly on their ports, and where the time goes."""
    from tests.bench.flights import document, measure, print_table

    rows = measure(lambda text: print(text, file=sys.stderr))
    if not args.json:
        print_table(rows)
    return {"flights": document(rows)}


if __name__ == "__main__":
    raise SystemExit(main())
