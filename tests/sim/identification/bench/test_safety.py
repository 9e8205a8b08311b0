"""A rotor on the bench stops, whatever happens: each test tries to keep it turning."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import pytest

from neuroflight.flash.link import requests
from neuroflight.flash.link.client import Client, RefusedError
from neuroflight.flash.link.transport import TcpPort, TcpTransport, Transport
from neuroflight.flash.motors.bench import MotorBench
from neuroflight.sim.identification.bench.drive import Log, Sensor, drive
from neuroflight.sim.identification.bench.guard import Guard, Limits, StoppedError
from neuroflight.sim.identification.bench.quantities import Rig as Meaning
from neuroflight.sim.identification.bench.sensor import LineReader
from neuroflight.sim.identification.dyno.bench import Phase
from neuroflight.toolchain.contract import MOTOR_TEST_TIMEOUT_MS, Msp, Refusal
from neuroflight.toolchain.errors import LinkError
from tests.sampling import sampled, sampled_rows
from tests.sim.identification.bench.rig import Rig, SensorKind, unplugged

LEVEL = 0.4
EXPERIMENT = (Phase(0.4, 0.0, 0.0), Phase(2.0, LEVEL, LEVEL), Phase(0.4, 0.0, 0.0))
FAULT_S = 0.8  # after the beginning: the rotor has its speed
EXPIRY_S = MOTOR_TEST_TIMEOUT_MS / 1000
TICK_S = 0.02
AGED_S = 0.3  # settling


@dataclass
class Stand:
    """A rig whose rotor is to be turned, and what may be put in the way."""

    rig: Rig
    meaning: Meaning
    sensor: Sensor
    begun: float = 0.0
    limits: Limits = field(default_factory=Limits)

    def run(self, transport: Transport | None = None, deadline: float = 1e9, level: float = LEVEL) -> Log:
        rig = self.rig
        line = transport or TcpTransport(TcpPort("127.0.0.1", rig.port.msp_port))
        guard = Guard(self.meaning, self.limits, rig.clock())
        self.begun = rig.clock()
        rest, held, last = EXPERIMENT
        phases = (rest, Phase(held.duration, level, level), last)
        with Client(line, rig.clock) as client, MotorBench(client, 0, 0.5) as motor:
            return drive(motor, self.sensor, guard, phases, rig.clock, deadline)

    def at_fault(self, do: Callable[[], object]) -> None:
        """Have something happen once, FAULT_S after the run began."""
        done = False

        def look() -> None:
            nonlocal done
            if not done and self.begun and self.rig.clock() >= self.begun + FAULT_S:
                done = True
                do()

        self.rig.on_step = look

    def stopped_after(self) -> float:
        """Time from the fault to the last step at which the motor turned [s]; it must have turned before."""
        self.rig.on_step = lambda: None
        self.rig.advance(EXPIRY_S + 0.1)
        assert self.rig.throttle == 0.0
        turned = [index for index, throttle in enumerate(self.rig.turned) if throttle > 0]
        assert max(self.rig.turned) == pytest.approx(LEVEL, abs=0.001)
        assert self.rig.others == 0.0
        return (turned[-1] + 1) / self.rig.port.gyro_rate_hz - (self.begun + FAULT_S)


@pytest.fixture
def stand(make_rig: Callable[..., Rig], cells_of: Callable[[SensorKind], Any]) -> Stand:
    rig = make_rig()
    sensor = Sensor(rig.line(), LineReader(), rig.clock)
    sensor.await_rows()
    layout = sensor.reader.layout
    assert layout is not None
    return Stand(rig, Meaning(layout, cells_of(rig.kind), rig.kind.blades, 0.02), sensor)


def test_the_rotor_turns_as_told_and_rests_when_nothing_happens(stand: Stand) -> None:
    log = stand.run()
    assert log.throttle.max() == pytest.approx(LEVEL)
    assert log.throttle[-1] == 0.0 and stand.rig.throttle == 0.0
    assert stand.stopped_after() == pytest.approx(2.4 - FAULT_S, abs=2 * TICK_S)


# --- The sensor -------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("fault", "says", "within"),
    sampled_rows(
        [
            ("silent_after", "no fresh reading for 0.5", 0.5 + 3 * TICK_S),
            ("frozen_after", "older than at the start", 0.25 / 0.95 + 5 * TICK_S),
            ("late_after", "no fresh reading for 0.5", 0.5 + 3 * TICK_S),
            ("blocked_after", "expected a rotor that turns", 0.6 + 4 * TICK_S),
        ],
        ("silent_after", "no fresh reading for 0.5", 0.5 + 3 * TICK_S),
    ),
)
def test_the_rotor_stops_when_the_sensor_tells_nothing_new(
    stand: Stand, fault: str, says: str, within: float
) -> None:
    setattr(stand.rig.faults, fault, stand.rig.clock() + FAULT_S)
    with pytest.raises(StoppedError, match=says):
        stand.run()
    assert stand.stopped_after() <= within


def test_the_rotor_stops_when_readings_come_ever_later(stand: Stand) -> None:
    """They come, and their clock moves, but they tell of what was."""
    rig = stand.rig
    kept: list[bytes] = []
    write, seen = rig.write, 0

    def slow(data: bytes) -> None:
        nonlocal seen
        kept.append(data)
        seen += 1
        if rig.clock() < stand.begun + FAULT_S or seen % 3 == 0:
            write(kept.pop(0))

    rig.write = slow  # type: ignore[method-assign]
    with pytest.raises(StoppedError, match="older than at the start"):
        stand.run()
    assert stand.stopped_after() <= 1.0


@pytest.mark.parametrize(
    ("limit", "column", "factor"),
    sampled_rows(
        [
            ("rpm_max", "pulses", None),
            ("thrust_max_n", "thrust_raw", 1.5),
            ("torque_max_n_m", "torque_left_raw", 20.0),
            ("amps_max", "amps", 3.0),
            ("temperature_max_c", "temperature_c", 2.0),
            ("volts_min", "volts", 0.7),
        ],
        ("rpm_max", "pulses", None),
        ("thrust_max_n", "thrust_raw", 1.5),
    ),
)
def test_the_rotor_stops_at_once_when_a_reading_is_beyond_its_limit(
    stand: Stand, limit: str, column: str, factor: float | None
) -> None:
    usual = {"rpm_max": 16_000, "thrust_max_n": 3.0, "torque_max_n_m": 0.05, "amps_max": 10.0}
    usual |= {"temperature_max_c": 50.0, "volts_min": 14.0}
    stand.limits = Limits(**usual)
    if factor is None:  # blades that flicker

        def flicker() -> None:
            stand.rig._angle += 0.5

        stand.at_fault(lambda: setattr(stand.rig, "on_step", flicker))
        says = "rotor speed is"
    else:
        stand.at_fault(lambda: stand.rig.faults.scale.update({column: factor}))
        says = limit.split("_")[0]
    with pytest.raises(StoppedError, match=f"{says}.*expected at"):
        stand.run()
    assert stand.stopped_after() <= 2 * TICK_S + (0.02 if factor is None else 0.0)


def test_the_rotor_never_begins_when_a_cell_is_loaded_or_the_sensor_starts_anew(stand: Stand) -> None:
    stand.rig.faults.scale["thrust_raw"] = 3.0
    with pytest.raises(StoppedError, match=r"thrust_raw shows .* N at rest"):
        stand.run()
    assert max(stand.rig.turned) == 0.0
    stand.rig.faults.scale.clear()
    stand.at_fault(lambda: setattr(stand.rig.kind, "clock_zero_us", stand.rig.kind.clock_zero_us - 1e7))
    with pytest.raises(StoppedError, match=r"clock went from .* did it start anew"):
        stand.run()
    assert stand.stopped_after() <= 2 * TICK_S


# --- The user and this program ------------------------------------------------------------------------
@pytest.mark.parametrize("kind", [KeyboardInterrupt, MemoryError])
def test_the_rotor_stops_at_once_when_the_program_is_interrupted(
    stand: Stand, kind: type[BaseException]
) -> None:
    def interrupt() -> None:
        raise kind

    stand.at_fault(interrupt)
    with pytest.raises(kind):
        stand.run()
    assert stand.stopped_after() <= TICK_S


def test_the_rotor_stops_when_the_time_limit_is_over(stand: Stand) -> None:
    with pytest.raises(StoppedError, match="time limit is over"):
        stand.run(deadline=stand.rig.clock() + FAULT_S)
    assert stand.stopped_after() <= 2 * TICK_S


@pytest.mark.parametrize("held_s", sampled([0.3, 2.0], 0.3))
def test_the_rotor_stops_when_this_computer_is_held_up(stand: Stand, held_s: float) -> None:
    """Whichever comes first: the gap is noticed here, or the board's own time-out ends the test."""
    stand.at_fault(lambda: stand.rig.advance(held_s))
    with pytest.raises((StoppedError, RefusedError)):
        stand.run()
    assert stand.stopped_after() <= min(held_s, EXPIRY_S) + 2 * TICK_S


def test_nothing_above_the_limit_is_sent_when_it_is_asked_for(stand: Stand) -> None:
    with stand.rig.client() as client, MotorBench(client, 0, 0.5) as motor:
        for throttle in (0.501, 1.0, -0.01, float("nan")):
            with pytest.raises(ValueError, match=r"expected 0 to 0\.5"):
                motor.give(throttle)
        with pytest.raises(RefusedError):  # nor does the board take it
            client.request(Msp.SET_MOTOR, struct.pack("<H", 1501))
    stand.rig.advance(0.1)
    assert max(stand.rig.turned) == 0.0


# --- The line and the board ---------------------------------------------------------------------------
class Cable:
    """The line to the board, until it breaks; then time passes on it in silence, or it raises."""

    def __init__(self, stand: Stand, gone: bool) -> None:
        self._stand, self._gone, self.broken = stand, gone, False
        self._line = TcpTransport(TcpPort("127.0.0.1", stand.rig.port.msp_port))

    name = "test cable"

    def read(self, timeout: float) -> bytes:
        if not self.broken:
            return self._line.read(timeout)
        self._stand.rig.advance(timeout)
        return unplugged() if self._gone else b""

    def write(self, data: bytes) -> None:
        if not self.broken:
            self._line.write(data)
        elif self._gone:
            unplugged()

    def close(self) -> None:
        self._line.close()

    def break_(self) -> None:
        self.broken = True


@pytest.mark.parametrize("gone", [True, False])
def test_the_board_stops_the_rotor_when_the_line_breaks(stand: Stand, gone: bool) -> None:
    cable = Cable(stand, gone)
    stand.at_fault(cable.break_)
    with pytest.raises(LinkError, match="did not confirm that the motor stops"):
        stand.run(cable)
    if gone:  # a connection that ends is noticed at once, before its values are old
        assert stand.stopped_after() <= 3 * TICK_S
    else:
        assert EXPIRY_S - 3 * TICK_S <= stand.stopped_after() <= EXPIRY_S + TICK_S


@pytest.mark.parametrize(("arm_us", "within"), [(1000, 0.25), (2000, 0.1)])
def test_the_rotor_stops_when_a_receiver_appears_or_the_arm_switch_goes_on(
    stand: Stand, arm_us: int, within: float
) -> None:
    """A link is one after some frames; a switch counts from the first that shows it."""
    channels = [1500, 1500, 1000, 1500, arm_us, *[1000] * 11]
    stand.at_fault(lambda: setattr(stand.rig, "channels", channels))
    with pytest.raises(LinkError, match=r"SET_MOTOR|ended the motor test"):
        stand.run()
    assert stand.stopped_after() <= within


def test_the_rotor_stops_when_another_program_ends_the_test(stand: Stand) -> None:
    def meddle() -> None:
        with stand.rig.client() as other:
            other.request(Msp.MOTOR_TEST, requests.motor_test(0))

    stand.at_fault(meddle)
    with pytest.raises(RefusedError, match="SET_MOTOR"):
        stand.run()
    assert stand.stopped_after() <= TICK_S


def test_a_look_at_the_board_finds_a_test_that_ended_when_no_value_was_sent_since(stand: Stand) -> None:
    with stand.rig.client() as client, MotorBench(client, 0, 0.5) as motor:
        motor.give(0.1)
        stand.rig.advance(0.1)
        motor.check()
        stand.rig.advance(2 * EXPIRY_S + 0.1)
        with pytest.raises(LinkError, match="ended the motor test"):
            motor.check()
        with pytest.raises(RefusedError):
            motor.give(0.1)
    assert stand.rig.throttle == 0.0


def test_nothing_turns_when_the_arm_switch_is_on_or_the_battery_is_low_before_the_run(stand: Stand) -> None:
    stand.rig.channels = [1500, 1500, 1000, 1500, 2000, *[1000] * 11]
    stand.rig.advance(0.5)
    with pytest.raises(LinkError, match="the arm switch is on"):
        stand.run()
    stand.rig.channels = None
    stand.rig.advance(2.0)
    stand.rig.port.set_battery(12.0, 0.0)
    stand.rig.advance(2.0)
    with pytest.raises(LinkError, match="the battery is low"):
        stand.run()
    assert max(stand.rig.turned) == 0.0


def test_nothing_opens_when_there_is_no_such_motor(stand: Stand) -> None:
    with stand.rig.client() as client:
        for motor in (-1, 4, 7):
            with pytest.raises(LinkError, match="expected 1 to 4"):
                MotorBench(client, motor)
        with pytest.raises(RefusedError) as refused:
            client.request(Msp.SET_MOTOR, requests.set_motor([1200]))
    assert requests.REASONS[Refusal.ORDER] in str(refused.value)
