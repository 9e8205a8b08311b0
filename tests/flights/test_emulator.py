"""The image to be flashed, on the emulated board: receiver protocols and the errors of its port."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.flash.settings.values import parse_change
from neuroflight.sim.aircraft.model import load_aircraft
from neuroflight.sim.board.board import Board
from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.debug.variables import pointers_in, read_variables
from neuroflight.sim.board.fitted import GYROS
from neuroflight.sim.board.peripherals.usart import CRSF as CRSF_FORMAT
from neuroflight.sim.control import sticks
from neuroflight.sim.design.figures import hover_throttle
from neuroflight.sim.flight.scenario import Scenario, Segment, pulses
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.host import HostPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.sim.ports.receiver_frames import crsf_frame
from neuroflight.toolchain.contract import FLASH_BANK_B
from neuroflight.toolchain.errors import BuildError, LinkError
from tests.firmware.board.banks import RUN_WELL, compose, read_build

Flown = Callable[..., Trace]
BUSY = Scenario(
    "busy",
    tuple(Segment(0.05, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(8)),
)
BY_CRSF = {"receiver_protocol": 1, "gyro_stuck_ms": 0}
STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.80665]))


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """The file to be flashed."""
    return board_image.with_suffix(".bin")


@pytest.mark.slow
def test_crsf_at_another_gyro_rate_flies_the_same_bits_when_the_image_is_set_so(
    image: Path, reference_library: Path, flown: Flown
) -> None:
    on_board = flown(EmulatedPort(image, 1000, BY_CRSF), BUSY)
    assert flown(ReferencePort(reference_library, 1000), BUSY).same(on_board)


@pytest.mark.slow
def test_five_minutes_of_commands_and_hovers_fly_the_same_bits_and_hold(
    image: Path, host_program: Path, flown: Flown
) -> None:
    hover = hover_throttle(load_aircraft("nf1"), 0.055)
    assert hover is not None
    rest = Segment(30.0, throttle=hover)
    commands = [part for part in pulses(1, 8, throttle=hover).segments if any(part.setpoint_deg_s)]
    five = Scenario("five minutes", (rest, *(part for each in commands for part in (each, rest)), rest))
    on_board = flown(EmulatedPort(image, 4000), five)
    assert on_board.t[-1] > 299.0
    assert flown(HostPort(host_program, 4000), five).same(on_board)
    rates = np.rad2deg(on_board.rate[-10_000:].mean(axis=0))
    assert np.abs(rates).max() < 1.0, "deg/s: what the gyro's bias leaves"


def test_the_image_for_bank_b_flies_the_same_bits(
    board_image: Path, reference_library: Path, flown: Flown, tmp_path: Path
) -> None:
    build = read_build(board_image)
    image = tmp_path / "neuroflight-b.bin"
    image.write_bytes(compose(build, None, (build.images[1], RUN_WELL)))
    shutil.copy(board_image.with_name("neuroflight-b.elf"), tmp_path)
    port = EmulatedPort(image)
    bank_b = range(FLASH_BANK_B.address, FLASH_BANK_B.address + FLASH_BANK_B.size)
    assert (
        int.from_bytes(port.board.engine.memory(port.board.symbols["fast_vectors"] + 4, 4), "little")
        in bank_b
    )
    on_board = flown(port, BUSY)
    assert flown(ReferencePort(reference_library), BUSY).same(on_board)


def test_a_switch_that_is_on_since_power_up_arms_nothing_until_it_was_off(image: Path) -> None:
    """Frames of CRSF come while it boots, each behind what seems to begin a longer one."""

    def frames(board: Board, count: int, *, on: bool) -> None:
        """So many, 4 ms apart, from now on."""
        channels = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=on).tolist()
        line, begin = board.hardware.usarts["USART2"], board.cycle
        for k in range(count):
            end = begin + (k + 1) * TIME_HZ // 250
            line.feed(b"\xc8\x3e" + crsf_frame(channels), CRSF_FORMAT, end=end)

    def powered(board: Board) -> Callable[[int], None]:
        frames(board, 50, on=True)
        return board.run_to

    def arms(seconds: float, *, on: bool) -> bool:
        frames(port.board, round(seconds * 250), on=on)
        replies = [port.exchange(STILL, None) for _ in range(round(seconds * 1000))]
        return any(reply.armed for reply in replies)

    with closing(EmulatedPort(image, 1000, BY_CRSF, attach=powered)) as port:
        assert not arms(2.5, on=True)
        assert port.arming_reasons() == ("SWITCH_NOT_CYCLED",)
        assert not arms(0.1, on=False)
        assert port.arming_reasons() == ()
        assert arms(0.1, on=True)


@pytest.mark.slow
def test_a_frame_is_refused_when_it_was_not_announced_in_time(image: Path) -> None:
    channels = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False).tolist()
    port = EmulatedPort(image)
    with pytest.raises(LinkError, match="must be announced"):
        port.exchange(STILL, channels)
    with pytest.raises(LinkError, match="250 us too late"):
        port.announce(channels, 12)
    port.close()


def test_the_link_fails_with_the_cause_when_the_firmware_resets_unexpectedly(image: Path) -> None:
    port = EmulatedPort(image)
    port.exchange(STILL, None)
    port.board.brown_out()
    with pytest.raises(LinkError, match=r"it was given \d+; it was reset: brown-out"):
        for _ in range(8):
            port.exchange(STILL, None)
    port.close()


def test_it_says_why_when_the_image_is_missing(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="not built yet"):
        EmulatedPort(tmp_path / "neuroflight.bin")


@pytest.mark.slow
def test_variables_are_found_by_name_or_named_when_they_are_not_there(board_image: Path) -> None:
    whole, step, dshot = read_variables(
        board_image, *(f"firmware.status.trace{field}" for field in ("", ".step", ".dshot"))
    )
    assert (step.address, step.dtype.str) == (whole.address, "<u4")
    assert dshot.dtype.base.str == "<u2"
    with pytest.raises(BuildError, match="there is no stap, only step, setpoint"):
        read_variables(board_image, "firmware.status.trace.stap")
    with pytest.raises(BuildError, match="0 variables named firmwar,"):
        read_variables(board_image, "firmwar.status")


def test_the_pointers_of_a_structure_are_found_wherever_they_lie_in_it(board_image: Path) -> None:
    whole, weights, outputs, counts = read_variables(
        board_image,
        *(
            f"firmware{field}"
            for field in ("", ".control.weights", ".dshot_command.outputs", ".gyro.last.gyro")
        ),
    )
    found = pointers_in(board_image, "firmware")
    for pointer in (weights, outputs):
        begin = pointer.address - whole.address
        assert pointer.dtype.kind == "V"
        assert slice(begin, begin + 8) in found  # the union around it has room for a computer's
    assert not any(place.start <= counts.address - whole.address < place.stop for place in found)
    assert pointers_in(board_image, "firmware.gyro") == ()


class OnTheChipsGrid(ReferencePort):
    """The library behind a chip that counts 70 mdeg/s, told to the nearest 2000 / 32768 deg/s."""

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        measured = sample.gyro.copy()
        counts = np.clip(np.rint(np.degrees(measured) / 0.07), -32768, 32767)
        sample.gyro[:] = np.radians(np.rint(counts * 0.07 * 32768 / 2000) * 2000 / 32768)
        try:
            return super().exchange(sample, channels_us)
        finally:
            sample.gyro[:] = measured


PLAIN = [kind for kind in GYROS if kind != "bmi270"]  # that need no file


@pytest.mark.slow
@pytest.mark.parametrize("chip", PLAIN)
def test_every_gyro_chip_flies_the_same_bits_when_the_pilot_has_said_how_it_is_turned(
    image: Path, reference_library: Path, flown: Flown, chip: str
) -> None:
    said = {"icm20602": "board", "mpu6500": "board", "icm20689": "cw90"}.get(chip, "cw180")
    port = EmulatedPort(image, gyro=GYROS[chip], settings=dict([parse_change(f"gyro_alignment={said}")]))
    on_board = flown(port, BUSY)
    library = OnTheChipsGrid if chip.startswith("lsm") else ReferencePort
    assert flown(library(reference_library), BUSY).same(on_board)


@pytest.mark.slow
def test_an_icm20689_ends_the_flight_when_the_pilot_has_said_another_way(image: Path, flown: Flown) -> None:
    port = EmulatedPort(image, gyro=GYROS["icm20689"], settings=dict([parse_change("gyro_alignment=cw180")]))
    trace = flown(port, BUSY)
    assert any(event.stops and event.at_s < BUSY.duration_s for event in port.events)
    # The chip's x axis is taken for pitch and its y axis for roll: the policy turns the aircraft over.
    turning = trace.dshot[:, 0] > 0
    assert turning[0] and not turning[-1]
    assert np.abs(trace.rate[turning]).max() > 2 * np.abs(trace.setpoint).max()
