"""neuroflight policy curves: the training reward of runs over their steps, averaged over seeds."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.plugins import add_plugin_argument, load_named

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.runs.learning_curves import Curve

RUNS_MAX = 100
NOTE = (
    "Reward: mean over the last 5 % of the steps; ± is 95 % confidence over seeds. 95 %: steps until that "
    "part of the way from the lowest reward to this one is done. Rewards compare only where the reward "
    "function is the same."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "runs",
        nargs="+",
        type=Path,
        metavar="RUN",
        help="folders that `train` wrote; one of --seeds K counts with all its seeds",
    )
    parser.add_argument(
        "--label",
        nargs="+",
        metavar="NAME",
        help="one for each RUN; runs with the same label are seeds of one configuration; default: the "
        "folders' names",
    )
    add_plugin_argument(parser)
    parser.add_argument(
        "--episodes",
        action="store_true",
        help="draw the reward summed over an episode, not of a control step",
    )
    parser.add_argument("--each-seed", action="store_true", help="draw each seed instead of their mean")
    parser.add_argument(
        "--plot", type=Path, metavar="FILE.png", help="draw the curves, a panel a configuration"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")


def run(args: argparse.Namespace) -> int:
    """Read the runs, print their figures, draw."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.plotting import save_png
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.runs.learning_curves import curves
    from neuroflight.training.runs.learning_curves_plot import draw_curves

    load_named(args)
    labels = _labels(args)
    if len(args.runs) > RUNS_MAX:
        raise TrainingError(f"{len(args.runs)} runs, expected 1 to {RUNS_MAX}")
    check_output(args.plot, ".png")
    found = curves(args.runs, labels)
    if args.plot:
        title = "Reward of training episodes" if args.episodes else "Reward in training"
        save_png(args.plot, draw_curves(found, title, episodes=args.episodes, seeds=args.each_seed))
    if args.json:
        print(
            json.dumps({"command": _command(args), "curves": [_document(curve) for curve in found]}, indent=2)
        )
    else:
        _print(found, episodes=args.episodes)
    return 0


def _labels(args: argparse.Namespace) -> list[str]:
    from neuroflight.toolchain.errors import TrainingError

    if args.label is None:
        return [run.resolve().name for run in args.runs]
    if len(args.label) != len(args.runs):
        raise TrainingError(
            f"--label: {len(args.label)} names for {len(args.runs)} runs, expected one for each"
        )
    return list(args.label)


def _command(args: argparse.Namespace) -> str:
    from neuroflight.cli.output import command_line

    return command_line("policy curves", *map(str, args.runs), label=args.label)


def _document(curve: Curve) -> dict[str, object]:
    from neuroflight.training.evaluation.evaluation import interval

    episode = curve.episode_steps
    final = interval(curve.final)
    reached = curve.reached_steps
    return {
        "label": curve.label,
        "seeds": [run.seed for run in curve.runs],
        "steps": min(int(run.steps[-1]) for run in curve.runs),
        "episode_steps": episode,
        "first": float(curve.reward.value[0]),
        "final": final,
        "final_episode": {name: episode * value for name, value in final.items()},
        "trend_end": float(curve.trend[-1]),
        "steps_to_95": None if reached is None else {**interval(reached), "seeds": int(reached.count)},
        "best_seed": curve.best.seed,
        "runs": [
            {
                "seed": run.seed,
                "steps": int(run.steps[-1]),
                "final": run.final,
                "final_episode": episode * run.final,
                "steps_to_95": run.reached_steps,
            }
            for run in curve.runs
        ],
    }


def _print(found: Sequence[Curve], *, episodes: bool) -> None:
    from neuroflight.cli.report import print_table

    heading = "reward of an episode" if episodes else "reward"
    rows: list[tuple[str, ...]] = [("", "seeds", "steps", heading, "95 % after", "best seed")]
    for curve in found:
        reached, factor = curve.reached_steps, float(curve.episode_steps) if episodes else 1.0
        rows.append(
            (
                curve.label,
                f"{len(curve.runs)}",
                f"{min(int(run.steps[-1]) for run in curve.runs):,}",
                _interval(curve.final, factor, 1 if episodes else 4),
                "did not rise" if reached is None else _interval(reached, 1.0, 0),
                f"{curve.best.seed}",
            )
        )
    print_table("", rows, NOTE)


def _interval(mean: Mean, factor: float, digits: int) -> str:
    value = f"{factor * float(mean.value):,.{digits}f}"
    if int(mean.count) < 2:
        return value
    return f"{value} ± {factor * float(mean.high - mean.low) / 2:,.{digits}f}"
