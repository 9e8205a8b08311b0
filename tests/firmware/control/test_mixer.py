"""mixer.c: the differences between the motors are kept, whatever the thrust."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from neuroflight.sim.control.motors import raised, throttle_mix
from neuroflight.toolchain.contract import Mix

EPSILON = float(np.finfo(np.float32).eps)


def make(core: Any, idle: float = 0.0, kind: Mix = Mix.ATTITUDE_FIRST, **changed: float) -> Any:
    """A mixer with these settings."""
    values = core.new("struct nf_settings *")
    core.lib.settings_default(values)
    for name, value in changed.items():
        setattr(values, name, value)
    mixer = core.new("struct mixer *")
    assert core.lib.mixer_init(mixer, values, idle, kind) == 0
    return mixer


def mix(core: Any, action: Any, throttle: float, idle: float = 0.0, **changed: float) -> np.ndarray:  # type: ignore[type-arg]
    return step(core, make(core, idle, Mix.ATTITUDE_FIRST, **changed), action, throttle)


def step(core: Any, mixer: Any, action: Any, throttle: float) -> np.ndarray:  # type: ignore[type-arg]
    """Outputs of the mixer."""
    mixed, out = core.new("float[8]"), core.new("float[8]")
    core.lib.mixer_mix(mixer, list(action), throttle, mixed)
    core.lib.mixer_raise(mixer, mixed, out)
    return np.array(list(out)[: len(action)])


def actions(count: int) -> np.ndarray:  # type: ignore[type-arg]
    rng = np.random.default_rng(3)
    random = rng.random((count, 4)).astype(np.float32)
    corners = rng.integers(0, 2, (count, 4)).astype(np.float32)
    return np.concatenate([random, corners])


def test_differences_between_motors_survive_when_any_thrust_is_added(scripted: Any) -> None:
    rng = np.random.default_rng(4)
    for action in actions(300):
        output = mix(scripted, action, float(np.float32(rng.random())))
        np.testing.assert_allclose(output - output[0], action - action[0], atol=4 * EPSILON)


def test_no_motor_saturates_when_thrust_is_full(scripted: Any) -> None:
    for action in actions(300):
        output = mix(scripted, action, 1.0)
        assert output.max() == pytest.approx(1.0, abs=2 * EPSILON)
        assert (output >= 0).all() and (output <= 1).all()


def test_outputs_are_the_actions_when_thrust_is_zero(scripted: Any) -> None:
    for action in actions(100):
        assert mix(scripted, action, 0.0).tolist() == action.tolist()


@pytest.mark.parametrize("motor", range(4))
def test_a_motor_idles_when_what_is_asked_of_it_is_no_number(scripted: Any, motor: int) -> None:
    action = [0.5] * 4
    action[motor] = float("nan")
    assert mix(scripted, action, 0.5, idle=0.25)[motor] == 0.25


@pytest.mark.parametrize("motor", range(6))
def test_every_motor_counts_when_there_are_six(hexacopter: Any, motor: int) -> None:
    action = [0.1] * 6
    action[motor] = 0.4
    expected = [0.5 * 0.6 + value for value in action]
    np.testing.assert_allclose(mix(hexacopter, action, 0.5), expected, atol=EPSILON)


def test_thrust_fills_the_room_in_proportion_when_it_is_partial(scripted: Any) -> None:
    np.testing.assert_allclose(mix(scripted, [0.1, 0.4, 0.2, 0.0], 0.5), [0.4, 0.7, 0.5, 0.3], atol=EPSILON)


@pytest.mark.parametrize("idle", [0.0, 0.05, 0.5])
def test_outputs_lie_between_idle_and_one_when_idle_is_set(scripted: Any, idle: float) -> None:
    for action in actions(100):
        output = mix(scripted, action, 0.3, idle)
        assert output.min() >= np.float32(idle)
        assert output.max() <= 1
        np.testing.assert_allclose(output, idle + (1 - idle) * mix(scripted, action, 0.3), atol=2 * EPSILON)


# --- Centred ----------------------------------------------------------------------------------
@pytest.mark.parametrize("idle", [0.0, 0.05])
def test_the_twins_bits_come_when_the_mix_is_centred(scripted: Any, idle: float) -> None:
    rng = np.random.default_rng(5)
    mixer = make(scripted, idle, Mix.CENTRED)
    some = actions(200)
    throttles = rng.choice([0.0, 0.1, 0.5, 0.9, 1.0], len(some)).astype(np.float32)
    expected = raised(throttle_mix(some, throttles, Mix.CENTRED), idle)
    for action, throttle, row in zip(some, throttles, expected, strict=True):
        assert step(scripted, mixer, action, throttle).astype(np.float32).tobytes() == row.tobytes()


def test_the_motors_mean_is_the_throttle_when_the_mix_is_centred(scripted: Any) -> None:
    mixer = make(scripted, 0.0, Mix.CENTRED)
    output = step(scripted, mixer, [0.7, 0.5, 0.6, 0.6], 0.25)
    np.testing.assert_allclose(output, [0.35, 0.15, 0.25, 0.25], atol=2 * EPSILON)


def test_all_motors_move_together_when_one_would_leave_the_range(scripted: Any) -> None:
    mixer = make(scripted, 0.0, Mix.CENTRED)
    for throttle, expected in ((0.1, [0.4, 0.0, 0.2, 0.2]), (0.9, [1.0, 0.6, 0.8, 0.8])):
        output = step(scripted, mixer, [0.7, 0.3, 0.5, 0.5], throttle)
        np.testing.assert_allclose(output, expected, atol=2 * EPSILON)


def test_every_motor_idles_when_a_centred_one_is_no_number(scripted: Any) -> None:
    mixer = make(scripted, 0.25, Mix.CENTRED)
    assert step(scripted, mixer, [0.5, float("nan"), 0.5, 0.5], 0.5).tolist() == [0.25] * 4


# --- What the pilot sets ----------------------------------------------------------------------
@pytest.mark.parametrize("idle", [0.0, 0.23, 0.5])
def test_no_bit_changes_when_the_limit_is_one(scripted: Any, idle: float) -> None:
    """Against the mix as it stands in the design, in float32."""
    one, low = np.float32(1), np.float32(idle)
    for action in actions(200):
        mixed = np.clip(np.float32(0.3) * (one - action.max()) + action, 0, one)
        expected = low + (one - low) * mixed
        assert mix(scripted, action, 0.3, idle).astype(np.float32).tobytes() == expected.tobytes()


@pytest.mark.parametrize("limit", [0.3, 0.75, 1.0])
def test_outputs_end_at_the_limit_when_the_motors_are_limited(scripted: Any, limit: float) -> None:
    for action in actions(100):
        output = mix(scripted, action, 1.0, 0.23, motor_limit=limit)
        assert output.max() == pytest.approx(limit, abs=2 * EPSILON)
        assert output.min() >= np.float32(0.23) - EPSILON
        np.testing.assert_allclose(
            output, 0.23 + (limit - 0.23) * mix(scripted, action, 1.0), atol=4 * EPSILON
        )


def test_all_motors_turn_at_the_limit_when_it_is_below_the_idle(scripted: Any) -> None:
    for action in actions(20):
        assert set(mix(scripted, action, 0.6, 0.23, motor_limit=0.1).tolist()) == {float(np.float32(0.1))}


def test_the_idle_is_the_new_controllers_when_it_takes_over(scripted: Any) -> None:
    mixer = make(scripted, 0.1, motor_limit=0.8)
    assert scripted.lib.mixer_set_idle(mixer, 0.3) == 0
    np.testing.assert_allclose(
        step(scripted, mixer, [0.0, 1.0, 0.5, 0.25], 0.0), [0.3, 0.8, 0.55, 0.425], atol=2 * EPSILON
    )


@pytest.mark.parametrize(("us", "stops"), [(880, True), (1050, True), (1051, False), (2000, False)])
def test_motors_stand_still_when_the_pilot_wants_so_and_the_throttle_is_low(
    scripted: Any, us: int, stops: bool
) -> None:
    throttle = scripted.lib.rates_throttle([us] * 16)
    assert scripted.lib.mixer_stops(make(scripted, motor_stop=1), throttle) is stops
    assert not scripted.lib.mixer_stops(make(scripted), throttle)


@pytest.mark.parametrize("idle", [-0.01, 1.0, 2.0, float("nan"), float("inf")])
def test_an_idle_is_refused_and_the_last_one_kept_when_it_is_out_of_range(scripted: Any, idle: float) -> None:
    values = scripted.new("struct nf_settings *")
    scripted.lib.settings_default(values)
    refused = scripted.new("struct mixer *")
    assert scripted.lib.mixer_init(refused, values, idle, Mix.CENTRED) == scripted.lib.NF_ERR_IDLE
    mixer = make(scripted, 0.2)
    assert scripted.lib.mixer_set_idle(mixer, idle) == scripted.lib.NF_ERR_IDLE
    assert step(scripted, mixer, [0.0] * 4, 0.0).tolist() == pytest.approx([0.2] * 4)
