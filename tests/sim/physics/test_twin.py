"""The twin as a whole: delay, repeatability, refusals, and that each motor turns it the right way."""

from dataclasses import replace

import numpy as np
import pytest

from neuroflight.sim.aircraft.model import Battery, Body, Thermal, load_aircraft
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GRAVITY
from neuroflight.toolchain.errors import AircraftError
from tests.sim.physics.flying import repeat

BODY = Body(size=(0.2, 0.16, 0.06), centre=(0.0, 0.0, 0.03), drag_area=(0.01, 0.01, 0.02))
PACK = Battery(cells=4, capacity=5580.0, rest_voltage=16.78, resistance=0.03, electronics_power=6.0)
NF1 = replace(load_aircraft("nf1"), body=BODY, battery=PACK)


def twin(count: int = 1, seed: int = 1, **options: object) -> Twin:
    return Twin(NF1, count, rng=np.random.default_rng(seed), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("rate_hz", "samples"), [(1000, 2), (4000, 8), (8000, 16)])
def test_a_command_acts_after_the_delay_at_any_rate(rate_hz: int, samples: int) -> None:
    asked, left = (twin(rate_hz=rate_hz, noise=False) for _ in range(2))
    differs = []
    for _ in range(samples + 1):
        asked.step(np.ones((1, 4)))
        left.step(np.zeros((1, 4)))
        differs.append(bool(asked.rotor_speed[0, 0] > left.rotor_speed[0, 0]))
    assert differs == [False] * samples + [True]


def test_a_command_acts_from_the_next_sample_when_there_is_no_delay() -> None:
    prompt = replace(NF1, propulsion=replace(NF1.propulsion, delay=0.0))
    aircraft = Twin(prompt, rng=np.random.default_rng(0), noise=False)
    aircraft.step(np.ones((1, 4)))
    at_once = aircraft.rotor_speed[0, 0]
    aircraft.step(np.ones((1, 4)))
    later = aircraft.rotor_speed[0, 0]
    assert at_once <= NF1.propulsion.speed_curve[2]
    assert later > 10.0


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize(
    ("motor", "signs"),
    [(0, (-1, 1, 1)), (1, (-1, -1, -1)), (2, (1, 1, -1)), (3, (1, -1, 1))],
    ids=["1 rear right cw", "2 front right ccw", "3 rear left ccw", "4 front left cw"],
)
def test_each_motor_turns_the_aircraft_its_own_way(
    motor: int, signs: tuple[int, int, int], mount: Mount
) -> None:
    aircraft = twin(noise=False, wash=False, mount=mount)
    command = np.full((1, 4), 0.3)
    command[0, motor] = 0.4
    repeat(60, aircraft.step, command)
    turned = tuple(np.sign(aircraft.rate[0]).astype(int))
    assert turned == signs


def test_reset_makes_an_aircraft_new_and_leaves_the_others() -> None:
    aircraft = twin(2, noise=False)
    repeat(100, aircraft.step, np.array([[0.5, 0.2, 0.2, 0.2]] * 2))
    other = aircraft.rate[1].copy()
    aircraft.reset(np.array([0]))
    assert aircraft.rate[0] == pytest.approx(np.zeros(3))
    assert aircraft.rotor_speed[0] == pytest.approx(np.zeros(4))
    assert np.array_equal(aircraft.rate[1], other)
    aircraft.step(np.zeros((2, 4)))
    assert aircraft.rotor_speed[0].max() < 1.0  # no command from before the reset still under way


@pytest.mark.parametrize(
    "motors",
    [np.full((1, 4), np.nan), np.full((1, 4), 1.5), np.full((1, 4), -0.1), np.zeros((1, 3)), np.zeros(4)],
    ids=["nan", "above one", "below zero", "three motors", "flat"],
)
def test_refuses_commands_that_are_no_fractions(motors: np.ndarray) -> None:
    aircraft = twin()
    with pytest.raises(ValueError, match="motor commands"):
        aircraft.step(motors)


def test_refuses_a_step_when_it_is_closed() -> None:
    aircraft = twin()
    aircraft.close()
    with pytest.raises(RuntimeError, match="is it closed"):
        aircraft.step(np.zeros((1, 4)))


def test_terminal_speed_thrust_and_yaw_torque_are_the_analytic_ones() -> None:
    """Half a per cent, in still air that holds nothing back: H(u), K_T w^2 and K_Q K_T w^2."""
    propulsion = replace(NF1.propulsion, drag_coefficient=0.0, rolling_coefficient=0.0)
    slick = replace(NF1, propulsion=propulsion, body=None)
    held = Twin(slick, noise=False, rng=np.random.default_rng(0))
    loose = Twin(slick, noise=False, mount=Mount.FREE, gravity=False, rng=np.random.default_rng(0))
    command = np.array([[0.6, 0.4, 0.4, 0.6]])  # the clockwise pair is faster: yaw to the left, nothing else
    repeat(800, held.step, command)
    repeat(800, loose.step, command)
    rate, velocity = held.rate[0, 2], loose.velocity[0, 2]
    repeat(10, held.step, command)
    repeat(10, loose.step, command)
    gained, climbed = (held.rate[0, 2] - rate) / 0.010, (loose.velocity[0, 2] - velocity) / 0.010
    speed, force = held.rotor_speed[0].copy(), loose.specific_force[0, 2]
    a, b, c = propulsion.speed_curve
    speeds = (a * command[0] + b) * command[0] + c
    thrusts = propulsion.thrust_coefficient[0] * speeds**2
    torque = -NF1.spins @ thrusts * propulsion.torque_ratio[0]
    assert speed == pytest.approx(speeds, rel=0.005)
    assert gained == pytest.approx(torque / NF1.mass_properties.inertia[2, 2], rel=0.005)
    assert climbed == pytest.approx(thrusts.sum() / NF1.mass_properties.mass, rel=0.005)
    assert force == pytest.approx(climbed, rel=1e-3)


def test_battery_sags_under_load_and_empties_as_power_says() -> None:
    sagging = twin(charge=1.0, noise=False)
    pack = NF1.battery
    assert pack is not None
    rest = sagging.telemetry.voltage[0]
    repeat(1000, sagging.step, np.full((1, 4), 0.8))
    report, speed = sagging.telemetry, sagging.rotor_speed.copy()
    settled = target_speed(np.array([[0.8]]), NF1.propulsion, report.voltage[:, None])
    torque = thrust_and_torque(speed, NF1.propulsion)[1]
    power = (speed * torque).sum() / NF1.propulsion.efficiency + pack.electronics_power
    step = NF1.esc.current_step / 2 + 0.01 * power / report.voltage[0]
    assert rest == pytest.approx(pack.rest_voltage, abs=NF1.esc.voltage_step)
    assert report.voltage[0] < rest - 0.1
    assert report.current[0] == pytest.approx(power / report.voltage[0], abs=step)
    assert speed[0] == pytest.approx([settled[0, 0]] * 4, rel=2e-3)


def test_draw_on_the_bench_is_the_rotors_power_and_more_while_they_speed_up() -> None:
    bench = twin(noise=False)
    still = bench.draw
    bench.step(np.full((1, 4), 0.6))
    for _ in range(30):
        before = bench.rotor_speed
        bench.step(np.full((1, 4), 0.6))
    early, speed = bench.draw, bench.rotor_speed
    repeat(1500, bench.step, np.full((1, 4), 0.6))
    late, settled = bench.draw, bench.rotor_speed
    bench.reset()
    again = bench.draw
    propulsion, idle = NF1.propulsion, PACK.electronics_power
    gained = propulsion.rotor_inertia * (speed - before) * 1000.0
    shaft = (speed * (thrust_and_torque(speed, propulsion)[1] + gained)).sum()
    assert (gained > 0.0).all()
    assert early.power[0] == pytest.approx(shaft / propulsion.efficiency + idle, rel=1e-9)
    held = (settled * thrust_and_torque(settled, propulsion)[1]).sum()
    assert late.power[0] == pytest.approx(held / propulsion.efficiency + idle, rel=1e-3)
    assert late.current[0] == pytest.approx(late.power[0] / propulsion.supply_voltage)
    assert still.power[0] == again.power[0] == pytest.approx(idle)


def test_draw_of_a_battery_is_what_it_gave_with_its_voltage() -> None:
    flying = twin(charge=0.8, noise=False)
    repeat(200, flying.step, np.full((1, 4), 0.5))
    drawn, packs = flying.draw, flying.battery
    assert packs is not None
    assert drawn.current[0] == packs.current[0]
    assert drawn.voltage[0] == flying.pack_voltage[0]
    assert drawn.power[0] == pytest.approx(drawn.voltage[0] * drawn.current[0])


def test_telemetry_tells_the_thrust_that_lifts_the_aircraft_and_the_torque_that_is_paid_for() -> None:
    weak = replace(Variation.nominal(2, NF1.propulsion.delay), thrust=np.array([1.0, 0.8]))
    pair = twin(2, noise=False, mount=Mount.CENTRE, variation=weak)
    repeat(500, pair.step, np.full((2, 4), 0.5))
    report, felt, drawn, speed = pair.telemetry, pair.specific_force[:, 2], pair.draw, pair.rotor_speed
    assert report.force.shape == report.torque.shape == (2, 4)
    # Held at the centre the aircraft feels its rotors alone.
    assert report.force.sum(axis=1) == pytest.approx(felt * NF1.mass_properties.mass)
    assert report.force[1] == pytest.approx(0.8 * report.force[0])
    shaft = (report.torque * speed).sum(axis=1)
    power = shaft / NF1.propulsion.efficiency + PACK.electronics_power
    assert power == pytest.approx(drawn.power, rel=1e-3)  # the rotors hardly gain speed any more


def test_windings_heat_up_to_what_their_current_sustains_and_cool_down() -> None:
    thermal = Thermal(winding_resistance=0.1, thermal_resistance=8.0, time_constant=0.1, ambient=25.0)
    hot = replace(NF1, esc=replace(NF1.esc, thermal=thermal))
    motors, known = Twin(hot, noise=False, rng=np.random.default_rng(1)), twin(noise=False)
    assert motors.telemetry.temperature.tolist() == [[25.0] * 4]
    repeat(1500, motors.step, np.array([[0.2, 0.6, 0.6, 0.2]]))
    repeat(1500, known.step, np.array([[0.2, 0.6, 0.6, 0.2]]))
    report, drawn = motors.telemetry, motors.draw
    assert np.array_equal(report.speed, known.telemetry.speed) and np.array_equal(motors.rate, known.rate)
    assert np.isnan(known.telemetry.temperature).all(), "without constants no temperature is known"
    current = np.sqrt((report.temperature[0] - 25.0) / (0.1 * 8.0))  # R_th R I^2 above ambient
    electronics = PACK.electronics_power / drawn.voltage[0]
    assert current.sum() == pytest.approx(drawn.current[0] - electronics, rel=1e-3)
    assert current[0] == pytest.approx(current[3]) and current[1] == pytest.approx(current[2])
    assert current[1] > 5 * current[0], "power goes with the third power of speed"
    repeat(1500, motors.step, np.zeros((1, 4)))
    assert motors.telemetry.temperature == pytest.approx(np.full((1, 4), 25.0), abs=0.1)
    motors.reset()
    assert motors.telemetry.temperature.tolist() == [[25.0] * 4]


def test_rotors_that_brake_give_no_power_back() -> None:
    braking = twin(charge=1.0, noise=False)
    repeat(500, braking.step, np.full((1, 4), 0.8))
    repeat(10, braking.step, np.zeros((1, 4)))
    report = braking.telemetry
    speed = braking.rotor_speed[0].copy()
    braking.step(np.zeros((1, 4)))
    lost = speed - braking.rotor_speed[0]
    drawn = float(braking.telemetry.current[0])
    inertia, torque = NF1.propulsion.rotor_inertia, thrust_and_torque(speed, NF1.propulsion)[1]
    assert (inertia * lost * 1000 > torque).all(), "braking must take more than the air does"
    assert drawn * report.voltage[0] == pytest.approx(PACK.electronics_power, rel=0.02)


def test_loose_aircraft_drifts_with_the_wind_until_it_flies_as_fast() -> None:
    """Without gravity and thrust only drag acts: the air takes the aircraft along, ever slower."""
    wind = (6.0, -3.0, 0.0)
    blown, still = (
        twin(mount=Mount.FREE, gravity=False, noise=False, wind=w) for w in (wind, (0.0, 0.0, 0.0))
    )
    lag = []
    for _ in range(2):
        repeat(4000, blown.step, np.zeros((1, 4)))
        repeat(4000, still.step, np.zeros((1, 4)))
        lag.append(float(np.linalg.norm(blown.velocity[0] - wind)))
    stayed = still.velocity[0].copy()
    assert stayed == pytest.approx(np.zeros(3), abs=0.01)  # at command zero the curve still says 87 rpm
    assert lag[1] < lag[0] < np.linalg.norm(wind)
    assert lag[0] < 0.9 * np.linalg.norm(wind)


def test_gusts_shake_each_aircraft_its_own_way_and_leave_the_gyro_noise_alone() -> None:
    gusty, calm = (twin(3, 4, mount=Mount.FREE, gust=g) for g in (15.0, 0.0))
    first = gusty.gyro.copy(), calm.gyro.copy()
    hover = np.full((3, 4), 0.25)
    repeat(300, gusty.step, hover)
    repeat(300, calm.step, hover)
    apart = gusty.velocity - calm.velocity
    assert np.array_equal(*first)
    assert np.abs(apart).max(axis=1).min() > 1e-3
    assert np.abs(apart[0] - apart[1]).max() > 1e-3


def test_specific_force_is_what_an_accelerometer_feels() -> None:
    falling, standing = twin(noise=False, mount=Mount.FREE), twin(noise=False, mount=Mount.FREE, ground=True)
    swinging = twin(noise=False, mount=Mount.RIG, gravity=True)
    for _ in range(300):
        for aircraft in (falling, standing, swinging):
            aircraft.step(np.zeros((1, 4)))
    forces = [aircraft.accelerometer[0].copy() for aircraft in (falling, standing, swinging)]
    assert forces[0] == pytest.approx([0.0, 0.0, 0.27], abs=0.02)  # drag of 2.9 m/s: 0.10 N on 0.391 kg
    assert forces[1] == pytest.approx([0.0, 0.0, 9.80665], abs=0.02)
    assert forces[2] == pytest.approx([0.0, 0.0, 9.80665], abs=1e-3)


@pytest.mark.parametrize("mount", [Mount.CENTRE, Mount.RIG])
@pytest.mark.parametrize("gravity", [False, True])
def test_a_held_accelerometer_feels_its_support_upwards_whatever_gravity_turns(
    mount: Mount, gravity: bool
) -> None:
    aircraft = twin(2, noise=False, mount=mount, gravity=gravity)
    assert aircraft.accelerometer == pytest.approx(np.tile([0.0, 0.0, GRAVITY], (2, 1)))
    turning = np.array([[0.3, 0.3, 0.32, 0.32], [0.3, 0.32, 0.3, 0.32]])
    repeat(400, aircraft.step, turning)
    felt, upwards = aircraft.accelerometer.copy(), aircraft.rotation[:, 2].copy()
    aircraft.reset(np.array([0]))
    again = aircraft.accelerometer.copy()
    assert np.degrees(np.arccos(upwards[:, 2])).min() > 20, "it must have turned"
    swinging = 0.0 if mount is Mount.CENTRE else 1.0  # [m/s^2], of the centre of mass below the rig's joint
    assert np.abs(felt - GRAVITY * upwards).max() <= swinging + 1e-12
    assert again[0] == pytest.approx([0.0, 0.0, GRAVITY])
    assert np.array_equal(again[1], felt[1])


def test_a_free_accelerometer_feels_the_rotors_alone_when_gravity_is_off() -> None:
    drifting = twin(noise=False, mount=Mount.FREE, gravity=False)
    at_rest = drifting.accelerometer.copy()
    repeat(500, drifting.step, np.full((1, 4), 0.4))
    felt, pushed = drifting.accelerometer.copy(), drifting.specific_force.copy()
    assert not at_rest.any()
    assert np.array_equal(felt, pushed)
    assert felt[0, 2] > 1.0


def test_turning_on_the_rig_pulls_the_centre_of_mass_inwards() -> None:
    """Yaw at w with the centre of mass r beside the joint: w^2 r towards the joint."""
    beside = replace(NF1, centre_of_thrust=(-0.03, 0.0, float(NF1.mass_properties.centre[2])))
    aircraft = Twin(beside, mount=Mount.RIG, noise=False, rng=np.random.default_rng(0))
    aircraft._world.reset([0], np.array([[0.0, 0.0, 10.0]]))
    repeat(10, aircraft.step, np.zeros((1, 4)))
    rate, force = aircraft.rate[0].copy(), aircraft.specific_force[0].copy()
    arm = float(NF1.mass_properties.centre[0]) + 0.03
    assert rate[2] == pytest.approx(10.0, abs=0.1)
    assert force[0] == pytest.approx(-(rate[2] ** 2) * arm, rel=0.01)


@pytest.mark.parametrize("mount", list(Mount))
def test_everything_on_repeats_exactly_for_a_seed(mount: Mount) -> None:
    air = {"ground": True, "wind": (3.0, 1.0, 0.0), "gust": 8.0} if mount is Mount.FREE else {}
    runs = []
    for seed in (3, 3, 4):
        aircraft = twin(2, seed, mount=mount, charge=0.9, **air)
        for command in np.random.default_rng(0).uniform(0, 1, (200, 2, 4)):
            aircraft.step(command)
        runs.append([aircraft.gyro.copy(), aircraft.accelerometer.copy()])
    assert all(np.array_equal(a, b) for a, b in zip(runs[0], runs[1], strict=True))
    assert not np.array_equal(runs[0][0], runs[2][0])


def test_vibration_of_the_rotors_reaches_the_gyro() -> None:
    shaky = replace(NF1, gyro=replace(NF1.gyro, noise=(0.0, 0.0, 0.0), bias=0.0, vibration=(0.1, 0.0, 0.0)))
    aircraft = Twin(shaky, rate_hz=8000, rng=np.random.default_rng(0))
    readings = []
    for step in range(8000):
        aircraft.step(np.array([[0.5, 0.0, 0.0, 0.0]]))
        if step >= 6000:
            readings.append(aircraft.gyro[0] - aircraft.rate[0])
    speed = aircraft.rotor_speed[0, 0]
    shake = np.array(readings)
    spectrum = np.abs(np.fft.rfft(shake[:, 0]))
    loudest = np.fft.rfftfreq(len(shake), 1 / 8000)[spectrum.argmax()]
    assert loudest == pytest.approx(speed / (2 * np.pi), abs=5.0)
    assert shake[:, 0].max() == pytest.approx(0.1 * (speed / NF1.propulsion.speed_max) ** 2, rel=0.05)
    assert np.abs(shake[:, 1:]).max() == 0.0


def test_an_aircraft_without_what_is_asked_for_is_refused() -> None:
    bare = replace(NF1, battery=None, body=None)
    with pytest.raises(AircraftError, match=r"no \[battery\] table"):
        Twin(bare, charge=1.0, rng=np.random.default_rng(0))
    with pytest.raises(AircraftError, match=r"no \[body\] table"):
        Twin(bare, mount=Mount.FREE, ground=True, rng=np.random.default_rng(0))
    unknown = replace(NF1, propulsion=replace(NF1.propulsion, supply_voltage=None))
    with pytest.raises(AircraftError, match="supply_voltage_v missing"):
        Twin(unknown, charge=1.0, rng=np.random.default_rng(0))


def test_reset_of_one_aircraft_leaves_the_sensors_of_the_others_where_they_are() -> None:
    slow = replace(NF1, gyro=replace(NF1.gyro, bandwidth_hz=20.0))
    aircraft = Twin(slow, 2, rng=np.random.default_rng(0))
    repeat(20, aircraft.step, np.array([[0.5, 0.2, 0.2, 0.2]] * 2))
    before = aircraft.gyro.copy()
    aircraft.reset(np.array([0]))
    after = aircraft.gyro.copy()
    assert np.array_equal(after[1], before[1])
    assert not np.array_equal(after[0], before[0])


@pytest.mark.parametrize("mount", list(Mount))
@pytest.mark.parametrize("varied", [False, True], ids=["alike", "varied"])
def test_one_aircraft_gets_the_bits_that_it_gets_among_others(mount: Mount, varied: bool) -> None:
    """Rows of a twin of five and twins of one, the same commands, with everything that needs no draw."""
    rng = np.random.default_rng(8)
    factors = rng.uniform(0.8, 1.25, (7, 5))
    names = ("mass", "inertia", "thrust", "torque", "speed", "lag", "noise")
    five = Variation(
        **dict(zip(names, factors, strict=True)),
        delay_s=rng.uniform(0.0, 0.004, 5),
        charge=rng.uniform(0.5, 1.0, 5),
        vibration=np.full(5, np.nan),
        motors=rng.uniform(0.8, 1.2, (5, 8)),
    )
    commands = np.repeat(rng.uniform(0.0, 1.0, (30, 5, 4)), 10, axis=0)
    options: dict[str, object] = {"noise": False, "wash": False, "mount": mount, "gravity": True}
    if mount is Mount.FREE:
        options["wind"] = (2.0, 1.0, -1.0)
    if not varied:
        options["charge"] = 0.7

    def flown(which: slice) -> np.ndarray:
        count = which.stop - which.start
        aircraft = twin(count, **(options | ({"variation": five.at(which)} if varied else {})))  # type: ignore[arg-type]
        for command in commands[:, which]:
            aircraft.step(command)
        seen = (aircraft.rate, aircraft.rotation, aircraft.velocity, aircraft.position, aircraft.gyro)
        more = (aircraft.specific_force, aircraft.accelerometer, aircraft.rotor_speed)
        rows: np.ndarray = np.concatenate([each.reshape(len(each), -1) for each in (*seen, *more)], axis=1)
        return rows

    among = flown(slice(0, 5))
    assert np.abs(among[:, :3]).max() > 1.0, "they must have turned"
    for i in range(5):
        assert flown(slice(i, i + 1)).tobytes() == among[i : i + 1].tobytes()
