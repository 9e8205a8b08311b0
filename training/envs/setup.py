"""The set-up of an environment: an aircraft and a configuration, from the arguments that a user gives."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from neuroflight.sim.aircraft.model import Aircraft, load_aircraft
from neuroflight.toolchain.contract import Mix
from neuroflight.training.config.algorithms import PpoConfig
from neuroflight.training.config.config_file import load_config
from neuroflight.training.config.config_table import ConfigReader, nearest
from neuroflight.training.config.pathwise_config import PathwiseConfig
from neuroflight.training.config.training_config import TrainingConfig, WorldConfig
from neuroflight.training.tasks.reward import TrackingReward

RECIPE = "gymnasium"  # what `config` is unless given
REWARD_SCALE = 0.01  # 1 - the discount of 0.99 that learners begin with: a value is then a mean reward
REWARD_SCALES = (1e-9, 1e9)
KEYS = (  # of a configuration, that are arguments as well; its other keys are the learner's
    *("task", "reward", "world", "output", "observation"),
    *("control_rate_hz", "idle", "mix", "gyro_filter"),
)
WORLD_KEYS = tuple(field.name for field in fields(WorldConfig))
ARGUMENTS = ("aircraft", "config", "reward_scale", *KEYS, *WORLD_KEYS)
READER = ConfigReader("environment", {})


@dataclass(frozen=True)
class Setup:
    """The aircraft, configuration and scale of rewards."""

    aircraft: Aircraft
    config: TrainingConfig
    reward_scale: float = 1.0


def make_setup(
    count: int,
    aircraft: str | Path | Aircraft = "nf1",
    config: str | Path | TrainingConfig | None = None,
    reward_scale: float = REWARD_SCALE,
    **arguments: Any,  # noqa: ANN401 - read by the types of the configuration
) -> Setup:
    """Read the arguments of an environment of `count` aircraft.

    aircraft: shipped name, file or object. config: a recipe's name, a file, a training.json among them, or
    an object. The others are keys of a configuration (`KEYS`) or of its table `world` (`WORLD_KEYS`) and
    replace what `config` has; a task or reward is a name, a table or an object. None leaves a key as it is.
    Raises AircraftError or TrainingError, one line, on invalid ones.
    """
    if isinstance(count, bool) or not isinstance(count, int):
        raise READER.error("num_envs", f"got {count!r}, expected a whole number of aircraft")
    if isinstance(reward_scale, bool) or not isinstance(reward_scale, int | float):
        raise READER.error("reward_scale", f"got {reward_scale!r}, expected a number")
    low, high = REWARD_SCALES
    if not low <= reward_scale <= high:
        raise READER.error("reward_scale", f"got {reward_scale}, expected {low:g} to {high:g}")
    given = {name: value for name, value in arguments.items() if value is not None}
    for name in given:
        if name not in ARGUMENTS:
            raise READER.error(name, f"unknown argument; {nearest(name, ARGUMENTS)}")
    base = _base(config)
    of_world = {
        name: READER.field(WorldConfig, name, given.pop(name)) for name in WORLD_KEYS if name in given
    }
    changes: dict[str, Any] = {name: READER.field(TrainingConfig, name, given[name]) for name in given}
    world = replace(changes.pop("world", base.world), **of_world)
    # The learner is not ours: of its values only the number of aircraft matters, which has limits.
    none = PpoConfig(aircraft=count, horizon=1, minibatch=1)
    whole = replace(base, algorithm=none, recurrent="none", world=world, **changes)
    setup = Setup(_aircraft(aircraft), whole, float(reward_scale))
    whole.check(setup.aircraft)
    return setup


def _base(config: object) -> TrainingConfig:
    """Return the configuration that the arguments change."""
    if isinstance(config, TrainingConfig):
        base = config
    elif config is None or isinstance(config, str | Path):
        base = load_config(RECIPE if config is None else config)
    else:
        raise READER.error(
            "config", f"got a {type(config).__name__}, expected a recipe's name, a file or a TrainingConfig"
        )
    if not isinstance(base.algorithm, PathwiseConfig):
        return base
    # The pathwise gradient has a loss and no reward. Outputs of the centred mix have no thrust to be low.
    centred = base.mixing is Mix.CENTRED
    return replace(base, reward=TrackingReward(output=0.0) if centred else TrackingReward())


def _aircraft(aircraft: object) -> Aircraft:
    if isinstance(aircraft, Aircraft):
        return aircraft
    if not isinstance(aircraft, str | Path):
        raise READER.error(
            "aircraft", f"got a {type(aircraft).__name__}, expected a shipped name or a file's path"
        )
    return load_aircraft(aircraft)
