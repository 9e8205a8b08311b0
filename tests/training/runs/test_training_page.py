"""docs/guides/training.md has a row for every task and reward, and an example that is one."""

import re
import tomllib
from pathlib import Path

import pytest

from neuroflight.training.config.config_file import load_config
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS

PAGE = (Path(__file__).parents[3] / "docs" / "guides" / "training.md").read_text()


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
