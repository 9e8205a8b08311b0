"""observation.c: every block against its definition in numpy, every term against the twin's bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.sim.control.observation import Observer
from neuroflight.toolchain.contract import (
    OBSERVATION_AGE_MAX,
    OBSERVATION_BLOCKS,
    OBSERVATION_COUNT_MAX,
    OBSERVATION_MEMORY_MAX,
    OBSERVATION_TERMS_MAX,
    needs_model,
    observation_blocks,
    observation_count,
)

BLOCKS = [block for block in OBSERVATION_BLOCKS if block.in_firmware]
EVERY_BLOCK = ",".join(block.name for block in BLOCKS)
OWN_BLOCKS = [block for block in BLOCKS if not needs_model(observation_blocks(block.name))]
PERIOD_S = 1 / 1000
Array = NDArray[np.float64]


class Observation:
    """An observation in C."""

    def __init__(
        self,
        core: Any,
        codes: list[int],
        width: int,
        ages: list[int] | None = None,
        gains: list[float] | None = None,
        motors: int = 4,
        rate_hz: int = 1000,
        expect: int = 0,
    ) -> None:
        self.core, self.lib = core, core.lib
        self.self = core.new("struct observation *")
        none = [0] * len(codes)
        self._arrays = (
            core.new("unsigned char[]", codes),
            core.new("unsigned char[]", ages or none),
            core.new("float[]", gains or none),
        )
        terms = core.new("struct observation_terms *", (*self._arrays, len(codes)))
        self._out = core.new("float[]", OBSERVATION_COUNT_MAX)
        self._width = width
        assert self.lib.observation_init(self.self, terms, motors, width, rate_hz) == expect

    @classmethod
    def of(cls, core: Any, text: str, motors: int = 4, rate_hz: int = 1000) -> Observation:
        """The observation that a policy asks for in `text`."""
        terms = observation_blocks(text)
        codes, ages = [term.block.code for term in terms], [term.age for term in terms]
        gains = [term.gain(rate_hz) for term in terms]
        return cls(core, codes, observation_count(terms, motors), ages, gains, motors, rate_hz)

    def step(self, rate: Array, setpoint: Array, action: Array, throttle: float, *more: Array) -> Array:
        """The next observation. more: rotors' speeds, last motors, the estimator's outputs."""
        before, after = (
            [self.core.new("float[]", values.tolist()) for values in part]
            for part in ((rate, setpoint, action), more)
        )
        missing = [self.core.new("float[]", 8) for _ in range(5 - len(more))]
        given = self.core.new("struct observation_input *", (*before, throttle, *after, *missing))
        self.lib.observation_step(self.self, given, self._out)
        return np.array(list(self._out)[: self._width])


def flight(steps: int, motors: int, scale: float) -> tuple[Array, ...]:
    """Random columns of what Observation.step takes, as float32 holds them."""
    rng = np.random.default_rng(steps)
    columns = (
        rng.normal(0, scale, (steps, 3)),
        rng.normal(0, scale, (steps, 3)),
        rng.random((steps, motors)),
        rng.random(steps),
        rng.random((steps, motors)) * 3000.0,
        rng.random((steps, motors)) - 0.5,
        rng.normal(0, 100.0 * scale, (steps, motors)),
        rng.normal(0, scale, (steps, 3)),
        rng.normal(0, scale, (steps, 3)),
    )
    return tuple(column.astype(np.float32).astype(float) for column in columns)


def defined(rate: Array, setpoint: Array, action: Array, throttle: Array, *more: Array) -> dict[str, Array]:
    """Each block at each step, as the contract's words say."""
    speeds, motors, rotors, estimate, estimate_error = more
    error = setpoint - rate
    return {
        "rate": rate,
        "rate_error": error,
        "rate_error_delta": np.diff(error, axis=0, prepend=error[:1]),
        "rate_error_integral": np.cumsum(error * PERIOD_S, axis=0),
        "previous_action": action,
        "throttle": throttle[:, None],
        "rotor_speed": speeds,
        "previous_motors": motors,
        "rotor_estimate": rotors,
        "rate_estimate": estimate,
        "rate_estimate_error": estimate_error,
        "rotor_measured": rotors,  # of the estimator too, which then holds the measured ones
    }


# --- Blocks -----------------------------------------------------------------------------------
@pytest.mark.parametrize("motors", [4, 6])
def test_blocks_are_as_defined_when_all_are_asked_for(scripted: Any, motors: int) -> None:
    columns = flight(200, motors, scale=2.0)
    expected = np.concatenate(list(defined(*columns).values()), axis=1)
    observation = Observation.of(scripted, EVERY_BLOCK, motors)
    for index, row in enumerate(zip(*columns, strict=True)):
        np.testing.assert_allclose(observation.step(*row), expected[index], atol=2e-5)


@pytest.mark.parametrize("names", ["rate_error,rate_error_delta", "throttle,rate", "previous_action"])
def test_blocks_come_in_the_policys_order_when_it_asks_for_some(scripted: Any, names: str) -> None:
    columns = flight(50, 4, scale=2.0)
    expected = np.concatenate([defined(*columns)[name] for name in names.split(",")], axis=1)
    observation = Observation.of(scripted, names)
    for index, row in enumerate(zip(*columns, strict=True)):
        np.testing.assert_allclose(observation.step(*row), expected[index], atol=2e-5)


@pytest.mark.parametrize("sign", [1, -1])
def test_integral_stops_at_its_limit_and_leaves_it_when_the_error_turns(scripted: Any, sign: int) -> None:
    observation = Observation.of(scripted, "rate_error_integral")
    still, error = np.zeros(3), np.array([10.0, 100.0, 1000.0])
    for _ in range(100):
        out = observation.step(still, sign * error, np.zeros(4), 0.0)
    np.testing.assert_allclose(out, sign * 0.6, rtol=1e-7)
    out = observation.step(still, -sign * error, np.zeros(4), 0.0)
    np.testing.assert_allclose(out, sign * np.array([0.59, 0.5, -0.4]), atol=1e-6)


# --- Terms ------------------------------------------------------------------------------------
def test_a_low_pass_is_as_defined_when_it_starts_and_goes_on(scripted: Any) -> None:
    rates = flight(300, 4, scale=2.0)[0]
    observation = Observation.of(scripted, "rate~15Hz")
    gain, expected = 1 - np.exp(-2 * np.pi * 15 * PERIOD_S), rates[0]
    for rate in rates:
        expected = expected + gain * (rate - expected)
        np.testing.assert_allclose(observation.step(rate, np.zeros(3), np.zeros(4), 0.0), expected, atol=1e-5)


def test_old_values_are_those_of_their_step_and_zero_when_there_was_none(scripted: Any) -> None:
    columns = flight(100, 4, scale=2.0)
    observation = Observation.of(scripted, "rate@1,previous_action@16,throttle@3,rate@2")
    rate, _, action, throttle = columns[:4]
    for index, row in enumerate(zip(*columns, strict=True)):

        def ago(values: Array, steps: int, now: int = index) -> Array:
            return np.atleast_1d(values[now - steps] if now >= steps else 0 * values[0])

        expected = [ago(rate, 1), ago(action, 16), ago(throttle, 3), ago(rate, 2)]
        assert observation.step(*row).tolist() == np.concatenate(expected).tolist()


def random_terms(rng: np.random.Generator, motors: int, rate_hz: int) -> str:
    """Terms that an observation has room for, one of which is low-passed and old at least."""
    texts = ["rate_error~15Hz@2"]
    width, remembered = 3, 9
    for _ in range(30):
        block = OWN_BLOCKS[rng.integers(len(OWN_BLOCKS))]
        age = int(rng.integers(0, OBSERVATION_AGE_MAX + 1)) * int(rng.random() < 0.4)
        passed = bool(rng.random() < 0.5)
        width += block.count(motors)
        remembered += block.count(motors) * (age + passed)
        if width > OBSERVATION_COUNT_MAX or remembered > OBSERVATION_MEMORY_MAX:
            break
        cutoff = f"~{rate_hz * 10 ** rng.uniform(-4, -0.31):.3f}Hz" if passed else ""
        texts.append(block.name + cutoff + (f"@{age}" if age else ""))
    return ",".join(texts)


@pytest.mark.parametrize("seed", range(12))
def test_c_gives_the_twins_bits_when_terms_are_random(scripted: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    motors, rate_hz = int(rng.choice([4, 6, 8])), int(rng.choice([1000, 2000, 4000]))
    text = random_terms(rng, motors, rate_hz)
    compiled = Observation.of(scripted, text, motors, rate_hz)
    observer = Observer(observation_blocks(text), 1, motors, rate_hz)
    rows = list(zip(*flight(400 + seed, motors, scale=10 ** rng.uniform(-2, 1.5)), strict=True))
    seen = set()
    last = np.zeros(motors)
    for index, row in enumerate(rows):
        if index > 0 and rng.random() < 0.02:
            compiled.lib.observation_reset(compiled.self)
            observer.reset(np.arange(1))
            last[:] = 0.0
        rate, setpoint, action, throttle, speed = (np.float32(values).reshape(-1) for values in row[:5])
        expected = observer.observe(
            slice(None), setpoint[None], rate[None], action[None], throttle, rotor_speed=speed[None]
        )
        given = np.float32(compiled.step(*row[:5], last))
        fractions = rng.random(motors).astype(np.float32)
        observer.commanded(slice(None), fractions[None], throttle)
        last = (fractions - throttle).astype(float)
        assert given.tobytes() == expected[0].tobytes(), f"{text}, step {index}"
        seen.add(given.tobytes())
    assert len(seen) > 300, "the observation must have moved"


# --- The past ---------------------------------------------------------------------------------
@pytest.mark.parametrize("text", [EVERY_BLOCK, "rate_error_delta~30Hz@2,throttle~5Hz,previous_action@7"])
def test_the_past_is_forgotten_when_it_is_reset(scripted: Any, text: str) -> None:
    used, fresh = (Observation.of(scripted, text) for _ in range(2))
    rows = list(zip(*flight(40, 4, scale=5.0), strict=True))
    for row in rows[20:]:
        used.step(*row)
    scripted.lib.observation_reset(used.self)
    for row in rows[:20]:
        assert used.step(*row).tolist() == fresh.step(*row).tolist()


# --- Refusals ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("codes", "width"),
    [([0], 3), ([7], 3), ([8], 3), ([9], 3), ([13], 3), ([255], 3), ([1, 2], 7), ([5], 3), ([1], 0)],
)
def test_init_refuses_when_a_block_is_unknown_or_the_width_differs(
    scripted: Any,
    codes: list[int],
    width: int,
) -> None:
    Observation(scripted, codes, width, expect=scripted.lib.NF_ERR_OBSERVATION)


@pytest.mark.parametrize(
    ("count", "age", "gain"),
    [
        (1, OBSERVATION_AGE_MAX + 1, 0.0),
        (1, 255, 0.0),
        (1, 0, 1.0),
        (1, 0, -0.1),
        (1, 0, float("nan")),
        (OBSERVATION_TERMS_MAX + 1, 0, 0.0),
        (OBSERVATION_TERMS_MAX, 8, 0.5),  # 9 floats each: 288
    ],
)
def test_init_refuses_when_a_term_is_out_of_bounds(scripted: Any, count: int, age: int, gain: float) -> None:
    """Of `count` throttles, each so old and so low-passed."""
    error = scripted.lib.NF_ERR_OBSERVATION
    Observation(scripted, [6] * count, count, [age] * count, [gain] * count, expect=error)


def test_init_takes_terms_when_they_fill_the_memory(scripted: Any) -> None:
    count = OBSERVATION_TERMS_MAX
    observation = Observation(scripted, [6] * count, count, [7] * count, [0.5] * count)
    assert count * 8 == OBSERVATION_MEMORY_MAX
    for _ in range(7):
        assert observation.step(np.zeros(3), np.zeros(3), np.zeros(4), 0.75).tolist() == [0.0] * count
    assert observation.step(np.zeros(3), np.zeros(3), np.zeros(4), 0.0).tolist() == [0.75] * count
