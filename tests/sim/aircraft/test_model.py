"""Aircraft files: what is read, and one line naming the key for what is refused."""

import copy
import functools
import hashlib
import math
import operator
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import neuroflight.sim.aircraft.model
from neuroflight.sim.aircraft.digest import EARLIER, flown_sha256
from neuroflight.sim.aircraft.mesh import BYTES_MAX
from neuroflight.sim.aircraft.model import (
    FOLDER,
    NAME,
    Aircraft,
    aircraft_file,
    load_aircraft,
    parse_aircraft,
    shipped,
    thrust_coefficient,
    torque_ratio,
)
from neuroflight.sim.aircraft.pid_write import write_pid
from neuroflight.toolchain.errors import AircraftError
from neuroflight.toolchain.policy.model import AIRCRAFT_NAME
from neuroflight.toolchain.strict_toml import StrictTable, Value

NF1 = (FOLDER / "nf1.toml").read_text()
DOCS = Path(__file__).parents[3] / "docs"
KEYS = (DOCS / "reference" / "aircraft.md").read_text()
FRAME_INERTIA = "inertia_kg_m2 = [1.6783e-4, 1.1834e-4, 2.7257e-4]"


def replaced(pattern: str, text: str) -> bytes:
    changed, count = re.subn(pattern, text, NF1, count=1, flags=re.MULTILINE)
    assert count == 1, pattern
    return changed.encode()


def put(key: str, value: str) -> bytes:
    """The NF1 with another value of the first such key."""
    return replaced(rf"^{key} = .*$", f"{key} = {value}")


def mass(lines: str) -> bytes:
    """The NF1 with these lines in place of its battery's mass."""
    return replaced(r"^mass_kg = 0.194$", lines)


def with_frame(lines: str) -> str:
    """The NF1 with its frame's inertia and centre of mass given some other way."""
    begin = NF1.index("centre_of_mass_m = [0.0, 0.0, 0.007083]")
    end = NF1.index(FRAME_INERTIA) + len(FRAME_INERTIA)
    return NF1[:begin] + lines + NF1[end:]


def brick() -> bytes:
    data = trimesh.creation.box((142, 171, 35)).export(file_type="stl")
    assert isinstance(data, bytes)
    return data


@pytest.mark.parametrize(("name", "motors"), [("nf1", 4), ("iris", 4), ("hexa", 6)])
def test_shipped_aircraft_number_their_corners_as_on_the_bench_when_loaded(name: str, motors: int) -> None:
    aircraft = load_aircraft(name)
    x, y = aircraft.rotor_positions[:4, :2].T
    assert name in shipped() and aircraft.motor_count == motors
    assert np.sign(x).tolist() == [-1, 1, -1, 1]
    assert np.sign(y).tolist() == [-1, -1, 1, 1]


@pytest.mark.parametrize("name", ["nf1", "iris"])  # the Iris's follow from the yaw column of its mixer
def test_quadcopters_turn_their_propellers_in_when_loaded(name: str) -> None:
    assert load_aircraft(name).spins.tolist() == [-1, 1, 1, -1]


def test_hexa_neighbours_turn_against_each_other() -> None:
    aircraft = load_aircraft("hexa")
    around = np.argsort(np.arctan2(aircraft.rotor_positions[:, 1], aircraft.rotor_positions[:, 0]))
    spins = aircraft.spins[around].tolist()
    assert all(one == -other for one, other in pairwise([*spins, spins[0]]))
    apart = np.hypot(*(aircraft.rotor_positions[around] - aircraft.rotor_positions[np.roll(around, 1)]).T[:2])
    assert apart == pytest.approx([0.275] * 6, abs=1e-4)


def test_iris_has_its_published_mass_and_axial_moments_when_loaded() -> None:
    found = load_aircraft("iris").mass_properties
    assert found.mass == pytest.approx(1.5 + 4 * 0.025)
    hubs = 2 * (0.13**2 + 0.22**2) + 2 * (0.13**2 + 0.20**2)
    assert found.inertia[2, 2] == pytest.approx(0.017 + 4 * 1.676e-4 + 0.025 * hubs)


@pytest.mark.parametrize(
    ("text", "by"),
    [
        ('name = "nf1"', 'name = "mine"'),
        ("mass_kg = 0.066", "mass_kg = 6.60e-2 # weighed again"),
        ("cells = 4\ncapacity_ah = 1.5", "capacity_ah = 1.50\ncells = 4"),
        ('name = "frame"', 'name = "carbon frame"'),
        ("[gyro]", "# a line\n\n[gyro]"),
        ("position_m = [0.0, 0.0, 0.037]", "position_m = [0, 0, 0.037]"),
        ("\n", "\r\n"),
    ],
)
def test_digest_stays_when_the_file_says_the_same_in_other_words(tmp_path: Path, text: str, by: str) -> None:
    assert text in NF1
    path = tmp_path / "mine.toml"
    path.write_bytes(NF1.replace(text, by).encode())
    assert load_aircraft(path).sha256 == load_aircraft("nf1").sha256
    assert load_aircraft(path).file_sha256 != load_aircraft("nf1").file_sha256


def test_digest_stays_when_the_pid_is_another(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    settings = replace(load_aircraft("nf1").pids[0][1], gains=((1.0, 2.0, 3.0),) * 3)
    write_pid(FOLDER / "nf1.toml", path, "mine", settings, "")
    assert load_aircraft(path).pids[0] == ("mine", settings)
    assert load_aircraft(path).sha256 == load_aircraft("nf1").sha256


def test_digest_changes_when_the_twin_flies_another_number() -> None:
    """Every number, choice and list of the file but those of names and PIDs."""
    document = tomllib.loads(NF1)
    found = flown_sha256(document, no_mesh)
    places = [place for place in leaves(document) if place[0] not in {"pid", "description"}]
    assert len(places) > 100
    for place in places:
        changed = copy.deepcopy(document)
        *way, last = place
        at = functools.reduce(operator.getitem, way, changed)
        at[last] = at[last] + "x" if isinstance(at[last], str) else at[last] * 1.001 + 1e-12
        assert (flown_sha256(changed, no_mesh) == found) == (last == "name"), place


def no_mesh(name: str) -> bytes:
    raise AssertionError(name)


def leaves(value: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, each in items:
        yield from leaves(each, (*way, key)) if isinstance(each, dict | list) else [(*way, key)]


def test_digest_of_a_file_stays_known_when_a_policy_holds_it(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_bytes(NF1.replace("capacity_ah = 1.5", "capacity_ah = 1.3").encode())
    mine, nf1 = load_aircraft(path), load_aircraft("nf1")
    assert mine.is_meant_by(hashlib.sha256(path.read_bytes()).hexdigest())
    assert mine.is_meant_by(mine.sha256) and not mine.is_meant_by(nf1.sha256)
    earlier = [digest for digest, flown in EARLIER.items() if flown == nf1.sha256]
    assert len(earlier) == 3
    assert all(nf1.is_meant_by(digest) and not mine.is_meant_by(digest) for digest in earlier)


def test_digests_of_before_are_of_aircraft_that_ship() -> None:
    assert set(EARLIER.values()) == {load_aircraft(name).sha256 for name in shipped()}


def test_hash_covers_the_mesh_when_a_part_has_one(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(with_frame('mesh = "cad/frame.stl"\nmesh_unit_m = 0.001'))
    (tmp_path / "cad").mkdir()
    (tmp_path / "cad" / "frame.stl").write_bytes(brick())
    before = load_aircraft(path)
    (tmp_path / "cad" / "frame.stl").write_bytes(b"a header".ljust(80) + brick()[80:])
    after = load_aircraft(path)
    assert before.sha256 != after.sha256
    assert before.mass_properties.inertia == pytest.approx(after.mass_properties.inertia)


def test_mesh_box_and_numbers_agree_when_they_describe_one_frame(tmp_path: Path) -> None:
    (tmp_path / "frame.stl").write_bytes(brick())
    x, y, z = 0.142**2, 0.171**2, 0.035**2
    moments = [0.066 / 12 * value for value in (y + z, z + x, x + y)]
    forms = (
        'mesh = "frame.stl"\nmesh_unit_m = 0.001',
        "box_m = [0.142, 0.171, 0.035]",
        f"centre_of_mass_m = [0, 0, 0]\ninertia_kg_m2 = {moments}",
        f"centre_of_mass_m = [0, 0, 0]\ninertia_kg_m2 = {[*moments, 0.0, 0.0, 0.0]}",
    )
    found = [parse_aircraft(with_frame(form).encode(), "mine", tmp_path).mass_properties for form in forms]
    for other in found[1:]:
        assert other.inertia == pytest.approx(found[0].inertia, rel=1e-6, abs=1e-12)
        assert other.centre == pytest.approx(found[0].centre, abs=1e-9)


def test_yaw_and_rotation_agree_when_they_turn_alike() -> None:
    turned = replaced(r"^yaw_rad = 1.5708$", "rotation_rad = [0.0, 0.0, 1.5708]")
    expected = load_aircraft("nf1").mass_properties
    assert parse_aircraft(turned, "mine").mass_properties.inertia == pytest.approx(expected.inertia)


def test_coefficients_are_those_of_the_propeller_when_given_without_dimension() -> None:
    """At 100 revolutions a second the closed form in n and the project's in w give one thrust, one torque."""
    c_t, c_q, diameter, density, n = 0.12, 0.0076, 0.254, 1.2, 100.0
    thrust = c_t * density * n**2 * diameter**4
    assert thrust_coefficient(c_t, diameter, density) * (2 * math.pi * n) ** 2 == pytest.approx(thrust)
    assert torque_ratio(c_t, c_q, diameter) * thrust == pytest.approx(c_q * density * n**2 * diameter**5)
    dimensionless = "c_t = 0.12\nc_q = 0.0076\nair_density_kg_m3 = 1.2"
    text = replaced(r"^thrust_coefficient = .*$", dimensionless).decode()
    text = re.sub(r"^torque_ratio_m = .*$", "", text, flags=re.MULTILINE)
    text = text.replace("propeller_diameter_m = 0.12954", "propeller_diameter_m = 0.254")
    found = parse_aircraft(text.encode(), "mine").propulsion
    assert found.thrust_coefficient == (thrust_coefficient(0.12, 0.254, 1.2),)
    assert found.torque_ratio == (torque_ratio(0.12, 0.0076, 0.254),)
    assert found.propeller_diameter == 0.254


def test_propellers_collide_when_their_hubs_are_nearer_than_a_radius() -> None:
    near = re.sub(r"_m = \[(.*), (-?)0.07,", r"_m = [\1, \g<2>0.03,", NF1)  # 60 mm apart; a radius is 65 mm
    with pytest.raises(AircraftError, match=r"rotor\[2\].propeller_m: .* 60 mm from rotor\[0\]'s"):
        parse_aircraft(near.encode(), "mine")
    unknown = near.replace("propeller_diameter_m = 0.12954", "")
    assert parse_aircraft(unknown.encode(), "mine").propulsion.propeller_diameter is None


def test_coaxial_rotors_are_accepted_when_they_turn_in_two_planes() -> None:
    text = NF1.replace("[0.0805, -0.07, 0.058]", "[-0.0805, -0.07, 0.098]")
    assert parse_aircraft(text.encode(), "mine").motor_count == 4


def test_motors_and_propellers_have_no_part_when_left_out() -> None:
    text = re.sub(r"^motor_m = .*\n", "", NF1, flags=re.MULTILINE)
    begin, end = text.index("[motor_part]"), text.index("# Motor order of the bench")
    aircraft = parse_aircraft((text[:begin] + text[end:]).encode(), "mine")
    assert [part.name for part in aircraft.parts] == ["frame", "battery", "flight stack"]
    assert aircraft.motor_count == 4


def test_byte_order_mark_is_skipped_when_an_editor_left_one() -> None:
    assert parse_aircraft(b"\xef\xbb\xbf" + NF1.encode(), "mine").name == "nf1"


def test_names_fit_a_policy_when_they_fit_the_file() -> None:
    assert NAME.pattern == AIRCRAFT_NAME.pattern


RIGHT = r"\[-0.0805, -0.07, 0.058\]"
MASS = r"part\[1\].mass_kg: "
BAD = [
    (b"\xff\xfe", "not UTF-8: byte 0xff at 0"),
    (b"name = [", "not TOML: .*end of document"),
    (b"x = " + b"[" * 3000, "not TOML"),
    (b"mass = " + b"9" * 5000, "not TOML"),
    (mass("mass_kg = 0.194\nmass_kg = 0.2"), "Cannot overwrite.*'mass_kg = 0.2'"),
    (replaced(r"^\[gyro\]$", "[gyro]\n[gyro]"), "not TOML: .*gyro"),
    (put("format", "2"), "format: got 2"),
    (replaced(r"^name = .*$", ""), "name: missing"),
    (replaced(r"^name = .*$", 'name = "my quad"'), "name: got 'my quad', expected at most 32 letters"),
    (replaced(r"^name = .*$", r'name = "a\\nb"'), "name: got .*expected one line"),
    (mass("mass_kg = -0.194"), MASS + r"got -0.194"),
    (mass('mass_kg = "heavy"'), MASS + r"got 'heavy', expected a number"),
    (mass("mass_kg = true"), MASS + r"got True"),
    (mass("mass_kg = nan"), MASS + r"got nan"),
    (mass(f"mass_kg = {'9' * 4000}"), MASS + r"got 9{60}\.\.\."),
    (mass("mass = 0.194"), MASS + r"missing"),
    (mass("mass_kg = 0.194\ncolour = 3"), r"part\[1\].colour: unknown.*box_m"),
    (
        with_frame("").encode(),
        r"part\[0\].inertia_kg_m2: missing; give it or one of: mesh, box_m, cylinder_m",
    ),
    (with_frame("box_m = [0.1, 0.1]").encode(), r"part\[0\].box_m: got .*three numbers"),
    (with_frame("cylinder_m = [0.1, 0.1, 0.1]").encode(), r"part\[0\].cylinder_m: got 3 numbers, expected 2"),
    (with_frame("cylinder_m = [0.1, 0]").encode(), r"part\[0\].cylinder_m\[1\]: got 0"),
    (
        with_frame("box_m = [0.1, 0.1, 0.1]\ncylinder_m = [0.1, 0.1]").encode(),
        r"part\[0\].cylinder_m: stands beside box_m",
    ),
    (replaced(r"^inertia_kg_m2 = \[1.6783e-4", "inertia_kg_m2 = [9e-4"), "no rigid body's"),
    (replaced(r"^inertia_kg_m2 = \[1.6783e-4", "inertia_kg_m2 = [0.0"), "no rigid body's"),
    (
        replaced(r"^inertia_kg_m2 = \[1.6783e-4,", "inertia_kg_m2 = [1, 1.6783e-4,"),
        "got 4 numbers, expected 3 or 6",
    ),
    (
        with_frame("centre_of_mass_m = [0, 0, 0]\ninertia_kg_m2 = [1, 1, 1, 0.9, 0.9, 0.9]").encode(),
        r"part\[0\].inertia_kg_m2: .*-.*no rigid body's|principal moments",
    ),
    (
        replaced(r"^yaw_rad = 1.5708$", "yaw_rad = 1.5708\nrotation_rad = [0, 0, 1]"),
        r"part\[0\].rotation_rad: stands beside yaw_rad",
    ),
    (with_frame('mesh = "frame.stl"').encode(), r"part\[0\].mesh_unit_m: missing"),
    (replaced(r'^spin = "cw"$', 'spin = "left"'), r"rotor\[0\].spin: got 'left'.*cw, ccw"),
    (
        replaced(rf"^propeller_m = {RIGHT}$", "propeller_m = [0.0805, -0.04, 0.058]"),
        r"rotor\[1\].propeller_m: .*30 mm from",
    ),
    (re.sub(r"^propeller_m = .*", "", NF1, flags=re.MULTILINE).encode(), r"rotor\[0\].propeller_m: missing"),
    (NF1[: NF1.index("[motor_part]")].encode() + b"[gyro]", "rotor: missing"),
    (
        replaced(
            r"^# Measured on a dynamometer",
            '[[rotor]]\nmotor_m = [0, 0, 0]\npropeller_m = [0, 0, 0]\nspin = "cw"\n' * 5 + "#",
        ),
        "rotor: got 9 motors, expected 3 to 8",
    ),
    (put("speed_curve_rpm", "[1.0, 2.0]"), "speed_curve_rpm: got"),
    (put("speed_curve_rpm", "[-9e4, 1e4, 0]"), "must rise"),
    (
        put("thrust_coefficient", "[9e-7, -5e-10]"),
        r"propulsion.thrust_coefficient: got .*reaches -4.*above 0",
    ),
    (put("torque_ratio_m", "[]"), "propulsion.torque_ratio_m: got 0 numbers"),
    (
        replaced(r"^thrust_coefficient = ", "c_t = 0.1\nthrust_coefficient = "),
        "propulsion.c_t: stands beside",
    ),
    (
        replaced(r"^thrust_coefficient = .*$", ""),
        "propulsion.thrust_coefficient: missing; give it or one of: c_t",
    ),
    (replaced(r"^thrust_coefficient = .*$", "c_t = 0.1\nc_q = 0.01"), "torque_ratio_m: stands beside c_q"),
    (replaced(r"^torque_ratio_m = .*$", "c_q = 0.01"), "propulsion.torque_ratio_m: missing"),
    (replaced(r'^kind = "torque"$', 'kind = "magic"'), "propulsion.response.kind: got 'magic'.*first_order"),
    (replaced(r'^kind = "torque"$', 'kind = "first_order"'), "response.time_constant_up_s: missing"),
    (replaced(r"^\[gyro\]$", "[gyroscope]"), "gyro: missing"),
    (put("noise_deg_s", "[1.0, inf, 1.0]"), r"gyro.noise_deg_s\[1\]: got inf"),
    (put("rest_voltage_v", "25.2"), "battery.rest_voltage_v: .*6.30 V for each of 4"),
    (put("cells", "4.5"), "battery.cells: got 4.5, expected a whole number"),
    (replaced(r"^\[battery\]$", "[[battery]]"), r"battery: got .*expected a table \[battery\]"),
]


@pytest.mark.parametrize(("data", "expected"), BAD)
def test_refuses_in_one_line_naming_the_key_when_malformed(data: bytes, expected: str) -> None:
    with pytest.raises(AircraftError, match=expected) as caught:
        parse_aircraft(data, "mine.toml")
    assert "\n" not in str(caught.value)
    assert "mine.toml" in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("name", "data", "expected"),
    [
        ("none.stl", b"", "'none.stl' is no file in"),
        ("../frame.stl", brick(), "lies outside the folder"),
        ("/etc/passwd", b"", "lies outside the folder"),
        ("loop.stl", b"", "cannot be read|is no file"),
        ("out.stl", b"", "lies outside the folder"),
        ("frame.stl", b"not a mesh", "not an STL"),
        ("frame.stl", brick()[:84] + bytes(600), "holds no solid|damaged|watertight|m long"),
        ("frame.stl", bytes(BYTES_MAX + 1), "expected at most 33554432"),
    ],
)
def test_refuses_a_mesh_naming_its_part_when_it_cannot_be_used(
    tmp_path: Path, name: str, data: bytes, expected: str
) -> None:
    folder = tmp_path / "aircraft"
    folder.mkdir()
    (folder / "loop.stl").symlink_to(folder / "loop.stl")
    (folder / "out.stl").symlink_to("/etc/passwd")
    if data:
        (folder / name).write_bytes(data)
    path = folder / "mine.toml"
    path.write_text(with_frame(f'mesh = "{name}"\nmesh_unit_m = 0.001'))
    with pytest.raises(AircraftError, match=expected) as caught:
        load_aircraft(path)
    assert re.search(r"mine.toml: part\[0\].mesh: ", str(caught.value))
    assert "\n" not in str(caught.value)


def test_refuses_an_open_mesh_saying_how_to_mend_it_when_it_has_a_hole(tmp_path: Path) -> None:
    data = bytearray(brick()[:-50])
    data[80:84] = (11).to_bytes(4, "little")
    (tmp_path / "frame.stl").write_bytes(data)
    text = with_frame('mesh = "frame.stl"\nmesh_unit_m = 0.001').encode()
    with pytest.raises(
        AircraftError, match=r"part\[0\].mesh: 'frame.stl' is not watertight.*close its holes"
    ):
        parse_aircraft(text, "mine.toml", tmp_path)
    with pytest.raises(AircraftError, match="has no folder"):
        parse_aircraft(text, "mine.toml")


def test_refuses_with_the_shipped_names_when_there_is_no_such_file(tmp_path: Path) -> None:
    with pytest.raises(AircraftError, match=r"no such file.*hexa, iris, nf1"):
        load_aircraft(tmp_path / "none.toml")


def test_refuses_an_oversized_file(tmp_path: Path) -> None:
    big = tmp_path / "big.toml"
    big.write_bytes(b"#" * (1 << 20))
    with pytest.raises(AircraftError, match="expected at most"):
        load_aircraft(big)


def test_thermal_constants_are_refused_in_one_line_when_no_current_is_known() -> None:
    thermal = "[esc.thermal]\nwinding_ohm = 0.1\nresistance_k_w = 8\ntime_constant_s = 20\n"
    text = replaced(r"^supply_voltage_v.*$", "").decode() + thermal
    with pytest.raises(
        AircraftError, match=r"^aircraft file mine: esc\.thermal: .*supply_voltage_v; give it$"
    ):
        parse_aircraft(text.encode(), "mine")
    with pytest.raises(AircraftError, match=r"esc\.thermal\.winding_ohm: got -1"):
        parse_aircraft((NF1 + thermal.replace("0.1", "-1")).encode(), "mine")


class Recording(StrictTable):
    """Notes every key that the parser asks for, with its range and default as the guide writes them."""

    asked: dict[str, set[tuple[str, str]]]

    def _note(self, key: str, allowed: str, default: object) -> None:
        name = re.sub(r"\[\d+\]", "", f"{self._path}{key}")
        name = re.sub(r"^(motor|propeller)_part\.", "part.", name)
        shown = str(list(default)) if isinstance(default, tuple) else "0"
        shown = f"{default:g}" if default and isinstance(default, int | float) else shown
        shown = "" if default is None else default if isinstance(default, str) else shown
        self.asked.setdefault(name, set()).add((allowed, shown.replace(".0", "")))

    def number(self, key: str, low: float, high: float, default: float | None = None) -> float:
        self._note(key, f"{low:g} to {high:g}", default)
        return super().number(key, low, high, default)

    def integer(self, key: str, low: int, high: int, default: int | None = None) -> int:
        self._note(key, f"{low:g} to {high:g}" if low < high else f"{low}", default)
        return super().integer(key, low, high, default)

    def text(self, key: str, default: str | None = None) -> str:
        self._note(key, "text", default)
        return super().text(key, default)

    def choice(self, key: str, values: Mapping[str, Value], default: str | None = None) -> Value:
        self._note(key, ", ".join(values), default)
        return super().choice(key, values, default)

    def vector(
        self, key: str, low: float, high: float, default: tuple[float, float, float] | None = None
    ) -> tuple[float, float, float]:
        self._note(key, f"{low:g} to {high:g}", default)
        return super().vector(key, low, high, default)

    def numbers(self, key: str, fewest: int, most: int, low: float, high: float) -> tuple[float, ...]:
        self._note(key, f"{low:g} to {high:g}", None)
        return super().numbers(key, fewest, most, low, high)


def plain(allowed: str) -> str:
    """A range of the guide with its numbers as Python prints them."""
    low, to, high = allowed.partition(" to ")
    return f"{float(low):g} to {float(high):g}" if to else allowed


PID = """
[propulsion.advance_ratio]
thrust = [-1, 0]
torque = [-0.5, 0]
[esc.thermal]
winding_ohm = 0.1
resistance_k_w = 8
time_constant_s = 20
[pid.NAME]
roll = [1, 1, 0]
pitch = [1, 1, 0]
yaw = [1, 1, 0]
derivative_cutoff_hz = 80
nominal_voltage_v = 15
[pid.NAME.mixer]
roll = [-1, -1, 1, 1]
pitch = [1, -1, 1, -1]
yaw = [1, -1, -1, 1]
[logged]
motor_thrust = [1, 1, 1, 1]
[known]
"propulsion.delay_s" = { how = "typical", from = "a page", range = [1, 2] }
"""


def every_form(folder: Path) -> list[str]:
    """Aircraft files that between them give every key there is."""
    (folder / "frame.stl").write_bytes(brick())
    dimensionless = "c_t = 0.1\nc_q = 0.01\nair_density_kg_m3 = 1.2"
    optional = replaced(r"^\[gyro\]$", "[gyro]\nbandwidth_hz = 100\nvibration_harmonics = [0.5]").decode()
    optional = re.sub(r"^\[accelerometer\]$", "[accelerometer]\nbandwidth_hz = 100", optional, flags=re.M)
    lag = 'kind = "first_order"\ntime_constant_up_s = 0.04\ntime_constant_down_s = 0.05\n'
    return [
        optional + PID,
        with_frame('mesh = "frame.stl"\nmesh_unit_m = 0.001'),
        with_frame("box_m = [0.1, 0.1, 0.1]"),
        with_frame("cylinder_m = [0.1, 0.1]"),
        replaced(r"^yaw_rad = 1.5708$", "rotation_rad = [0, 0, 1.5]").decode(),
        re.sub(r'^kind = "torque"\n.*\n.*\n.*\n', lag, NF1, flags=re.M),
        re.sub(
            r"^torque_ratio_m.*$",
            "",
            replaced(r"^thrust_coefficient = .*$", dimensionless).decode(),
            flags=re.M,
        ),
    ]


def test_guide_lists_every_key_with_its_range_and_default_when_compared_with_the_parser(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, set[tuple[str, str]]] = {}
    monkeypatch.setattr(Recording, "asked", asked, raising=False)
    monkeypatch.setattr(neuroflight.sim.aircraft.model, "StrictTable", Recording)
    for text in every_form(tmp_path):
        assert isinstance(parse_aircraft(text.encode(), "mine", tmp_path), Aircraft)
    asked = {key.replace("known.propulsion.delay_s.", "known.NAME."): of for key, of in asked.items()}
    other_pids = {name for name in asked if name.startswith("pid.") and not name.startswith("pid.NAME.")}
    row = r"^\| `([\w.]+)` \|[^|]*\|([^|]*)\|([^|]*)\|[^|]*\|$"  # key, unit, range, default, meaning
    rows = re.findall(row, KEYS, re.MULTILINE)
    guide = {key: (plain(allowed.strip()), default.strip()) for key, allowed, default in rows}
    assert len(guide) == len(rows)
    assert set(guide) == set(asked) - other_pids
    for key, (allowed, default) in guide.items():
        assert allowed in {one for one, _ in asked[key]}, key
        if defaults := {one for _, one in asked[key] if one}:
            assert default in defaults, key
        else:
            assert default in ("required", "none", "either"), key


def test_a_base_gives_what_the_file_does_not() -> None:
    text = 'format = 1\nbase = "nf1"\nname = "mine"\n[propulsion]\ndelay_s = 0.004\n'
    mine, nf1 = parse_aircraft(text.encode(), "mine"), load_aircraft("nf1")
    by_hand = parse_aircraft(replaced(r"^delay_s = 0.002", "delay_s = 0.004"), "by hand")
    assert mine.name == "mine" and mine.sha256 == by_hand.sha256 != nf1.sha256
    assert replace(mine.propulsion, delay=nf1.propulsion.delay) == nf1.propulsion
    assert (mine.parts, mine.rotors, mine.pids) == (nf1.parts, nf1.rotors, nf1.pids)
    for other in ('"nf2"', "3", "[]"):
        with pytest.raises(AircraftError, match=r"base: got .*, expected one of: .*nf1"):
            parse_aircraft(text.replace('"nf1"', other).encode(), "mine")


def test_props_out_is_the_file_with_its_spins_turned(tmp_path: Path) -> None:
    swapped = NF1.replace('"cw"', '"x"').replace('"ccw"', '"cw"').replace('"x"', '"ccw"')
    path = tmp_path / "by hand.toml"
    path.write_text(swapped)
    by_hand, nf1, out = load_aircraft(path), load_aircraft("nf1"), load_aircraft("nf1:props-out")
    assert out.name == "nf1-props-out" and out.spins.tolist() == (-nf1.spins).tolist()
    assert out.sha256 == by_hand.sha256 != nf1.sha256
    assert not any(out.is_meant_by(digest) for digest in (nf1.sha256, nf1.file_sha256, *EARLIER))
    assert out.pids[0] == nf1.pids[0]
    for name, settings in nf1.pids:
        if settings.mixer is not None:
            roll, pitch, yaw = settings.mixer
            assert dict(out.pids)[name].mixer == (roll, pitch, tuple(-share for share in yaw))
    mine = tmp_path / "mine.toml"
    mine.write_text(NF1)
    assert load_aircraft(f"{mine}:props-out").sha256 == out.sha256
    assert (
        aircraft_file(f"{mine}:props-out") == mine and aircraft_file("nf1:props-out") == FOLDER / "nf1.toml"
    )


@pytest.mark.parametrize(
    ("pattern", "text", "message"),
    [
        (r'^name = "nf1"$', 'name = "a-name-of-twenty-five-char"', "at most 32"),
        (r'^spin = "cw"$', 'spin = "left"', "expected one of: cw, ccw"),
        (r'^spin = "cw"$', "spin = [1]", "expected one of: cw, ccw"),
        (r"^name = .*$", "", "name: missing"),
        (r"^yaw = \[.*$", 'yaw = "x"', "yaw"),
        (r"^\[pid\.\w+\]$", "[[pid.flying]]", "pid"),
    ],
)
def test_props_out_of_no_aircraft_is_refused_as_the_file_is(pattern: str, text: str, message: str) -> None:
    with pytest.raises(AircraftError, match=re.escape(message)):
        parse_aircraft(replaced(pattern, text), "mine.toml", out=True)
