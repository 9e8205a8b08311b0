"""One run of a sweep: train, fly the validation's commands, count instructions and cycles on the board.

A worker does this. All its files are in the run's folder; an interrupted run resumes from its checkpoint.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import mean_of
from neuroflight.sim.arrays import Array
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ
from neuroflight.toolchain.cortex_m7.timing import mixed_observations, time_policy
from neuroflight.toolchain.errors import BuildError, TrainingError
from neuroflight.toolchain.files import read_limited, write_text
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.training.checkpoints.monitor_process import Monitor
from neuroflight.training.evaluation.comparison import values
from neuroflight.training.evaluation.controllers import Conditions, ControllerSpec, load_controller
from neuroflight.training.evaluation.equal_thrust import equal_thrust
from neuroflight.training.evaluation.evaluation import scores
from neuroflight.training.runs.train import CHECKPOINT, POLICY, Callback, read_record, train
from neuroflight.training.sweeps.config import Trial, Validation
from neuroflight.training.tasks.flight import FlightTask
from neuroflight.training.tasks.registry import TASKS

RESULT = "result.json"
RESULT_BYTES_MAX = 1 << 20
CLOSED = 0.0  # the thrust that stands for a closed throttle
AT_THRUST = ("mae", "mse", "change", "power", "current", "drift")
FIGURES = ("mae", "mse", "output", "change")
TIMED_OBSERVATIONS = 30  # generated code has no branches that depend on them; every third one is extreme


@dataclass(frozen=True)
class Figure:
    """A mean and the half width of its 95 % confidence interval."""

    mean: float
    margin: float

    @staticmethod
    def of(values: ArrayLike) -> Figure:
        """Compute the mean of (N,) values."""
        mean = mean_of(np.asarray(values, np.float64))
        return Figure(float(mean.value), float(mean.high - mean.value))


@dataclass(frozen=True)
class AtThrust:
    """The figures at one throttle."""

    asked: float | None  # thrust at rest, times the weight; None: with the throttle closed
    throttle: float
    thrust: float  # what it gives at rest: more than asked for where the controller cannot less
    mae: Figure  # [deg/s]
    mse: Figure
    change: Figure  # |Δ| of a motor fraction in 1 ms
    power: Figure | None = None  # [W], electric, motors and electronics; None: of an older sweep
    current: Figure | None = None  # [A]; None also on a supply of unknown voltage
    drift: Figure | None = None  # [deg], as in Outcome


@dataclass(frozen=True)
class Outcome:
    """The result of a run; errors are against the true rate, means over axes and commands.

    Output and its change are those of the controller, before the throttle mix. Where the validation asks for
    thrusts the change is that of the motors, and all four are means over these thrusts.
    """

    mae: Figure  # [deg/s]
    mse: Figure  # [(deg/s)²]
    output: Figure  # ū, fraction
    change: Figure  # |Δu| in 1 ms, fraction
    thrusts: tuple[AtThrust, ...]  # the closed throttle first; empty unless asked for
    instructions: int | None  # of policy_step on the board, at most
    predicted_cycles: float | None  # likewise
    no_cycles_reason: str | None  # why one of the two is unknown
    weights: int  # in the board's table, those of the activations' curves included
    training_seconds: float
    steps: int  # control steps trained
    policy_sha256: str
    # [deg] in 10 s of centred sticks, at the worst of the thrusts; None where no flights were flown.
    drift: Figure | None = None


def run_trial(
    trial: Trial, aircraft: Aircraft, validation: Validation, folder: Path, callback: Callback
) -> Outcome:
    """Do the run in `folder`, or the rest of it, and write its result.json."""
    document = trial.config.document(aircraft)
    if not _trained(folder, document):
        kept = (folder / CHECKPOINT).exists()
        train(aircraft, trial.config, folder, callback, resume=kept, monitor=Monitor(aircraft, trial.config))
    policy = folder / POLICY
    trained = read_record(folder)
    outcome = Outcome(
        **_flown(policy, aircraft, validation),
        **_counted(policy),
        training_seconds=float(trained["seconds"]),
        steps=int(trained["steps"]),
        policy_sha256=hashlib.sha256(policy.read_bytes()).hexdigest(),
    )
    result = {
        "varied": trial.varied,
        "validation": asdict(validation),
        "config": document,
        "outcome": asdict(outcome),
    }
    write_text(folder / RESULT, json.dumps(result, indent=2) + "\n")
    return outcome


def read_outcome(folder: Path, trial: Trial, aircraft: Aircraft, validation: Validation) -> Outcome | None:
    """Read the outcome of a finished run, None if it is not finished.

    Raises TrainingError if the result is damaged or of another run.
    """
    path = folder / RESULT
    if not path.is_file():
        return None
    data = read_limited(path, str(path), RESULT_BYTES_MAX, TrainingError)
    try:
        document = json.loads(data)
        outcome = _outcome(document["outcome"])
        wanted = {"config": trial.config.document(aircraft), "validation": asdict(validation)}
        same = all(document[key] == json.loads(json.dumps(value)) for key, value in wanted.items())
    except (ValueError, KeyError, TypeError) as error:
        raise TrainingError(f"{path} is damaged ({error!r}); remove its folder to train it again") from error
    if not same:
        raise TrainingError(
            f"{path} is of another run than the sweep now asks for; restore the sweep file and its recipe, "
            f"or start the sweep in another folder"
        )
    return outcome


def _outcome(values: Mapping[str, Any]) -> Outcome:
    thrusts = tuple(
        AtThrust(**{**each, **{name: Figure(**each[name]) for name in AT_THRUST if each.get(name)}})
        for each in values["thrusts"]
    )
    figures = {name: Figure(**values[name]) for name in (*FIGURES, "drift") if values.get(name)}
    return Outcome(**{**values, **figures, "thrusts": thrusts})


def _trained(folder: Path, document: dict[str, Any]) -> bool:
    """Return True if the record says that this configuration is fully trained."""
    try:
        record = read_record(folder)
        return bool(record["complete"]) and record["config"] == json.loads(json.dumps(document))
    except (TrainingError, KeyError):
        return False


def _flown(path: Path, aircraft: Aircraft, validation: Validation) -> dict[str, Any]:
    """Fly the validation's commands; return the policy's figures by their names in Outcome."""
    controller = load_controller(str(path), aircraft)
    task, episodes = TASKS[validation.task](), validation.episodes
    if isinstance(task, FlightTask):
        task, episodes = task.of_commands(episodes)
    conditions = Conditions(aircraft, task, episodes, validation.seed)
    if validation.thrust:
        return _at_thrusts(controller, conditions, validation.thrust)
    own = values(scores(conditions.fly(controller, validation.throttle)))
    figures = {name: Figure.of(own[name].reshape(episodes, -1).mean(axis=1)) for name in FIGURES}
    return {**figures, "drift": _drift(own), "thrusts": ()}


def _drift(own: Mapping[str, Array]) -> Figure | None:
    """Return the size of the drift in the hover, mean of the axes [deg]; None without a hover."""
    return Figure.of(own["drift"].mean(axis=1)) if "drift" in own else None


def _at_thrusts(
    controller: ControllerSpec, conditions: Conditions, thrusts: Sequence[float]
) -> dict[str, Any]:
    """Fly at equal thrust, with gyros as fast as the board's; return figures as in Outcome."""
    fast = replace(conditions, gyro_rate_hz=GYRO_RATE_DEFAULT_HZ)
    flown = equal_thrust((controller,), fast, (CLOSED, *thrusts), lambda _: lambda done, total: None)
    found: list[AtThrust] = []
    each: dict[str, list[Array]] = {name: [] for name in FIGURES}
    for level in flown.levels:
        (entry,), (trim,) = level.entries, level.trims
        own = values(entry.scores)
        figures = {
            "mae": own["mae"].mean(axis=1),
            "mse": own["mse"].mean(axis=1),
            "change": own["motor_change"],
        }
        drawn = {"power": entry.scores.power, "current": entry.scores.current}
        means = {
            name: Figure.of(by_command)
            for name, by_command in {**figures, **drawn}.items()
            if by_command is not None and np.isfinite(by_command).all()
        }
        drift = _drift(own)
        asked = None if level.wanted == CLOSED else level.wanted
        found.append(AtThrust(asked, trim.rest.throttle, float(trim.rest.thrust.value), drift=drift, **means))
        if asked is not None:
            for name, by_command in {**figures, "output": own["output"]}.items():
                each[name].append(by_command)
    drifts = [level.drift for level in found if level.asked is not None and level.drift is not None]
    worst = max(drifts, key=lambda drift: drift.mean) if drifts else None
    means = {name: Figure.of(np.mean(rows, axis=0)) for name, rows in each.items()}
    return {**means, "drift": worst, "thrusts": tuple(found)}


def _counted(path: Path) -> dict[str, Any]:
    """Count greatest instructions and cycles of a step, and weights, by their names in Outcome."""
    compiled = compile_policy(read_policy(path))
    observations = mixed_observations(TIMED_OBSERVATIONS, compiled.network.inputs)
    found: dict[str, Any] = {
        "instructions": None,
        "predicted_cycles": None,
        "weights": int(compiled.plan.table.size),
    }
    try:
        with tempfile.TemporaryDirectory(prefix="neuroflight-") as folder:
            cost = time_policy(compiled, Path(folder), observations).cost
    except BuildError as error:
        return {**found, "no_cycles_reason": str(error)}
    return {
        **found,
        "instructions": cost.instructions[1],
        "predicted_cycles": cost.cycles[1] if cost.cycles else None,
        "no_cycles_reason": cost.no_cycles_reason,
    }
