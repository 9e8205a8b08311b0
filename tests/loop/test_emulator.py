"""The image that is flashed, on the emulated board in the loop: the bits of the host build."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from sim import sticks
from sim.board.variables import read_variables
from sim.emulated_port import EmulatedPort, sbus_frame
from sim.port import Sample
from sim.reference_port import ReferencePort
from sim.scenario import Scenario, Segment, load_scenario
from sim.trace import Trace
from toolchain.contract import CHANNEL_COUNT
from toolchain.errors import BuildError, LinkError

Flown = Callable[..., Trace]
BUSY = Scenario(
    "busy",
    tuple(Segment(0.1, (150.0 * (-1) ** k, 40.0 * k, -30.0 * k), 0.1 * k) for k in range(8)),
)
STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 9.80665]))


@pytest.fixture(scope="module")
def image(board_image: Path) -> Path:
    """What is flashed."""
    return board_image.with_suffix(".bin")


@pytest.mark.parametrize("controller", ["policy", "pid"])
def test_the_image_flies_the_bits_of_the_host_build_when_the_scenario_is_busy(
    image: Path, reference_library: Path, flown: Flown, controller: str
) -> None:
    scenario = BUSY if controller == "policy" else BUSY.under_pid()
    on_board = flown(EmulatedPort(image), scenario)
    assert np.ptp(on_board.dshot, axis=0).min() > 100  # every motor has something to do
    assert flown(ReferencePort(reference_library), scenario).same(on_board)


def test_policy_and_pid_differ_when_flown_on_the_reference(reference_library: Path, flown: Flown) -> None:
    flights = [flown(ReferencePort(reference_library), scenario) for scenario in (BUSY, BUSY.under_pid())]
    assert not np.array_equal(flights[0].dshot, flights[1].dshot)


@pytest.mark.prove
@pytest.mark.parametrize("controller", ["policy", "pid"])
def test_the_image_flies_the_bits_of_the_host_build_for_a_minute(
    image: Path, reference_library: Path, flown: Flown, controller: str
) -> None:
    scenario = load_scenario("pulses", seed=5, count=14)
    scenario = scenario if controller == "policy" else scenario.under_pid()
    on_board = flown(EmulatedPort(image), scenario, seed=5)
    assert len(on_board.t) >= 60_000
    assert flown(ReferencePort(reference_library), scenario, seed=5).same(on_board)


def test_a_frame_is_refused_when_it_was_not_announced_in_time(image: Path) -> None:
    channels = sticks.channels((0.0, 0.0, 0.0), 0.0, armed=False).tolist()
    port = EmulatedPort(image)
    with pytest.raises(LinkError, match="must be announced"):
        port.exchange(STILL, channels)
    with pytest.raises(LinkError, match="250 us too late"):
        port.announce(channels, 12)
    port.close()


def test_it_says_why_when_the_image_is_missing_or_set_otherwise(image: Path, tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="not built yet"):
        EmulatedPort(tmp_path / "neuroflight.bin")
    with pytest.raises(LinkError, match="reads its gyro at 4000 Hz as flashed, asked for 8000 Hz"):
        EmulatedPort(image, 8000)


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


def test_a_frame_holds_every_channel_when_its_bits_are_read_back() -> None:
    channels = [880, 881, 988, 1000, 1500, 1501, 1999, 2000, 2012, 2159, 1234, 1357, 1111, 1789, 1023, 1777]
    frame = sbus_frame(channels)
    bits = "".join(f"{byte:08b}"[::-1] for byte in frame[1:23])
    values = [int(bits[11 * i : 11 * i + 11][::-1], 2) for i in range(CHANNEL_COUNT)]
    assert [880 + (5 * value + 4) // 8 for value in values] == channels
    assert (frame[0], *frame[23:]) == (0x0F, 0, 0)
