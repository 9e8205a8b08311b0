"""Propellers' tables in the forms of APC and the UIUC database, made here of known curves."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft
from neuroflight.sim.identification.propeller_tables import read_tables
from neuroflight.toolchain.errors import DynoError
from tests.sampling import examples

Rows = list[tuple[float, float, float]]  # J or rpm, C_T, C_P
UNITS = "(mph)     (Adv_Ratio)     -          -           -          (Hp)        (In-Lbf)     (Lbf)      (W)"
HEADING = "V          J           Pe         Ct          Cp          PWR         Torque      Thrust      PWR"


def curve(scale: float = 1.0) -> Rows:
    """Return points of C_T = 0.12 (1 - 0.5 J - 0.5 J^2) and C_P = 0.06 (1 + 0.3 J - 0.9 J^2)."""
    ratios = [float(j) for j in np.linspace(0.0, 0.9, 19)]
    return [
        (j, scale * 0.12 * (1 - 0.5 * j - 0.5 * j * j), 0.06 * (1 + 0.3 * j - 0.9 * j * j)) for j in ratios
    ]


def apc(blocks: dict[int, Rows], damage: str = "") -> str:
    """Write a file like APC's PER3_*.dat; damage: Ct's text in a further row of each block."""
    lines = [
        "         5x4.3                    (5x43.dat)",
        "",
        "         DEFINITIONS:",
        "         J=V/nD (advance ratio)",
    ]
    for rpm, rows in blocks.items():
        lines += ["", f"         PROP RPM =  {rpm:9d}", "", f"         {HEADING}", f"       {UNITS}"]
        lines += [
            f"   {j * 9:10.2f} {j:11.6f} {0.1:10.4f} {t:12.8f} {p:12.8f} {1:9.3f} {2:9.3f} {3:9.3f} 1.0"
            for j, t, p in rows
        ]
        if damage:
            lines.append(f"   12.00 0.95 0.1 {damage} 0.05 1.0 2.0 3.0 1.0")
    return "\r\n".join(lines) + "\r\n"


def static(rows: Rows, names: str = "RPM    CT       CP") -> str:
    """Write a file like the UIUC database's *_static_*.txt."""
    return "\n".join([names, *(f"{rpm:.0f}   {t:.6f}   {p:.6f}" for rpm, t, p in rows)]) + "\n"


def save(path: Path, text: str) -> Path:
    path.write_bytes(text.encode())
    return path


def command(capsys: pytest.CaptureFixture[str], *words: str | Path) -> dict[str, object]:
    capsys.readouterr()
    assert main(["aircraft", "propeller", *map(str, words), "--json"]) == 0
    document: dict[str, object] = json.loads(capsys.readouterr().out)
    return document


def test_one_speed_of_apcs_is_fitted_or_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = save(
        tmp_path / "PER3_5x43.dat", apc({10_000: curve(0.9), 20_000: curve(), 30_000: curve(1.1)}, "-NaN")
    )
    one = command(capsys, path, "--rpm", "21900")
    assert one["speeds_rpm"] == [20_000.0] and one["rows"] == 19
    assert one["advance_ratio"] == {"thrust": [-0.5, -0.5], "torque": [0.3, -0.9]}
    assert one["thrust"]["static"] == pytest.approx(0.12, rel=1e-5)  # type: ignore[index]
    assert one["notes"] == ["of 3 speeds from 10000 to 30000 rpm, 20000 rpm is taken"]
    every = command(capsys, path)
    assert every["rows"] == 57 and len(every["speeds_rpm"]) == 3  # type: ignore[arg-type]
    assert every["thrust"]["static"] == pytest.approx(0.12, rel=1e-5)  # type: ignore[index]


def test_a_table_at_rest_gives_coefficients_in_both_forms(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = save(tmp_path / "gwsdd_5x4.3_static_2500.txt", static([(2500, 0.10, 0.050), (5000, 0.12, 0.058)]))
    found = command(capsys, path, "--diameter", "0.127")
    c_t, c_q = 0.11, 0.054 / (2 * math.pi)
    assert found["c_t"] == pytest.approx(c_t) and found["c_q"] == pytest.approx(c_q)
    # T = C_T rho n^2 D^4 at 6000 rpm, over the square of 628.3 rad/s; Q likewise, over T.
    thrust, torque = c_t * 1.225 * 100.0**2 * 0.127**4, c_q * 1.225 * 100.0**2 * 0.127**5
    assert found["thrust_coefficient"] == pytest.approx(thrust / (200 * math.pi) ** 2)
    assert found["torque_ratio_m"] == pytest.approx(torque / thrust)
    assert found["advance_ratio"] is None
    assert command(capsys, path, "--rpm", "4900")["c_t"] == pytest.approx(0.12)
    assert command(capsys, path)["thrust_coefficient"] is None
    assert main(["aircraft", "propeller", str(path)]) == 0
    out = capsys.readouterr().out
    assert "c_t = 0.11\n" in out and "in a climb it does not tell" in out
    own = tmp_path / "own.toml"
    own.write_bytes((FOLDER / "nf1.toml").read_bytes())
    assert main(["aircraft", "propeller", str(path), "--write", str(own)]) == 0
    rotor = load_aircraft(own).propulsion
    diameter = rotor.propeller_diameter
    assert diameter is not None
    assert rotor.thrust_coefficient[0] == pytest.approx(
        c_t * 1.225 * diameter**4 / (2 * math.pi) ** 2, rel=1e-3
    )
    assert rotor.torque_ratio[0] == pytest.approx(c_q * diameter / c_t, rel=1e-3)


def test_measurements_at_rest_are_those_of_no_wind_beside_a_table_of_j(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late = [row for row in curve() if row[0] > 0.4]
    wind = save(tmp_path / "wind.txt", "J CT CP\n" + "".join(f"{j} {t} {p}\n" for j, t, p in late))
    rest = save(tmp_path / "static.txt", static([(4000, 0.12, 0.06), (5000, 0.12, 0.06)]))
    both = command(capsys, wind, rest)
    assert both["rows"] == len(late) + 2
    assert both["advance_ratio"] == {"thrust": [-0.5, -0.5], "torque": [0.3, -0.9]}


@pytest.mark.parametrize(
    ("text", "words", "message"),
    [
        ("r/R     c/R     beta\n0.15 0.1 30\n", [], "a blade's shape (r/R, c/R, beta)"),
        ("J CT CP\n0.1 0.1 0.05\n", ["--rpm", "5000"], "does not tell its speed; leave --rpm out"),
        (static([(2500, 0.1, 0.05)]), ["--plot", "a.png"], "has no curve over J; leave it out"),
        (static([(2500, -0.1, 0.05)]), [], "CT is -0.1 at rest, expected above 0"),
        (static([(2500, 0.1, 0.05)]), ["--diameter", "5.1"], "--diameter 5.1, expected 0.01 to 5 m"),
        (static([(2500, 0.1, 0.05)]), ["--rpm", "0"], "--rpm 0, expected above 0"),
        (static([(2500, 0.1, 7.0)]), [], "line 2: CP is '7.000000', expected a number from -2 to 2"),
        (apc({1000: []}), [], "no rows with J, Ct and Cp below 'PROP RPM"),
        (apc({1000: [(0.1, 9.0, 0.1)]}), [], "J, Ct or Cp of 1000 rpm beyond any propeller's"),
        (apc({1000: curve()}, "x1").replace("12.00 0.95", "x 0.95"), [], "expected a row of numbers"),
    ],
)
def test_what_is_no_table_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: list[str], message: str
) -> None:
    path = save(tmp_path / "t.txt", text)
    assert main(["aircraft", "propeller", str(path), *words]) == 1
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1


@settings(
    max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_every_form_of_a_table_holds_the_numbers_that_were_written(
    tmp_path: Path, data: st.DataObject
) -> None:
    draw = data.draw
    count = draw(st.integers(1, 12))
    thrust = np.array(draw(st.lists(st.floats(-0.3, 0.3), min_size=count, max_size=count)))
    power = np.array(draw(st.lists(st.floats(0.0, 0.4), min_size=count, max_size=count)))
    rest = draw(st.booleans())
    first = np.array(draw(st.lists(st.floats(0.0, 1.5), min_size=count, max_size=count))) * (
        10_000 if rest else 1
    )
    mark = draw(st.sampled_from(["   ", " ", ",", ";", "\t"]))
    names = {"RPM" if rest else "J": first, draw(st.sampled_from(["CT", "C_T", "Ct"])): thrust}
    torque = draw(st.booleans())
    names[draw(st.sampled_from(["CQ", "c_q"] if torque else ["CP", "Cp"]))] = power
    names["eta"] = np.full(count, 0.5)
    order = draw(st.permutations(list(names)))
    before = draw(st.sampled_from([[], ["# a propeller"], ["APC 5x4.3", ""]]))
    lines = [*before, mark.join(order)]
    lines += [mark.join(f"{names[name][row]:.9f}" for name in order) for row in range(count)]
    path = save(tmp_path / "t.txt", draw(st.sampled_from(["\n", "\r\n"])).join([*lines, ""]))
    found = read_tables([path])
    rows = (
        (found.rest.rpm, found.rest.thrust, found.rest.torque) if rest else tuple(vars(found.wind).values())
    )
    right = power if torque else power / (2 * math.pi)
    for mine, other in zip(rows, (first, thrust, right), strict=True):
        assert np.abs(mine - other).max() <= 1e-8 * max(1.0, float(np.abs(other).max()))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(DynoError, match=r"none\.dat: no such file"):
        read_tables([tmp_path / "none.dat"])
