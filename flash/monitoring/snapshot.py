"""A firmware's complete state at one moment."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.board.info import Info
from neuroflight.flash.board.overview import Overview, read_overview
from neuroflight.flash.link import messages, records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.records import Tasks
from neuroflight.toolchain.contract import (
    CHANNEL_COUNT,
    GYRO_COUNTS,
    GYRO_FULL_SCALE_DEG_S,
    MSP_GYRO_COUNTS,
    Msp,
)

# MSP tells the channels in this order, whatever the receiver's is.
CHANNELS = ("roll", "pitch", "yaw", "throttle", *(f"aux{n}" for n in range(1, CHANNEL_COUNT - 3)))

BETAFLIGHT_GYRO_COUNTS = (
    GYRO_COUNTS / GYRO_FULL_SCALE_DEG_S
)  # for 1 deg/s: the chip's, read in 4.6 and 2025.12


@dataclass(frozen=True)
class Snapshot:
    """A state whose parts are read one after the other, within tens of milliseconds."""

    overview: Overview
    rates_deg_s: tuple[int, int, int]  # roll, pitch, yaw
    channels_us: dict[str, int]  # by name
    motors_us: tuple[int, ...]  # 1000 (stopped) to 2000, motor order
    tasks: Tasks | None  # None from a firmware of another make


def read_snapshot(client: Client, info: Info) -> Snapshot:
    """Read all of it. info: of that firmware. Raises LinkError."""
    overview = read_overview(client)
    widths = messages.rc(client.request(Msp.RC))
    ours = overview.flight is not None
    count = info.policy.action_count if info.policy is not None else None
    return Snapshot(
        overview=overview,
        rates_deg_s=_rates(messages.raw_imu(client.request(Msp.RAW_IMU)).gyro, info),
        channels_us=dict(zip(CHANNELS, widths, strict=False)),
        motors_us=_there(messages.motor(client.request(Msp.MOTOR)), count),
        tasks=records.tasks(client.request(Msp.TASKS)) if ours else None,
    )


def _rates(counts: tuple[int, int, int], info: Info) -> tuple[int, int, int]:
    """Scale a gyro's counts to deg/s."""
    if info.policy is None:
        scale = BETAFLIGHT_GYRO_COUNTS
    else:
        scale = MSP_GYRO_COUNTS if info.api.minor >= messages.RAW_IMU_COUNTS_SINCE else 1.0
    roll, pitch, yaw = (round(count / scale) for count in counts)
    return roll, pitch, yaw


def _there(outputs: tuple[int, ...], count: int | None) -> tuple[int, ...]:
    """Return the outputs of the motors that exist."""
    return outputs[:count] if count is not None else tuple(us for us in outputs if us)
