"""Decodes the replies that only this firmware gives: safety, tasks and faults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from neuroflight.flash.link.layouts import read
from neuroflight.flash.link.payload import one_of
from neuroflight.toolchain.contract import (
    FAULT_REGISTERS,
    GYRO_IDENTITIES,
    FallbackCause,
    FaultKind,
    FlightState,
    GyroChip,
    GyroHealth,
    Msp,
    StopCause,
    Task,
)

NO_CHIP = 0xFF  # read through the bus's pull-up if no gyro chip answers


@dataclass(frozen=True)
class Safety:
    """The interlocks that stop the motors, and the controller that flies."""

    state: FlightState
    stop_cause: StopCause  # why the motors stopped last
    fallback_cause: FallbackCause  # why the PID took over last
    gyro_health: GyroHealth
    arming_flags: int  # bit field of contract.ArmingReason, see `flash.link.messages.arming_reasons`
    policy_good: bool
    pid_built_in: bool
    pid_flies: bool  # or would if armed now
    receiver_percent: int  # quality of the link
    temperature_deg_c: float  # of the gyro
    idle: float  # motor fraction at zero thrust, of the controller that flies
    refused_cause: FallbackCause  # why the policy must not fly until it is acknowledged; NONE: it may
    gyro_identity: int | None  # what its chip says it is; None: no chip was read, or the firmware tells none
    brown_out_level: int | None  # of the supply's detector, 0: it is off; None: the firmware tells none
    airborne: bool | None  # it has taken off since it was armed; None: the firmware does not tell
    gyro: GyroChip | None  # its chip; None: none that the firmware knows
    motor_key: int | None = None  # that motors_checked is once motors and gyro were checked; None: not told

    @property
    def gyro_chip(self) -> str:
        """Name and identity of the gyro chip for messages; "" if the firmware reports none."""
        if self.gyro_identity is None:
            return ""
        if self.gyro_identity == NO_CHIP:
            return f"no chip answers (0x{NO_CHIP:02X})"
        return f"{'unknown chip' if self.gyro is None else self.gyro.name} (0x{self.gyro_identity:02X})"


@dataclass(frozen=True)
class TaskLoad:
    """The processor time of one task since boot."""

    task: Task
    rate_hz: int  # nominal rate; 0: on demand
    runs: int
    misses: int  # deadlines
    worst_cycles: int
    best_cycles: int
    mean_cycles: int

    @property
    def variability(self) -> float:
        """(worst - best) / worst, 0 before the first run."""
        return (self.worst_cycles - self.best_cycles) / self.worst_cycles if self.worst_cycles else 0.0


@dataclass(frozen=True)
class Tasks:
    """The processor time, task by task."""

    cycles_hz: int  # cycles a second
    loads: tuple[TaskLoad, ...]


@dataclass(frozen=True)
class Fault:
    """A fault that nobody acknowledged; registers are 0 if the kind has none."""

    boot: int  # number of the boot that found it, by which FAULTS acknowledges it
    kind: FaultKind
    registers: dict[str, int]
    file: str
    line: int
    uptime_steps: int  # control steps before it


@dataclass(frozen=True)
class Faults:
    """The log of boots and faults."""

    boots: int  # the present one included
    pending: Fault | None  # the newest one, which forbids arming


def safety(payload: bytes) -> Safety:
    """Decode SAFETY."""
    told = read(Msp.SAFETY, payload)
    later = told.get("brown_out", 0)  # older firmware sends none of these
    return Safety(
        state=one_of(FlightState, told["state"], Msp.SAFETY),
        stop_cause=one_of(StopCause, told["stop_cause"], Msp.SAFETY),
        fallback_cause=one_of(FallbackCause, told["fallback_cause"], Msp.SAFETY),
        gyro_health=one_of(GyroHealth, told["gyro_health"], Msp.SAFETY),
        arming_flags=told["arming_reasons"],
        policy_good=bool(told["policy_good"]),
        pid_built_in=bool(told["pid_built_in"]),
        pid_flies=bool(told["pid_flies"]),
        receiver_percent=told["receiver_quality"],
        temperature_deg_c=told["temperature"] / 100,
        idle=told["idle"],
        refused_cause=one_of(FallbackCause, told["refused_cause"], Msp.SAFETY),
        gyro_identity=told.get("gyro_identity") or None,
        brown_out_level=later - 1 if later else None,
        airborne=bool(told["airborne"]) if "airborne" in told else None,
        gyro=_gyro(told),
        motor_key=told.get("motor_key"),
    )


def _gyro(told: Mapping[str, Any]) -> GyroChip | None:
    """Return the chip that SAFETY names; older firmware tells its identity alone, and knew six of them."""
    if "gyro_chip" in told:
        number = told["gyro_chip"] - 1
    else:
        older = GYRO_IDENTITIES[: GyroChip.MPU6000]
        identity = told.get("gyro_identity")
        number = older.index(identity) if identity in older else -1
    return GyroChip(number) if 0 <= number < len(GyroChip) else None


def tasks(payload: bytes) -> Tasks:
    """Decode TASKS. Tasks that this tool has no name for are left out."""
    told = read(Msp.TASKS, payload)
    rows = (tuple(row.values()) for row in told["tasks"])
    loads = tuple(TaskLoad(task, *row) for task, row in zip(Task, rows, strict=False))
    return Tasks(told["cycles_hz"], loads)


def faults(payload: bytes) -> Faults:
    """Decode FAULTS."""
    told = read(Msp.FAULTS, payload)
    if not told["pending"]:
        return Faults(told["boots"], None)
    told = read(Msp.FAULTS, payload, upto="uptime")
    return Faults(
        told["boots"],
        Fault(
            boot=told["boot"],
            kind=one_of(FaultKind, told["fault"], Msp.FAULTS),
            registers=dict(zip(FAULT_REGISTERS, told["registers"], strict=True)),
            file=told["file"],
            line=told["line"],
            uptime_steps=told["uptime"],
        ),
    )
