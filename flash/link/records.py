"""Decodes the replies that only this firmware gives: safety, tasks and faults."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from neuroflight.flash.link.payload import Reader
from neuroflight.toolchain.contract import (
    FallbackCause,
    FlightState,
    GyroHealth,
    GyroIdentity,
    Msp,
    StopCause,
    Task,
)

# Registers of a fault record, in the order of the reply: firmware/src/storage/fault_record.h.
FAULT_REGISTERS = ("r0", "r1", "r2", "r3", "r12", "lr", "pc", "psr", "cfsr", "hfsr", "mmfar", "bfar", "sp")
FAULT_FILE_BYTES = 24
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
    gyro_identity: int | None  # WHO_AM_I of its chip; None: no chip was read, or the firmware tells none
    brown_out_level: int | None  # of the supply's detector, 0: it is off; None: the firmware tells none
    airborne: bool | None  # it has taken off since it was armed; None: the firmware does not tell

    @property
    def gyro_known(self) -> bool:
        """True if boards are flown with this chip."""
        return self.gyro_identity in tuple(GyroIdentity)

    @property
    def gyro_chip(self) -> str:
        """Name and identity of the gyro chip for messages; "" if the firmware reports none."""
        if self.gyro_identity is None:
            return ""
        if self.gyro_identity == NO_CHIP:
            return f"no chip answers (0x{NO_CHIP:02X})"
        if not self.gyro_known:
            return f"unknown chip (0x{self.gyro_identity:02X})"
        return f"{GyroIdentity(self.gyro_identity).name} (0x{self.gyro_identity:02X})"


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


class FaultKind(IntEnum):
    """Causes of a reset: firmware/src/storage/fault_record.h."""

    NONE = 0
    HARD = 1
    ASSERT = 2
    WATCHDOG = 3
    BROWN_OUT = 4
    CLOCK = 5
    RESET = 6


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
    reader = Reader(Msp.SAFETY, payload)
    state, stop = reader.one_of(FlightState), reader.one_of(StopCause)
    fallback, health = reader.one_of(FallbackCause), reader.one_of(GyroHealth)
    reasons, policy_good, pid_built_in, pid_flies, percent, centidegrees, idle = reader.fields("I3?Bhf")
    refused = reader.one_of(FallbackCause)
    later = payload[reader.at :]  # older firmware sends none of these
    identity, brown_out = (*later, 0, 0)[:2]
    return Safety(
        state=state,
        stop_cause=stop,
        fallback_cause=fallback,
        gyro_health=health,
        arming_flags=reasons,
        policy_good=policy_good,
        pid_built_in=pid_built_in,
        pid_flies=pid_flies,
        receiver_percent=percent,
        temperature_deg_c=centidegrees / 100,
        idle=idle,
        refused_cause=refused,
        gyro_identity=identity or None,
        brown_out_level=brown_out - 1 if brown_out else None,
        airborne=bool(later[2]) if len(later) > 2 else None,
    )


def tasks(payload: bytes) -> Tasks:
    """Decode TASKS. Tasks that this tool has no name for are left out."""
    reader = Reader(Msp.TASKS, payload)
    cycles_hz, count = reader.fields("IB")
    rows = [reader.fields("H5I") for _ in range(count)]
    return Tasks(cycles_hz, tuple(TaskLoad(task, *row) for task, row in zip(Task, rows, strict=False)))


def faults(payload: bytes) -> Faults:
    """Decode FAULTS."""
    reader = Reader(Msp.FAULTS, payload)
    boots, pending = reader.fields("I?")
    if not pending:
        return Faults(boots, None)
    (boot,) = reader.fields("I")
    kind = reader.one_of(FaultKind)
    reader.bytes(3)  # the kind is stored in four bytes
    registers = dict(zip(FAULT_REGISTERS, reader.fields(f"{len(FAULT_REGISTERS)}I"), strict=True))
    (line,) = reader.fields("I")
    file = reader.text(FAULT_FILE_BYTES)
    (uptime_steps,) = reader.fields("I")
    return Faults(boots, Fault(boot, kind, registers, file, line, uptime_steps))
