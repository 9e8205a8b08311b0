"""Thrust stands' logs in the forms of their programs, made here of known coefficients, read and fitted."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.model import FOLDER, RPM, load_aircraft
from neuroflight.sim.identification.dyno.headings import Quantity, known_unit, read_heading
from neuroflight.sim.identification.dyno.points import fit_points
from neuroflight.sim.identification.dyno.stand import Choices, choices, read_logs
from neuroflight.toolchain.errors import DynoError
from tests.sampling import examples

K_T, K_Q = 1.4e-6, 0.0123  # of the stand that is made up, N s^2/rad^2 and m
NOTHING = Choices()
# The heading of RCbenchmark's program 1.x, as its logs have it.
RCBENCHMARK = (
    "Time (s),ESC signal (µs),Servo 1 (µs),AccX (g),Torque (N·m),Thrust (gf),Voltage (V),Current (A),"
    "Motor Electrical Speed (RPM),Motor Optical Speed (RPM),Electrical Power (W),Motor Efficiency (%),"
    "Overall Efficiency (gf/W),Vibration (g),App message,"
)


@dataclass(frozen=True)
class Fitted:
    """The result of `dyno fit`."""

    thrust: float
    torque: float | None
    document: dict[str, Any]


class Bench:
    """A folder of logs, and what `dyno fit` says of them."""

    def __init__(self, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
        self.folder, self._capsys = folder, capsys

    def write(self, lines: list[str], heading: str = RCBENCHMARK, encoding: str = "utf-8-sig") -> Path:
        path = self.folder / "StepsTest.csv"
        path.write_bytes("\r\n".join([heading, *lines, ""]).encode(encoding))
        return path

    def fitted(self, path: Path, *words: str) -> Fitted:
        """Return the coefficients of `dyno fit`."""
        self._capsys.readouterr()
        assert main(["dyno", "fit", str(path), "--json", *words]) == 0
        document = json.loads(self._capsys.readouterr().out)
        torque = document["torque_ratio_m"]
        return Fitted(document["thrust_coefficient"][0]["value"], torque and torque[0]["value"], document)

    def refused(self, path: Path, *words: str) -> str:
        """Return the one line of the error with which `dyno fit` ends."""
        self._capsys.readouterr()
        assert main(["dyno", "fit", str(path), *words]) == 1
        error = self._capsys.readouterr().err
        assert error.count("\n") == 1
        return error


@pytest.fixture
def bench(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Bench:
    return Bench(tmp_path, capsys)


def speeds(count: int = 21) -> list[float]:
    return [float(w) for w in np.linspace(600.0, 2600.0, count)]


def steps(count: int = 21, *, sign: float = 1.0, optical: bool = False) -> list[str]:
    """Return averaged steps as RCbenchmark's script logs them, the first two rows with late times."""
    rows = []
    for k, w in enumerate(speeds(count)):
        time = 3.5 * k if k else 3.6
        rpm = w / RPM
        pair = f"0,{rpm!r}" if optical else f"{rpm!r},0"
        thrust = K_T * w * w
        rows.append(
            f"{time},{1000 + 40 * k},,-0.03,{sign * K_Q * thrust!r},{1000 * thrust / 9.80665!r},11.8,1.2,"
            f"{pair},14.6,6.3,1.3,0.21,,"
        )
    return rows


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-8", "cp1252", "utf-16"])
@pytest.mark.parametrize("optical", [False, True])
def test_averaged_steps_give_both_coefficients_as_they_are(
    bench: Bench, encoding: str, optical: bool
) -> None:
    found = bench.fitted(bench.write(steps(optical=optical), encoding=encoding))
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    assert found.torque == pytest.approx(K_Q, rel=1e-12)
    assert found.document["rows"] == 21
    assert found.document["response"] is None
    assert str(found.document["reason"]).startswith("the response cannot be known: StepsTest.csv has")
    assert found.document["speed_curve_rpm"] is None


def test_signs_of_a_stand_mounted_the_other_way_are_turned_and_told(bench: Bench) -> None:
    found = bench.fitted(bench.write(steps(sign=-1.0)))
    assert found.torque == pytest.approx(K_Q, rel=1e-12)
    assert any("torque is below 0" in str(note) for note in found.document["notes"])


def test_pulses_become_a_speed_curve_when_their_ends_are_given(bench: Bench) -> None:
    path = bench.write(steps())
    told = bench.fitted(path).document["notes"]
    assert any("--esc-us" in str(note) for note in told)
    curve = bench.fitted(path, "--esc-us", "1000", "1800").document["speed_curve_rpm"]
    a, b, c = (term["value"] for term in curve)
    assert c == pytest.approx(600 / RPM, rel=1e-3)
    assert a + b + c == pytest.approx(2600 / RPM, rel=1e-3)


def test_a_stand_without_torque_gives_thrust_alone(bench: Bench) -> None:
    heading = "Time (s),ESC signal (µs),Thrust (kgf),Motor Optical Speed (RPM)"
    rows = [f"{k},1500,{K_T * w * w / 9.80665!r},{w / RPM!r}" for k, w in enumerate(speeds())]
    path = bench.write(rows, heading)
    found = bench.fitted(path)
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    assert found.torque is None
    own = bench.folder / "own.toml"
    own.write_bytes((FOLDER / "nf1.toml").read_bytes())
    assert main(["dyno", "fit", str(path), "--write", str(own)]) == 0
    before, after = load_aircraft("nf1").propulsion, load_aircraft(own).propulsion
    assert after.thrust_coefficient[0] == pytest.approx(K_T, rel=1e-5)
    assert replace(after, thrust_coefficient=before.thrust_coefficient) == before


def test_sensors_read_in_turns_are_fitted_each_by_its_rows(bench: Bench) -> None:
    rows = []
    for k, w in enumerate(speeds(60)):
        thrust = K_T * w * w
        cells = ("", f"{thrust!r}") if k % 2 else (f"{-K_Q * thrust!r}", "")
        rows.append(f"{k * 0.01},,{cells[0]},{cells[1]},{w!r}")
    path = bench.write(rows, "Time (s),ESC signal (us),Torque (N m),Thrust (N),Speed (rad/s)")
    found = bench.fitted(path)
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    assert found.torque == pytest.approx(K_Q, rel=1e-12)


def test_a_dense_log_with_a_throttle_is_a_recording_and_shows_the_response(bench: Bench) -> None:
    own = bench.folder / "own.csv"
    run = "dyno run --aircraft nf1 --experiment steps --noise 0.5 --seed 3 --out"
    assert main([*run.split(), str(own)]) == 0
    truth = bench.fitted(own).document
    lines = own.read_text().splitlines()[1:]
    rows = ["0,1000,0,0,0", "0,1000,0,0,0"]
    for line in lines:
        t, u, rpm, thrust, torque = (float(cell) for cell in line.split(","))
        rows.append(f"{t + 0.01},{1000 + 1000 * u},{-torque * 100},{thrust / 0.00980665},{rpm * 7}")
    heading = "Time (s);ESC signal (µs);Torque (N·cm);Thrust (gf);eRPM"
    path = bench.write([row.replace(",", ";") for row in rows], heading, "cp1252")
    assert "counts electrical turns" in bench.refused(path)
    words = ("--poles", "14", "--esc-us", "1000", "2000")
    found = bench.fitted(path, *words).document
    assert found["response"]["kind"] == truth["response"]["kind"]
    for name in ("thrust_coefficient", "torque_ratio_m", "speed_curve_rpm"):
        for mine, other in zip(found[name], truth[name], strict=True):
            assert mine["value"] == pytest.approx(other["value"], rel=2e-3)
    without = [row.replace(",", ";") for row in (",".join(np.delete(row.split(","), 2)) for row in rows)]
    path = bench.write(without, heading.replace("Torque (N·cm);", ""), "cp1252")
    found = bench.fitted(path, *words).document
    assert found["torque_ratio_m"] is None and found["torque_mae_n_m"] is None
    assert found["response"]["kind"] == truth["response"]["kind"]


def test_a_rotor_in_wind_is_told_and_not_written(bench: Bench) -> None:
    rows = [f"{K_T * w * w - 5.0},{w},{-0.05 * w / 2600}" for w in speeds()]
    path = bench.write(rows, "Thrust (N),Speed (rad/s),Torque (N·m)")
    warned = bench.fitted(path).document["warnings"]
    assert "was it in wind?" in warned[0]
    own = bench.folder / "own.toml"
    own.write_bytes(before := (FOLDER / "nf1.toml").read_bytes())
    assert "is not written: thrust does not follow" in bench.refused(path, "--write", str(own))
    assert own.read_bytes() == before


def test_slips_of_the_speed_sensor_are_left_out_and_counted(bench: Bench) -> None:
    lines = steps(40)
    cells = lines[30].split(",")
    cells[8] = str(2 * float(cells[8]))
    lines[30] = ",".join(cells)
    found = bench.fitted(bench.write(lines))
    assert found.document["slips"] == 1
    assert found.thrust == pytest.approx(K_T, rel=1e-12)


def test_two_sensors_of_speed_that_disagree_are_told(bench: Bench) -> None:
    rows = [f"{K_T * w * w},{w * 7},{w}" for w in speeds()]
    path = bench.write(rows, "Thrust (N),Electrical Speed (rad/s),Optical Speed (rad/s)")
    found = bench.fitted(path)
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    assert any("7 times as large" in str(note) for note in found.document["notes"])
    assert bench.fitted(path, "--poles", "14").document["notes"][0].startswith("speed is")


@pytest.mark.parametrize(
    ("heading", "words", "message"),
    [
        ("Thrust,RPM", [], "column 'Thrust' names no unit: --unit thrust=UNIT (N, gf, kgf, ozf, lbf, ..)"),
        ("Thrust (stone),RPM", [], "has a unit that is not known, 'stone': --unit thrust=UNIT (N, gf"),
        ("Thrust (N),Speed", [], "column 'Speed' names no unit: --unit speed=UNIT (rpm, rad/s, Hz, ..)"),
        ("Thrust (N),eRPM", [], "counts electrical turns; give the motor's magnets by --poles"),
        ("Thrust A (N),Thrust B (N),RPM", [], "2 columns may be the thrust: 'Thrust A (N)', 'Thrust B (N)'"),
        ("Push (N),RPM", [], "no line names a thrust and a speed"),
        ("Thrust (N),RPM", ["--column", "thrust=Push (N)"], "0 columns of that name"),
        ("Thrust (N),RPM", ["--unit", "thrust=stone"], "thrust=stone: unknown; expected one of: N, gf"),
        ("Thrust (N),RPM", ["--unit", "push=N"], "expected QUANTITY=... with one of: time, throttle, speed"),
        ("Thrust (N),RPM", ["--poles", "7"], "--poles 7, expected an even number"),
        ("Thrust (N),RPM", ["--esc-us", "2000", "1000"], "--esc-us 2000 1000, expected the pulse of 0"),
        (
            "Thrust (N),RPM,Throttle",
            [],
            "'Throttle' names no unit: --unit throttle=UNIT (fraction, %, us, ..)",
        ),
        ("Thrust (N),RPM,throttle", [], "'throttle' reaches 900, expected 0 to 1; is it in percent"),
        ("Time (\N{REPLACEMENT CHARACTER}s),Thrust (N),RPM", [], "unit that is not known, '?s'"),
    ],
)
def test_what_headings_do_not_tell_is_asked_for_in_one_line(
    bench: Bench, heading: str, words: list[str], message: str
) -> None:
    count = heading.count(",") + 1
    rows = [",".join([str(100 * k)] * count) for k in range(1, 10)]
    assert message in bench.refused(bench.write(rows, heading, "utf-8"), *words)


def test_all_units_that_are_lacking_are_asked_for_at_once(bench: Bench) -> None:
    """Fit the log of a hobby bench whose heading has names without units."""
    rows = [
        f"{10 * k};{1000 + 40 * k};{K_T * w * w / 9.80665e-3!r};{w / RPM!r}" for k, w in enumerate(speeds(60))
    ]
    error = bench.refused(bench.write(rows, "time;throttle;thrust;rpm"))
    assert "--unit time=UNIT (s, ms, us, ..), and 'thrust' names no unit: --unit thrust=UNIT" in error
    words = ("--unit", "time=ms", "--unit", "thrust=gf", "--unit", "throttle=us", "--esc-us", "1000", "3400")
    found = bench.fitted(bench.write(rows, "time;throttle;Pull;rpm"), "--column", "thrust=Pull", *words)
    assert found.thrust == pytest.approx(K_T, rel=1e-3)


def test_units_below_the_heading_and_in_the_cells_are_read(bench: Bench) -> None:
    rows = [f"{5 * k} %;{K_T * w * w / 9.80665!r};{w / RPM!r}" for k, w in enumerate(speeds(20), 1)]
    path = bench.write(["%;(kgf);[rpm]", *rows], "Throttle;Thrust;Speed")
    found = bench.fitted(path)
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    path = bench.write(rows, "Throttle;Thrust (kgf);RPM")
    curve = bench.fitted(path).document["speed_curve_rpm"]
    assert sum(term["value"] for term in curve) == pytest.approx(2600 / RPM, rel=1e-3)


def test_decimal_commas_of_three_digits_in_one_column_are_told_by_the_others(bench: Bench) -> None:
    rows = [
        f"{k},100;{number(K_T * w * w, ',', '')};{number(w, ',', '')}" for k, w in enumerate(speeds(30), 1)
    ]
    path = bench.write(rows, "Time (s);Thrust (N);Speed (rad/s)")
    found = bench.fitted(path)
    assert found.thrust == pytest.approx(K_T, rel=1e-6)
    assert re.search("has a row each 1 s|no throttle", str(found.document["reason"]))


def test_messages_and_columns_of_a_script_behind_a_row_are_passed_over(bench: Bench) -> None:
    lines = steps()
    lines[3] = lines[3].removesuffix(",") + "Cutoff: thrust (val=-1.02, limit=-1.02),"
    lines[5] += "3500,-156,-1000,"
    found = bench.fitted(bench.write(lines))
    assert found.thrust == pytest.approx(K_T, rel=1e-12) and found.document["rows"] == 21
    cut = ["0,5,1,2,1000,note", "1,0,2,4,2000,note", "1,5,3,6,3000,note"]  # decimal commas between commas
    path = bench.write(cut, "Time (s),Thrust (N),RPM,App message")
    assert "line 2: 6 columns, expected 4 as in the heading" in bench.refused(path)
    path = bench.write(["1.5,2,1000", "2.5,4,2000"], "Thrust (N),RPM")
    assert "line 2: 3 columns, expected 2" in bench.refused(path)


def test_words_in_the_throttle_and_dates_leave_them_out(bench: Bench) -> None:
    """Fit a table whose throttle column has words and percents: IDLE, 25 %, ..."""
    levels = ["IDLE", *(f"{k}%" for k in range(25, 125, 25))]
    rows = [
        f"2024-05-01 12:00:0{k},{level},{1000 * K_T * w * w / 9.80665!r},{w / RPM!r}"
        for k, (level, w) in enumerate(zip(levels, speeds(5), strict=True))
    ]
    found = bench.fitted(bench.write(rows, "Timestamp,Throttle,Thrust (g),RPM"))
    assert found.thrust == pytest.approx(K_T, rel=1e-12)
    assert found.document["speed_curve_rpm"] is None
    assert "'Throttle' holds 'IDLE': it is left out" in found.document["notes"]


def test_a_log_of_too_few_levels_is_named(bench: Bench) -> None:
    assert "StepsTest.csv: 2 rows with a turning rotor, expected at least 3" in bench.refused(
        bench.write(steps(2))
    )
    still = [row.replace(row.split(",")[8], "0") for row in steps()]
    assert "StepsTest.csv: the rotor's speed is 0 in every row" in bench.refused(bench.write(still))
    assert "StepsTest.csv: no rows below the heading" in bench.refused(bench.write([]))


def test_a_blackbox_log_is_called_what_it_is(bench: Bench) -> None:
    path = bench.folder / "LOG00001.TXT"
    path.write_bytes(b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\n\0")
    assert "a blackbox log, which has no thrust and no torque" in bench.refused(path)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (["1,000", "2,500", "4,500"], "has it a decimal comma? Nothing in the file tells"),
        (["1,5", "2.5", "4.5"], "numbers with a decimal comma and with a point"),
        (["1.5", "2.5x", "4.5"], "line 3: Thrust (N) is '2.5x', expected a number"),
        (["1.5", "inf", "4.5"], "line 3: Thrust (N) is 'inf', expected a number"),
    ],
)
def test_numbers_that_can_be_read_in_two_ways_are_refused(
    bench: Bench, cells: list[str], message: str
) -> None:
    rows = [f"{cell};{1000 * k}" for k, cell in enumerate(cells, 1)]
    assert message in bench.refused(bench.write(rows, "Thrust (N);RPM"))


def test_names_of_other_things_are_no_quantities() -> None:
    for text in (
        "Overall Efficiency (gf/W)", "Propeller Mech. Efficiency (N/W)", "Vibration (g)", "AccX (g)", "",
        "Servo 1 (µs)", "Mechanical Power (W)", "4N76 Temp (ºC)", "ESC temperature (C)", "Airspeed (m/s)",
        "T (C)", "App message",
    ):  # fmt: skip
        assert read_heading(text) is None, text


# The independent reading: factors of units to SI as tables print them, applied here by hand.
THRUST = {
    "N": 1.0,
    "gf": 0.00980665,
    "g": 0.00980665,
    "kgf": 9.80665,
    "kg": 9.80665,
    "lbf": 4.4482216,
    "ozf": 0.27801385,
}
TORQUE = {
    "N·m": 1.0, "Nm": 1.0, "N*m": 1.0, "N.m": 1.0, "mN·m": 1e-3, "N·cm": 1e-2, "gf·cm": 9.80665e-5,
    "kgf·cm": 0.0980665, "ozf·in": 7.0615518e-3, "oz-in": 7.0615518e-3, "lbf·in": 0.11298483,
    "in-lbf": 0.11298483, "lbf·ft": 1.3558179,
}  # fmt: skip
SPEED = {
    "rpm": 0.10471976,
    "RPM": 0.10471976,
    "rad/s": 1.0,
    "Hz": 6.2831853,
    "rps": 6.2831853,
    "1/min": 0.10471976,
}
FORMS = ("{} ({})", "{} [{}]", "{}({})", "{} - {}")


def number(value: float, decimal: str, thousands: str) -> str:
    """Format a number as spreadsheets of different countries do."""
    minus = "-" if thousands else "\N{MINUS SIGN}"  # as some spreadsheets write it
    text = f"{value:,.9f}" if abs(value) >= 1 else f"{value:.9g}" if abs(value) > 1e-4 else f"{value:.15f}"
    if "e" not in text:
        text = text.replace("-", minus)
    return text.replace(",", "T").replace(".", decimal).replace("T", thousands)


@settings(
    max_examples=examples(300), deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_every_mix_of_units_marks_and_encodings_gives_the_same_rotor(
    tmp_path: Path, data: st.DataObject
) -> None:
    draw = data.draw
    thrust_unit, torque_unit = draw(st.sampled_from(sorted(THRUST))), draw(st.sampled_from(sorted(TORQUE)))
    speed_unit = draw(st.sampled_from(sorted(SPEED)))
    k_t, k_q = draw(st.floats(1e-8, 1e-4)), draw(st.floats(1e-3, 0.1))
    thrust_sign, torque_sign = draw(st.sampled_from([1, -1])), draw(st.sampled_from([1, -1]))
    w = np.array(draw(st.lists(st.floats(50, 4000), min_size=5, max_size=30, unique=True)))
    mark, decimal = draw(
        st.sampled_from([(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", ".")])
    )
    thousands = draw(st.sampled_from(["", " ", {".": ",", ",": "."}[decimal]])) if mark != "," else ""
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", *(["cp1252"] if thousands else [])]))
    form = draw(st.sampled_from(FORMS))
    columns = {
        form.format("Thrust", thrust_unit): thrust_sign * k_t * w**2 / THRUST[thrust_unit],
        form.format("Torque", torque_unit): torque_sign * k_q * k_t * w**2 / TORQUE[torque_unit],
        form.format(draw(st.sampled_from(["Motor Optical Speed", "Rotation speed"])), speed_unit): w
        / SPEED[speed_unit],
        "Overall Efficiency (gf/W)": np.full(len(w), 0.25),
        "App message": None,
    }
    order = draw(st.permutations(sorted(columns)))
    before = draw(
        st.sampled_from([[], ["# bench 3"], ["Motor: X 2207", "Propeller: 5x4.3x3", ""], ["sep=" + mark]])
    )
    quote = draw(st.sampled_from(["", '"']))
    lines = [*before, mark.join(f"{quote}{name}{quote}" for name in order)]
    for row in range(len(w)):
        cells = []
        for name in order:
            column = columns[name]
            cells.append("" if column is None else number(float(column[row]), decimal, thousands))
        lines.append(mark.join(f"{quote}{cell}{quote}" for cell in cells))
    path = tmp_path / "log.csv"
    path.write_bytes(draw(st.sampled_from(["\n", "\r\n"])).join([*lines, ""]).encode(encoding))
    _, stands, reason = read_logs([path], NOTHING)
    found = fit_points(stands, reason)
    assert found.thrust_coefficient[0].value == pytest.approx(k_t, rel=1e-5)
    assert found.torque_ratio[0].value == pytest.approx(k_q, rel=1e-5)


def test_every_unit_that_is_known_is_asked_for_by_its_own_name() -> None:
    for texts, quantity in ((THRUST, Quantity.THRUST), (TORQUE, Quantity.TORQUE), (SPEED, Quantity.SPEED)):
        for text in texts:
            assert known_unit(quantity, text) is not None, text
    assert choices([], ["thrust=gf", "time=ms"], None, None).units == {
        Quantity.THRUST: "gf",
        Quantity.TIME: "ms",
    }
    with pytest.raises(DynoError, match="expected QUANTITY="):
        choices(["thrust"], [], None, None)
