"""What `evaluate` and `compare` command: the arguments of tasks, named commands and recordings, as a task."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.cli.logs.reading import add_recording_arguments, header_lines, part
from neuroflight.cli.training.evaluation.ranges import check_ranges
from neuroflight.cli.training.plugins import add_plugin_argument, load_named

if TYPE_CHECKING:
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.tasks.pieces import RecordedPieces
    from neuroflight.training.tasks.task import Task

TASKS = ("flight", "pilot", "pulse", "episodic", "envelope", "continuous")  # the first unless the user says
FLIGHT_COMMANDS = 200  # at most, unless the user says: 20 flights
LONG_EPISODES = 10  # unless the user says: each holds many commands
LONG_MAX_S = 10_000.0  # of all such episodes together; all are kept in memory, a gigabyte for this long
LENGTH_MIN_S, LENGTH_MAX_S = 0.1, 600.0
FLIGHT_MIN_S = 20.0
PIECE_S = 5.0  # of recorded commands, unless the user says
PIECE_MIN_S, PIECE_MAX_S = 0.1, 3600.0
FLIGHT_NOTE = (
    " Of flights, figures are of the commands before the hover, and ± is that of flights, as commands of one "
    "depend on each other. Rest: |rate| in deg/s with the sticks centred for half a second, in the first and "
    "in the last fifth of these. Hover and drift: |rate| in its last 10 s, and what the aircraft turned in "
    "them."
)


def add_task_arguments(parser: argparse.ArgumentParser, episodes: int) -> None:
    """The arguments; `episodes` is the default number of random commands."""
    parser.add_argument(
        "--task",
        metavar="NAME",
        help=f"what is commanded: {', '.join(TASKS)}, or a task of a --plugin; default: flight, ten "
        "commands one after another and a hover, a minute in all; pilot: a pilot's minute, and a hover; with "
        "--command: pulse",
    )
    add_plugin_argument(parser)
    parser.add_argument(
        "--episodes",
        type=int,
        metavar="N",
        help=f"commands; one aircraft each, or for ten in a flight; default: {episodes}, in flights "
        f"{min(episodes, FLIGHT_COMMANDS)}; a pilot's minutes or continuous episodes, {LONG_EPISODES}",
    )
    parser.set_defaults(episodes_default=episodes)
    parser.add_argument(
        "--command",
        dest="named_command",  # `command` is the subcommand's name
        type=float,
        nargs=3,
        metavar=("ROLL", "PITCH", "YAW"),
        help="this command [deg/s] instead of random ones, in the pulse, episodic or envelope task; "
        "--plot draws its step responses. Default: one episode; more differ in the noise",
    )
    parser.add_argument(
        "--limit",
        type=float,
        metavar="DEG_S",
        help="greatest command of the episodic and the continuous task; default: 300 and 360",
    )
    parser.add_argument(
        "--length",
        type=float,
        metavar="SECONDS",
        help="of an episode of the continuous task, 10, or of a flight, 60: ten commands, then a hover; with "
        "--sigma before the hover",
    )
    parser.add_argument(
        "--sigma",
        type=float,
        metavar="DEG_S",
        help="standard deviation of the commands of the pilot task, who then flies no aerobatics",
    )
    parser.add_argument(
        "--commands",
        type=Path,
        metavar="FILE",
        help="fly these recorded commands instead: a trace (.npz), a table (.csv), a blackbox log (.bbl, "
        ".bfl, .txt; FILE:N for its log N)",
    )
    add_recording_arguments(parser)
    parser.add_argument(
        "--piece",
        type=float,
        metavar="SECONDS",
        help=f"cut them into episodes of at least this length, one aircraft each; 0: one, the whole; "
        f"default: {PIECE_S:g}",
    )


def task_of(args: argparse.Namespace) -> tuple[Task, int]:
    """What is commanded, and its number of episodes."""
    from neuroflight.sim.physics.world import COUNT_MAX
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.plugins import users_own
    from neuroflight.training.tasks.flight import FlightTask, PilotTask
    from neuroflight.training.tasks.task import ContinuousTask

    load_named(args)
    if args.commands is None:
        if args.piece is not None:
            raise TrainingError("--piece: cuts recorded commands; give them with --commands")
        if args.header or args.start or args.stop is not None or args.cut_rates:
            raise TrainingError(
                "--from, --to, --header, --cut-rates: of recorded commands; give them with --commands"
            )
        task = _commanded(args)
        episodes = args.episodes if args.episodes is not None else _default_episodes(args, task)
        check_ranges(("--episodes", episodes, 1, COUNT_MAX))
        if isinstance(task, FlightTask):
            short, flights = task.of_commands(episodes)
            task, episodes = (short if args.length is None else task), flights
        long = isinstance(task, (FlightTask, PilotTask, ContinuousTask)) or users_own(type(task))
        if long and episodes * task.duration_s > LONG_MAX_S:
            raise TrainingError(
                f"{episodes} episodes of {task.duration_s:g} s, expected at most {LONG_MAX_S:g} s "
                f"together; ask for fewer with --episodes, or for shorter ones"
            )
        return task, episodes
    for option in ("task", "episodes", "named_command", "limit", "length", "sigma"):
        if getattr(args, option) is not None:
            word = "command" if option == "named_command" else option
            raise TrainingError(f"--{word}: the commands are those of {args.commands}; leave it out")
    if args.piece:
        check_ranges(("--piece", args.piece, PIECE_MIN_S, PIECE_MAX_S))
    pieces = _pieces(args)
    check_ranges((f"pieces of {args.commands}", pieces.count, 1, COUNT_MAX))
    return pieces, pieces.count


def _default_episodes(args: argparse.Namespace, task: Task) -> int:
    """The number of episodes, or of commands in flights."""
    from neuroflight.training.tasks.flight import FlightTask, PilotTask
    from neuroflight.training.tasks.task import ContinuousTask

    default: int = args.episodes_default
    if args.named_command is not None:
        return 1
    if isinstance(task, FlightTask):
        return min(default, FLIGHT_COMMANDS)
    return min(default, LONG_EPISODES) if isinstance(task, (PilotTask, ContinuousTask)) else default


def _commanded(args: argparse.Namespace) -> Task:
    """The task of the arguments, with their limit, length or command."""
    from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
    from neuroflight.toolchain.errors import TrainingError
    from neuroflight.training.plugins import users_own
    from neuroflight.training.tasks.flight import FlightTask, PilotTask
    from neuroflight.training.tasks.named_command import NamedCommand
    from neuroflight.training.tasks.registry import TASKS as BUILDERS
    from neuroflight.training.tasks.task import ContinuousTask, EpisodicTask, PulseTask, RandomCommands

    full = float(RATE_FULL_STICK_DEG_S)
    name = args.task or (TASKS[0] if args.named_command is None else PulseTask.name)
    known = [*TASKS, *(each for each, kind in BUILDERS.items() if users_own(kind))]
    if name not in known:
        raise TrainingError(
            f"--task {name}, expected one of: {', '.join(known)}; one of a file of yours needs its "
            f"--plugin FILE.py"
        )
    task = BUILDERS[name]()
    if args.sigma is not None:
        if not isinstance(task, PilotTask):
            raise TrainingError(f"--sigma: of the pilot task, got {task.name}; leave it out")
        check_ranges(("--sigma", args.sigma, 0.1, full))
        task = replace(task, sigma_deg_s=args.sigma)
    if args.length is not None:
        if isinstance(task, FlightTask):
            check_ranges(("--length", args.length, FLIGHT_MIN_S, LENGTH_MAX_S))
            task = task.of_length(args.length)
        elif isinstance(task, ContinuousTask) or (isinstance(task, PilotTask) and task.sigma_deg_s):
            check_ranges(("--length", args.length, LENGTH_MIN_S, LENGTH_MAX_S))
            task = replace(task, length_s=args.length)
        else:
            raise TrainingError(
                f"--length: of the flight and the continuous task, or the pilot's with --sigma, got "
                f"{task.name}; leave it out"
            )
    if args.limit is not None:
        if not isinstance(task, RandomCommands) or task.distribution != "uniform":
            raise TrainingError(
                f"--limit: of the episodic and the continuous task, got {task.name}; leave it out"
            )
        if args.named_command is not None:
            raise TrainingError("--limit: of random commands; --command names one; leave it out")
        check_ranges(("--limit", args.limit, 1.0, full))
        task = replace(task, limit_deg_s=args.limit)
    if args.named_command is None:
        return task
    if not isinstance(task, (PulseTask, EpisodicTask)):
        raise TrainingError(
            f"--command: holds in the pulse, episodic and envelope task, got {task.name}; choose one of them"
        )
    roll, pitch, yaw = args.named_command
    check_ranges(*(("--command", value, -full, full) for value in (roll, pitch, yaw)))
    if not any(args.named_command):
        raise TrainingError("--command 0 0 0, expected a rate other than 0 on some axis")
    return NamedCommand(task, (roll, pitch, yaw))


def _pieces(args: argparse.Namespace) -> RecordedPieces:
    """The recorded commands of the arguments; says on stderr what they lose."""
    from neuroflight.sim.recorded.files import load_commands
    from neuroflight.training.tasks.pieces import RecordedPieces

    recorded = load_commands(args.commands, part(args), header_lines(args), cut=args.cut_rates)
    for words in recorded.warnings():
        print(words, file=sys.stderr)
    piece_s = PIECE_S if args.piece is None else args.piece
    return RecordedPieces.cut(recorded.scenario(), piece_s or None)


def flown_words(flown: Conditions) -> str:
    """What is flown, for titles."""
    from neuroflight.training.tasks.flight import FlightTask, PilotTask
    from neuroflight.training.tasks.named_command import NamedCommand
    from neuroflight.training.tasks.pieces import RecordedPieces
    from neuroflight.training.tasks.task import ContinuousTask

    task = flown.task
    if isinstance(task, RecordedPieces):
        cut = f"{flown.episodes} pieces of {task.duration_s:g} s of " if flown.episodes > 1 else ""
        return f"{cut}the recording {task.scenario.name}, seed {flown.seed}"
    if isinstance(task, NamedCommand):
        rates = ", ".join(f"{rate:g}" for rate in task.command_deg_s)
        times = f", {flown.episodes} times" if flown.episodes > 1 else ""
        return f"{task.task.name} command of ({rates}) deg/s{times}, seed {flown.seed}"
    if isinstance(task, FlightTask):
        flights = f"{flown.episodes} flights" if flown.episodes > 1 else "a flight"
        commands = f"{task.pulses} commands" if task.pulses > 1 else "a command"
        return f"{flights} of {commands} and a hover, {task.duration_s:g} s, seed {flown.seed}"
    if isinstance(task, PilotTask):
        flights = f"{flown.episodes} flights" if flown.episodes > 1 else "a flight"
        what = f"a pilot's commands of {task.sigma_deg_s:g} deg/s" if task.sigma_deg_s else "a pilot's minute"
        return f"{flights} of {what} and a hover, {task.duration_s:g} s, seed {flown.seed}"
    if isinstance(task, ContinuousTask):
        episodes = f"{flown.episodes} episodes" if flown.episodes > 1 else "an episode"
        return f"{episodes} of {task.name}, {task.length_s:g} s, seed {flown.seed}"
    return f"{flown.episodes} commands of {task.name}, seed {flown.seed}"


def commands_flown(flown: Conditions) -> int:
    """How many commands, one by one or in flights: what --episodes asks for."""
    from neuroflight.training.tasks.flight import FlightTask

    return flown.episodes * (flown.task.pulses if isinstance(flown.task, FlightTask) else 1)


def default_throttle(flown: Conditions) -> float | None:
    """The pilot's thrust where he does not say: about a hover in flights; None: as recorded."""
    from neuroflight.training.tasks.flight import HOVER_THROTTLE, course_of
    from neuroflight.training.tasks.pieces import RecordedPieces

    if isinstance(flown.task, RecordedPieces):
        return None
    return HOVER_THROTTLE if course_of(flown.task) else 0.0


def flight_note(flown: Conditions) -> str:
    """What the figures of flights are, to stand below a table; nothing for other tasks."""
    from neuroflight.training.tasks.flight import course_of

    return FLIGHT_NOTE if course_of(flown.task) else ""


def task_name(task: Task) -> str:
    """What --task calls it, with a named command too."""
    from neuroflight.training.tasks.named_command import NamedCommand

    return task.task.name if isinstance(task, NamedCommand) else task.name


def drawn_as_flown(flown: Conditions) -> bool:
    """Whether a plot shows the first episode as it was flown, rather than all of them on one scale."""
    from neuroflight.training.tasks.flight import PilotTask
    from neuroflight.training.tasks.named_command import NamedCommand
    from neuroflight.training.tasks.task import ContinuousTask

    return isinstance(flown.task, (NamedCommand, ContinuousTask, PilotTask))


def task_document(flown: Conditions) -> dict[str, Any]:
    """What is commanded, as JSON data."""
    from neuroflight.training.tasks.flight import FlightTask
    from neuroflight.training.tasks.named_command import NamedCommand
    from neuroflight.training.tasks.task import ContinuousTask

    task, found = flown.task, {"task": task_name(flown.task)}
    if isinstance(task, NamedCommand):
        return {**found, "command_deg_s": list(task.command_deg_s)}
    if isinstance(task, FlightTask):
        return {**found, "length_s": task.duration_s, "commands_per_flight": task.pulses}
    if isinstance(task, ContinuousTask):
        return {**found, "length_s": task.length_s, "limit_deg_s": task.limit_deg_s}
    return found
