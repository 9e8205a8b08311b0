"""Aircraft files made of URDF and SDF: masses as pybullet loads them, drives as the motor plugins say."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pybullet
import pytest

from neuroflight.cli.main import main
from neuroflight.sim.aircraft.known import How
from neuroflight.sim.aircraft.mass import MassProperties, rotation_matrix
from neuroflight.sim.aircraft.model import RPM, Aircraft, FirstOrderResponse, TorqueResponse, load_aircraft
from neuroflight.sim.aircraft.robot import FILE_BYTES_MAX
from neuroflight.sim.aircraft.robot_aircraft import import_aircraft
from neuroflight.sim.design.airworthiness import Level, examine
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError

Capture = pytest.CaptureFixture[str]

ARM = 0.1
PLACES = {
    0: (ARM, -ARM, "ccw"),
    1: (-ARM, ARM, "ccw"),
    2: (ARM, ARM, "cw"),
    3: (-ARM, -ARM, "cw"),
}  # PX4's order
MOTOR = """
<plugin name="motor{n}" filename="libgazebo_motor_model.so">
  <jointName>rotor_{n}_joint</jointName><linkName>rotor_{n}</linkName>
  <turningDirection>{spin}</turningDirection><motorNumber>{n}</motorNumber>
  <timeConstantUp>0.0125</timeConstantUp><timeConstantDown>0.025</timeConstantDown>
  <maxRotVelocity>2000</maxRotVelocity><motorConstant>2e-06</motorConstant>
  <momentConstant>0.012</momentConstant>
  <rotorDragCoefficient>8e-05</rotorDragCoefficient><rollingMomentCoefficient>1e-06</rollingMomentCoefficient>
</plugin>"""
BODY = ("0.4", (1.2e-3, 1e-4, -5e-5, 1.5e-3, 2e-5, 2.4e-3))
CAMERA = ("0.05", (2e-5, 0.0, 0.0, 3e-5, 0.0, 4e-5))
ROTOR = ("0.006", (4e-6, 0.0, 0.0, 4e-6, 0.0, 8e-6))
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def urdf(plugins: bool = True, joint: str = "continuous") -> str:
    """A quadcopter whose camera is turned and moved, as one would write it for ROS."""

    def link(name: str, mass: str, moments: tuple[float, ...], xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
        inertia = " ".join(f'{key}="{value}"' for key, value in zip(MOMENTS, moments, strict=True))
        return (
            f'<link name="{name}"><inertial><origin xyz="{xyz}" rpy="{rpy}"/><mass value="{mass}"/>'
            f"<inertia {inertia}/></inertial>"
            f'<collision><geometry><box size="0.1 0.06 0.04"/></geometry></collision></link>'
        )

    def fixed(child: str, xyz: str, rpy: str = "0 0 0", kind: str = "fixed") -> str:
        return (
            f'<joint name="{child}_joint" type="{kind}"><parent link="base"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/></joint>'
        )

    lines = [link("base", *BODY, "0.002 -0.001 0.01", "0.1 0 0.2")]
    lines += [
        link("camera", *CAMERA, "0.01 0 0.005", "0 0.3 0"),
        fixed("camera", "0.06 0.01 0.02", "0 0.5 0.1"),
    ]
    for number, (x, y, spin) in PLACES.items():
        lines += [link(f"rotor_{number}", *ROTOR), fixed(f"rotor_{number}", f"{x} {y} 0.03", kind=joint)]
        if plugins:
            lines.append(f"<gazebo>{MOTOR.format(n=number, spin=spin)}</gazebo>")
    return f'<?xml version="1.0"?>\n<robot name="my quad">{"".join(lines)}</robot>\n'


def sdf(include: str = "") -> str:
    """The same quadcopter for Gazebo: poses in the model, relative to others, in degrees."""

    def link(
        name: str, mass: str, moments: tuple[float, ...], pose: str, inertial: str = "0 0 0 0 0 0"
    ) -> str:
        inertia = "".join(f"<{key}>{value}</{key}>" for key, value in zip(MOMENTS, moments, strict=True))
        return (
            f'<link name="{name}">{pose}<inertial><pose>{inertial}</pose><mass>{mass}</mass>'
            f"<inertia>{inertia}</inertia></inertial><collision name='c'><geometry><box><size>0.1 0.06 0.04"
            f"</size></box></geometry></collision></link>"
        )

    lines = [link("base", *BODY, "<pose>0 0 0 0 0 0</pose>", "0.002 -0.001 0.01 0.1 0 0.2")]
    turned = f"0 {np.rad2deg(0.5)} {np.rad2deg(0.1)}"
    at = f'<pose relative_to="mount" degrees="true">0 0 0 {turned}</pose>'
    camera = link("camera", *CAMERA, at, "0.01 0 0.005 0 0.3 0")
    lines += ['<frame name="mount"><pose>0.06 0.01 0.02 0 0 0</pose></frame>', camera]
    motors = ""
    for number, (x, y, spin) in PLACES.items():
        lines.append(link(f"rotor_{number}", *ROTOR, f"<pose>{x} {y} 0.03 0 0 0</pose>"))
        lines.append(
            f'<joint name="rotor_{number}_joint" type="revolute"><parent>base</parent>'
            f"<child>rotor_{number}</child><axis><xyz>0 0 1</xyz>"
            f"<limit><lower>-1e16</lower><upper>1e16</upper></limit></axis></joint>"
        )
        motors += MOTOR.format(n=number, spin=spin)
    if include:
        return f'<sdf version="1.9"><model name="my quad">{include}{motors}</model></sdf>'
    return f'<sdf version="1.9"><model name="my quad">{"".join(lines)}{motors}</model></sdf>'


def written(folder: Path, text: str, name: str = "quad.urdf") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def as_pybullet(path: Path) -> MassProperties:
    """All links of a URDF together, as pybullet loads them."""
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = pybullet.loadURDF(str(path), flags=pybullet.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
        mass, first, parts = 0.0, np.zeros(3), []
        for link in range(-1, pybullet.getNumJoints(body, client)):
            info = pybullet.getDynamicsInfo(body, link, client)
            place, turn = (
                pybullet.getBasePositionAndOrientation(body, client)
                if link < 0
                else pybullet.getLinkState(body, link, physicsClientId=client)[:2]
            )
            turned = np.array(pybullet.getMatrixFromQuaternion(turn)).reshape(3, 3)
            parts.append((info[0], np.array(place), turned @ np.diag(info[2]) @ turned.T))
            mass, first = mass + info[0], first + info[0] * np.array(place)
    finally:
        pybullet.disconnect(client)
    centre = first / mass
    inertia = np.zeros((3, 3))
    for part, place, own in parts:
        off = place - centre
        inertia += own + part * (off @ off * np.eye(3) - np.outer(off, off))
    return MassProperties(mass, centre, inertia)


def test_masses_are_those_that_pybullet_loads(tmp_path: Path) -> None:
    path = written(tmp_path, urdf())
    ours, theirs = import_aircraft(path).aircraft.mass_properties, as_pybullet(path)
    assert ours.mass == pytest.approx(theirs.mass) == pytest.approx(0.474)
    assert np.allclose(ours.centre, theirs.centre, atol=1e-9)
    assert np.allclose(ours.inertia, theirs.inertia, rtol=1e-6, atol=1e-10)


def test_an_sdf_of_the_same_aircraft_makes_the_same(tmp_path: Path) -> None:
    one = import_aircraft(written(tmp_path, urdf())).aircraft
    flat = import_aircraft(written(tmp_path, sdf(), "quad.sdf")).aircraft
    base = sdf().replace("my quad", "quad_base").replace("<pose>0 0 0 0 0 0</pose><inertial>", "<inertial>")
    without = re.sub(r"<plugin.*?</plugin>", "", base, flags=re.DOTALL)
    written(tmp_path, without, "models/quad_base/model.sdf")
    merged = "<include merge='true'><uri>model://quad_base</uri></include>"
    whole = import_aircraft(written(tmp_path, sdf(merged), "models/quad/model.sdf")).aircraft
    for other in (flat, whole):
        assert other.mass_properties.mass == pytest.approx(one.mass_properties.mass)
        assert np.allclose(other.mass_properties.inertia, one.mass_properties.inertia, rtol=1e-7, atol=1e-12)
        assert other.rotors == one.rotors
        assert other.propulsion == one.propulsion


def test_rotors_stand_in_the_order_of_the_bench_with_the_files_drives(tmp_path: Path) -> None:
    found = import_aircraft(written(tmp_path, urdf()))
    aircraft = found.aircraft
    assert [rotor.position[:2] for rotor in aircraft.rotors] == [
        (-ARM, -ARM),
        (ARM, -ARM),
        (-ARM, ARM),
        (ARM, ARM),
    ]
    assert aircraft.spins.tolist() == [-1, 1, 1, -1]
    drive = aircraft.propulsion
    assert drive.thrust_coefficient == (2e-6,)
    assert drive.torque_ratio == (0.012,)
    assert drive.speed_max == pytest.approx(2000.0)
    assert drive.response == FirstOrderResponse(0.0125, 0.025)
    assert (drive.drag_coefficient, drive.rolling_coefficient, drive.rotor_inertia) == (8e-5, 1e-6, 8e-6)
    assert "# the file's motorConstant" in found.text
    assert [line.partition(":")[0] for line in found.assumed] == [
        "centre_of_thrust_m",
        "delay_s",
        "[gyro]",
        "[accelerometer]",
    ]
    known = found.aircraft.known
    assert {"gyro", "accelerometer", "propulsion.delay_s"} <= set(known)
    assert all(mark.how is How.GUESSED and mark.source for mark in known.values())
    assert aircraft.gyro == load_aircraft("nf1").gyro
    assert aircraft.body is not None
    assert Level.ERROR not in {verdict.level for verdict in examine(aircraft)[1]}


def test_a_gymfc_model_says_its_curve_torque_and_centre_of_thrust(tmp_path: Path) -> None:
    more = (
        "<escTransferFunction><term1Coefficient>-9000</term1Coefficient><term2Coefficient>30000</term2Coefficient>"
        "<term3Coefficient>90</term3Coefficient></escTransferFunction><joint_control_pid><p>1e-4</p>"
        "<cmdMin>{low}</cmdMin><cmdMax>{high}</cmdMax></joint_control_pid></plugin>"
    )
    text = sdf()
    for spin, low, high in (("ccw", -0.1, 0.05), ("cw", -0.05, 0.1)):
        pattern = rf"(<turningDirection>{spin}</turningDirection>.*?)</plugin>"
        text = re.sub(pattern, rf"\g<1>{more.format(low=low, high=high)}", text, flags=re.DOTALL)
    offset = "<centerOfThrust><link>camera</link><offset>0 0 0.01</offset></centerOfThrust>"
    text = text.replace("<link", f"<plugin name='config' filename='x'>{offset}</plugin><link", 1)
    aircraft = import_aircraft(written(tmp_path, text, "quad.sdf")).aircraft
    assert np.allclose(aircraft.propulsion.speed_curve, np.array([-9000, 30000, 90]) * RPM)
    assert aircraft.propulsion.response == TorqueResponse(1e-4, 0.05, 0.1)
    turned = rotation_matrix((0.0, 0.5, 0.1)) @ [0.0, 0.0, 0.01] + [0.06, 0.01, 0.02]
    assert np.allclose(aircraft.centre_of_thrust, turned, atol=1e-9)


def properties(name: str = "cf") -> str:
    """A quadcopter as gym-pybullet-drones has them: rotors without mass, at the place of their inertia."""
    props = "".join(
        f'<link name="prop{n}_link"><inertial><origin xyz="{x} {y} 0"/><mass value="0"/><inertia ixx="0"/>'
        f'</inertial></link><joint name="prop{n}_joint" type="fixed"><parent link="base_link"/>'
        f'<child link="prop{n}_link"/></joint>'
        for n, (x, y) in enumerate(((0.03, -0.03), (-0.03, -0.03), (-0.03, 0.03), (0.03, 0.03)))
    )
    moments = '<inertia ixx="1.4e-5" iyy="1.4e-5" izz="2.2e-5"/>'
    base = f'<link name="base_link"><inertial><mass value="0.03"/>{moments}</inertial></link>'
    given = 'arm="0.042" kf="3e-10" km="7.5e-12" thrust2weight="2.0" prop_radius="0.023" drag_coeff_xy="9e-7"'
    return f'<robot name="{name}"><properties {given}/>{base}{props}</robot>'


def test_properties_of_gym_pybullet_drones_are_read(tmp_path: Path) -> None:
    found = import_aircraft(written(tmp_path, properties()))
    aircraft = found.aircraft
    drive = aircraft.propulsion
    assert drive.torque_ratio[0] == pytest.approx(0.025)
    full = 4 * drive.thrust_coefficient[0] * drive.speed_max**2
    assert full == pytest.approx(2.0 * 0.03 * GRAVITY, rel=1e-5)
    assert drive.thrust_coefficient[0] * (1000 * RPM) ** 2 == pytest.approx(3e-10 * 1000**2)
    assert drive.propeller_diameter == pytest.approx(0.046)
    assert drive.drag_coefficient == 9e-7
    assert aircraft.spins.tolist() == [-1, 1, 1, -1]  # prop1, prop0, prop2, prop3
    assert any("gym-pybullet-drones" in line for line in found.assumed)
    racer = import_aircraft(written(tmp_path, properties("racer")))
    assert racer.aircraft.spins.tolist() == [1, -1, -1, 1]
    told = import_aircraft(written(tmp_path, properties()), spins=["cw", "ccw", "cw", "ccw"])
    assert told.aircraft.spins.tolist() == [1, -1, -1, 1]
    assert not any("spin" in line for line in told.assumed)


def test_what_is_not_said_is_another_aircrafts(tmp_path: Path) -> None:
    path, spins = written(tmp_path, urdf(plugins=False)), ["ccw", "ccw", "cw", "cw"]
    with pytest.raises(
        AircraftError, match=r"does not say which way its rotors turn; give --spins, .*rotor_0, rotor_1"
    ):
        import_aircraft(path)
    with pytest.raises(
        AircraftError, match=r"says nothing of the rotors' thrust .* torque .* greatest speed .*--like"
    ):
        import_aircraft(path, spins=spins)
    found, nf1 = import_aircraft(path, spins=spins, like="nf1"), load_aircraft("nf1")
    ours = found.aircraft
    assert ours.spins.tolist() == [-1, 1, 1, -1]
    assert ours.propulsion.thrust_coefficient == nf1.propulsion.thrust_coefficient
    assert ours.propulsion.response == nf1.propulsion.response
    assert np.allclose(ours.propulsion.speed_curve, nf1.propulsion.speed_curve, rtol=1e-6)
    assert (ours.battery, ours.gyro) == (nf1.battery, nf1.gyro)
    assert ours.propulsion.rotor_inertia == 8e-6  # which the model does say
    assert "# as of nf1" in found.text


URDF, SDF = (urdf(), "a.urdf"), (sdf(), "a.sdf")
INCLUDE = "<include><uri>model://{}</uri></include><frame"


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (URDF, "<robot", '<!DOCTYPE x [<!ENTITY a "b">]><robot', "has a document type or entities"),
        (URDF, "<robot", "<robot><robot", "not XML: no element found"),
        (URDF, '"my quad"', '"${name}"', r"is a template; expand it first, such as `xacro a\.urdf"),
        (URDF, "robot", "robots", r"its root is <'?robots'?>, expected <robot>"),
        (URDF, '"0.4"', '"heavy"', "link base: mass: got 'heavy', expected 1 finite number"),
        (URDF, '"0.4"', '"inf"', "link base: mass: got 'inf', expected 1 finite number"),
        (URDF, 'base"/><child link="camera"', 'camera"/><child link="camera"', "form a circle"),
        (URDF, '<child link="camera"/>', '<child link="lens"/>', "its child 'lens' is no link of the file"),
        (URDF, "Direction>cw<", "Direction>left<", "turningDirection 'left', expected cw or ccw"),
        (URDF, "Name>rotor_2<", "Name>rotor_7<", "turns link 'rotor_7', which is not in the file"),
        (URDF, '"0.1 0.1 0.03" rpy="0 0', '"0.1 0.1 0.03" rpy="0.3 0', "rotor rotor_2 turns about"),
        (
            URDF,
            "1</motorNumber>",
            "1</motorNumber><motorConstant>3e-06</motorConstant>",
            "differ in motorConstant",
        ),
        (SDF, "<mass>0.05</mass>", "", "link camera: has no mass, which SDF takes for 1 kg"),
        (SDF, 'relative_to="mount"', 'relative_to="mast"', "relative to 'mast', which is no frame"),
        (SDF, "<frame", INCLUDE.format("../up"), r"includes 'model://\.\./up'"),
        (SDF, "<frame", INCLUDE.format("lens"), "includes model://lens, which is not beside it"),
        (SDF, "</sdf>", "<model name='b'/></sdf>", "2 models, expected a file of one"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(
    file: tuple[str, str], old: str, new: str, message: str, tmp_path: Path
) -> None:
    text, name = file
    path = written(tmp_path, text.replace(old, new), name)
    with pytest.raises(AircraftError, match=message) as caught:
        import_aircraft(path)
    assert "\n" not in str(caught.value)
    assert path.read_text() != text


def test_a_file_that_is_too_large_or_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.urdf"
    path.write_bytes(b" " * (FILE_BYTES_MAX + 1))
    with pytest.raises(AircraftError, match=f"expected at most {FILE_BYTES_MAX}"):
        import_aircraft(path)
    path.write_bytes(urdf().encode("utf-16"))
    with pytest.raises(AircraftError, match="not UTF-8"):
        import_aircraft(path)


def test_the_command_writes_a_new_file_and_says_what_is_assumed(tmp_path: Path, capsys: Capture) -> None:
    path, out = written(tmp_path, properties("my racer")), tmp_path / "mine.toml"
    words = ["aircraft", "import", str(path), "--out", str(out)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert "my-racer, 4 rotors, 0.03 kg" in told
    assert "assumed: rotor.spin: as gym-pybullet-drones' program turns them" in told
    aircraft: Aircraft = load_aircraft(out)
    assert aircraft.name == tomllib.loads(out.read_text())["name"] == "my-racer"
    assert main(words) == 1
    assert "exists; name a new file" in capsys.readouterr().err
    assert main(["aircraft", "check", str(out)]) == 0
    wrong = ["aircraft", "import", str(path), "--out", str(tmp_path / "b.toml"), "--spins", "cw,up"]
    assert main(wrong) == 1
    assert "expected cw or ccw for each of: prop0_link" in capsys.readouterr().err
