"""observation.c: every block of the contract, against its definition in numpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from toolchain.contract import OBSERVATION_BLOCKS, observation_blocks, observation_count

CODES = [block.code for block in OBSERVATION_BLOCKS if block.in_firmware]
PERIOD_S = 1 / 1000
Array = NDArray[np.float64]


class Observation:
    def __init__(self, core: Any, codes: list[int], width: int, motors: int = 4, expect: int = 0) -> None:
        self.core, self.lib = core, core.lib
        self.self = core.new("struct observation *")
        self._codes = core.new("unsigned char[]", codes)
        self._out = core.new("float[64]")
        self._width = width
        error = self.lib.observation_init(self.self, self._codes, len(codes), motors, width, 1000)
        assert error == expect

    def step(self, rate: Array, setpoint: Array, action: Array, throttle: float) -> Array:
        arrays = [self.core.new("float[]", values.tolist()) for values in (rate, setpoint, action)]
        given = self.core.new("struct observation_input *", (*arrays, throttle))
        self.lib.observation_step(self.self, given, self._out)
        return np.array(list(self._out)[: self._width])


def flight(steps: int, motors: int, scale: float) -> tuple[Array, Array, Array, Array]:
    """Random rates, setpoints, actions and throttles, as float32 holds them."""
    rng = np.random.default_rng(steps)
    columns = (
        rng.normal(0, scale, (steps, 3)),
        rng.normal(0, scale, (steps, 3)),
        rng.random((steps, motors)),
        rng.random(steps),
    )
    rate, setpoint, action, throttle = (column.astype(np.float32).astype(float) for column in columns)
    return rate, setpoint, action, throttle


def defined(rate: Array, setpoint: Array, action: Array, throttle: Array) -> dict[str, Array]:
    """Each block at each step, as the contract's words say."""
    error = setpoint - rate
    return {
        "rate": rate,
        "rate_error": error,
        "rate_error_delta": np.diff(error, axis=0, prepend=error[:1]),
        "rate_error_integral": np.cumsum(error * PERIOD_S, axis=0),
        "previous_action": action,
        "throttle": throttle[:, None],
    }


@pytest.mark.parametrize("motors", [4, 6])
def test_blocks_are_as_defined_when_all_are_asked_for(puppet: Any, motors: int) -> None:
    columns = flight(200, motors, scale=2.0)
    expected = np.concatenate(list(defined(*columns).values()), axis=1)
    observation = Observation(puppet, CODES, expected.shape[1], motors)
    for index, row in enumerate(zip(*columns, strict=True)):
        np.testing.assert_allclose(observation.step(*row), expected[index], atol=2e-5)


@pytest.mark.parametrize("names", ["rate_error,rate_error_delta", "throttle,rate", "previous_action"])
def test_blocks_come_in_the_policys_order_when_it_asks_for_some(puppet: Any, names: str) -> None:
    blocks = observation_blocks(names)
    columns = flight(50, 4, scale=2.0)
    expected = np.concatenate([defined(*columns)[block.name] for block in blocks], axis=1)
    observation = Observation(puppet, [term.block.code for term in blocks], observation_count(blocks, 4))
    for index, row in enumerate(zip(*columns, strict=True)):
        np.testing.assert_allclose(observation.step(*row), expected[index], atol=2e-5)


@pytest.mark.parametrize("sign", [1, -1])
def test_integral_stops_at_its_limit_and_leaves_it_when_the_error_turns(puppet: Any, sign: int) -> None:
    blocks = observation_blocks("rate_error_integral")
    observation = Observation(puppet, [blocks[0].block.code], 3)
    still, error = np.zeros(3), np.array([10.0, 100.0, 1000.0])
    for _ in range(100):
        out = observation.step(still, sign * error, np.zeros(4), 0.0)
    np.testing.assert_allclose(out, sign * 0.6, rtol=1e-7)
    out = observation.step(still, -sign * error, np.zeros(4), 0.0)
    np.testing.assert_allclose(out, sign * np.array([0.59, 0.5, -0.4]), atol=1e-6)


def test_the_past_is_forgotten_when_it_is_reset(puppet: Any) -> None:
    used, fresh = (Observation(puppet, CODES, 17) for _ in range(2))
    first, *later = list(zip(*flight(20, 4, scale=5.0), strict=True))
    for row in later:
        used.step(*row)
    puppet.lib.observation_reset(used.self)
    assert used.step(*first).tolist() == fresh.step(*first).tolist()
    assert used.step(*later[0]).tolist() == fresh.step(*later[0]).tolist()


@pytest.mark.parametrize(
    ("codes", "width"), [([0], 3), ([7], 4), ([8], 3), ([9], 3), ([255], 3), ([1, 2], 7), ([5], 3), ([1], 0)]
)
def test_init_refuses_when_a_block_is_unknown_or_the_width_differs(
    puppet: Any,
    codes: list[int],
    width: int,
) -> None:
    Observation(puppet, codes, width, expect=puppet.lib.NF_ERR_OBSERVATION)
