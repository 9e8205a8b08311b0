"""The host program over its real sockets: flights that end as they should; what each injected fault does."""

from __future__ import annotations

import math
import os
import shutil
import struct
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import TcpPort, TcpTransport
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.analysis.metrics import figures
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import (
    DEADLINE_MISSES_MAX,
    FLASH_BASE,
    FLASH_FAULT_RECORD,
    GYRO_BAD_MS,
    GYRO_SATURATED_MS,
    MOTOR_TEST_MAGIC,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    RECEIVER_RECOVERY_MS,
    SETTINGS,
    FallbackCause,
    FilterKind,
    FlightState,
    GyroHealth,
    Msp,
    StopCause,
)
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.files import locked
from neuroflight.toolchain.policy.model import read_policy
from tests.sampling import examples

ROOT = Path(__file__).resolve().parents[3]
STILL = (0.0, 0.0, 0.0)
STOPPED = (0.0, 0.0, 0.0, 0.0)
FRAME_MS = 10
TOO_FAST = math.radians(2100)  # rad/s, beyond the gyro's range
GLITCH_MS = 2
NAN_STEP = 400  # of the policy: in flight
Rates = Sequence[float]


class Pilot:
    """Flies a program at 1 kHz with a frame each 10 ms: one call is one millisecond."""

    def __init__(self, program: Any) -> None:
        self.program = program
        self.ms = 0
        self.arm, self.throttle, self.pid = 1000, 1000, 1000
        self.heard = True
        self.noise = np.random.default_rng(3)

    def step(self, rates: Rates | None = None, *, late_ms: float = 0.0) -> tuple[float, ...]:
        """One sample of a gyro with noise, unless `rates` are given; returns the motors' fractions."""
        if self.heard and self.ms % FRAME_MS == 0:
            self.program.sticks(arm=self.arm, throttle=self.throttle, pid=self.pid)
        given = self.noise.normal(0, 0.02, 3).tolist() if rates is None else rates
        self.ms += 1
        self.program.state(given, time_s=self.ms / 1000 + late_ms / 1000)
        motors: tuple[float, ...] = self.program.motors()
        return motors

    def run(self, ms: int, rates: Rates | None = None) -> list[tuple[float, ...]]:
        return [self.step(rates) for _ in range(ms)]

    def boot(self) -> None:
        assert set(self.run(1150)) == {STOPPED}

    def take_off(self) -> None:
        """Boot, arm, throttle up."""
        self.boot()
        self.arm = 2000
        self.run(50)
        self.throttle = 1400
        assert min(min(row) for row in self.run(100)[20:]) > 0

    def connect(self) -> Client:
        """A program that stays."""
        return Client(TcpTransport(TcpPort("127.0.0.1", self.program.ports["msp"])))

    def ask(self, command: Msp, payload: bytes = b"") -> bytes:
        with self.connect() as client:
            return client.request(command, payload)

    @property
    def safety(self) -> records.Safety:
        return records.safety(self.ask(Msp.SAFETY))

    def state(self) -> FlightState:
        return self.safety.state

    @property
    def reasons(self) -> set[str]:
        flags = records.safety(self.ask(Msp.SAFETY)).arming_flags
        return set(messages.arming_reasons(flags))


MakePilot = Callable[..., Pilot]


@pytest.fixture
def make_pilot(start: Callable[..., Any], host_program: Path) -> MakePilot:
    """Starts the firmware around the shipped policy and its PID."""

    def make(*options: str, build: Path = host_program.parent) -> Pilot:
        return Pilot(start("--gyro-hz=1000", "--trace-port=0", *options, build=build))

    return make


@pytest.fixture
def pilot(make_pilot: MakePilot) -> Pilot:
    return make_pilot()


def stops_after(rows: list[tuple[float, ...]]) -> int:
    """Milliseconds until the motors stand; and stand for good."""
    stopped = [row == STOPPED for row in rows]
    assert True in stopped, "the motors still turn"
    first = stopped.index(True)
    assert all(stopped[first:])
    return first + 1


# --- Flights ----------------------------------------------------------------------------------
def test_it_arms_flies_and_disarms_when_the_pilot_says_so(pilot: Pilot) -> None:
    pilot.take_off()
    assert pilot.state() == FlightState.ARMED
    pilot.run(500)
    pilot.arm = 1000
    while pilot.ms % FRAME_MS:
        pilot.step()
    assert all(min(row) > 0 for row in pilot.run(FRAME_MS)), "one frame that says off may be wrong"
    assert pilot.step() == STOPPED, "in the step of the second one"
    assert (pilot.safety.state, pilot.safety.stop_cause) == (FlightState.DISARMED, StopCause.SWITCH)
    assert set(pilot.run(100)) == {STOPPED}
    pilot.throttle = 1000
    pilot.run(50)
    pilot.arm = 2000
    pilot.run(50)
    assert pilot.state() == FlightState.ARMED


@pytest.mark.parametrize("seed", range(examples(40)))
def test_it_ends_disarmed_in_time_when_the_receiver_is_lost_at_a_random_moment(
    make_pilot: MakePilot, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    p = make_pilot()
    p.take_off()
    p.throttle = int(rng.integers(1000, 2001))
    p.run(int(rng.integers(1, 400)))
    p.heard = False
    since_frame = (p.ms - 1) % FRAME_MS + 1
    rows = p.run(RECEIVER_LOST_MS + 50)
    assert stops_after(rows) + since_frame == RECEIVER_LOST_MS + 1
    assert p.state() == FlightState.FAILSAFE_DROP
    assert p.safety.stop_cause == StopCause.RECEIVER
    p.heard = True
    assert set(p.run(500)) == {STOPPED}, "the switch is still on"
    p.arm, p.throttle = 1000, 1000
    p.run(RECEIVER_RECOVERY_MS + 20)
    assert p.state() == FlightState.DISARMED
    assert not p.reasons


def test_it_holds_and_flies_on_when_the_receiver_is_back_within_the_hold(pilot: Pilot) -> None:
    pilot.take_off()
    pilot.heard = False
    pilot.run(RECEIVER_HOLD_MS + 50)
    assert pilot.state() == FlightState.FAILSAFE_HOLD
    pilot.heard = True
    pilot.run(2 * FRAME_MS)
    assert pilot.state() == FlightState.ARMED


@pytest.mark.parametrize(("delay_ms", "silence_ms"), [(None, 900), (2000, 1900), (20_000, 5000)])
def test_it_flies_on_when_frames_come_again_within_the_failsafe_delay(
    make_pilot: MakePilot, delay_ms: int | None, silence_ms: int
) -> None:
    p = make_pilot() if delay_ms is None else make_pilot(f"--set=failsafe_delay_ms={delay_ms}")
    p.take_off()
    p.heard = False
    assert min(map(min, p.run(silence_ms))) > 0
    assert p.state() == FlightState.FAILSAFE_HOLD
    p.heard = True
    p.run(2 * FRAME_MS)
    assert p.state() == FlightState.ARMED


@pytest.mark.parametrize("delay_ms", [200, 3000])
def test_the_stage_begins_when_silence_has_lasted_as_long_as_is_set(
    make_pilot: MakePilot, delay_ms: int
) -> None:
    p = make_pilot(f"--set=failsafe_delay_ms={delay_ms}", "--set=failsafe_hold_ms=100")
    p.take_off()
    p.heard = False
    since_frame = (p.ms - 1) % FRAME_MS + 1
    assert stops_after(p.run(delay_ms + 50)) + since_frame == delay_ms + 1
    assert p.safety.stop_cause == StopCause.RECEIVER


def test_it_descends_and_then_stops_when_that_is_the_set_stage(make_pilot: MakePilot) -> None:
    p = make_pilot("--set=failsafe_stage=1", "--set=failsafe_descend_ms=300", "--set=failsafe_throttle=0.5")
    p.take_off()
    p.heard = False
    p.run(RECEIVER_LOST_MS)
    descending = p.run(250)
    assert p.state() == FlightState.FAILSAFE_DROP
    assert min(map(min, descending)) > 0.5, "its throttle, not the pilot's"
    assert stops_after(p.run(100)) <= 60


# --- Faults -----------------------------------------------------------------------------------
NAN = (math.nan, 0.0, 0.0)


def test_a_glitch_is_flown_through_and_the_motors_stop_when_the_gyro_stays_bad(pilot: Pilot) -> None:
    pilot.take_off()
    for _ in range(20):
        assert all(min(row) > 0 for row in pilot.run(GLITCH_MS, NAN) + pilot.run(20))
    assert abs(stops_after(pilot.run(3 * GYRO_BAD_MS, NAN)) - GYRO_BAD_MS) <= 1
    assert (pilot.safety.state, pilot.safety.stop_cause) == (FlightState.FAULT, StopCause.GYRO_INVALID)
    pilot.arm, pilot.throttle = 1000, 1000
    pilot.run(300)
    pilot.arm = 2000
    assert set(pilot.run(300)) == {STOPPED}, "until the next boot"
    assert "FAULT" in pilot.reasons


def too_fast(p: Pilot, ms: int) -> list[tuple[float, ...]]:
    """So long a pitch beyond the gyro's range, the other axes alive."""
    return [p.step((*p.noise.normal(0, 0.02, 1), TOO_FAST, *p.noise.normal(0, 0.02, 1))) for _ in range(ms)]


def test_it_flies_a_saturated_gyro_tells_it_and_stops_when_that_lasts(make_pilot: MakePilot) -> None:
    # Or these would stop an aircraft that turns at 2000 deg/s with the sticks in their middle.
    off = ("crash_detection", "runaway_detection", "plausibility_detection", "level_limit_deg")
    p = make_pilot(*(f"--set={name}=0" for name in off))
    p.take_off()
    for _ in range(3):
        assert all(min(row) > 0 for row in too_fast(p, GYRO_SATURATED_MS - 20))
        assert (p.state(), p.safety.gyro_health) == (FlightState.ARMED, GyroHealth.SATURATED)
        assert all(min(row) > 0 for row in p.run(2))
        assert p.safety.gyro_health == GyroHealth.GOOD
    assert abs(stops_after(too_fast(p, GYRO_SATURATED_MS + 50)) - GYRO_SATURATED_MS) <= 1
    assert (p.safety.state, p.safety.stop_cause) == (FlightState.CRASHED, StopCause.GYRO_SATURATED)
    p.arm, p.throttle = 1000, 1000
    assert set(too_fast(p, 300)) == {STOPPED}
    assert "GYRO_BAD" in p.reasons
    p.arm = 2000
    assert set(too_fast(p, 100)) == {STOPPED}, "nothing arms with a gyro that stays at its end"
    p.arm = 1000
    p.run(50)  # on the ground again
    assert not p.reasons
    p.arm = 2000
    assert min(p.run(50)[-1]) > 0


def test_the_motors_stop_when_the_gyro_is_stuck(pilot: Pilot) -> None:
    pilot.take_off()
    pilot.program.alive = False
    assert abs(stops_after(pilot.run(3 * GYRO_BAD_MS, (0.1, 0.2, 0.3))) - GYRO_BAD_MS) <= 2
    assert (pilot.safety.state, pilot.safety.stop_cause) == (FlightState.FAULT, StopCause.GYRO_STUCK)


def test_the_motors_stop_when_the_gyro_was_silent(pilot: Pilot) -> None:
    pilot.take_off()
    assert min(pilot.step(late_ms=GYRO_BAD_MS - 2)) > 0
    pilot.ms += GYRO_BAD_MS - 2
    assert min(pilot.step()) > 0
    assert pilot.step(late_ms=GYRO_BAD_MS + 1) == STOPPED
    assert (pilot.safety.state, pilot.safety.stop_cause) == (FlightState.FAULT, StopCause.GYRO_SILENT)


def test_it_does_not_arm_while_the_gyro_is_bad_and_does_again_when_it_has_mended(pilot: Pilot) -> None:
    pilot.boot()
    pilot.run(2 * GYRO_BAD_MS, NAN)
    assert pilot.safety.gyro_health == GyroHealth.INVALID
    assert pilot.reasons == {"GYRO_BAD"}
    pilot.run(20)
    assert not pilot.reasons


def test_the_pid_flies_on_when_deadlines_are_missed(pilot: Pilot) -> None:
    pilot.take_off()
    pilot.program.power(control_us=1001.0)
    pilot.run(DEADLINE_MISSES_MAX - 1)
    pilot.program.power(control_us=900.0)
    pilot.run(5)
    assert not pilot.safety.pid_flies
    pilot.program.power(control_us=1001.0)
    pilot.run(DEADLINE_MISSES_MAX)
    pilot.program.power(control_us=900.0)
    assert all(min(row) > 0 for row in pilot.run(50))
    assert (pilot.safety.pid_flies, pilot.safety.fallback_cause) == (True, FallbackCause.DEADLINE)
    tasks = {load.task.name: load for load in records.tasks(pilot.ask(Msp.TASKS)).loads}
    assert tasks["CONTROL"].misses == 2 * DEADLINE_MISSES_MAX - 1


def test_nothing_arms_by_itself_and_the_link_is_lost_when_the_receiver_speaks_garbage(pilot: Pilot) -> None:
    pilot.take_off()
    pilot.heard = False
    rng = np.random.default_rng(8)
    rows = []
    for _ in range(RECEIVER_LOST_MS + 50):
        # Channels that no receiver has: the host says them as they are.
        pilot.program.send("receiver", rng.integers(0, 256, int(rng.integers(0, 39)), np.uint8).tobytes())
        rows.append(pilot.step())
    assert stops_after(rows) <= RECEIVER_LOST_MS + 1
    assert pilot.safety.stop_cause == StopCause.RECEIVER


def test_it_only_warns_when_the_battery_is_low(pilot: Pilot) -> None:
    pilot.take_off()
    pilot.program.power(volts=4 * 3.1, amps=20.0)
    assert all(min(row) > 0 for row in pilot.run(3000))
    state = messages.battery_state(pilot.ask(Msp.BATTERY_STATE))
    assert state.level is messages.BatteryLevel.CRITICAL
    assert pilot.state() == FlightState.ARMED


def test_it_does_not_arm_when_the_battery_is_unknown(pilot: Pilot) -> None:
    pilot.program.power(volts=0.3)
    pilot.boot()
    assert pilot.reasons == {"BATTERY_UNKNOWN"}
    pilot.arm = 2000
    assert set(pilot.run(100)) == {STOPPED}


@pytest.fixture(scope="module")
def wrong_weight(host_program: Path, shipped_policy: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program with one bit of one weight of its policy turned over."""
    folder = tmp_path_factory.mktemp("wrong")
    data = bytearray(host_program.read_bytes())
    blob = compile_policy(read_policy(shipped_policy)).emission.blob
    data[data.index(blob) + len(blob) // 2] ^= 1
    (folder / "neuroflight").write_bytes(data)
    shutil.copymode(host_program, folder / "neuroflight")
    return folder


def test_the_policy_cannot_arm_but_the_pid_can_when_a_weight_is_corrupted(
    make_pilot: MakePilot, wrong_weight: Path
) -> None:
    p = make_pilot(build=wrong_weight)
    p.boot()
    assert p.reasons == {"POLICY_BAD"}
    assert not p.safety.policy_good
    p.arm = 2000
    assert set(p.run(100)) == {STOPPED}
    p.arm, p.pid = 1000, 2000
    p.run(50)
    assert not p.reasons
    p.arm = 2000
    p.run(50)
    assert p.state() == FlightState.ARMED
    p.pid = 1000
    assert all(min(row) > 0 for row in p.run(100)), "the switch does not put a bad policy in command"
    assert p.safety.pid_flies


@pytest.fixture(scope="module")
def nan_policy(host_program: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program around a policy that answers no number at its step NAN_STEP, self-test included."""
    folder = tmp_path_factory.mktemp("nan") / "HOST"
    with locked(host_program.parent):
        shutil.copytree(host_program.parent, folder)  # but for the policy everything is compiled there
    generated = folder / "generated"
    source = (generated / "policy.c").read_text()
    call = "void policy_step("
    assert source.count(call) == 1
    wrapper = f"""
void policy_step(struct policy *p, const float observation[POLICY_OBSERVATION_COUNT],
                 float action[POLICY_ACTION_COUNT])
{{
    static int step;

    good_step(p, observation, action);
    if (++step == {NAN_STEP})
        action[2] = __builtin_nanf("");
}}
"""
    (generated / "policy.c").write_text(source.replace(call, "static void good_step(") + wrapper)
    firmware = ROOT / "firmware"
    make = ["make", "-s", "-C", str(firmware), "TARGET=HOST"]
    make += [f"GENERATED={os.path.relpath(generated, firmware)}"]
    make += [f"BUILD={os.path.relpath(folder / 'make', firmware)}"]
    subprocess.run(make, check=True, capture_output=True)
    return folder / "make"


def test_the_pid_answers_in_the_same_step_when_the_policy_answers_no_number(
    make_pilot: MakePilot, nan_policy: Path
) -> None:
    p = make_pilot(build=nan_policy)
    p.take_off()
    assert not p.safety.pid_flies
    rows = p.run(NAN_STEP)
    assert all(0.0 < value <= 1.0 for row in rows for value in row)
    assert (p.safety.pid_flies, p.safety.fallback_cause) == (True, FallbackCause.POLICY_OUTPUT)
    p.run(50)
    assert p.safety.pid_flies, "the policy is refused"
    p.arm, p.throttle = 1000, 1000
    p.run(50)
    assert p.reasons == {"POLICY_REFUSED"}
    assert p.safety.fallback_cause == FallbackCause.POLICY_OUTPUT, "told after disarming"
    p.arm = 2000
    assert set(p.run(50)) == {STOPPED}
    p.arm, p.pid = 1000, 2000
    p.run(50)
    assert not p.reasons
    p.arm = 2000
    p.run(50)
    assert (p.safety.state, p.safety.pid_flies) == (FlightState.ARMED, True)
    p.pid = 1000
    p.run(50)
    assert (p.safety.pid_flies, p.safety.fallback_cause) == (True, FallbackCause.POLICY_OUTPUT)


# --- What MSP may change ----------------------------------------------------------------------
def setting_index(name: str) -> int:
    return [setting.name for setting in SETTINGS].index(name)


def test_a_setting_is_flown_from_the_next_boot_on_when_it_is_saved(
    make_pilot: MakePilot, tmp_path: Path
) -> None:
    file = f"--settings={tmp_path / 'flash.bin'}"
    first = make_pilot(file)
    first.boot()
    change = struct.pack("<HI", setting_index("filter1_kind"), FilterKind.PT1)
    first.ask(Msp.SETTING_SET, change)
    first.ask(Msp.EEPROM_WRITE)
    first.run(200)
    assert not first.reasons, "this boot flies as it began"
    first.program.end()
    second = make_pilot(file)
    second.boot()
    assert second.reasons == {"POLICY_BAD"}, "the policy was trained without a filter"
    assert "PID" not in " ".join(second.reasons)
    second.pid = 2000
    second.run(50)
    assert not second.reasons


def test_nothing_is_saved_when_it_is_armed(pilot: Pilot) -> None:
    pilot.take_off()
    with pytest.raises(LinkError):
        pilot.ask(Msp.EEPROM_WRITE)
    assert all(min(row) > 0 for row in pilot.run(50))
    assert not pilot.reasons


def test_motors_turn_on_request_and_nothing_arms_meanwhile_when_the_test_is_open(pilot: Pilot) -> None:
    pilot.boot()
    values = struct.pack("<4H", 1000, 1080, 1000, 1000)
    with pytest.raises(LinkError):
        pilot.ask(Msp.SET_MOTOR, values)
    with pilot.connect() as bench:
        bench.request(Msp.MOTOR_TEST, struct.pack("<I", MOTOR_TEST_MAGIC))
        pilot.run(2)
        bench.request(Msp.SET_MOTOR, values)
        turning = pilot.run(5)[-1]
        assert turning[1] == pytest.approx(0.08, abs=1e-3)
        assert (turning[0], *turning[2:]) == (0.0, 0.0, 0.0)
        pilot.arm = 2000
        rows = pilot.run(60)
    assert stops_after(rows) <= FRAME_MS + 1, "a pilot who wants to arm ends it"
    assert pilot.state() == FlightState.DISARMED
    assert "MOTOR_TEST" in pilot.reasons


def test_motors_stop_when_the_program_that_turns_them_hangs_up(pilot: Pilot) -> None:
    pilot.boot()
    with pilot.connect() as bench:
        bench.request(Msp.MOTOR_TEST, struct.pack("<I", MOTOR_TEST_MAGIC))
        pilot.run(2)
        bench.request(Msp.SET_MOTOR, struct.pack("<4H", *[1080] * 4))
        with pilot.connect() as other:
            other.request(Msp.SAFETY)
        assert min(pilot.run(5)[-1]) > 0, "another one that hangs up ends nothing"
    assert max(pilot.run(100)[-1]) == 0, "long before its values are too old"


def test_sticks_come_by_msp_when_that_is_the_receiver(make_pilot: MakePilot) -> None:
    p = make_pilot(f"--set=receiver_protocol={2}")
    p.heard = False
    order = struct.Struct("<16H")
    for ms in range(1600):
        if ms % FRAME_MS == 0:
            switch = 2000 if ms >= 1200 else 1000
            p.ask(Msp.SET_RAW_RC, order.pack(1500, 1500, 1000, 1500, switch, *[1000] * 11))
        p.step()
    assert p.state() == FlightState.ARMED
    assert stops_after(p.run(RECEIVER_LOST_MS + 20)) <= RECEIVER_LOST_MS + 1


# --- In the twin ------------------------------------------------------------------------------
@contextmanager
def flight(library: Path, mount: Mount, **settings: float) -> Iterator[tuple[ReferencePort, Twin]]:
    port = ReferencePort(library, 1000, settings)
    twin = Twin(load_aircraft("nf1"), rate_hz=1000, mount=mount, rng=np.random.default_rng(5))
    try:
        yield port, twin
    finally:
        twin.close()
        port.close()


def test_no_motor_jumps_when_policy_and_pid_take_turns_in_hover(reference_library: Path) -> None:
    hover = Segment(0.5, throttle=0.25)
    scenario = Scenario(
        "turns",
        tuple(hover if k % 2 else Segment(0.5, throttle=0.25, pid=True) for k in range(1, 21)),
        Mount.FREE,
    )
    with flight(reference_library, Mount.FREE) as (port, twin):
        trace = fly(twin, port, scenario)
    moves = np.abs(np.diff(trace.motors, axis=0)).max(axis=1)
    switches = np.arange(500, len(trace.t), 500)
    at_switches = max(float(moves[k - 5 : k + 60].max()) for k in switches)
    print(f"largest step of a motor around a change of controller: {at_switches:.4f}")
    assert at_switches < 0.1
    assert figures(trace).tracking.mae.max() < 6.0
    assert (trace.dshot > 0).all()


def test_the_motors_stop_within_a_second_when_two_motors_are_swapped(reference_library: Path) -> None:
    scenario = Scenario("runaway", (Segment(0.1), Segment(2.0, (60.0, 0.0, 0.0), 0.3)))
    with flight(reference_library, Mount.CENTRE) as (port, twin):
        trace = fly(twin, port, scenario, motor_order=(0, 2, 1, 3))
        client = Client(port.reference)
        safety = records.safety(client.request(Msp.SAFETY))
    # The pilot's "off" at the end is not confirmed yet.
    assert (safety.state, safety.stop_cause) == (FlightState.CRASHED, StopCause.RUNAWAY)
    stopped = int(np.argmin((trace.dshot > 0).all(axis=1)))
    print(f"two motors swapped: stopped after {stopped} ms, {safety.stop_cause.name}")
    assert 0 < stopped < 1000
    assert not trace.dshot[stopped:].any()


def test_a_full_log_begins_anew_some_seconds_after_the_boot_and_only_while_disarmed(
    make_pilot: MakePilot, tmp_path: Path
) -> None:
    flash = tmp_path / "flash.bin"
    log = slice(FLASH_FAULT_RECORD.address - FLASH_BASE, FLASH_FAULT_RECORD.address - FLASH_BASE + 0x4000)
    make_pilot(f"--settings={flash}").program.end()  # it is made, with its policy
    content = bytearray(flash.read_bytes())
    content[log] = b"\x55" * FLASH_FAULT_RECORD.size  # written all over
    flash.write_bytes(content)
    p = make_pilot(f"--settings={flash}")
    p.take_off()
    p.run(6000)
    assert p.state() == FlightState.ARMED
    assert flash.read_bytes()[log] == content[log], "nothing is erased at boot, nor in flight"
    p.arm, p.throttle = 1000, 1000
    p.run(200)
    assert flash.read_bytes()[log.start : log.start + 4] == b"NFFL"
    p.run(FRAME_MS)
    assert not p.reasons
