"""mixer.c: thrust on top, attitude first."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

EPSILON = float(np.finfo(np.float32).eps)


def mix(core: Any, action: Any, throttle: float, idle: float = 0.0) -> np.ndarray:  # type: ignore[type-arg]
    mixer, out = core.new("struct mixer *"), core.new("float[4]")
    assert core.lib.mixer_init(mixer, idle) == 0
    core.lib.mixer_step(mixer, list(action), throttle, out)
    return np.array(list(out))


def actions(count: int) -> np.ndarray:  # type: ignore[type-arg]
    rng = np.random.default_rng(3)
    random = rng.random((count, 4)).astype(np.float32)
    corners = rng.integers(0, 2, (count, 4)).astype(np.float32)
    return np.concatenate([random, corners])


def test_differences_between_motors_survive_when_any_thrust_is_added(puppet: Any) -> None:
    rng = np.random.default_rng(4)
    for action in actions(300):
        output = mix(puppet, action, float(np.float32(rng.random())))
        np.testing.assert_allclose(output - output[0], action - action[0], atol=4 * EPSILON)


def test_no_motor_saturates_when_thrust_is_full(puppet: Any) -> None:
    for action in actions(300):
        output = mix(puppet, action, 1.0)
        assert output.max() == pytest.approx(1.0, abs=2 * EPSILON)
        assert (output >= 0).all() and (output <= 1).all()


def test_outputs_are_the_actions_when_thrust_is_zero(puppet: Any) -> None:
    for action in actions(100):
        assert mix(puppet, action, 0.0).tolist() == action.tolist()


def test_thrust_fills_the_room_in_proportion_when_it_is_partial(puppet: Any) -> None:
    np.testing.assert_allclose(mix(puppet, [0.1, 0.4, 0.2, 0.0], 0.5), [0.4, 0.7, 0.5, 0.3], atol=EPSILON)


@pytest.mark.parametrize("idle", [0.0, 0.05, 0.5])
def test_outputs_lie_between_idle_and_one_when_idle_is_set(puppet: Any, idle: float) -> None:
    for action in actions(100):
        output = mix(puppet, action, 0.3, idle)
        assert output.min() >= np.float32(idle)
        assert output.max() <= 1
        np.testing.assert_allclose(output, idle + (1 - idle) * mix(puppet, action, 0.3), atol=2 * EPSILON)


@pytest.mark.parametrize("idle", [-0.01, 1.0, 2.0, float("nan"), float("inf")])
def test_init_refuses_when_idle_is_out_of_range(puppet: Any, idle: float) -> None:
    assert puppet.lib.mixer_init(puppet.new("struct mixer *"), idle) == puppet.lib.NF_ERR_IDLE
