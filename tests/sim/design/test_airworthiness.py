"""Figures of an aircraft against closed forms, and the verdicts on files that cannot fly."""

import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import linprog

from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import FOLDER, Aircraft, load_aircraft, parse_aircraft, shipped
from neuroflight.sim.design.airworthiness import Level, Verdict, examine
from neuroflight.sim.design.figures import balanced_thrust, greatest_moment
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY

NF1 = (FOLDER / "nf1.toml").read_text()
IRIS = (FOLDER / "iris.toml").read_text()
ERROR, WARNING = Level.ERROR, Level.WARNING


def changed(text: str, *changes: tuple[str, str]) -> Aircraft:
    for pattern, put in changes:
        text, count = re.subn(pattern, put, text, flags=re.MULTILINE)
        assert count, pattern
    return parse_aircraft(text.encode(), "mine.toml")


def put(key: str, value: str, before: str = ".*") -> tuple[str, str]:
    """A change of a key's lines, all or those with this value, for `changed`."""
    return rf"^{key} = {before}", f"{key} = {value}"


def verdicts(aircraft: Aircraft, level: Level) -> list[Verdict]:
    return [verdict for verdict in examine(aircraft)[1] if verdict.level is level]


@pytest.mark.parametrize("name", shipped())
def test_shipped_aircraft_pass_without_a_warning_when_examined(name: str) -> None:
    found = examine(load_aircraft(name))[1]
    assert {verdict.level for verdict in found} == {Level.OK}
    assert {"thrust", "hover", "control", "inertia", "battery", "body"} <= {v.subject for v in found}


def test_hover_carries_the_weight_evenly_when_the_rotors_are_symmetric() -> None:
    nf1 = load_aircraft("nf1")
    hover = examine(nf1)[0].hover
    assert hover is not None
    newtons = 0.39094 * GRAVITY / 4
    assert hover.thrust == pytest.approx([newtons] * 4, rel=1e-9)
    speed = math.sqrt(newtons / 9.37e-7)
    assert hover.speed == pytest.approx([speed] * 4, rel=1e-4)
    # H(u) at the hover throttle is the hover speed; the curve is the file's, in rpm.
    u = hover.throttle[0]
    assert -14229.32 * u**2 + 39125.59 * u + 86.67 == pytest.approx(speed * 60 / (2 * math.pi), rel=1e-4)
    assert hover.power == pytest.approx(4 * 8.64e-3 * newtons * speed / 0.7 + 6.21, rel=1e-4)


def slid_back() -> Aircraft:
    return changed(NF1, (r"^position_m = \[0.0, 0.0, 0.0\]", "position_m = [-0.03, 0.0, 0.0]"))


@pytest.mark.parametrize(
    "aircraft", [*map(load_aircraft, shipped()), slid_back()], ids=[*shipped(), "nf1, battery slid back"]
)
def test_twin_hangs_in_the_air_when_its_motors_get_the_hover_throttle(aircraft: Aircraft) -> None:
    """Once the rotors turn, nothing accelerates it: the twin and these figures agree on every moment."""
    hover = examine(aircraft)[0].hover
    assert hover is not None
    twin = Twin(aircraft, mount=Mount.CENTRE, noise=False, rng=np.random.default_rng(0))
    try:
        for _ in range(1000):
            twin.step(hover.throttle[None])
        twin_rate = twin.rate.copy()
        for _ in range(20):
            twin.step(hover.throttle[None])
        turning = (twin.rate - twin_rate)[0] / 0.020
        force = twin.specific_force[0, 2]
    finally:
        twin.close()
    assert force == pytest.approx(GRAVITY, rel=2e-3)
    # Where the transient of uneven rotors left it turning, drag and gyroscopic moments remain.
    limit = 0.01 if np.ptp(hover.thrust) < 1e-6 * hover.thrust.max() else 0.5
    assert np.abs(turning).max() < limit


def test_accelerations_are_lever_times_thrust_over_inertia_when_the_aircraft_is_an_x() -> None:
    figures = examine(load_aircraft("nf1"))[0]
    i, thrust = np.diag(figures.inertia), 9.37e-7 * (24982.94 * 2 * math.pi / 60) ** 2
    full = [2 * 0.07 * thrust / i[0], 2 * 0.0805 * thrust / i[1], 2 * 8.64e-3 * thrust / i[2]]
    assert figures.acceleration == pytest.approx(full, rel=1e-5)
    weight = 0.39094 * GRAVITY  # all of it on one side, or on the two of one spin
    hover = [0.07 * weight / i[0], 0.0805 * weight / i[1], 8.64e-3 * weight / i[2]]
    assert figures.hover_acceleration == pytest.approx(hover, rel=1e-5)


def test_rear_motors_carry_more_when_the_battery_slides_back() -> None:
    aircraft = changed(NF1, (r"^position_m = \[0.0, 0.0, 0.0\]", "position_m = [-0.05, 0.0, 0.0]"))
    figures, found = examine(aircraft)
    assert figures.hover is not None
    # Moments about y: the centre of mass lies 0.194 * 50 / 0.39094 mm behind the middle of the rotors.
    behind = 0.194 * 0.05 / 0.39094
    front = (0.0805 - behind) / (2 * 0.0805) * 0.39094 * GRAVITY / 2
    assert figures.hover.thrust[[1, 3]] == pytest.approx([front, front], rel=1e-4)
    warning = next(v for v in found if v.subject == "hover")
    assert warning.level is Level.WARNING
    assert re.search(r"motor [13] carries 1\.\d times that of motor [24]", warning.message)


def test_current_gives_the_power_when_multiplied_with_the_sagging_voltage() -> None:
    figures = examine(load_aircraft("nf1"))[0]
    endurance, hover = figures.endurance, figures.hover
    assert endurance is not None and hover is not None
    assert endurance.current * (16.78 - 0.020 * endurance.current) == pytest.approx(hover.power, rel=1e-6)
    # A pack gives most of its life between 3.7 and 4.0 V a cell.
    assert 0.8 * 5580 * 14.4 / hover.power < endurance.seconds < 0.8 * 5580 * 16.4 / hover.power
    full = endurance.full_throttle_current
    assert full * (16.78 - 0.020 * full) == pytest.approx(
        4 * 8.64e-3 * 9.37e-7 * (24982.94 * 2 * math.pi / 60) ** 3 / 0.7 + 6.21, rel=1e-6
    )
    assert endurance.full_throttle_voltage == pytest.approx(16.78 - 0.020 * full)


def test_balanced_thrust_leaves_a_rotor_out_when_sharing_would_make_it_pull_down() -> None:
    rows = np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0]])  # a beam held at 0, 1 and 2, loaded at 0.1
    thrust = balanced_thrust(rows, np.array([10.0, 1.0]), 100.0)
    assert thrust is not None
    assert thrust.min() >= 0.0
    assert rows @ thrust == pytest.approx([10.0, 1.0])


def test_balanced_thrust_is_none_when_the_load_lies_outside_or_is_too_heavy() -> None:
    rows = np.array([[1.0, 1.0], [0.0, 1.0]])
    assert balanced_thrust(rows, np.array([10.0, 12.0]), 100.0) is None
    assert balanced_thrust(rows, np.array([10.0, 5.0]), 4.0) is None


@pytest.mark.parametrize("count", [4, 6, 8])
def test_greatest_moment_is_that_of_the_simplex_method_when_random(count: int) -> None:
    rng = np.random.default_rng(count)
    for bound in (2, 3):
        rows, moment = rng.normal(size=(bound, count)), rng.normal(size=count)
        wanted = rows @ rng.uniform(0.0, 2.0, count)
        peer = linprog(-moment, A_eq=rows, b_eq=wanted, bounds=(0.0, 2.0))
        assert greatest_moment(moment, rows, wanted, 2.0) == pytest.approx(max(0.0, -peer.fun), abs=1e-9)


@pytest.mark.parametrize(
    ("text", "changes", "level", "subject", "expected"),
    [
        (NF1, [put("mass_kg", "19.4", r"0.194")], ERROR, "thrust", "cannot lift itself"),
        (IRIS, [put("mass_kg", "2.5", r"1.5")], WARNING, "thrust", "little is left"),
        (NF1, [(r'^spin = "ccw"', 'spin = "cw"')], ERROR, "hover", "check spin"),
        (NF1, [(r'^spin = "ccw"', 'spin = "cw"')], ERROR, "control", "can set 3 of"),
        (
            NF1,
            [put("position_m", "[0.4, 0.0, 0.0]", r"\[0.0, 0.0, 0.0\]")],
            ERROR,
            "hover",
            "must lie among the rotors",
        ),
        (
            NF1,
            [put("position_m", "[0.0, 0.0, 0.8]", r"\[0.0, 0.0, 0.0\]")],
            WARNING,
            "size",
            r"part 'battery' lies \d+ mm",
        ),
        (
            IRIS,
            [put("inertia_kg_m2", "[8.0, 15.0, 17.0]", r"\[0.008, 0.015, 0.017\]")],
            ERROR,
            "inertia",
            "cannot be; check inertia_kg_m2",
        ),
        (
            IRIS,
            [put("inertia_kg_m2", "[0.08, 0.15, 0.17]", r"\[0.008, 0.015, 0.017\]")],
            WARNING,
            "inertia",
            "unusual",
        ),
        (
            NF1,
            [put("centre_of_thrust_m", "[0, 0, 0.1]")],
            WARNING,
            "centre of thrust",
            r"42 mm .*\[0, 0, 0.058\]",
        ),
        (NF1, [put("torque_ratio_m", "8.64e-4")], ERROR, "propeller", "pay for"),
        (NF1, [put("torque_ratio_m", "0.04")], WARNING, "propeller", "unusual"),
        (NF1, [put("speed_curve_rpm", "[-20000, 70000, 0]")], WARNING, "propeller", "speed of sound"),
        (
            NF1,
            [put("propeller_diameter_m", "0.15")],
            WARNING,
            "propeller",
            "motors 1 and 3 overlap: hubs 140 mm apart",
        ),
        (NF1, [put("rotor_inertia_kg_m2", "4e-3")], ERROR, "rotor", "in an"),
        (NF1, [put("rotor_inertia_kg_m2", "4e-7")], WARNING, "rotor", "carries"),
        (
            NF1,
            [put("cells", "3"), put("rest_voltage_v", "12.6")],
            WARNING,
            "battery",
            "12.6 V full, speed curve at 16 V: unusual",
        ),
        (NF1, [put("cells", "8"), put("rest_voltage_v", "33.6")], ERROR, "battery", "cannot be"),
        (NF1, [put("resistance_ohm", "0.09")], WARNING, "battery", "cannot feed"),
        (NF1, [put("resistance_ohm", "0.07")], WARNING, "battery", "sags to 2"),
        (NF1, [(r"^supply_voltage_v = .*", "")], WARNING, "battery", "give propulsion.supply_voltage_v"),
        (NF1, [put("centre_m", "[0, 0, 0.3]")], WARNING, "body", "outside the box"),
        (
            NF1,
            [
                (r"^propeller_m = (.*), 0.058\]", r"propeller_m = \1, -0.02]"),
                put("centre_of_thrust_m", "[0, 0, -0.02]"),
            ],
            WARNING,
            "body",
            "20 mm below",
        ),
    ],
)
def test_verdict_names_the_mistake_when_a_number_is_wrong(
    text: str, changes: list[tuple[str, str]], level: Level, subject: str, expected: str
) -> None:
    found = verdicts(changed(text, *changes), level)
    assert any(v.subject == subject and re.search(expected, v.message) for v in found), found


def test_axes_tilt_when_the_inertia_does() -> None:
    nf1 = load_aircraft("nf1")
    turn = np.array([[math.cos(0.2), -math.sin(0.2), 0], [math.sin(0.2), math.cos(0.2), 0], [0, 0, 1]])
    properties = MassProperties(0.4, np.zeros(3), turn @ np.diag([8e-4, 1e-3, 1.5e-3]) @ turn.T)
    figures = examine(dataclasses.replace(nf1, mass_properties=properties))[0]
    assert figures.principal_moments == pytest.approx([8e-4, 1e-3, 1.5e-3])
    assert figures.principal_axes == pytest.approx(turn)


def test_no_battery_and_no_body_are_fine_when_left_out(tmp_path: Path) -> None:
    bare = dataclasses.replace(load_aircraft("nf1"), battery=None, body=None)
    figures, found = examine(bare)
    assert figures.endurance is None
    assert {v.level for v in found} == {Level.OK}


WEAK = (r"^speed_curve_rpm = .*$", "speed_curve_rpm = [-1000, 9000, 0]")
IN_GRAMS = [(rf"^mass_kg = {mass}$", f"mass_kg = {1000 * float(mass):g}") for mass in ("0.194", "0.066")]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (IN_GRAMS[:1], "'battery' has 194 of them: if grams are meant, write 0.194"),
        (IN_GRAMS, "'battery' has 194 of them: if grams are meant, write 0.194"),
        ([WEAK], "check mass_kg of the parts"),
        ([WEAK, IN_GRAMS[0]], "check mass_kg of the parts"),  # not with grams either
    ],
)
def test_grams_are_named_when_they_are_what_keeps_it_down(changes: list[tuple[str, str]], told: str) -> None:
    (verdict,) = (v for v in verdicts(changed(NF1, *changes), Level.ERROR) if v.subject == "thrust")
    assert "cannot lift itself" in verdict.message and told in verdict.message


def test_motors_are_named_by_place_and_turning_direction() -> None:
    def told(name: str) -> list[str]:
        return [v.message for v in examine(load_aircraft(name))[1] if v.subject == "motors"]

    places = "1 rear right {}, 2 front right {}, 3 rear left {}, 4 front left {}: propellers {}"
    assert told("nf1") == [places.format("cw", "ccw", "ccw", "cw", "in, as Betaflight has it")]
    assert told("nf1:props-out") == [places.format("ccw", "cw", "cw", "ccw", "out")]
    assert told("hexa") == []


def test_rotors_in_another_order_are_warned_of() -> None:
    nf1 = load_aircraft("nf1")
    swapped = dataclasses.replace(nf1, rotors=(nf1.rotors[3], *nf1.rotors[1:3], nf1.rotors[0]))
    (verdict,) = verdicts(swapped, Level.WARNING)
    assert verdict.subject == "motors" and verdict.message.startswith("1 front left cw, 2 front right ccw")
    assert "expected 1 rear right, 2 front right, 3 rear left, 4 front left" in verdict.message
