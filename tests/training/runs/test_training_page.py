"""docs/training.md names every key of a configuration."""

import dataclasses
import re
import tomllib
from pathlib import Path

import pytest

from neuroflight.training.config.algorithms import DdpgConfig, PpoConfig, SacConfig, Td3Config, TrpoConfig
from neuroflight.training.config.config_file import load_config
from neuroflight.training.config.randomization import Randomization
from neuroflight.training.config.training_config import OutputMap, TrainingConfig, WorldConfig
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import (
    REWARDS,
    CalmReward,
    NormalizedReward,
    ProgressReward,
    TrackingReward,
)
from neuroflight.training.tasks.task import ContinuousTask, EnvelopeTask, EpisodicTask, PulseTask

PAGE = (Path(__file__).parents[3] / "docs" / "training.md").read_text()
KINDS = (
    *(TrainingConfig, OutputMap, WorldConfig, Randomization),
    *(PulseTask, EpisodicTask, EnvelopeTask, ContinuousTask),
    *(TrackingReward, NormalizedReward, CalmReward, ProgressReward),
    *(PpoConfig, TrpoConfig, DdpgConfig, Td3Config, SacConfig),
)


@pytest.mark.parametrize("kind", KINDS)
def test_the_page_names_every_field(kind: type) -> None:
    for field in dataclasses.fields(kind):
        assert re.search(rf"\b{field.name}\b", PAGE), field.name


@pytest.mark.parametrize("name", [*TASKS, *REWARDS])
def test_the_page_has_a_row_for_every_task_and_reward(name: str) -> None:
    assert f"\n| `{name}` |" in PAGE


def test_the_pages_example_is_a_configuration(tmp_path: Path) -> None:
    [example] = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    file = tmp_path / "example.toml"
    file.write_text(example)
    config = load_config(file)
    given = tomllib.loads(example)
    assert config.steps == given["steps"]
    assert config.world.randomization.mass == (0.8, 1.2)
