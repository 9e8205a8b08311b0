"""Constants of a policy's model: through JSON and back, and one line for each number that no aircraft has."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.control.estimator import model_constants
from neuroflight.toolchain.policy.model_constants import UNLIMITED, ModelConstants

GOOD: dict[str, Any] = {
    "delay_steps": 2,
    "speed_curve": [-900.0, 4000.0, 150.0],
    "rise": 0.0625,
    "fall": 0.03125,
    "gain_max": 50.0,
    "loss_max": 40.0,
    "correction": 0.0625,
    "turn": [[1.0, -1.0], [3.0, 3.5], [4.0, -4.0]],
    "reaction": [[0.0, 0.0], [0.5, 0.25], [0.125, -0.125]],
}
SHARES = st.floats(1e-6, 1.0)
NUMBERS = st.floats(-1e9, 1e9)
COUNTS = st.integers(1, 8)


@given(st.data())
def test_nothing_is_lost_when_constants_go_through_json(data: st.DataObject) -> None:
    motors = data.draw(COUNTS)
    row = st.lists(NUMBERS, min_size=motors, max_size=motors)
    rows = st.lists(row, min_size=3, max_size=3)
    document = {
        "delay_steps": data.draw(COUNTS),
        "speed_curve": data.draw(st.lists(NUMBERS, min_size=3, max_size=3)),
        **{name: data.draw(SHARES) for name in ("rise", "fall", "correction")},
        **{name: data.draw(st.floats(1e-6, 1e9)) for name in ("gain_max", "loss_max")},
        **{name: data.draw(rows) for name in ("turn", "reaction")},
    }
    model = ModelConstants.of(document)
    assert ModelConstants.of(json.loads(json.dumps(model.document()))) == model
    assert model.motor_count == motors
    for number in (*model.rotor, *model.turn[2], *model.reaction[0]):
        assert float(np.float32(number)) == number


@pytest.mark.parametrize("rate_hz", [500, 1000, 2000])
def test_the_nf1s_constants_are_a_steps_at_the_policys_rate(rate_hz: int) -> None:
    aircraft = load_aircraft("nf1")
    model = model_constants(aircraft, rate_hz)
    assert model.delay_steps == max(1, round(aircraft.propulsion.delay * rate_hz))
    assert model.correction == pytest.approx(1 - np.exp(-2 * np.pi * 10 / rate_hz), rel=1e-6)
    assert model.speed_curve == tuple(float(np.float32(x)) for x in aircraft.propulsion.speed_curve)
    assert (model.gain_max, model.loss_max) == (UNLIMITED, UNLIMITED) or model.rise == model.fall
    assert ModelConstants.of(json.loads(json.dumps(model.document()))) == model


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"delay_steps": 0}, "delay_steps is 0, expected 1 to 8"),
        ({"delay_steps": 9}, "delay_steps is 9, expected 1 to 8"),
        ({"delay_steps": 2.0}, "delay_steps is no whole number"),
        ({"delay_steps": True}, "delay_steps is no whole number"),
        ({"rise": 0.0}, "rise is 0.0, expected above 0 and at most 1"),
        ({"fall": 1.5}, "fall is 1.5, expected above 0 and at most 1"),
        ({"correction": -0.5}, "correction is -0.5, expected above 0"),
        ({"correction": "much"}, "correction holds 'much', expected a number"),
        ({"rise": True}, "rise holds 'True', expected a number"),
        ({"rise": float("nan")}, "rise holds 'nan', expected a number"),
        ({"fall": 10**400}, "fall holds '1000.*', expected a number"),
        ({"gain_max": 0.0}, "gain_max is 0.0, expected above 0, at most"),
        ({"loss_max": 2e9}, r"loss_max is 2000000000.0, expected above 0, at most 1e\+09"),
        ({"speed_curve": [1.0, 2.0]}, r"speed_curve holds '\[1.0, 2.0\]', expected a list of 3"),
        ({"speed_curve": 1.0}, "speed_curve holds '1.0', expected a list of 3"),
        ({"speed_curve": [1.0, 2.0, 2e9]}, r"a number is not finite or beyond 1e\+09"),
        ({"turn": [[1.0], [2.0]]}, "turn holds .*, expected a list each for roll, pitch and yaw"),
        ({"turn": [1.0, 2.0, 3.0]}, "turn holds '1.0', expected a list of a value a motor"),
        ({"turn": [[], [], []]}, "turn is for 0 motors, expected 1 to 8"),
        ({"turn": [[1.0] * 9] * 3, "reaction": [[1.0] * 9] * 3}, "turn is for 9 motors, expected 1 to 8"),
        ({"reaction": [[0.0], [0.5], [0.125]]}, "turn and reaction have rows of other lengths"),
        ({"turn": [[1.0, 2.0], [2.0], [3.0, 4.0]]}, "turn and reaction have rows of other lengths"),
        ({"reaction": [[0.0, None]] * 3}, "reaction holds 'None', expected a number"),
        ({"lift": 1.0}, "keys lift unknown or missing, expected delay_steps, speed_curve"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_constants_are_refused_in_one_line_when_no_aircraft_has_them(
    change: dict[str, Any], text: str
) -> None:
    with pytest.raises(ValueError, match=text) as caught:
        ModelConstants.of({**GOOD, **change})
    assert "\n" not in str(caught.value)


def test_constants_are_refused_when_one_is_missing() -> None:
    with pytest.raises(ValueError, match="keys rise unknown or missing"):
        ModelConstants.of({name: value for name, value in GOOD.items() if name != "rise"})
