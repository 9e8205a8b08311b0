"""Coefficients over the advance ratio from tables: curves of known coefficients, and tables that are none."""

import math
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.identification.propeller import doubts, fit_propeller
from neuroflight.sim.identification.propeller_plot import draw_coefficients
from neuroflight.sim.identification.propeller_tables import Measurements, read_tables
from neuroflight.toolchain.errors import DynoError


def measured(noise: float = 0.0, last: float = 1.05, count: int = 60) -> Measurements:
    """C_T = 0.14 (1 - 0.7 J - 0.35 J^2), C_Q = 0.012 (1 - 0.2 J - 0.4 J^2)."""
    rng = np.random.default_rng(1)
    ratio = np.linspace(0.05, last, count)
    thrust = 0.14 * (1 - 0.7 * ratio - 0.35 * ratio**2)
    torque = 0.012 * (1 - 0.2 * ratio - 0.4 * ratio**2)
    draws = rng.standard_normal((2, count))
    return Measurements(ratio, thrust + noise * 0.14 * draws[0], torque + noise * 0.012 * draws[1])


def table(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_known_coefficients_are_found_exactly_without_noise() -> None:
    fit = fit_propeller(measured())
    assert fit.thrust.static == pytest.approx(0.14)
    assert fit.advance.thrust == pytest.approx((-0.7, -0.35))
    assert fit.advance.torque == pytest.approx((-0.2, -0.4))
    assert doubts(fit) == []


def test_known_coefficients_are_found_within_their_errors_in_noise() -> None:
    fit = fit_propeller(measured(0.01))
    for curve, true in ((fit.thrust, (-0.7, -0.35)), (fit.torque, (-0.2, -0.4))):
        assert curve.residual == pytest.approx(0.01, rel=0.4)
        for term, error, known in zip(curve.terms, curve.errors, true, strict=True):
            assert 0.0 < error < 0.1
            assert abs(term - known) < 3.0 * error


def test_rows_in_which_the_propeller_brakes_are_left_out() -> None:
    windmill = Measurements(np.array([1.3, 1.6, -0.2]), np.array([-0.1, -0.5, 0.1]), np.full(3, 0.001))
    both = Measurements(
        *(np.concatenate([getattr(of, name) for of in (measured(), windmill)]) for name in vars(windmill))
    )
    assert fit_propeller(both).advance == fit_propeller(measured()).advance


def test_a_line_and_a_warning_when_the_table_ends_early() -> None:
    early = measured(last=0.4, count=20)
    line = fit_propeller(early, degree=1)
    assert line.advance.thrust[1] == line.advance.torque[1] == 0.0
    (doubt,) = doubts(line)
    assert "of the thrust is left at the largest J measured, 0.4" in doubt
    two = Measurements(early.ratio[:2], early.thrust[:2], early.torque[:2])
    assert all(math.isnan(error) for error in fit_propeller(two, degree=1).thrust.errors[:1])


def test_a_table_is_read_in_any_of_its_forms(tmp_path: Path) -> None:
    forms = {
        "uiuc.txt": "   J      CT       CP       eta\n0.1  0.13 0.0628318530717959 0.2\n 0.3 0.1 0.05 0.6\n",
        "own.csv": "# mine\nc_q, rpm, J, C_T\n0.01, 6000, 0.1, 0.13\n0.0079577472, 6000, 0.3, 0.1\n\n",
        "semicolons.csv": '"J";"CT";"CP"\r\n0.1;0.13;0.0628318530717959\r\n0.3;0.1;0.05\r\n',
    }
    for name, text in forms.items():
        found = read_tables([table(tmp_path / name, text)]).wind
        assert found.ratio.tolist() == [0.1, 0.3]
        assert found.thrust.tolist() == [0.13, 0.1]
        assert found.torque == pytest.approx([0.01, 0.05 / (2 * math.pi)])
    together = read_tables([tmp_path / "uiuc.txt", tmp_path / "own.csv"]).wind
    assert len(together.ratio) == 4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no measurements"),
        ("J,CT,CP\n", "no measurements"),
        ("J,CT\n0,0.1\n", "no column CQ or CP in the heading 'J, CT'"),
        ("CT,CP\n0,0.1\n", "no column J"),
        ("J,CT,CT,CP\n", "two columns CT"),
        ("J,CT,CP\n0.1,0.1\n", "line 2: CP is '', expected a number from -2 to 2"),
        ("J,CT,CP\n0.1,abc,0\n", "line 2: CT is 'abc', expected a number"),
        ("J,CT,CP\n0.1,nan,0\n", "line 2: CT is 'nan'"),
        ("J,CT,CP\n45,0.1,0.1\n", "line 2: J is '45', expected a number from -3 to 3"),
        ("J,CT,CP\n0.1,0.1," + "9" * 500 + "\n", "line 2: CP is '999"),
        ("J,CT,CP\n" + "0,0.1,0.1\n" * 10_001, "more than 10000 rows"),
    ],
)
def test_a_damaged_table_is_one_line_with_its_place(tmp_path: Path, text: str, message: str) -> None:
    path = table(tmp_path / "t.csv", text)
    with pytest.raises(DynoError) as caught:
        read_tables([path])
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


def test_measurements_that_show_no_curve_are_refused() -> None:
    few = Measurements(np.array([0.1, 0.1, 0.3]), np.full(3, 0.1), np.full(3, 0.01))
    with pytest.raises(DynoError, match="2 different advance ratios with thrust, expected at least 3"):
        fit_propeller(few)
    swapped = measured()
    with pytest.raises(DynoError, match=r"CQ is .* at J = 0 by the fit, expected above 0"):
        fit_propeller(Measurements(swapped.ratio, swapped.thrust, -swapped.torque))
    rising = Measurements(swapped.ratio, 0.1 * (1 + 3 * swapped.ratio), swapped.torque)
    with pytest.raises(DynoError, match="expected at most 2: most coefficients are negative"):
        fit_propeller(rising, degree=1)


def test_plot_draws_both_coefficients() -> None:
    left, right = draw_coefficients(fit_propeller(measured(0.01, last=0.6)), "prop").axes
    assert left.get_title(loc="left").startswith("C_T = 0.1")
    assert right.get_title(loc="left").startswith("C_Q = 0.01")
    assert len(left.lines) == 3
