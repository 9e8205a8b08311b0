"""Commands of flights, pulses and the like: tasks, named commands and recordings."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.compare.controllers import check_ranges
from neuroflight.cli.compare.suite import Suite
from neuroflight.cli.log.reading import header_lines
from neuroflight.cli.options import OfRecording
from neuroflight.cli.requests import Option

if TYPE_CHECKING:
    from neuroflight.training.evaluation.controllers import Conditions
    from neuroflight.training.tasks.pieces import RecordedPieces
    from neuroflight.training.tasks.task import Task

Number = float | None
TASKS = {  # of suites; the first unless the user says
    "flights": "flight",
    "pilot": "pilot",
    "pulses": "pulse",
    "episodic": "episodic",
    "envelope": "envelope",
    "continuous": "continuous",
}
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


@dataclass(frozen=True, kw_only=True)
class Commanded(OfRecording, Suite):
    """Options that choose the commands."""

    names = tuple(TASKS)

    one: Annotated[bool, Option(None, "one controller alone: a column an axis, JSON without a list")] = False
    plugin: Annotated[
        tuple[Path, ...],
        Option("FILE.py", "run this file of yours first; it registers rewards and tasks", once=True),
    ] = ()
    task: Annotated[
        str | None, Option("NAME", f"as --suite: {', '.join(TASKS.values())}, or a task of a --plugin")
    ] = None
    episodes: Annotated[
        int | None,
        Option("N", "commands; default: 1000, with --one 100, in flights 200 at most, of long episodes 10"),
    ] = None
    named_command: Annotated[
        tuple[float, ...] | None,
        Option(
            ("ROLL", "PITCH", "YAW"),
            "this command [deg/s] instead of random ones; more episodes than one differ in the noise",
            name="--command",
            number=3,
        ),
    ] = None
    limit: Annotated[
        Number,
        Option(
            "DEG_S",
            "greatest command, episodic and continuous; default: 300 and 360",
            name="--max-rate",
            old=("--limit",),
        ),
    ] = None
    length: Annotated[
        Number, Option("S", "of an episode, continuous (10) or flight (60); with --sigma, pilot")
    ] = None
    sigma: Annotated[
        Number, Option("DEG_S", "standard deviation of the pilot's commands; he flies no aerobatics then")
    ] = None
    commands: Annotated[
        Path | None,
        Option("FILE", "fly these recorded commands: a trace (.npz), a table (.csv), a log (FILE:N for N)"),
    ] = None
    piece: Annotated[
        Number, Option("S", f"cut them into episodes of this length; 0: the whole; default: {PIECE_S:g}")
    ] = None

    def commanded(self) -> tuple[Task, int]:
        """Return the commands, and the number of episodes. Raises NeuroflightError."""
        from neuroflight.sim.physics.world import COUNT_MAX
        from neuroflight.toolchain.errors import TrainingError
        from neuroflight.training.plugins import load_plugins, users_own
        from neuroflight.training.tasks.flight import FlightTask, PilotTask
        from neuroflight.training.tasks.task import ContinuousTask

        load_plugins(self.plugin)
        if self.suite is not None:
            said = f"--suite {self.suite} says what is flown; leave one of them out"
            self.refuse("task", "commands", because=said)
        if self.commands is None:
            of_recorded = ("piece", "start", "stop", "header", "cut_rates")
            self.refuse(*of_recorded, because="of recorded commands; give them with --commands")
            task = self._task()
            episodes = self.episodes if self.episodes is not None else self._default_episodes(task)
            check_ranges(("--episodes", episodes, 1, COUNT_MAX))
            if isinstance(task, FlightTask):
                short, flights = task.of_commands(episodes)
                task, episodes = (short if self.length is None else task), flights
            long = isinstance(task, (FlightTask, PilotTask, ContinuousTask)) or users_own(type(task))
            if long and episodes * task.duration_s > LONG_MAX_S:
                raise TrainingError(
                    f"{episodes} episodes of {task.duration_s:g} s, expected at most {LONG_MAX_S:g} s "
                    f"together; ask for fewer with --episodes, or for shorter ones"
                )
            return task, episodes
        of_tasks = ("task", "episodes", "named_command", "limit", "length", "sigma")
        self.refuse(*of_tasks, because=f"the commands are those of {self.commands}; leave it out")
        if self.piece:
            check_ranges(("--piece", self.piece, PIECE_MIN_S, PIECE_MAX_S))
        pieces = self._pieces()
        check_ranges((f"pieces of {self.commands}", pieces.count, 1, COUNT_MAX))
        return pieces, pieces.count

    def _default_episodes(self, task: Task) -> int:
        """Return the number of episodes, or of commands in flights."""
        from neuroflight.training.tasks.flight import FlightTask, PilotTask
        from neuroflight.training.tasks.task import ContinuousTask

        default = 100 if self.one else 1000
        if self.named_command is not None:
            return 1
        if isinstance(task, FlightTask):
            return min(default, FLIGHT_COMMANDS)
        return min(default, LONG_EPISODES) if isinstance(task, (PilotTask, ContinuousTask)) else default

    def _task(self) -> Task:
        """Return the task that is named, with its limit, length or command."""
        from neuroflight.toolchain.contract import RATE_FULL_STICK_DEG_S
        from neuroflight.toolchain.errors import TrainingError
        from neuroflight.training.plugins import users_own
        from neuroflight.training.tasks.flight import FlightTask, PilotTask
        from neuroflight.training.tasks.named_command import NamedCommand
        from neuroflight.training.tasks.registry import TASKS as BUILDERS
        from neuroflight.training.tasks.task import ContinuousTask, EpisodicTask, PulseTask, RandomCommands

        full = float(RATE_FULL_STICK_DEG_S)
        said = self.task if self.suite is None else TASKS[self.suite]
        name = said or (FlightTask.name if self.named_command is None else PulseTask.name)
        known = [*TASKS.values(), *(each for each, kind in BUILDERS.items() if users_own(kind))]
        if name not in known:
            raise TrainingError(
                f"--task {name}, expected one of: {', '.join(known)}; one of a file of yours needs its "
                f"--plugin FILE.py"
            )
        task = BUILDERS[name]()
        if self.sigma is not None:
            if not isinstance(task, PilotTask):
                raise TrainingError(f"--sigma: of the pilot task, got {task.name}; leave it out")
            check_ranges(("--sigma", self.sigma, 0.1, full))
            task = replace(task, sigma_deg_s=self.sigma)
        if self.length is not None:
            if isinstance(task, FlightTask):
                check_ranges(("--length", self.length, FLIGHT_MIN_S, LENGTH_MAX_S))
                task = task.of_length(self.length)
            elif isinstance(task, ContinuousTask) or (isinstance(task, PilotTask) and task.sigma_deg_s):
                check_ranges(("--length", self.length, LENGTH_MIN_S, LENGTH_MAX_S))
                task = replace(task, length_s=self.length)
            else:
                raise TrainingError(
                    f"--length: of the flight and the continuous task, or the pilot's with --sigma, got "
                    f"{task.name}; leave it out"
                )
        if self.limit is not None:
            if not isinstance(task, RandomCommands) or task.distribution != "uniform":
                raise TrainingError(
                    f"--max-rate: of the episodic and the continuous task, got {task.name}; leave it out"
                )
            if self.named_command is not None:
                raise TrainingError("--max-rate: of random commands; --command names one; leave it out")
            check_ranges(("--max-rate", self.limit, 1.0, full))
            task = replace(task, limit_deg_s=self.limit)
        if self.named_command is None:
            return task
        if not isinstance(task, (PulseTask, EpisodicTask)):
            raise TrainingError(
                f"--command: holds in the pulse, episodic and envelope task, got {task.name}; choose one of "
                "them"
            )
        roll, pitch, yaw = self.named_command
        check_ranges(*(("--command", value, -full, full) for value in (roll, pitch, yaw)))
        if not any(self.named_command):
            raise TrainingError("--command 0 0 0, expected a rate other than 0 on some axis")
        return NamedCommand(task, (roll, pitch, yaw))

    def _pieces(self) -> RecordedPieces:
        """Read the recorded commands; what they lose is told on stderr."""
        from neuroflight.sim.recorded.files import load_commands
        from neuroflight.training.tasks.pieces import RecordedPieces

        assert self.commands is not None
        recorded = load_commands(self.commands, self.part, header_lines(self), cut=self.cut_rates)
        for words in recorded.warnings():
            print(words, file=sys.stderr)
        piece_s = PIECE_S if self.piece is None else self.piece
        return RecordedPieces.cut(recorded.scenario(), piece_s or None)


def flown_words(flown: Conditions) -> str:
    """Return the task in words, for titles."""
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
    """Return the number of commands, one by one or in flights: the unit of --episodes."""
    from neuroflight.training.tasks.flight import FlightTask

    return flown.episodes * (flown.task.pulses if isinstance(flown.task, FlightTask) else 1)


def default_throttle(flown: Conditions) -> float | None:
    """Return the default of the pilot's thrust: about a hover in flights; None: as recorded."""
    from neuroflight.training.tasks.flight import HOVER_THROTTLE, course_of
    from neuroflight.training.tasks.pieces import RecordedPieces

    if isinstance(flown.task, RecordedPieces):
        return None
    return HOVER_THROTTLE if course_of(flown.task) else 0.0


def flight_note(flown: Conditions) -> str:
    """Return a note below a table that explains the figures of flights; empty for other tasks."""
    from neuroflight.training.tasks.flight import course_of

    return FLIGHT_NOTE if course_of(flown.task) else ""


def task_name(task: Task) -> str:
    """Return the name of the task in --task, with a named command too."""
    from neuroflight.training.tasks.named_command import NamedCommand

    return task.task.name if isinstance(task, NamedCommand) else task.name


def drawn_as_flown(flown: Conditions) -> bool:
    """Return True if a plot shows the first episode as it was flown, not all of them on one scale."""
    from neuroflight.training.tasks.flight import PilotTask
    from neuroflight.training.tasks.named_command import NamedCommand
    from neuroflight.training.tasks.task import ContinuousTask

    return isinstance(flown.task, (NamedCommand, ContinuousTask, PilotTask))


def task_document(flown: Conditions) -> dict[str, Any]:
    """Return the task as JSON data."""
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
