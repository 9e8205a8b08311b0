from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.control import sticks
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.contract import RECEIVER_RECOVERY_MS
from neuroflight.toolchain.errors import LinkError

STILL = Sample(0.0, np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3))


def test_the_port_knows_the_policy_when_booted(reference_library: Path) -> None:
    port = ReferencePort(reference_library, 8000)
    assert (port.motor_count, port.gyro_rate_hz, port.control_rate_hz) == (4, 8000, 1000)


def test_control_steps_advance_when_the_divider_has_passed(reference_library: Path) -> None:
    port = ReferencePort(reference_library, 2000)
    assert [port.exchange(STILL, None).step for _ in range(6)] == [0, 0, 1, 1, 2, 2]


def settled(port: ReferencePort, channels: list[int]) -> Reply:
    """The reply after so many frames that the receiver is believed."""
    replies = [port.exchange(STILL, channels) for _ in range(RECEIVER_RECOVERY_MS + 2)]
    return replies[-1]


def test_two_firmwares_are_independent_when_they_share_the_library(reference_library: Path) -> None:
    turning = sticks.channels((300.0, 0.0, 0.0), 0.0, armed=False).tolist()
    first, second = ReferencePort(reference_library, 1000), ReferencePort(reference_library, 1000)
    assert np.rad2deg(settled(first, turning).setpoint) == pytest.approx([300, 0, 0])
    assert second.exchange(STILL, None).setpoint.tolist() == [0, 0, 0]


def test_replies_are_not_overwritten_when_the_flight_goes_on(reference_library: Path) -> None:
    port = ReferencePort(reference_library, 1000)
    first = settled(port, sticks.channels((300.0, 0.0, 0.0), 0.0, armed=False).tolist())
    port.exchange(STILL, sticks.channels((-300.0, 0.0, 0.0), 0.0, armed=False).tolist())
    assert np.rad2deg(first.setpoint) == pytest.approx([300, 0, 0])


def test_the_reasons_are_named_when_it_has_just_booted(reference_library: Path) -> None:
    port = ReferencePort(reference_library)
    port.exchange(STILL, None)
    assert {"BOOT_GRACE", "GYRO_NOT_CALIBRATED", "RECEIVER_LOST"} <= set(port.arming_reasons())


@pytest.mark.parametrize("rate", [0, 500, 3000])
def test_a_gyro_rate_is_refused_when_the_firmware_does_not_know_it(
    reference_library: Path, rate: int
) -> None:
    with pytest.raises(LinkError, match=f"refuses a gyro rate of {rate} Hz"):
        ReferencePort(reference_library, rate)


def test_it_says_how_to_build_when_the_library_is_missing(tmp_path: Path) -> None:
    with pytest.raises(LinkError, match="not built yet; build it with `make host`"):
        ReferencePort(tmp_path / "libneuroflight.so")


def test_it_says_so_when_the_file_is_no_library(tmp_path: Path) -> None:
    (tmp_path / "lib.so").write_text("no ELF")
    with pytest.raises(LinkError, match="not the firmware's reference library"):
        ReferencePort(tmp_path / "lib.so")
