"""Marks of an aircraft's numbers: what is read, and one line for what is refused."""

import tomllib

import pytest

from neuroflight.sim.aircraft.known import How, Known, keys_of, known_line, mark_of
from neuroflight.sim.aircraft.model import FOLDER, load_aircraft, parse_aircraft
from neuroflight.toolchain.errors import AircraftError

NF1 = (FOLDER / "nf1.toml").read_text()
MARKS = {
    "propulsion.delay_s": Known(How.TYPICAL, None, "DShot600"),
    "propulsion.speed_curve_rpm": Known(How.MEASURED, None, "a dynamometer"),
    "propulsion.speed_curve_rpm[1]": Known(How.MEASURED, (38000.0, 40000.0), 'of "the" rotor, 5 %'),
    "part.flight stack.mass_kg": Known(How.GUESSED),
    "rotor.propeller_m": Known(How.MEASURED, None, "a ruler"),
    "motor_part.inertia_kg_m2[2]": Known(How.GUESSED, (1e-6, 3e-6), "a cylinder"),
    "body": Known(How.GUESSED),
    "part": Known(How.TYPICAL, None, "a page"),
    "part.battery": Known(How.MEASURED, None, "a scale"),
    "centre_of_thrust_m": Known(How.MEASURED, None, "a ruler"),
}


def marked(*lines: str) -> bytes:
    return (NF1 + "\n[known]\n" + "\n".join(lines) + "\n").encode()


def test_marks_come_back_as_written_and_change_nothing_that_is_flown() -> None:
    aircraft = parse_aircraft(marked(*(known_line(*each) for each in MARKS.items())), "mine")
    assert aircraft.known == MARKS
    assert aircraft.sha256 == load_aircraft("nf1").sha256


@pytest.mark.parametrize(
    ("key", "nearest"),
    [
        ("propulsion.delay_s", "propulsion.delay_s"),
        ("propulsion.speed_curve_rpm[1]", "propulsion.speed_curve_rpm[1]"),
        ("propulsion.speed_curve_rpm[0]", "propulsion.speed_curve_rpm"),
        ("part.battery.mass_kg", "part.battery"),
        ("part.frame.mass_kg", "part"),
        ("body.size_m[2]", "body"),
        ("gyro.bias_deg_s", ""),
    ],
)
def test_number_has_the_nearest_mark(key: str, nearest: str) -> None:
    assert mark_of(MARKS, key) is MARKS.get(nearest)


def test_every_number_of_a_file_can_be_marked() -> None:
    keys = keys_of(tomllib.loads(NF1))
    lines = (known_line(key, Known(How.GUESSED)) for key in keys)
    assert list(parse_aircraft(marked(*lines), "mine").known) == keys
    assert {"part.battery.mass_kg", "propulsion.response.gain", "body.drag_area_m2"} <= set(keys)
    assert not [key for key in keys if key.startswith(("pid", "format")) or key.endswith(("name", "spin"))]


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('"propulsion.dealy_s" = { how = "guessed" }', "propulsion.dealy_s: names no number of this file"),
        ('"part.wing.mass_kg" = { how = "guessed" }', "part.wing.mass_kg: names no number"),
        ('"rotor.spin" = { how = "guessed" }', "rotor.spin: names no number"),
        ('"pid.flying.roll" = { how = "guessed" }', "pid.flying.roll: names no number"),
        ('"propulsion.delay_s[0]" = { how = "guessed" }', "names no number"),
        ('"propulsion.speed_curve_rpm[3]" = { how = "guessed" }', "names no number"),
        ('"propulsion.delay_s" = { how = "known" }', "expected one of: measured, typical, guessed"),
        ('"propulsion.delay_s" = { how = "typical" }', "propulsion.delay_s.from: missing"),
        (
            '"propulsion.delay_s" = { how = "guessed", form = "x" }',
            "form: unknown key; known here: from",
        ),
        ('"propulsion.delay_s" = { how = "guessed", range = [2, 1] }', "expected the lower bound first"),
        ('"gyro.noise_deg_s" = { how = "guessed", range = [1, 2] }', "gyro.noise_deg_s: has several numbers"),
        ('"body" = { how = "guessed", range = [1, 2] }', "body: has several numbers"),
        ('"part.wing" = { how = "guessed" }', "part.wing: names no number"),
        ('"propulsion.delay_s" = 3', "expected a table"),
    ],
)
def test_wrong_mark_is_refused_by_one_line_that_names_it(line: str, told: str) -> None:
    with pytest.raises(AircraftError, match=told) as refused:
        parse_aircraft(marked(line), "mine")
    assert "\n" not in str(refused.value)
