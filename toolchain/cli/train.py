"""neuroflight train: synthesize a policy in the twin of an aircraft."""

from __future__ import annotations

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    parser.add_argument("--aircraft", default="nf1", help="shipped name or path of a .toml file")
    parser.add_argument("--steps", type=int, default=8_000_000, help="control steps, all aircraft together")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder for the three results")
    parser.add_argument("--force", action="store_true", help="replace results that are in --out already")


def run(args: argparse.Namespace) -> int:
    """Train with a progress bar, then say where the results are."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    from sim.aircraft import load_aircraft
    from toolchain.errors import TrainingError
    from training.configuration import TrainingConfig
    from training.synthesis import Progress as State
    from training.synthesis import Watcher, train

    aircraft = load_aircraft(args.aircraft)
    config = TrainingConfig(steps=args.steps, seed=args.seed)
    if args.out.exists() and not args.out.is_dir():
        raise TrainingError(f"--out {args.out} is no folder; give the name of one, new or old")
    if not args.force and (args.out / "checkpoint.pt").exists():
        raise TrainingError(f"{args.out} already holds a checkpoint; choose another --out or add --force")
    console = Console()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} · {task.fields[figures]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(f"training {aircraft.name}", total=args.steps, figures="")

        class Bar(Watcher):
            def progressed(self, progress: State) -> None:
                speed = progress.steps / progress.seconds
                figures = f"{speed:,.0f}/s · reward {progress.reward:.3f}"
                bar.update(task, completed=progress.steps, figures=figures)

        state = train(aircraft, config, args.out, Bar())
    console.print(
        f"{state.steps:,} steps in {state.seconds:.0f} s ({state.steps / state.seconds:,.0f} a second); "
        f"{args.out / 'policy.onnx'}, checkpoint.pt and training.json beside it"
    )
    return 0
