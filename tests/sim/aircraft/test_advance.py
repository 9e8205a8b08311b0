"""[propulsion.advance_ratio] of an aircraft file."""

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.aircraft.advance import RATIO_LAST, AdvanceRatio
from neuroflight.sim.aircraft.edit import edit_aircraft
from neuroflight.sim.aircraft.model import FOLDER, Aircraft, load_aircraft, parse_aircraft
from neuroflight.toolchain.errors import AircraftError

NF1 = (FOLDER / "nf1.toml").read_text()
DIAMETER = "propeller_diameter_m = 0.12954 "


def with_table(lines: str, text: str = NF1) -> Aircraft:
    return parse_aircraft(f"{text}\n[propulsion.advance_ratio]\n{lines}\n".encode(), "own.toml")


def test_table_is_read() -> None:
    read = with_table("thrust = [-0.9, -0.1]\ntorque = [-0.5, 0]").propulsion.advance
    assert read == AdvanceRatio((-0.9, -0.1), (-0.5, 0.0))
    assert load_aircraft("nf1").propulsion.advance is None


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("thrust = [-1.0, 0]", "propulsion.advance_ratio.torque: missing"),
        ("thrust = -1.0\ntorque = [0, 0]", "thrust: got 1 numbers, expected 2"),
        ("thrust = [-21, 0]\ntorque = [0, 0]", "thrust[0]: got -21, expected -20 to 20"),
        ("thrust = [0.9, 0]\ntorque = [0, 0]", "thrust: got [0.9, 0.0], which makes 3.7 times"),
        ("thrust = [-0.1, 0]\ntorque = [0.8, 0]", "torque: got [0.8, 0.0], which makes 3.4 times"),
        ("thrust = [-1, 0]\ntorque = [0, 0]\npower = [0, 0]", "power: unknown key"),
    ],
)
def test_a_bad_table_is_one_line_that_names_the_key(lines: str, message: str) -> None:
    with pytest.raises(AircraftError) as caught:
        with_table(lines)
    text = str(caught.value)
    assert message in text
    assert "\n" not in text and "own.toml" in text


def test_a_table_without_the_diameter_is_refused() -> None:
    bare = "\n".join(line for line in NF1.splitlines() if not line.startswith(DIAMETER))
    with pytest.raises(AircraftError, match=r"propeller_diameter_m: missing; .*advance_ratio. needs it"):
        with_table("thrust = [-1, 0]\ntorque = [0, 0]", bare)


@pytest.mark.parametrize(
    ("thrust", "last"),
    [
        ((-1.0, 0.0), 1.0),  # where thrust ends
        ((0.5, -1.5), 1.0),
        ((-3.0, 2.0), 0.5),  # the first of two roots
        ((-1.0, 0.5), 1.0),  # no root: the lowest point
        ((0.0, 0.0), RATIO_LAST),
        ((0.1, 0.1), RATIO_LAST),
    ],
)
def test_factors_stay_as_they_are_where_thrust_ends(thrust: tuple[float, float], last: float) -> None:
    advance = AdvanceRatio(thrust, (-0.2, 0.0))
    assert advance.ratio_max == pytest.approx(last)
    at_last, beyond = advance.factors([last, 10.0 * last]), advance.factors(10.0 * last)
    assert np.ravel(at_last[0]) == pytest.approx([float(beyond[0])] * 2)
    assert float(beyond[1]) == pytest.approx(max(0.0, 1.0 - 0.2 * last))
    assert [float(value) for value in advance.factors(-1.0)] == [1.0, 1.0]


def test_the_table_stays_when_other_keys_are_edited(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(
        f"{NF1}\n[propulsion.advance_ratio] # of a wind tunnel\nthrust = [-1, 0]\ntorque = [0, 0]\n"
    )
    edit_aircraft(path, {"propulsion": {"rotor_inertia_kg_m2": 5e-6}})
    edit_aircraft(path, {"propulsion.advance_ratio": {"torque": (-0.5, 0.1)}})
    assert "# of a wind tunnel" in path.read_text()
    propulsion = load_aircraft(path).propulsion
    assert propulsion.rotor_inertia == 5e-6
    assert propulsion.advance == AdvanceRatio((-1.0, 0.0), (-0.5, 0.1))
