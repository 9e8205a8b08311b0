"""Controllers as a user names them (policies, PIDs, classes of his own), and the conditions they fly in."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.identity import other_aircraft_note
from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.control.any_policy import own_policy
from neuroflight.sim.control.controller import Controller, PolicyController
from neuroflight.sim.control.pid import aircraft_pid
from neuroflight.sim.control.pid_table import pid_settings
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ, Mix
from neuroflight.toolchain.errors import PolicyError
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters
from neuroflight.toolchain.policy.label import policy_label
from neuroflight.toolchain.policy.model import parse_policy
from neuroflight.training.evaluation.betaflight import BetaflightSpec, record_betaflight
from neuroflight.training.evaluation.evaluation import Event, Flights, record
from neuroflight.training.evaluation.users_controller import (
    UsersController,
    is_users_controller,
    load_users_controller,
    users_label,
)
from neuroflight.training.tasks.pieces import RecordedPieces
from neuroflight.training.tasks.sticks import OnSticks
from neuroflight.training.tasks.task import Task

PID = "pid"
OTHER_AIRCRAFT = "other_aircraft"  # in the facts of a policy that flies another's twin: the line that says so
PID_RATE_HZ = 1000


@dataclass(frozen=True)
class ControllerSpec:
    """A controller that can be built for any number of aircraft."""

    name: str  # as the user wrote it
    build: Callable[[int], Controller]  # for a number of aircraft
    control_rate_hz: int
    idle: float  # motor fraction of armed motors at no thrust
    facts: dict[str, str]  # what a stored result records of it
    mix: Mix = Mix.ATTITUDE_FIRST  # of its outputs and the throttle
    gyro_filters: GyroFilters = UNFILTERED  # of the gyro before it
    standing: Callable[[int], Controller] | None = None  # as `build`, on the ground; None: as in the air

    @property
    def label(self) -> str:
        """A short name for tables and plots."""
        if "pid" in self.facts:
            return f"PID {self.facts['pid']}"
        if is_users_controller(self.name):
            return users_label(self.name)
        return policy_label(self.name)


AnyController = ControllerSpec | BetaflightSpec


def load_controller(name: str, aircraft: Aircraft, idle: float | None = None) -> ControllerSpec:
    """Load `pid`, `pid:NAME` of the aircraft file, a policy.onnx, `any` or a FILE.py:CLASS.

    A general policy, as `any` is, flies specialized for the aircraft.

    idle: replaces its own unless None. Raises AircraftError, PolicyError or TrainingError if it does not
    exist, or drives another number of motors.
    """
    if is_users_controller(name):
        return users_spec(load_users_controller(name), aircraft, name, idle)
    kind, _, which = name.partition(":")
    if kind == PID:
        settings = pid_settings(aircraft, which or None)
        chosen = which or next(iter(dict(aircraft.pids)))
        return ControllerSpec(
            name=name,
            build=lambda count: aircraft_pid(aircraft, count, PID_RATE_HZ, chosen),
            standing=lambda count: aircraft_pid(aircraft, count, PID_RATE_HZ, chosen, standing=True),
            control_rate_hz=PID_RATE_HZ,
            idle=settings.idle if idle is None else idle,
            facts={"pid": chosen},
            mix=settings.mix,
            gyro_filters=settings.gyro_filters,
        )
    data = own_policy(name, aircraft)
    try:
        policy = parse_policy(data)
    except PolicyError as error:
        raise PolicyError(f"{name}: {error}") from error
    if policy.action_count != aircraft.motor_count:
        raise PolicyError(
            f"{name} drives {policy.action_count} motors, aircraft {aircraft.name} has "
            f"{aircraft.motor_count}; evaluate it on an aircraft it was trained for"
        )
    note = other_aircraft_note(name, policy.aircraft, policy.aircraft_sha256, aircraft)
    return ControllerSpec(
        name=name,
        build=lambda count: PolicyController(policy, count, exact=False, idle=idle),
        standing=lambda count: PolicyController(policy, count, exact=False, idle=idle, standing=True),
        control_rate_hz=policy.control_rate_hz,
        idle=policy.idle if idle is None else idle,
        facts={
            "policy_sha256": hashlib.sha256(data).hexdigest(),
            **({} if note is None else {OTHER_AIRCRAFT: note}),
        },
        mix=policy.mix,
        gyro_filters=policy.gyro_filters,
    )


def users_spec(
    controller: UsersController, aircraft: Aircraft, name: str, idle: float | None = None
) -> ControllerSpec:
    """Return a class of a user's file as a controller; idle: replaces its own unless None."""
    return ControllerSpec(
        name=name,
        build=lambda count: controller.build(aircraft, count),
        control_rate_hz=controller.control_rate_hz,
        idle=controller.idle if idle is None else idle,
        facts={
            "file_sha256": controller.sha256,
            "parameters": ", ".join(f"{each}={value:g}" for each, value in controller.values.items()),
        },
        mix=controller.mix,
        gyro_filters=controller.gyro_filters,
    )


@dataclass(frozen=True)
class Conditions:
    """The conditions that are the same for every controller."""

    aircraft: Aircraft
    task: Task
    episodes: int
    seed: int  # of commands, noise and bias
    mount: Mount = Mount.CENTRE
    ground: bool = False  # whether they stand on it to begin with; mount free
    noise: bool = True
    charge: float | None = None  # of every battery, 0..1; None: the bench supply
    gyro_rate_hz: int | None = None  # of every gyro; None: as each controller needs, see `record`
    sticks: bool = False  # whether commands are rounded to what a pilot's sticks can say

    def fly(
        self,
        controller: AnyController,
        throttle: float | NDArray[np.float32] | None,
        progress: Callable[[int, int], None] | None = None,
        variation: Variation | None = None,
        event: Event | None = None,
    ) -> Flights:
        """Fly all episodes at once; see `record`. throttle None: that of a recorded task, else none."""
        if throttle is None:
            throttle = 0.0
            if isinstance(self.task, RecordedPieces):
                throttle = self.task.throttle(self.episodes, controller.control_rate_hz)
        # Recorded commands are of sticks already.
        task = OnSticks(self.task) if self.sticks and not isinstance(self.task, RecordedPieces) else self.task
        common: dict[str, Any] = {
            "episodes": self.episodes,
            "seed": self.seed,
            "mount": self.mount,
            "ground": self.ground,
            "noise": self.noise,
            "throttle": throttle,
            "charge": self.charge if variation is None else None,
            "variation": variation,
            "event": event,
            "progress": progress,
        }
        if isinstance(controller, BetaflightSpec):
            if event is not None and event.yaw_given_up:
                raise ValueError("Betaflight cannot be told to give up yaw")
            return record_betaflight((controller.armed,), self.aircraft, task, **common)
        # With the throttle closed they stay on the ground, as the firmware assumes.
        stands = controller.standing if self.ground and not np.any(throttle) else None
        return record(
            (stands or controller.build)(self.episodes),
            self.aircraft,
            task,
            control_rate_hz=controller.control_rate_hz,
            idle=controller.idle,
            mix=controller.mix,
            gyro_filters=controller.gyro_filters,
            gyro_rate_hz=self.gyro_rate_hz,
            **common,
        )


def at_gyro_rate(conditions: Conditions, controllers: Iterable[AnyController], *, sticks: bool) -> Conditions:
    """Return the conditions at the gyro rate that one of the controllers needs; sticks: see Conditions."""
    if sticks or any(controller.gyro_filters.every_sample for controller in controllers):
        return replace(conditions, gyro_rate_hz=GYRO_RATE_DEFAULT_HZ, sticks=sticks)
    return conditions
