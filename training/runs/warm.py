"""A warm start: a run that begins with the policy of another one, on another aircraft, and with its network.

The policy that comes of it is of the same architecture, so a board takes it into a policy slot.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.toolchain.contract import CHECKPOINT_FILE_BYTES_MAX
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.training.config.config_file import load_config
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.learners.pathwise.learner import PathwiseLearner
from neuroflight.training.runs.checkpoint import Learned, load_learned
from neuroflight.training.runs.train import CHECKPOINT, POLICY, RECORD, Start, read_record

SHIPPED = Path(__file__).parents[1] / "policies"
FILE, KNOWN = "file", "nf1"  # a world of one aircraft; the recipe of an aircraft that is known
STEPS = 20_000_000  # a minute on two cores
# Of a general policy: it gains in the first ones, and with more its memory winds up on the ground.
GENERAL_STEPS = 2_000_000
LEARNING_RATE = 5e-4  # a tenth of a fresh run's: the policy flies already
WARM_UP = 20
PROBED = 10  # batches that tell how much the policy moves the motors of its new aircraft
PROBE_SEED = 7


def find_source(name: str) -> Path:
    """Return the folder of the run that is named, its files, or by the name of a shipped policy.

    Raises TrainingError if it holds no checkpoint.
    """
    path = Path(name)
    if path.name in (CHECKPOINT, POLICY):
        path = path.parent
    for folder in (path, SHIPPED / name):
        if (folder / CHECKPOINT).is_file():
            return folder
    shipped = ", ".join(sorted(each.parent.name for each in SHIPPED.glob(f"*/{CHECKPOINT}")))
    raise TrainingError(
        f"--from {name}: no {CHECKPOINT} there; give the folder of a run, or one of the shipped policies: "
        f"{shipped}"
    )


def load_start(name: str) -> Start:
    """Load what a run begins with; name: see `find_source`. Raises TrainingError."""
    folder = find_source(name)
    path = folder / CHECKPOINT
    data = read_limited(path, str(path), CHECKPOINT_FILE_BYTES_MAX, TrainingError)
    aircraft = read_record(folder)["config"]["aircraft"]
    return Start(
        learned=load_learned(path),
        folder=folder,
        name=name,
        sha256=hashlib.sha256(data).hexdigest(),
        aircraft=str(aircraft["name"]),
        aircraft_sha256=str(aircraft["sha256"]),
    )


def warm_config(start: Start, aircraft: Aircraft, overrides: Sequence[str] = ()) -> TrainingConfig:
    """Return the configuration that refines the policy on `aircraft`: its own run's, in shorter steps.

    A policy may stay below the limit of the motors' change that it was trained with, and would use what is
    left of it. So the limit is what it makes on the new aircraft, if that is less. overrides: "key=value".
    Raises TrainingError for a run of another learner.
    """
    config = load_config(start.folder / RECORD, overrides)
    general = config.world.aircraft != FILE
    if general:
        config = _of_one_aircraft(config)
    algorithm = config.algorithm
    if not isinstance(algorithm, PathwiseConfig):
        raise TrainingError(
            f"--from {start.name}: trained with {algorithm.name}, expected pathwise: only that learner "
            "goes on from another run"
        )
    given = {each.partition("=")[0].strip() for each in overrides}
    if "steps" not in given:
        config = replace(config, steps=GENERAL_STEPS if general else STEPS)
    if "algorithm.learning_rate" not in given:
        algorithm = replace(algorithm, learning_rate=LEARNING_RATE)
    if "algorithm.warm_up" not in given:
        algorithm = replace(algorithm, warm_up=WARM_UP)
    config = replace(config, algorithm=algorithm, start=start.sha256)
    if algorithm.change_limit is not None and "algorithm.change_limit" not in given:
        limit = min(algorithm.change_limit, _change(aircraft, config, start.learned))
        config = replace(config, algorithm=replace(algorithm, change_limit=limit))
    return config


def _of_one_aircraft(config: TrainingConfig) -> TrainingConfig:
    """Return the configuration of a general policy for the aircraft of a file, drawn as KNOWN's runs draw."""
    known = load_config(KNOWN)
    world = replace(config.world, aircraft=FILE, randomization=known.world.randomization)
    return replace(config, world=world, selection=known.selection)


def _change(aircraft: Aircraft, config: TrainingConfig, learned: Learned) -> float:
    """Measure the mean change of outputs or motors by the learned policy in flights of the training."""
    assert isinstance(config.algorithm, PathwiseConfig)
    learner = PathwiseLearner(aircraft, config, config.algorithm)
    try:
        learner.start_from(learned.policy, learned.learner)
        rng = np.random.default_rng(PROBE_SEED)
        changes = [learner.flown(rng).change for _ in range(PROBED)]
    finally:
        learner.close()
    return float(f"{np.mean(changes):.3g}")  # the same on every machine
