"""What it costs that a number of an aircraft file is wrong."""

from pathlib import Path

import pytest

from neuroflight.sim.aircraft.edit import with_known
from neuroflight.sim.aircraft.known import How, Known
from neuroflight.sim.aircraft.model import FOLDER
from neuroflight.sim.design.guesses import TRAITS, marked_numbers

NF1 = (FOLDER / "nf1.toml").read_text()
KEYS = (
    "part",
    "part.battery.mass_kg",
    "rotor",
    "propulsion.thrust_coefficient",
    "propulsion.speed_curve_rpm",
    "propulsion.rotor_inertia_kg_m2",
    "propulsion.delay_s",
    "gyro.noise_deg_s",
    "gyro.noise_deg_s[0]",
    "battery.cells",
    "body",
)


def costs(folder: Path, text: str, *keys: str) -> dict[str, float]:
    path = folder / "mine.toml"
    path.write_text(with_known(text, {key: Known(How.GUESSED) for key in keys}))
    found = marked_numbers(path)
    assert [guess.cost for guess in found] == sorted((guess.cost for guess in found), reverse=True)
    return {guess.key: guess.cost for guess in found}


def test_cost_of_a_number_is_that_of_what_a_controller_feels(tmp_path: Path) -> None:
    found = costs(tmp_path, NF1, *KEYS)
    assert found["part"] == pytest.approx(TRAITS["turn"].cost + TRAITS["yaw"].cost, rel=1e-6)
    # As flown: K_T 1.08, the speed curve 1.35, the rotors' inertia (whose lag it is) 1.11; see guesses.py.
    assert found["propulsion.thrust_coefficient"] == pytest.approx(0.08, abs=0.03)
    assert found["propulsion.speed_curve_rpm"] == pytest.approx(0.35, abs=0.06)
    assert found["propulsion.rotor_inertia_kg_m2"] == pytest.approx(0.11, abs=0.02)
    assert found["propulsion.delay_s"] == pytest.approx(TRAITS["delay"].cost)
    assert 0 < found["gyro.noise_deg_s[0]"] < found["gyro.noise_deg_s"] == pytest.approx(TRAITS["noise"].cost)
    assert found["part"] > found["part.battery.mass_kg"] > 0
    assert found["body"] == found["battery.cells"] == 0.0


def test_mark_of_a_table_counts_for_its_numbers_without_one(tmp_path: Path) -> None:
    both = costs(tmp_path, NF1, "gyro", "gyro.noise_deg_s")
    assert both["gyro"] == 0.0 and both["gyro.noise_deg_s"] == pytest.approx(TRAITS["noise"].cost)
    assert list(costs(tmp_path, NF1, "gyro", "gyro.noise_deg_s", "gyro.bias_deg_s")) == [
        "gyro.noise_deg_s",
        "gyro.bias_deg_s",
    ]


@pytest.mark.parametrize(
    ("low", "high", "share"), [(0.0018, 0.0022, 0.0675), (0.0018, 0.003, 1.0), (0.0, 0.003, 1.0)]
)
def test_number_with_a_range_costs_what_its_worse_end_does(
    tmp_path: Path, low: float, high: float, share: float
) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(with_known(NF1, {"propulsion.delay_s": Known(How.MEASURED, (low, high), "a log")}))
    (found,) = marked_numbers(path)
    assert found.cost == pytest.approx(share * TRAITS["delay"].cost, rel=0.01)


def test_cost_of_a_lag_is_the_same_in_both_forms(tmp_path: Path) -> None:
    lag = 'kind = "first_order"\ntime_constant_up_s = 0.04\ntime_constant_down_s = 0.05\n'
    start = NF1.index('kind = "torque"')
    first_order = NF1[:start] + lag + NF1[NF1.index("\n\n", start) :]
    assert costs(tmp_path, first_order, "propulsion.response") == pytest.approx(
        {"propulsion.response": TRAITS["lag"].cost}
    )
    assert costs(tmp_path, NF1, "propulsion.response.gain") == pytest.approx(
        {"propulsion.response.gain": TRAITS["lag"].cost}
    )
