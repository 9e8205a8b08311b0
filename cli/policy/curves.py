"""neuroflight policy curves: the training reward of runs over their steps, averaged over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.options import Json, picture
from neuroflight.cli.plugins import WithPlugins
from neuroflight.cli.report import print_json, print_table, with_margin
from neuroflight.cli.requests import Argument, Option

if TYPE_CHECKING:
    from neuroflight.sim.analysis.confidence import Mean
    from neuroflight.training.runs.learning_curves import Curve

RUNS_MAX = 100
NOTE = (
    "Reward: mean over the last 5 % of the steps; ± is 95 % confidence over seeds. 95 %: steps until that "
    "part of the way from the lowest reward to this one is done. Rewards compare only where the reward "
    "function is the same."
)


@dataclass(frozen=True, kw_only=True)
class Curves(WithPlugins):
    """A request for training curves."""

    runs: Annotated[
        tuple[Path, ...],
        Argument(
            "RUN", "folders that `train` wrote; one of --seeds K counts with all its seeds", most=RUNS_MAX
        ),
    ]
    label: Annotated[
        tuple[str, ...] | None,
        Option(
            "NAME",
            "one for each RUN; runs with the same label are seeds of one configuration; default: the "
            "folders' names",
        ),
    ] = None
    episodes: Annotated[
        bool,
        Option(
            None,
            "draw the reward summed over an episode, not of a control step",
            name="--by-episode",
            old=("--episodes",),
            recorded=False,
        ),
    ] = False
    each_seed: Annotated[bool, Option(None, "draw each seed instead of their mean", recorded=False)] = False
    plot: Annotated[Path | None, picture("draw the curves, a panel a configuration")] = None
    json: Json = False

    def run(self) -> int:
        """Read the runs, print their figures, draw."""
        from neuroflight.sim.plotting import save_png
        from neuroflight.training.runs.learning_curves import curves
        from neuroflight.training.runs.learning_curves_plot import draw_curves

        self.load_named()
        labels = _labels(self)
        found = curves(self.runs, labels)
        if self.plot:
            title = "Reward of training episodes" if self.episodes else "Reward in training"
            save_png(self.plot, draw_curves(found, title, episodes=self.episodes, seeds=self.each_seed))
        if self.json:
            print_json({"command": self.command, "curves": [_document(curve) for curve in found]})
        else:
            _print(found, episodes=self.episodes)
        return 0


def _labels(args: Curves) -> list[str]:
    from neuroflight.toolchain.errors import TrainingError

    if args.label is None:
        return [run.resolve().name for run in args.runs]
    if len(args.label) != len(args.runs):
        raise TrainingError(
            f"--label: {len(args.label)} names for {len(args.runs)} runs, expected one for each"
        )
    return list(args.label)


def _document(curve: Curve) -> dict[str, object]:
    episode = curve.episode_steps
    final = curve.final.document()
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
        "steps_to_95": None if reached is None else {**reached.document(), "seeds": int(reached.count)},
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
    margin = factor * float(mean.high - mean.low) / 2 if int(mean.count) > 1 else 0.0
    return with_margin(factor * float(mean.value), margin, digits)
