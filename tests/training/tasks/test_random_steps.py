"""Random steps: commands, and the weights of control steps."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.errors import TrainingError
from neuroflight.training.tasks.random_steps import RandomStepsTask

RATE_HZ = 1000


def changes(setpoint: NDArray[np.float32]) -> NDArray[np.intp]:
    """Steps of one episode (T, 3) at which its setpoint is new."""
    return 1 + np.flatnonzero((np.diff(setpoint, axis=0) != 0.0).any(axis=1))


def test_commands_and_rest_take_turns_when_episodes_are_drawn() -> None:
    setpoints = RandomStepsTask(length_s=2.0).episodes(50, np.random.default_rng(0), RATE_HZ)
    assert setpoints.shape == (50, 2000, 3)
    assert setpoints.dtype == np.float32
    for setpoint in setpoints:
        moving = setpoint[changes(setpoint)].any(axis=1)
        assert not setpoint[0].any()
        assert np.array_equal(moving, np.arange(len(moving)) % 2 == 0)


def test_holds_last_their_mean_and_never_less_than_their_least_when_they_are_drawn() -> None:
    task = RandomStepsTask(length_s=20.0, hold_least_s=0.1, hold_mean_s=0.3)
    setpoints = task.episodes(100, np.random.default_rng(1), RATE_HZ)
    holds = np.concatenate([np.diff(changes(setpoint)) for setpoint in setpoints])
    assert holds.min() >= 99  # both ends are rounded to a step
    assert holds.mean() == pytest.approx(300.0, rel=0.03)


def test_time_to_the_next_change_does_not_depend_on_the_time_already_held() -> None:
    setpoints = RandomStepsTask(length_s=20.0).episodes(200, np.random.default_rng(2), RATE_HZ)
    holds = np.concatenate([np.diff(changes(setpoint)) for setpoint in setpoints])
    rest = [holds[holds >= age].mean() - age for age in (100, 300, 500)]
    assert rest[1:] == pytest.approx([rest[0]] * 2, rel=0.1)


def test_commands_of_a_batch_have_sigma_exactly_when_none_is_wide() -> None:
    task = RandomStepsTask(sigma_deg_s=80.0)
    setpoints, _ = task.batch(32, np.random.default_rng(3), RATE_HZ)
    commands = [s[c] for s in setpoints for c in changes(s) if s[c].any()]
    assert np.rad2deg(np.sqrt(np.square(commands).mean(axis=0))) == pytest.approx([80.0] * 3, rel=1e-5)


def test_transients_of_a_batch_have_their_share_of_the_weight() -> None:
    task = RandomStepsTask(start_s=0.06, transient_s=0.15, transient_share=0.2)
    setpoints, weights = task.batch(64, np.random.default_rng(4), RATE_HZ)
    counts = weights.error
    transient = np.zeros(counts.shape, bool)
    for row, setpoint in zip(transient, setpoints, strict=True):
        for change in changes(setpoint):
            row[change : change + 150] = True
    transient[:, :60] = False
    assert not counts[:, :60].any()
    assert counts[transient].sum() / counts.sum() == pytest.approx(0.2)


def test_wide_episodes_have_weight_only_where_they_hold_for_effort_as_for_errors() -> None:
    task = RandomStepsTask(wide_share=0.5, wide_factor=4.0, wide_weight=0.3)
    setpoints, weights = task.batch(400, np.random.default_rng(5), RATE_HZ)
    wide = ~weights.square.any(axis=1)
    size = [np.sqrt(np.square(setpoints[which][:, -1]).mean()) for which in (wide, ~wide)]
    assert wide.mean() == pytest.approx(0.5, abs=0.08)
    assert size[0] / size[1] == pytest.approx(4.0, rel=0.15)
    assert np.array_equal(weights.error, weights.effort), "motors that swing in a held turn count"
    for setpoint, counts in zip(setpoints[wide], weights.error[wide], strict=True):
        assert not any(counts[change : change + 150].any() for change in changes(setpoint))
    held = [weights.error[which, 60:100].max() for which in (wide, ~wide)]  # before any change
    assert held[0] / held[1] == pytest.approx(0.3)


def test_the_way_to_a_wide_command_weighs_as_much_as_it_is_said_to() -> None:
    weights = [
        RandomStepsTask(wide_share=0.5, wide_transient=part).batch(100, np.random.default_rng(5), RATE_HZ)[1]
        for part in (0.0, 1.0, 2.0)
    ]
    usual = weights[0].square.any(axis=1)
    ways = [each.error - weights[0].error for each in weights]
    assert not ways[1][usual].any() and ways[1][~usual].any()
    assert np.array_equal(ways[2], 2.0 * ways[1])
    assert set(np.unique(ways[1][~usual])) <= {0.0, *np.unique(weights[0].square)}
    assert np.array_equal(weights[2].effort, weights[0].effort), "the way is flown as fast as motors can"


def test_commands_stay_within_full_stick_when_they_are_wide() -> None:
    task = RandomStepsTask(sigma_deg_s=500.0, wide_share=1.0)
    setpoints = task.episodes(20, np.random.default_rng(6), RATE_HZ)
    assert np.rad2deg(np.abs(setpoints).max()) == pytest.approx(1000.0)


def test_episodes_repeat_when_the_seed_is_the_same() -> None:
    task = RandomStepsTask(wide_share=0.3)
    one, other, third = (task.episodes(5, np.random.default_rng(seed), RATE_HZ) for seed in (7, 7, 8))
    assert np.array_equal(one, other)
    assert not np.array_equal(one, third)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("hold_mean_s", 0.05),
        ("start_s", 0.8),
    ],
)
def test_an_invalid_field_is_rejected_by_name(field: str, value: float) -> None:
    with pytest.raises(TrainingError, match=f"random-steps: {field}"):
        RandomStepsTask(**{field: value})
