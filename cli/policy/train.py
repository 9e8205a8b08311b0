"""neuroflight policy train: train a policy in the twin of an aircraft."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

from neuroflight.cli import options
from neuroflight.cli.options import Json
from neuroflight.cli.plugins import WithPlugins
from neuroflight.cli.policy.proof import PROOF, end_proof, prove_better
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Either, Option

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.config.training_config import TrainingConfig
    from neuroflight.training.fitness.ending import Ending
    from neuroflight.training.fitness.references import References
    from neuroflight.training.runs.seeds import Planned
    from neuroflight.training.runs.train import Callback, Progress, Start

DEFAULT_RECIPE = "nf1"  # of every aircraft that has none of its own
PLOT, BOARD = "monitor.png", "tensorboard"
KEPT = Either()
ABOUT = (
    f"Without --config: the recipe named like a shipped aircraft, for all others {DEFAULT_RECIPE}; with "
    "--algorithm alone, the recipe named like the algorithm, such as ppo, the dissertation's. With --from: "
    "the configuration of that run with a lower learning rate, and a proof at the end that the policy is "
    "better than the one before on this aircraft; else policy.onnx is not kept."
)


@dataclass(frozen=True, kw_only=True)
class Train(WithPlugins):
    """A request to train a policy."""

    aircraft: options.Aircraft = "nf1"
    config: Annotated[
        str | None, Option("RECIPE|FILE", "shipped recipe, a .toml, or the training.json of another run")
    ] = None
    algorithm: Annotated[str | None, Option("NAME", "such as ppo")] = None
    source: Annotated[
        str | None,
        Option(
            "RUN|NAME",
            "begin with the policy of that run's folder, or a shipped one; the result has its architecture, "
            "as `board policy swap` needs",
            name="--from",
        ),
    ] = None
    steps: Annotated[
        int | None, Option("N", "control steps, all aircraft together; with --from 20 million, a minute")
    ] = None
    seed: Annotated[int | None, Option("S", "of the run")] = None
    seeds: Annotated[
        int, Option("N", "train N seeds from S on and keep the best; default: 1", usual=True)
    ] = 1
    set: Annotated[
        tuple[str, ...], Option("NAME=VALUE", "change the configuration, such as world.throttle_max=0.8")
    ] = ()
    out: Annotated[Path, Option("DIR", "folder for the results", recorded=False)]
    resume: Annotated[bool, Option(None, "continue the run in --out", either=KEPT, recorded=False)] = False
    force: Annotated[bool, Option(None, "replace existing results in --out", either=KEPT, recorded=False)] = (
        False
    )
    tensorboard: Annotated[bool, Option(None, f"write event files into DIR/{BOARD}", recorded=False)] = False
    json: Json = False

    more: ClassVar[str] = f". {ABOUT}"

    def run(self) -> int:
        """Train with a progress display, then print the result."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.toolchain.files import claimed

        self.load_named()
        aircraft = load_aircraft(self.aircraft)
        start = None
        if self.source is not None:
            from neuroflight.training.runs.warm import load_start

            self.refuse("config", "algorithm", because="--from takes the configuration of its run; use --set")
            start = load_start(self.source)
        config = configuration(self, aircraft, start)
        _check_folder(self.out)
        with ExitStack() as claims:
            claims.enter_context(claimed(self.out, "training"))
            return _train_all(self, aircraft, config, start, claims)


def _train_all(
    args: Train, aircraft: Aircraft, config: TrainingConfig, start: Start | None, claims: ExitStack
) -> int:
    """Train every seed in --out, which this process has claimed. claims: gets the folders of the seeds."""
    from neuroflight.toolchain.files import claimed
    from neuroflight.toolchain.policy.check_stamp import write_stamp
    from neuroflight.training.runs.seeds import best_seed, keep, plan  # torch, which takes seconds
    from neuroflight.training.runs.train import read_record

    planned = plan(aircraft, config, args.out, args.seeds, resume=args.resume, force=args.force)
    for item in planned:
        if item.out != args.out:
            claims.enter_context(claimed(item.out, "training"))
    if args.force:
        _remove_earlier(args.out, planned)
    best = planned[0].config.seed
    ending: Ending | None = None
    with _Fitness(aircraft, args.aircraft, config) as fitness:
        try:
            ends = {item.config.seed: _train(args, aircraft, item, start) for item in planned}
            chosen = {seed: end.chosen for seed, end in ends.items() if end.chosen}
            best = best_seed(chosen, config.selection)
            ending = fitness.choose(planned)
            best = best if ending is None else ending.seed
            if len(planned) > 1:
                keep(args.out, best, chosen, replace(args, seed=config.seed).command)
        except KeyboardInterrupt:
            _draw(args.out, aircraft, planned, best)
            raise
    if ending is not None:
        ends[best] = replace(ends[best], chosen=ending.chosen)
        write_stamp(args.out / "policy.onnx", ending.verdict.document())
    _draw(args.out, aircraft, planned, best)
    proof = None if start is None else prove_better(args, aircraft, start)
    if args.json:
        record = read_record(args.out)
        told = None if ending is None else ending.document()
        proven = {} if proof is None else {"proof": proof.document()}
        print_json({"out": str(args.out), **record, "check": told, **proven})
    else:
        _print(args, planned, ends, best)
        fitness.tell(args, ending)
    if proof is not None and start is not None:
        end_proof(args, proof, start)
    return int(config.selection.fit and (ending is None or not ending.verdict.fit))


class _Fitness:
    """The check at the end of a training, where the recipe wants a policy that is fit to fly.

    Its references fly while the policy is learned. Where nothing can be flown beside it, `why` says so.
    """

    def __init__(self, aircraft: Aircraft, named: str, config: TrainingConfig) -> None:
        from neuroflight.cli.policy.check import find_betaflight
        from neuroflight.toolchain.errors import AircraftError
        from neuroflight.training.fitness.references import References

        self._aircraft, self.why = aircraft, ""
        self._references: References | None = None
        if not config.selection.fit:
            return
        betaflight, missing = find_betaflight(aircraft, None, build=not aircraft.pids)
        try:
            self._references = References(aircraft, named, betaflight, missing)
        except AircraftError as error:
            self.why = str(error)

    def __enter__(self) -> _Fitness:
        if self._references is not None:
            self._references.begin()
        return self

    def __exit__(self, *_: object) -> None:
        if self._references is not None:
            self._references.close()

    def choose(self, planned: tuple[Planned, ...]) -> Ending | None:
        """Return the best checkpoint that is fit, see `choose_fit`; None: nothing was checked."""
        from neuroflight.toolchain.errors import NeuroflightError
        from neuroflight.training.fitness.ending import choose_fit

        if self._references is None:
            return None
        try:
            with progress_bars() as bar:
                return choose_fit(
                    self._aircraft, planned, self._references, lambda name: bar(f"checking {name}")
                )
        except NeuroflightError as error:  # the trained policy is kept although its check failed
            self.why = str(error)
            return None

    def tell(self, args: Train, ending: Ending | None) -> None:
        """Print how the check ended, or the command that makes one."""
        from neuroflight.cli.policy.check import print_end
        from neuroflight.toolchain.policy.check_stamp import check_command

        policy = args.out / "policy.onnx"
        if ending is None:
            why = f": {self.why}" if self.why else ""
            print(f"not checked{why}; to fly it: {check_command(policy, args.aircraft)}")
            return
        for each in ending.rejected:
            print(f"not fit to fly: {each.name}: {each.reasons[0]}")
        if not ending.verdict.fit:
            print(f"no checkpoint of {len(ending.rejected)} is fit to fly; train with another --seed")
        elif ending.rejected:
            print(f"went back to: {ending.name}")
        print_end(ending.verdict, policy)


def configuration(args: Train, aircraft: Aircraft, start: Start | None = None) -> TrainingConfig:
    """Return the configuration of the arguments; start: of --from. Raises TrainingError if it is invalid."""
    from neuroflight.training.config.config_file import load_config
    from neuroflight.training.runs.warm import warm_config

    overrides = [*args.set]
    for key in ("algorithm", "steps", "seed"):
        if (value := getattr(args, key)) is not None:
            overrides.append(f"{key}={value}")
    if start is not None:
        return warm_config(start, aircraft, overrides)
    return load_config(_source(args, aircraft), overrides)


def _source(args: Train, aircraft: Aircraft) -> str | None:
    """Return the recipe or file that the run begins from; None: `TrainingConfig()`."""
    from neuroflight.sim.aircraft.model import shipped
    from neuroflight.training.config.config_file import recipes

    if args.config is not None:
        return str(args.config)
    if args.algorithm:
        return args.algorithm if args.algorithm in recipes() else None
    return aircraft.name if aircraft.name in shipped() and aircraft.name in recipes() else DEFAULT_RECIPE


def _check_folder(out: Path) -> None:
    """Reject a folder that could not be written after the training."""
    from neuroflight.cli.output import check_folder, check_output

    check_folder(out, "--out")
    check_output(out / "training.json", ".json")


def _remove_earlier(out: Path, planned: tuple[Planned, ...]) -> None:
    """Remove the proof of the replaced run, and its event files: TensorBoard would draw both runs as one."""
    (out / PROOF).unlink(missing_ok=True)
    for item in planned:
        for path in (item.out / BOARD).glob("events.out.tfevents.*"):
            path.unlink()


def _train(args: Train, aircraft: Aircraft, item: Planned, start: Start | None) -> Progress:
    from neuroflight.cli.policy.train_display import Display
    from neuroflight.training.checkpoints.monitor_process import Monitor
    from neuroflight.training.runs.train import Callbacks, train

    config = item.config
    with ExitStack() as stack:
        monitor = stack.enter_context(Monitor(aircraft, config, apart=config.steps > config.checkpoint_steps))
        display = stack.enter_context(
            Display(f"{aircraft.name}, seed {config.seed}", config.steps, item.done or 0)
        )
        callbacks: list[Callback] = [display]
        if args.tensorboard:
            from neuroflight.training.runs.tensorboard import TensorBoard

            board = TensorBoard(item.out / BOARD, item.done)
            stack.callback(board.close)
            callbacks.append(board)
        before = _written(item)
        try:
            return train(
                aircraft,
                config,
                item.out,
                Callbacks(callbacks),
                resume=item.done is not None,
                monitor=monitor,
                command=replace(args, seed=config.seed, seeds=1).command,
                start=start,
            )
        except KeyboardInterrupt:
            _print_saved_steps(item, before)
            raise


def _print_saved_steps(item: Planned, before: int | None) -> None:
    """Print the steps that were saved. before: `_written` when the run began."""
    from neuroflight.training.runs.train import read_record

    if (now := _written(item)) is not None and (now != before or item.done is not None):
        steps = read_record(item.out)["steps"]
        print(
            f"{steps:,} of {item.config.steps:,} steps are kept in {item.out}; the same command with "
            "--resume goes on",
            file=sys.stderr,
        )


def _written(item: Planned) -> int | None:
    """Return when the record of a run was written [ns]; None if there is none."""
    from neuroflight.training.runs.train import RECORD

    path = item.out / RECORD
    return path.stat().st_mtime_ns if path.exists() else None


def _draw(out: Path, aircraft: Aircraft, planned: tuple[Planned, ...], best: int) -> None:
    """Write monitor.png, if there is anything to draw."""
    from neuroflight.sim.plotting import save_png
    from neuroflight.training.checkpoints.monitor import episodes, flown
    from neuroflight.training.checkpoints.monitor_plot import draw_monitored, read_monitor
    from neuroflight.training.runs.train import MONITOR

    runs = [read_monitor(item.out / MONITOR) for item in planned if (item.out / MONITOR).exists()]
    if any(run.history for run in runs):
        config = planned[0].config
        task, count = flown(config).task.name, episodes(config)
        title = f"{aircraft.name}: each checkpoint on {count} {task} episodes, mean and range"
        save_png(out / PLOT, draw_monitored(runs, f"seed {best}", title))


def _print(args: Train, planned: tuple[Planned, ...], ends: dict[int, Progress], best: int) -> None:
    from neuroflight.cli.policy.train_display import figures
    from neuroflight.training.checkpoints.selection import within

    for item in planned:
        seed, end = item.config.seed, ends[item.config.seed]
        name = f"seed {seed}: " if len(planned) > 1 else ""
        if item.finished:
            print(f"{name}was complete: {end.steps:,} steps; nothing was left to train")
        else:
            speed = f" ({end.steps / end.seconds:,.0f} a second)" if end.seconds else ""
            print(f"{name}{end.steps:,} steps in {end.seconds:.0f} s{speed}")
    chosen = ends[best].chosen
    if chosen is not None:
        limits = planned[0].config.selection
        of = f"seed {best} " if len(planned) > 1 else ""
        note = (
            ""
            if within(chosen, limits)
            else (f"; no checkpoint kept the limits of ū, {limits.output:g}, and |Δu|, {limits.change:g}")
        )
        print(f"chosen: {of}at {chosen.steps:,} steps: {figures(chosen)}{note}")
    print(f"{args.out / 'policy.onnx'}, with checkpoint.pt, training.json and {PLOT} beside it")
