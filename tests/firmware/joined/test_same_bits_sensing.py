"""Filters, attitude and gyro of the board's image, run on an emulated Cortex-M7, give the host's bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from neuroflight.toolchain.contract import FilterKind
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program

GYRO_HZ, CONTROL_HZ = 1000, 1000
CW90 = 1
FILTERS_BYTES, ATTITUDE_BYTES, GYRO_BYTES, SAMPLE_BYTES = 600, 64, 512, 18
STEPS = 1500
CHAINS = (
    {"filter1_kind": FilterKind.PT1, "filter2_kind": FilterKind.PT2, "filter3_kind": FilterKind.PT3},
    {
        "filter1_kind": FilterKind.NOTCH,
        "filter1_hz": 180.0,
        "filter1_q": 3.0,
        "filter4_kind": FilterKind.BIQUAD,
    },
    {"dynamic_notch_count": 3, "filter2_kind": FilterKind.PT1, "filter2_hz": 250.0},
)


def float32(values: Any) -> NDArray[np.float32]:
    return np.array(values, np.float32)


def vibration(rng: np.random.Generator) -> NDArray[np.float32]:
    """Two tones, noise and a pilot's hand, (STEPS, 3) [rad/s]."""
    t = np.arange(STEPS)[:, None] / GYRO_HZ
    tones = sum(
        a * np.sin(2 * np.pi * hz * t + rng.uniform(0, 6, 3)) for hz, a in [(150, 1), (290, 0.6), (2, 5)]
    )
    return float32(tones + rng.normal(0, 0.05, (STEPS, 3)))


@pytest.mark.parametrize("settings", CHAINS)
def test_the_boards_filters_give_the_hosts_bits_when_a_frame_shakes(
    reference_core: Any, board_image: Path, settings: dict[str, float]
) -> None:
    lib, ffi = reference_core.lib, reference_core.ffi
    ours = reference_core.new("struct nf_settings *")
    lib.settings_default(ours)
    for name, value in settings.items():
        setattr(ours, name, value)
    host, rate = reference_core.new("struct filters *"), reference_core.new("float[3]")
    lib.filters_init(host, ours, GYRO_HZ)
    core = CortexM7(load_program(board_image))
    board, theirs, argument = (
        core.allocate(size) for size in (FILTERS_BYTES, ffi.sizeof("struct nf_settings"), 12)
    )
    core.write(theirs, bytes(ffi.buffer(ours)))
    core.call("filters_init", board, theirs, GYRO_HZ)
    rows = vibration(np.random.default_rng(1))
    seen = set()
    for step, row in enumerate(rows):
        rate[0:3] = row.tolist()
        lib.filters_step(host, rate)
        core.write(argument, row.tobytes())
        core.call("filters_step", board, argument)
        got = core.read(argument, 12)
        assert got == bytes(ffi.buffer(rate)), f"step {step}"
        seen.add(got)
    assert len(seen - {row.tobytes() for row in rows}) > STEPS * 0.99, "filtered, each sample another"


def test_the_boards_gyro_gives_the_hosts_bits_while_its_bias_follows(
    reference_core: Any, board_image: Path
) -> None:
    """Calibrated, then four seconds of drift with the motors at rest, and the same with motors that turn."""
    lib, ffi = reference_core.lib, reference_core.ffi
    host, out = reference_core.new("struct gyro *"), reference_core.new("float[3]")
    assert lib.gyro_init(host, CONTROL_HZ, CW90, 0) == 0
    core = CortexM7(load_program(board_image))
    board, argument, answer = (core.allocate(size) for size in (GYRO_BYTES, SAMPLE_BYTES, 12))
    assert core.call("gyro_init", board, CONTROL_HZ, CW90, 0) == 0
    rng = np.random.default_rng(4)
    biases = set()
    for step in range(6 * CONTROL_HZ):
        if step == 5 * CONTROL_HZ:
            lib.gyro_rest(host, False)
            core.call("gyro_rest", board, 0)
        drift = np.array([0.3, -0.2, 0.7]) * step / CONTROL_HZ  # counts
        counts = np.rint(rng.normal(drift, 20)).astype(np.int16)
        sample = np.array([*counts, 0, 0, 2048, step % 2, 1, 0], "<i2").tobytes()
        lib.gyro_step(host, ffi.cast("struct imu_sample *", ffi.from_buffer(sample)), out)
        core.write(argument, sample)
        core.call("gyro_step", board, argument, answer)
        assert core.read(answer, 12) == bytes(ffi.buffer(out)), f"step {step}"
        biases.add(tuple(host.bias))
    assert len(biases) == 1 + 5, "none, calibrated, and once a second"


def test_the_boards_attitude_is_the_hosts_bits_when_it_flies(reference_core: Any, board_image: Path) -> None:
    lib, ffi = reference_core.lib, reference_core.ffi
    host = reference_core.new("struct attitude *")
    rate, force, out = (reference_core.new("float[3]") for _ in range(3))
    lib.attitude_init(host, CONTROL_HZ)
    core = CortexM7(load_program(board_image))
    board, turning, felt, answer = (core.allocate(size) for size in (ATTITUDE_BYTES, 12, 12, 12))
    core.call("attitude_init", board, CONTROL_HZ)
    rng = np.random.default_rng(2)
    seen = set()
    for step in range(STEPS):
        rates = float32(rng.normal(0, 0.1 if step < CONTROL_HZ else 5.0, 3))
        forces = float32(rng.normal([0, 0, 9.81], 0.5))
        rate[0:3], force[0:3] = rates.tolist(), forces.tolist()
        lib.attitude_step(host, rate, force)
        core.write(turning, rates.tobytes())
        core.write(felt, forces.tobytes())
        core.call("attitude_step", board, turning, felt)
        lib.attitude_euler_deg(host, out)
        core.call("attitude_euler_deg", board, answer)
        got = core.read(answer, 12)
        assert got == bytes(ffi.buffer(out)), f"step {step}"
        seen.add(got)
    assert bool(core.call("attitude_known", board) & 0xFF) is bool(lib.attitude_known(host)) is True
    assert len(seen) > STEPS * 0.99
