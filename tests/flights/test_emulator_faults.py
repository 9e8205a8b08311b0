"""How the firmware reacts to injected faults on the emulated board, as docs/explanation/safety.md says."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.sim.board.debug.control_timing import missed_deadlines
from neuroflight.sim.board.debug.fault_injection import FAULTS, Fault, parse_fault
from neuroflight.sim.board.debug.variables import read_variables
from neuroflight.sim.board.devices.esc import SILENT_S
from neuroflight.sim.board.serial.bridge import LineTransport, UartLine
from neuroflight.sim.control import sticks
from neuroflight.sim.ports.emulator import EmulatedPort, Event, PortSnapshot
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import (
    ARMING_DELAY_MS,
    DEADLINE_MISSES_MAX,
    GESTURE_MS,
    GRAVITY,
    GYRO_BAD_MS,
    LOAD_CALM_MS,
    RECEIVER_HOLD_MS,
    RECEIVER_LOST_MS,
    FallbackCause,
    FaultKind,
    Msp,
    Task,
)
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ
from neuroflight.toolchain.errors import LinkError, ScenarioError
from tests.sampling import sampled

RATE = 4000  # of gyro samples
FRAME, LEAD = 40, 16  # samples between two receiver frames, and from the announcement to the frame
STOP_FRAMES_S = 0.02  # from any reset, whatever else the boot does
START_S = 0.05  # of the flight, when the drills begin
NOTHING = Reply(np.zeros(4, np.uint16), 0, np.zeros(3, np.float32), np.zeros(3, np.float32), 0.0, armed=False)


class Still:
    """A still aircraft with a live gyro, and a pilot who holds his sticks."""

    def __init__(self, port: EmulatedPort) -> None:
        self.port = port
        self._number = 0
        self._planned: dict[int, list[int]] = {}
        self._rng = np.random.default_rng(1)

    def fly(
        self,
        seconds: float,
        *,
        armed: bool = True,
        until: Callable[[Reply], bool] | None = None,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> list[Reply]:
        """The replies to so many samples, or up to the one that is waited for."""
        channels = sticks.channels(rates, 0.3 if until is None and armed else 0.0, armed=armed)
        replies = []
        for _ in range(round(seconds * RATE)):
            if self._number % FRAME == 0:
                self._planned[self._number + LEAD] = channels.tolist()
                self.port.announce(channels.tolist(), LEAD)
            gyro, force = self._rng.normal(0.0, 0.01, 3), np.array([0.0, 0.0, GRAVITY])
            sample = Sample(0.0, gyro, np.eye(3), np.zeros(3), np.zeros(3), force)
            replies.append(self.port.exchange(sample, self._planned.pop(self._number, None)))
            self._number += 1
            if until is not None and until(replies[-1]):
                return replies
        assert until is None
        return replies

    def save(self) -> Any:
        return self.port.save(), copy.deepcopy((self._number, self._planned, self._rng))

    def restore(self, moment: tuple[PortSnapshot, Any], *faults: str) -> None:
        self.port.restore(moment[0], [parse_fault(fault) for fault in faults])
        self._number, self._planned, self._rng = copy.deepcopy(moment[1])


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """The file to be flashed."""
    return board_image.with_suffix(".bin")


def take_off(image: Path, *faults: str) -> Still:
    """One that was just armed."""
    still = Still(EmulatedPort(image, faults=[parse_fault(fault) for fault in faults]))
    still.fly(1.1, armed=False)
    still.fly(0.2, until=lambda reply: reply.armed)
    return still


@pytest.fixture(scope="module")
def started(image: Path) -> Iterator[tuple[Still, Any]]:
    """A flight of 50 ms, and a snapshot at its end."""
    still = take_off(image, "hang@3000")  # a fault that never comes: so that the watchdog resets the board
    still.fly(START_S - 1 / RATE)
    yield still, still.save()
    still.port.close()


Drill = Callable[..., tuple[list[Reply], list[Event]]]


@pytest.fixture
def drill(started: tuple[Still, Any]) -> Drill:
    """Flies on from that snapshot with faults; returns replies and events, arming and faults left out."""
    still, moment = started

    def run(*faults: str, seconds: float = 0.1) -> tuple[list[Reply], list[Event]]:
        still.restore(moment, *faults)
        replies = still.fly(seconds)
        armed, *events = still.port.events
        assert armed == Event(0.0, "ARMED")
        return replies, [event for event in events if not event.what.startswith("fault ")]

    return run


def turning(replies: list[Reply]) -> float:
    """For how long the motors turned [s]."""
    return [bool(reply.dshot.any()) for reply in [*replies, NOTHING]].index(False) / RATE


def test_the_motors_stop_when_the_gyro_is_silent(drill: Drill, started: tuple[Still, Any]) -> None:
    replies, (stop,) = drill("gyro-silent@0.06")
    assert (stop.what, stop.stops) == ("FAULT: GYRO_SILENT", True)
    # Silence counts from the last sample that came, in ticks of a millisecond; the first may come at once.
    silent_ms = 1000 * (stop.at_s - (0.06 - 1 / RATE))
    assert GYRO_BAD_MS - 1 <= round(silent_ms, 6) <= GYRO_BAD_MS + 1
    assert turning(replies) == pytest.approx(stop.at_s - START_S, abs=2 / RATE)
    assert {"GYRO_BAD", "FAULT"} <= set(started[0].port.arming_reasons())


def test_it_flies_on_when_the_gyro_is_silent_for_less_than_the_limit(drill: Drill) -> None:
    replies, events = drill(f"gyro-silent={(GYRO_BAD_MS - 3) / 1000}@0.06")
    assert not events
    assert all(reply.armed and reply.dshot.all() for reply in replies)
    steps = np.diff([reply.step for reply in replies])
    assert len(replies) // 4 - sum(steps) == pytest.approx(GYRO_BAD_MS - 3, abs=1)  # those were not flown


def test_spikes_are_flown_when_bits_of_the_gyro_turn_over(drill: Drill) -> None:
    replies, events = drill("spi-bit-errors=0.01@0.06")
    rates = np.abs([reply.gyro for reply in replies[::4]]).max(axis=1)
    hit = rates > 0.1  # of a gyro with a noise of 0.01 rad/s
    assert not events  # the chip's bytes have no checksum: a spike cannot be told from motion
    assert not hit[:9].any()
    # A count is 0.00107 rad/s, so that of each word the upper 7 bits are worth 0.4 in a sample and 0.1 in the
    # mean of four; 3 axes have 84 such bits, any of which turns over once in a hundred.
    assert hit[10:].mean() == pytest.approx(1 - 0.99**84, abs=0.2)


def test_it_boots_disarmed_and_remembers_when_the_supply_dips(
    drill: Drill, started: tuple[Still, Any]
) -> None:
    replies, (reset, boot, calibrates) = drill("brown-out@0.06", seconds=0.45)
    assert (reset, calibrates.what) == (Event(0.06, "reset: brown-out", stops=True), "CALIBRATING")
    assert 0.2 < boot.at_s - reset.at_s < 0.4
    # Its ESCs keep the battery's power and their last value until frames come again, which say 0.
    assert turning(replies) <= reset.at_s - START_S + STOP_FRAMES_S
    assert not any(reply.armed for reply in replies[round(0.02 * RATE) :])
    assert {"FAULT", "SWITCH_NOT_CYCLED"} <= set(started[0].port.arming_reasons())


def test_a_pull_at_the_reset_line_in_flight_is_recorded(drill: Drill, started: tuple[Still, Any]) -> None:
    replies, (reset, *_) = drill("reset@0.06", seconds=0.45)
    assert reset == Event(0.06, "reset: pin", stops=True)
    assert turning(replies) <= reset.at_s - START_S + STOP_FRAMES_S
    assert {"FAULT", "SWITCH_NOT_CYCLED"} <= set(started[0].port.arming_reasons())
    board = started[0].port.board
    line = LineTransport(UartLine(board), board.run_to)
    fault = records.faults(Client(line, line.clock).request(Msp.FAULTS)).pending
    assert fault is not None and fault.kind is FaultKind.RESET
    assert fault.uptime_steps > 1000


def acknowledge(still: Still) -> None:
    """By sticks."""
    both_down_and_apart = (1000.0, -1000.0, 1000.0)  # roll right, pitch back, yaw left
    still.fly(GESTURE_MS / 1000 + 0.3, armed=False, rates=both_down_and_apart)
    still.fly(0.1, armed=False)


@pytest.mark.slow
def test_it_arms_again_in_the_field_when_the_pilot_acknowledges_the_fault_by_sticks(
    drill: Drill, started: tuple[Still, Any]
) -> None:
    still = started[0]
    drill("brown-out@0.06", seconds=0.45)
    still.fly(1.4, armed=False)
    assert still.port.arming_reasons() == ("FAULT",)
    still.fly(0.1)
    still.fly(0.1, armed=False)
    assert still.port.arming_reasons() == ("FAULT",)
    acknowledge(still)
    assert still.port.arming_reasons() == ()
    assert still.fly(0.2, until=lambda reply: reply.armed)[-1].armed


def assert_stops(
    replies: list[Reply], events: list[Event], cause: str, noticed_s: float, begun_s: float = 0.0
) -> None:
    """The program ended 10 ms after the first of the replies, which came at `begun_s`."""
    reset, boot, *_ = events
    assert (reset.what, reset.stops) == (f"reset: {cause}", True)
    assert turning(replies) <= 0.01 + noticed_s + STOP_FRAMES_S
    assert not any(
        reply.dshot.any() for reply in replies[round((reset.at_s - begun_s + STOP_FRAMES_S) * RATE) :]
    )
    assert boot.what == "the firmware has booted and reads its gyro"


@pytest.mark.slow
def test_stop_frames_follow_the_reset_when_the_program_hangs(
    drill: Drill, started: tuple[Still, Any]
) -> None:
    replies, events = drill(f"hang@{START_S + 0.01}", seconds=1.0)
    assert_stops(replies, events, "iwdg", SILENT_S, START_S)
    assert "FAULT" in started[0].port.arming_reasons()


@pytest.mark.slow
def test_stop_frames_follow_the_reset_when_the_processor_faults(image: Path) -> None:
    still = take_off(image, "processor-fault@0.01")
    replies = still.fly(0.5)
    assert_stops(replies, list(still.port.events)[2:], "software", 0.001)
    assert "FAULT" in still.port.arming_reasons()
    still.port.close()


def test_it_boots_again_when_power_goes_while_the_fault_is_logged(drill: Drill) -> None:
    _, events = drill("brown-out@0.06", "flash-cut@0.06", seconds=0.75)
    assert [event.what for event in events[:3]] == [
        "reset: brown-out",
        "reset: power",
        "the firmware has booted and reads its gyro",
    ]


def test_it_starts_anew_without_its_crystal_and_does_not_arm_when_the_crystal_fails(
    drill: Drill, started: tuple[Still, Any]
) -> None:
    replies, (reset, boot, _) = drill("crystal@0.06", seconds=0.6)
    assert reset == Event(0.06, "reset: software", stops=True)
    assert turning(replies) <= 0.06 - START_S + STOP_FRAMES_S
    assert 0.2 < boot.at_s - reset.at_s < 0.4
    assert {"CLOCK", "FAULT"} <= set(started[0].port.arming_reasons())


def test_no_fault_is_told_when_the_reset_line_is_pulled_with_the_motors_stopped(
    started: tuple[Still, Any],
) -> None:
    still, moment = started
    still.restore(moment, "reset@0.3")
    still.fly(0.2, armed=False)
    still.fly(0.5, armed=False)
    assert [event.what for event in still.port.events if "reset" in event.what] == [
        "fault reset@0.3",
        "reset: pin",
    ]
    assert "FAULT" not in still.port.arming_reasons()


@pytest.mark.slow
def test_no_fault_is_told_when_the_supply_dips_with_the_motors_stopped(started: tuple[Still, Any]) -> None:
    still, moment = started
    still.restore(moment, "brown-out@0.3")  # the detector is off, as the chip is delivered
    still.fly(0.2, armed=False)
    still.fly(0.5, armed=False)
    assert [event.what for event in still.port.events if "reset" in event.what] == ["reset: brown-out"]
    assert "FAULT" not in still.port.arming_reasons()


def test_the_failsafe_acts_when_every_receiver_frame_is_broken(drill: Drill) -> None:
    replies, (hold, drop) = drill("receiver-broken@0.06", seconds=1.1)
    assert (hold.what, drop.what) == ("FAILSAFE_HOLD", "FAILSAFE_DROP: RECEIVER")
    # Two frames may have been on their way: one in the loop's hands, one just heard.
    late = FRAME / RATE
    assert RECEIVER_HOLD_MS / 1000 - late <= hold.at_s - 0.06 <= RECEIVER_HOLD_MS / 1000 + late
    assert drop.at_s - hold.at_s == pytest.approx((RECEIVER_LOST_MS - RECEIVER_HOLD_MS) / 1000, abs=0.001)
    assert turning(replies) == pytest.approx(drop.at_s - START_S, abs=2 / RATE)
    assert drop.stops and not hold.stops


def test_it_flies_on_when_some_receiver_frames_are_broken(drill: Drill) -> None:
    replies, events = drill("receiver-broken=0.5@0.06", seconds=0.2)
    assert not events
    assert all(reply.armed for reply in replies)


def read(port: EmulatedPort, elf: Path, name: str) -> Any:
    """A variable of the image, as it is now."""
    (variable,) = read_variables(elf, name)
    return np.frombuffer(port.board.engine.memory(variable.address, variable.size), variable.dtype)[0]


def test_frames_go_on_within_five_samples_when_the_timer_that_sends_them_has_stopped(
    drill: Drill, started: tuple[Still, Any], board_image: Path
) -> None:
    """The ESCs of the board refuse a frame that is not whole, and one without a rest before it."""
    escs = started[0].port.board.hardware.escs[:4]
    drill(seconds=0.1)
    whole = [esc.frames for esc in escs]
    replies, events = drill("motors-stuck@0.06", seconds=0.1)
    assert not events and all(reply.armed and reply.dshot.all() for reply in replies)
    # The one that was to begin as it stopped, four that found its stream enabled: the last of them ended it.
    assert [before - esc.frames for before, esc in zip(whole, escs, strict=True)] == [5] * 4
    assert read(started[0].port, board_image, "restarts") == 1


OVERLOAD_S = 0.0006  # of each control step: with it a sample takes 2.8 times its period


def test_lost_samples_are_missed_deadlines_and_time_goes_on_when_the_processor_is_overloaded(
    drill: Drill, started: tuple[Still, Any], board_image: Path
) -> None:
    replies, events = drill(f"overload={OVERLOAD_S}@0.06", seconds=0.5)
    port = started[0].port
    assert not events  # it flies on, late as the steps are
    assert all(reply.armed and reply.dshot.all() for reply in replies)
    assert replies[-1].step - replies[0].step == pytest.approx(len(replies) / 4, abs=2)
    status, stats = (read(port, board_image, name) for name in ("firmware.status", "stats"))
    assert (bool(status["pid_flies"]), int(status["fallback_cause"])) == (True, FallbackCause.DEADLINE)
    steps = 0.5 - 0.01 - DEADLINE_MISSES_MAX / 1000
    assert stats[Task.CONTROL]["misses"] >= 1000 * steps
    assert stats[Task.GYRO]["misses"] >= 1000 * steps


@pytest.mark.slow
@pytest.mark.parametrize("slow_s", sampled([0.00095, 0.0012, 0.0017], 0.0012))
def test_the_background_has_its_share_when_a_control_step_takes_as_long_as_its_period(
    drill: Drill, started: tuple[Still, Any], board_image: Path, slow_s: float
) -> None:
    """Longer than the watchdog waits: nothing ran below the samples but where these are left out."""
    port, before = started[0].port, started[1]
    replies, events = drill(f"overload={slow_s}@0.06", seconds=0.9)
    assert not events
    assert all(reply.armed and reply.dshot.all() for reply in replies)
    status, stats = (read(port, board_image, name) for name in ("firmware.status", "stats"))
    assert (bool(status["pid_flies"]), int(status["fallback_cause"])) == (True, FallbackCause.DEADLINE)
    flown = 0.9 / (slow_s + 0.0006)  # control steps that there was time for, at least
    assert stats[Task.CONTROL]["runs"] > flown
    assert before is not None
    assert stats[Task.ALERT]["runs"] > 0.8 * 50 * 0.9  # 50 a second are meant
    line = LineTransport(UartLine(port.board), port.board.run_to)
    assert records.tasks(Client(line, line.clock).request(Msp.TASKS)).loads[Task.CONTROL].misses > flown / 2


@pytest.mark.parametrize(
    ("slow_s", "missed"),
    [
        pytest.param(0.0, 0, marks=pytest.mark.slow),
        (0.00005, 0),  # late, but over before the next sample
        pytest.param(0.0006, 1, marks=pytest.mark.slow),  # within its period; the step after it lacks samples
        (0.0012, 2),  # longer than its period, and the step after it lacks samples
    ],
)
def test_missed_deadlines_are_counted_when_one_control_step_is_slow(
    slow_s: float, missed: int, started: tuple[Still, Any], board_image: Path
) -> None:
    still, moment = started
    port, calls = still.port, still.port.board.symbols["functions"]
    still.restore(moment)
    assert missed_deadlines(port.board, board_image) == 0
    normal = port.board.engine.memory(calls, 64)
    before = read(port, board_image, "stats")[Task.CONTROL]
    if slow_s:
        still.restore(moment, f"overload={slow_s}@{START_S}")
        while port.events[-1].what == "ARMED":
            still.fly(1 / RATE)
    still.fly(3 / RATE)  # with the sample at which it began one control period, so that one step is slow
    port.board.engine.set_memory(calls, normal)
    still.fly(0.02)
    after = read(port, board_image, "stats")[Task.CONTROL]
    assert missed_deadlines(port.board, board_image) == missed
    assert slow_s < after["worst"] / CORE_HZ < slow_s + 0.0002
    assert after["runs"] - before["runs"] == pytest.approx(21, abs=1)
    line = LineTransport(UartLine(port.board), port.board.run_to)
    load = records.tasks(Client(line, line.clock).request(Msp.TASKS)).loads[Task.CONTROL]
    assert (load.misses, load.worst_cycles) == (missed, after["worst"])


@pytest.mark.slow
def test_the_receiver_is_lost_in_its_time_when_the_processor_is_overloaded(drill: Drill) -> None:
    _, (hold, drop) = drill(f"overload={OVERLOAD_S}@0.06", "receiver-broken@0.06", seconds=1.3)
    assert (hold.what, drop.what) == ("FAILSAFE_HOLD", "FAILSAFE_DROP: RECEIVER")
    assert hold.at_s - 0.06 == pytest.approx(RECEIVER_HOLD_MS / 1000, abs=FRAME / RATE)
    assert drop.at_s - hold.at_s == pytest.approx((RECEIVER_LOST_MS - RECEIVER_HOLD_MS) / 1000, abs=0.002)


def test_an_overloaded_board_does_not_arm_and_says_why(started: tuple[Still, Any]) -> None:
    still, moment = started
    port, calls = still.port, still.port.board.symbols["functions"]
    still.restore(moment)
    normal = port.board.engine.memory(calls, 64)
    still.restore(moment, f"overload={OVERLOAD_S}@0.06")
    still.fly(0.1)
    still.fly(0.3, armed=False)
    refused = "POLICY_REFUSED"  # the PID had to take over
    assert port.arming_reasons() == (refused, "LOAD")
    assert not any(reply.armed for reply in still.fly(0.1))
    port.board.engine.set_memory(calls, normal)
    still.fly(LOAD_CALM_MS / 1000, armed=False)
    assert port.arming_reasons() == (refused, "LOAD")
    still.fly(0.2, armed=False)
    assert port.arming_reasons() == (refused,)
    acknowledge(still)
    still.fly(0.05, until=lambda reply: reply.armed)


def test_no_motor_is_asked_to_turn_before_the_escs_start_up_tunes_have_ended(image: Path) -> None:
    """With the delay that a user's board has. A pilot in a hurry moves the switch from power-up on."""
    still = Still(EmulatedPort(image, settings={"arming_delay_ms": ARMING_DELAY_MS}))
    replies: list[Reply] = []
    asked = itertools.count(1)
    while not replies or not replies[-1].armed:
        replies += still.fly(0.1, armed=False)
        replies += still.fly(0.2, until=lambda reply: reply.armed or next(asked) % (RATE // 10) == 0)
        assert len(replies) < 5 * RATE
    still.port.close()
    turning = next(index for index, reply in enumerate(replies) if reply.dshot.any()) / RATE
    assert ARMING_DELAY_MS / 1000 <= turning < ARMING_DELAY_MS / 1000 + 0.5


def test_a_flight_continues_bit_for_bit_when_a_snapshot_is_restored(drill: Drill) -> None:
    first, second = (drill("spi-bit-errors=0.01@0.06")[0] for _ in range(2))
    assert [reply.dshot.tobytes() for reply in first] == [reply.dshot.tobytes() for reply in second]


def test_it_boots_when_power_goes_at_a_flash_operation_of_the_boot(image: Path) -> None:
    port = EmulatedPort(image, faults=[parse_fault("flash-cut=3@boot")])
    assert port.board.engine.resets == ["power", "power"]
    assert [event.what for event in port.events] == ["fault flash-cut=3@boot", "reset: power"]
    port.close()


def test_it_boots_on_the_internal_oscillator_and_talks_when_the_crystal_does_not_start(image: Path) -> None:
    still = Still(EmulatedPort(image, faults=[parse_fault("crystal@boot")]))
    still.fly(1.1, armed=False)
    assert still.port.arming_reasons() == ("CLOCK",)
    assert not any(reply.armed for reply in still.fly(0.1))
    line = LineTransport(UartLine(still.port.board), still.port.board.run_to)
    client = Client(line, line.clock)
    assert "CLOCK" in messages.arming_reasons(records.safety(client.request(Msp.SAFETY)).arming_flags)
    still.port.close()


def test_it_says_so_when_a_fault_lets_the_firmware_never_boot(image: Path) -> None:
    fault = "spi-bit-errors=1@boot"  # no chip is found behind such a bus
    with pytest.raises(LinkError, match=rf"reads no gyro sample within 5 s of its boot: .*fault {fault}"):
        EmulatedPort(image, faults=[parse_fault(fault)])


def test_a_fault_prints_as_it_was_written_when_parsed() -> None:
    written = ("gyro-silent@1.5", "gyro-silent=0.005@0", "flash-cut=7@boot", "spi-bit-errors=1e-05@3")
    assert [str(parse_fault(text)) for text in written] == list(written)
    assert parse_fault("brown-out@2") == Fault("brown-out", 0.0, 2.0)
    for name in FAULTS:
        assert parse_fault(f"{name}@1").name == name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("gyro-silent", "expected NAME"),
        ("gyro-loud@1", "fault 'gyro-loud' is unknown, expected one of gyro-silent, "),
        ("brown-out=2@1", "got the value '2', expected none"),
        ("spi-bit-errors=2@1", "got '2', expected 1e-09 to 1"),
        ("flash-cut=1.5@boot", "expected a whole number from 1 to"),
        ("crystal@soon", "its time: got 'soon', expected 0 to 3600"),
        ("crystal@-1", "its time: got '-1'"),
        ("crystal@nan", "its time: got 'nan'"),
    ],
)
def test_a_fault_is_refused_in_one_line_when_it_is_none(text: str, message: str) -> None:
    with pytest.raises(ScenarioError) as refusal:
        parse_fault(text)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)
