"""Aircraft that differ from their file: each parameter has its effect and no other."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from neuroflight.sim.aircraft.mass import MassProperties
from neuroflight.sim.aircraft.model import Aircraft, TorqueResponse, load_aircraft
from neuroflight.sim.physics.battery import open_circuit_voltage
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX
from neuroflight.toolchain.errors import AircraftError
from tests.sim.physics.flying import repeat

NF1 = load_aircraft("nf1")
HEXA = load_aircraft("hexa")
GRAVITY = 9.80665
DELAY = NF1.propulsion.delay


def varied(count: int, **changes: object) -> Variation:
    """Nominal aircraft but for `changes`, one value each."""
    columns = {name: np.array(values, float) for name, values in changes.items()}
    return replace(Variation.nominal(count, DELAY), **columns)


def twin(variation: Variation | None, count: int = 0, aircraft: Aircraft = NF1, **options: object) -> Twin:
    options = {
        "noise": False,
        "wash": False,
        "rng": np.random.default_rng(1),
        **options,
    }  # each draws its own
    number = len(variation) if variation is not None else count
    return Twin(aircraft, number, variation=variation, **options)  # type: ignore[arg-type]


def slick(aircraft: Aircraft) -> Aircraft:
    """Without drag."""
    bare = replace(aircraft.propulsion, drag_coefficient=0.0, rolling_coefficient=0.0)
    return replace(aircraft, propulsion=bare, body=None)


def slick_on_ground() -> Aircraft:
    """Without rotor drag, but with a body that can touch the ground."""
    return replace(slick(NF1), body=NF1.body)


def changed(aircraft: Aircraft, v: Variation, i: int) -> Aircraft:
    """The aircraft as a file would describe the one of row `i`."""
    mass, propulsion = aircraft.mass_properties, aircraft.propulsion
    response = propulsion.response
    if isinstance(response, TorqueResponse):
        gain, up, down = (x / v.lag[i] for x in (response.gain, response.torque_up, response.torque_down))
        response = TorqueResponse(gain=gain, torque_up=up, torque_down=down)
    else:
        response = replace(
            response,
            time_constant_up=response.time_constant_up * v.lag[i],
            time_constant_down=response.time_constant_down * v.lag[i],
        )
    a, b, c = (x * v.speed[i] for x in propulsion.speed_curve)
    return replace(
        aircraft,
        mass_properties=MassProperties(mass.mass * v.mass[i], mass.centre, mass.inertia * v.inertia[i]),
        propulsion=replace(
            propulsion,
            response=response,
            speed_curve=(a, b, c),
            thrust_coefficient=tuple(x * v.thrust[i] for x in propulsion.thrust_coefficient),
            torque_ratio=tuple(x * v.torque[i] for x in propulsion.torque_ratio),
            delay=float(v.delay_s[i]),
        ),
    )


WORLDS: dict[str, dict[str, Any]] = {
    "centre": {"mount": Mount.CENTRE},
    "rig": {"mount": Mount.RIG},
    "hanging": {"mount": Mount.RIG, "gravity": True},
    "free": {"mount": Mount.FREE, "wind": (2.0, -1.0, 0.0)},
    "ground": {"mount": Mount.FREE, "ground": True},
}


def test_a_drawn_vibration_is_that_of_a_file_that_says_so() -> None:
    drawn = replace(Variation.nominal(2, NF1.propulsion.delay), vibration=np.array([0.5, np.nan]))
    gyro = replace(NF1.gyro, vibration=(0.5, 0.5, 0.25), harmonics=(0.1, 0.4))
    told = replace(NF1, gyro=gyro)
    commands = np.full((40, 2, 4), 0.5)
    varied, filed, usual = (
        readings(Twin(aircraft, 2, variation=variation, rng=np.random.default_rng(5)), commands)
        for aircraft, variation in ((NF1, drawn), (told, None), (NF1, None))
    )
    np.testing.assert_allclose(varied[:, 0], filed[:, 0], atol=1e-12)
    assert varied[:, 1].tobytes() == usual[:, 1].tobytes()
    assert np.abs(filed - usual).max() > 0.02


def readings(flown: Twin, commands: np.ndarray) -> np.ndarray:
    """Gyros of a flight, (T, N, 3)."""
    seen = []
    for command in commands:
        flown.step(command)
        seen.append(flown.gyro)
    flown.close()
    return np.array(seen)


# Not on the ground: there the last bit decides which corner of the box touches first.
@pytest.mark.parametrize("world", [world for world in WORLDS if world != "ground"])
@pytest.mark.parametrize("aircraft", [NF1, HEXA], ids=["nf1", "hexa"])
def test_a_varied_aircraft_flies_like_one_whose_file_says_so(aircraft: Aircraft, world: str) -> None:
    rng = np.random.default_rng(3)
    count = 5
    factors = ("mass", "inertia", "thrust", "torque", "speed", "lag")
    variation = Variation(
        **{name: np.exp(rng.uniform(-0.4, 0.4, count)) for name in factors},
        noise=np.ones(count),
        delay_s=np.array([0.0, 0.001, 0.003, 0.006, 0.002]),
        charge=np.array([1.0, 0.5, np.nan, 0.9, 0.2]),
        vibration=np.full(count, np.nan),
        motors=rng.uniform(0.8, 1.0, (count, MOTOR_COUNT_MAX)),
    )
    commands = rng.uniform(0.0, 0.9, (20, count, aircraft.motor_count)).repeat(10, axis=0)
    together = twin(variation, aircraft=aircraft, **WORLDS[world])
    apart = [
        twin(
            None,
            1,
            changed(aircraft, variation, i),
            charge=None if np.isnan(variation.charge[i]) else float(variation.charge[i]),
            **WORLDS[world],
        )
        for i in range(count)
    ]
    for single, motors in zip(apart, variation.motors, strict=True):
        single.weaken(motors[: aircraft.motor_count])
    worst = 0.0
    for k, command in enumerate(commands):
        together.step(command)
        for i, single in enumerate(apart):
            single.step(command[i : i + 1])
        if k % 20 == 19:
            for name in ("rate", "position", "velocity", "specific_force", "rotor_speed", "rotation"):
                ours = getattr(together, name)
                theirs = np.concatenate([getattr(single, name) for single in apart])
                scale = np.maximum(1.0, np.abs(theirs))
                worst = max(worst, float((np.abs(ours - theirs) / scale).max()))
    expected = np.concatenate([single.telemetry.voltage for single in apart])
    volts = together.telemetry.voltage
    assert worst < 1e-9
    assert np.array_equal(volts, expected)


@pytest.mark.parametrize("world", list(WORLDS))
def test_factors_of_one_change_nothing(world: str) -> None:
    same = twin(varied(3), noise=True, **WORLDS[world])
    plain = twin(None, 3, noise=True, **WORLDS[world])
    for command in np.random.default_rng(2).uniform(0, 1, (300, 3, 4)):
        same.step(command)
        plain.step(command)
    pairs = [(getattr(same, name), getattr(plain, name)) for name in ("rate", "gyro", "position")]
    exact = world not in ("rig", "hanging")  # whose maps are summed in another order
    for ours, theirs in pairs:
        assert np.array_equal(ours, theirs) if exact else np.abs(ours - theirs).max() < 1e-11


def test_each_aircraft_leaves_the_ground_under_its_own_weight() -> None:
    mass = np.repeat([0.6, 1.0, 1.8], 2)
    share = np.tile([0.95, 1.05], 3)  # of the weight that is thrust
    six = twin(varied(6, mass=mass, inertia=mass), aircraft=slick_on_ground(), mount=Mount.FREE, ground=True)
    repeat(300, six.step, np.zeros((6, 4)))
    stood, start = six.specific_force[:, 2].copy(), six.position[:, 2].copy()
    thrust = share * mass * NF1.mass_properties.mass * GRAVITY / 4
    a, b, c = NF1.propulsion.speed_curve
    c = c - np.sqrt(thrust / NF1.propulsion.thrust_coefficient[0])
    command = (-b + np.sqrt(b * b - 4 * a * c)) / (2 * a)
    repeat(800, six.step, np.repeat(command[:, None], 4, axis=1))
    climbed = six.position[:, 2] - start
    assert stood == pytest.approx(np.full(6, GRAVITY), abs=0.05)
    assert climbed[0::2] == pytest.approx(np.zeros(3), abs=1e-3)
    assert (climbed[1::2] > 0.05).all()


def test_each_aircraft_feels_a_command_after_its_own_delay() -> None:
    delays = [0.0, 0.001, 0.002, 0.0045, 0.006]
    asked, left = (twin(varied(5, delay_s=delays)) for _ in range(2))
    differs = []
    for _ in range(8):
        asked.step(np.ones((5, 4)))
        left.step(np.zeros((5, 4)))
        differs.append(asked.rotor_speed[:, 0] > left.rotor_speed[:, 0])
    # 4.5 ms are four samples: half goes to even, as for the aircraft file's delay.
    assert np.argmax(differs, axis=0).tolist() == [1, 1, 2, 4, 6]


def test_commands_under_way_still_arrive_when_another_aircraft_gets_a_longer_delay() -> None:
    pair = twin(varied(2, delay_s=[0.004, 0.004]))
    for level in (1.0, 0.0, 0.5):
        pair.step(np.full((2, 4), level))
    pair.vary(np.array([1]), varied(1, delay_s=[0.02]))
    pair.reset(np.array([1]))
    speeds = []
    for _ in range(5):
        pair.step(np.zeros((2, 4)))
        speeds.append(pair.rotor_speed[0, 0])
    plain = twin(None, 1, replace(NF1, propulsion=replace(NF1.propulsion, delay=0.004)))
    for level in (1.0, 0.0, 0.5):
        plain.step(np.full((1, 4), level))
    expected = []
    for _ in range(5):
        plain.step(np.zeros((1, 4)))
        expected.append(plain.rotor_speed[0, 0])
    assert speeds == expected
    assert any(later > earlier for earlier, later in pairwise(speeds))


def test_noise_and_bias_of_the_gyro_are_multiplied() -> None:
    count = 400
    factor = np.repeat([0.5, 3.0], count)
    many = twin(varied(2 * count, noise=factor), noise=True)
    readings = []
    for _ in range(60):
        many.measure()
        readings.append(many.gyro)
    taken = np.array(readings)
    spread = taken.std(axis=0, ddof=1).reshape(2, count, 3)
    bias = taken.mean(axis=0).reshape(2, count, 3)
    white = np.sqrt((spread**2).mean(axis=1))
    offset = np.sqrt((bias**2).mean(axis=1) - white**2 / 60)
    for row, times in enumerate((0.5, 3.0)):
        assert white[row] == pytest.approx(times * np.array(NF1.gyro.noise), rel=0.02)
        assert offset[row] == pytest.approx(np.full(3, times * NF1.gyro.bias), rel=0.15)


def test_each_battery_starts_at_its_own_charge_beside_a_bench_supply() -> None:
    charge = np.array([1.0, 0.5, 0.0, np.nan])
    four = twin(varied(4, charge=charge))
    rest = four.telemetry.voltage.copy()
    repeat(300, four.step, np.full((4, 4), 0.6))
    loaded, current = four.telemetry.voltage.copy(), four.telemetry.current.copy()
    speed = four.rotor_speed[:, 0].copy()
    four.reset()
    again = four.telemetry.voltage.copy()
    assert NF1.battery is not None
    open_circuit = open_circuit_voltage(NF1.battery, charge[:3])
    assert rest == pytest.approx([*open_circuit, 16.0], abs=0.006)  # telemetry counts centivolts
    assert again == pytest.approx(rest)
    assert (loaded[:3] < rest[:3] - 0.1).all()
    assert loaded[3] == pytest.approx(16.0)
    assert (current > 1.0).all()
    assert speed[0] > speed[1] > speed[2]


def test_varying_one_aircraft_leaves_the_others_where_they_are() -> None:
    pair = twin(varied(2), mount=Mount.RIG)
    lone = twin(varied(2), mount=Mount.RIG)
    command = np.array([[0.5, 0.2, 0.2, 0.2]] * 2)
    for step in range(100):
        if step == 50:
            pair.vary(np.array([0]), varied(1, mass=[1.2], inertia=[0.7], lag=[2.0], charge=[0.5]))
            pair.reset(np.array([0]))
        pair.step(command)
        lone.step(command)
    rates = pair.rate.copy(), lone.rate.copy()
    known = pair.variation
    assert np.array_equal(rates[0][1], rates[1][1])
    assert np.abs(rates[0][0] - rates[1][0]).max() > 0.1
    assert known is not None
    assert known.mass.tolist() == [1.2, 1.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass": [0.0, 1.0]}, r"mass is 0.0, expected above 0"),
        ({"inertia": [1.0, np.nan]}, r"inertia is nan, expected above 0"),
        ({"lag": [1.0, np.inf]}, r"lag is inf, expected above 0"),
        ({"noise": [1.0, -1.0]}, r"noise is -1.0, expected 0 or more"),
        ({"delay_s": [-0.001, 0.0]}, r"delay_s is -0.001, expected 0 or more"),
        ({"charge": [0.5, 1.1]}, r"charge is 1.1, expected 0 to 1"),
        ({"speed": [1.0]}, r"speed has shape \(1,\)"),
    ],
)
def test_refuses_what_cannot_fly(changes: dict[str, list[float]], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        varied(2, **changes)


def test_refuses_a_variation_where_there_is_no_place_for_it() -> None:
    with pytest.raises(ValueError, match="a variation of 2 aircraft, expected 3"):
        Twin(NF1, 3, variation=varied(2), rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="which says the charge"):
        Twin(NF1, 2, variation=varied(2), charge=1.0, rng=np.random.default_rng(0))
    with pytest.raises(AircraftError, match=r"no \[battery\] table"):
        twin(varied(1, charge=[0.5]), aircraft=replace(NF1, battery=None))
    plain = twin(None, 1)
    with pytest.raises(ValueError, match="made without a variation"):
        plain.vary(np.array([0]), varied(1))
