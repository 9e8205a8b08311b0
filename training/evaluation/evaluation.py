"""Figures of a controller on unseen commands: many aircraft at once, without firmware."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.analysis.confidence import Mean, mean_of
from neuroflight.sim.analysis.holding import Holding, HoldingFigures, holding, holding_figures
from neuroflight.sim.analysis.metrics import Effort, Tracking, effort, tracking
from neuroflight.sim.analysis.response import Hold, Response, ResponseFigures, hold, mean_figures, response
from neuroflight.sim.analysis.spectrum import Spectrum, components, smoothness, spectrum
from neuroflight.sim.control.battery_voltage import BatteryVoltage
from neuroflight.sim.control.controller import Controller, PolicyController
from neuroflight.sim.control.gyro_filter import GyroFilter, samples_per_step
from neuroflight.sim.control.motors import motor_commands
from neuroflight.sim.control.pid import Pid
from neuroflight.sim.physics.imu import quantised_rate
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.variation import Variation
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.port import control_divider
from neuroflight.toolchain.contract import IDLE_DEFAULT, Mix
from neuroflight.toolchain.policy.gyro_filters import UNFILTERED, GyroFilters
from neuroflight.training.tasks.flight import Course, course_of
from neuroflight.training.tasks.pieces import RecordedPieces
from neuroflight.training.tasks.task import Task

CHUNK_ROWS = 1 << 20  # of episodes whose errors are computed at a time: their float64 copies are large


@dataclass(frozen=True, eq=False)
class Flights:
    """The record of E episodes of T control steps with M motors."""

    setpoint: NDArray[np.float32]  # (E, T, 3) [rad/s]
    rate: NDArray[np.float32]  # (E, T, 3) [rad/s], true body rate
    output: NDArray[np.float32]  # (E, T, M), the controller's, before throttle mix and idle
    step_s: float  # [s] between rows
    recorded: bool = False  # whether episodes are pieces of a recording: none begins with a command
    motors: NDArray[np.float32] | None = None  # (E, T, M) fractions, after throttle mix, idle and rounding
    lift: NDArray[np.float32] | None = None  # (E, T) [m/s^2], specific force along body z
    volts: NDArray[np.float32] | None = None  # (E, T) [V], of the battery under load; None: the bench supply
    power: NDArray[np.float32] | None = None  # (E, T) [W], electric: motors and electronics
    current: NDArray[np.float32] | None = None  # (E, T) [A]; NaN where the supply's voltage is not known
    course: Course | None = None  # of flights of a minute; None: of single commands
    samples: int = 1  # steps of the twin between rows

    @property
    def commands(self) -> int:
        """Number of commands of an episode whose figures are told one by one."""
        return self.course.commands if self.course else 1

    @property
    def commanded(self) -> slice:
        """The rows before the hover; all where there is none."""
        rows = self.rate.shape[1] - (round(self.course.hover_s / self.step_s) if self.course else 0)
        return slice(0, rows - rows % self.commands)

    def hold(self) -> Hold | None:
        """Return each episode's held command, of a flight one by one; None if one holds under a second."""
        if self.recorded:
            return None
        parts = len(self.rate) * self.commands
        setpoint, rate = (
            rows[:, self.commanded].reshape(parts, -1, 3) for rows in (self.setpoint, self.rate)
        )
        return hold(setpoint, rate, self.step_s)

    def holding(self) -> Holding | None:
        """Return the figures by age; None where episodes are no flights of a minute."""
        if self.course is None:
            return None
        return holding(self.setpoint, self.rate, self.step_s, self.commands, self.commanded.stop)


@dataclass(frozen=True, eq=False)
class Floors:
    """The least errors of each of E episodes that any motors could reach, mean of axes and control steps."""

    mae: NDArray[np.float64]  # (E,) [deg/s]
    mse: NDArray[np.float64]  # (E,) [deg^2/s^2]


@dataclass(frozen=True, eq=False)
class Scores:
    """Figures of each of E episodes; of flights of a minute, those of the time before the hover."""

    tracking: Tracking  # (E, 3) each
    output: NDArray[np.float64]  # (E,), mean output of the controller, fraction 0..1
    change: NDArray[np.float64]  # (E,), mean |change| of an output in 1 ms
    smoothness: NDArray[np.float64]  # (E,), Sm: see sim.analysis.spectrum
    spectrum: Spectrum  # of all episodes
    response: Response | None  # of each command, flight by flight; None where none is held for a second
    motor_change: NDArray[np.float64] | None = None  # (E,), mean |change| of a motor's fraction in 1 ms
    power: NDArray[np.float64] | None = None  # (E,) [W], mean electric power
    current: NDArray[np.float64] | None = None  # (E,) [A], mean
    holding: Holding | None = None  # by age, and the hover's; None where episodes are no flights of a minute
    floors: Floors | None = None  # None where none is known, see training/evaluation/floor.py

    @property
    def commands(self) -> int:
        """Number of commands of `response` of one episode."""
        return len(self.response.success) // len(self.output) if self.response else 1


@dataclass(frozen=True)
class Evaluation:
    """Figures of a controller over `episodes` commands or flights; errors are against the true rate."""

    episodes: int
    tracking: Tracking  # mean over episodes, per axis
    tracking_margin: Tracking  # half width of its 95 % confidence interval
    worst_mae: float  # [deg/s], of the worst episode and axis
    effort: Effort
    effort_margin: Effort  # likewise
    smoothness: float  # Sm: see sim.analysis.spectrum
    smoothness_margin: float  # likewise
    spectrum: Spectrum
    response: ResponseFigures | None  # None where the task holds no command for a second
    motor_change: Mean | None = None  # |change| of a motor's fraction in 1 ms; None where none was recorded
    holding: HoldingFigures | None = None  # None where episodes are no flights of a minute
    mae_least: float | None = None  # [deg/s], that any motors could reach, mean of the axes; None: not known
    mse_least: float | None = None  # [deg^2/s^2], likewise, by another flight


@dataclass(frozen=True)
class Event:
    """A change of all aircraft in flight."""

    at_s: float  # [s] of an episode; control steps from there on fly the changed aircraft
    change: Callable[[Twin], None]
    yaw_given_up: bool = False  # afterwards the controller is told the measured yaw rate as the commanded one


class Rows:
    """The record of T control steps of E aircraft with M motors, float32."""

    def __init__(self, steps: int, episodes: int, motors: int) -> None:
        self._rate = np.empty((steps, episodes, 3), np.float32)
        self._lift = np.empty((steps, episodes), np.float32)
        self._power = np.empty((steps, episodes), np.float32)
        self._current = np.empty((steps, episodes), np.float32)
        self.motors = np.empty((steps, episodes, motors), np.float32)
        self.output = np.empty((steps, episodes, motors), np.float32)
        self._volts: NDArray[np.float32] | None = None

    def put(self, k: int, twin: Twin, motors: NDArray[np.float64]) -> None:
        """Keep step `k`: the twin as it is, and the motor fractions (E, M) that it will be given."""
        self._rate[k] = twin.live.rate
        self._lift[k] = twin.live.specific_force[:, 2]
        drawn = twin.draw
        self._power[k], self._current[k] = drawn.power, drawn.current
        self.motors[k] = motors
        if twin.battery is not None:
            if self._volts is None:
                self._volts = np.empty_like(self._lift)
            self._volts[k] = twin.battery.voltage[:, 0]

    def flights(self, setpoint: NDArray[np.float32], step_s: float, task: Task, samples: int) -> Flights:
        """Return the record of all steps of the task's episodes; samples: of the twin in a step."""
        rate, output, motors, lift, power, current = map(
            _by_episode, (self._rate, self.output, self.motors, self._lift, self._power, self._current)
        )
        volts = None if self._volts is None else _by_episode(self._volts)
        return Flights(
            setpoint,
            rate,
            output,
            step_s,
            isinstance(task, RecordedPieces),
            motors,
            lift,
            volts,
            power,
            current,
            course_of(task),
            samples,
        )


def drawn(seed: int) -> tuple[np.random.Generator, np.random.Generator]:
    """Return the streams of a seed that commands and the sensors' noise are drawn from."""
    commands, noise = (np.random.default_rng(part) for part in np.random.SeedSequence(seed).spawn(2))
    return commands, noise


def record(
    controller: Controller,
    aircraft: Aircraft,
    task: Task,
    *,
    episodes: int,
    seed: int,
    control_rate_hz: int,
    mount: Mount = Mount.CENTRE,
    ground: bool = False,
    noise: bool = True,
    throttle: float | NDArray[np.float32] = 0.0,
    idle: float = IDLE_DEFAULT,
    mix: Mix = Mix.ATTITUDE_FIRST,
    gyro_filters: GyroFilters = UNFILTERED,
    gyro_rate_hz: int | None = None,
    charge: float | None = None,
    variation: Variation | None = None,
    event: Event | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Flights:
    """Fly `episodes` commands of `task`, one aircraft each, all at once.

    controller: for `episodes` aircraft; seed: of commands and noise; ground: they stand on it, mount free;
    throttle: the pilot's thrust 0..1, one
    for all, (episodes,), or that of each control step, (episodes, T); charge: of every battery, 0..1, None:
    the bench supply, if no variation says it; idle, mix: of the controller; gyro_filters: of the
    gyro before it; gyro_rate_hz: of the gyro and of
    the twin's steps, a multiple of the control rate, None: the control rate, with filters the NF1's;
    variation: how the aircraft differ from their file, `episodes` of them; event: what happens to them in
    flight; progress: called with steps done and to do. The same seed gives every controller the same
    commands, and at the same gyro rate the same noise and bias. Raises LinkError on a gyro rate that is
    no multiple.
    """
    commands, noise_rng = drawn(seed)
    wanted = task.episodes(episodes, commands, control_rate_hz)
    steps = wanted.shape[1]
    # Of each control step, (T, episodes); None: it stays as it is.
    by_step = np.ascontiguousarray(np.transpose(throttle), np.float32) if np.ndim(throttle) == 2 else None
    thrust = np.full(episodes, 0.0 if by_step is not None else throttle, np.float32)
    rows = Rows(steps, episodes, aircraft.motor_count)
    samples = samples_per_step(gyro_filters, control_rate_hz)
    if gyro_rate_hz is not None:
        samples = control_divider(gyro_rate_hz, control_rate_hz)
    seen = samples if gyro_filters.every_sample else 1  # of a control period
    gyro = GyroFilter(gyro_filters, episodes, aircraft.motor_count, control_rate_hz, samples)
    twin = Twin(
        aircraft,
        episodes,
        rate_hz=samples * control_rate_hz,
        mount=mount,
        ground=ground,
        noise=noise,
        charge=charge,
        variation=variation,
        rng=noise_rng,
    )
    battery = BatteryVoltage(control_rate_hz)
    try:
        controller.reset()
        if isinstance(controller, Pid):
            controller.compensate(battery.measure(twin.pack_voltage))
        gyro.add(quantised_rate(twin.gyro))
        for k in range(steps):
            setpoint = wanted[:, k]
            if event is not None and k == round(event.at_s * control_rate_hz):
                event.change(twin)
            if event is not None and event.yaw_given_up and k >= round(event.at_s * control_rate_hz):
                setpoint = setpoint.copy()
                setpoint[:, 2] = gyro.read()[:, 2]
            if by_step is not None:
                thrust = by_step[k]
            if isinstance(controller, PolicyController) and controller.senses:
                controller.sense(twin.told_speed, twin.rotation)
            rows.output[k] = y = controller.step(setpoint, gyro.read(), thrust)
            if isinstance(controller, Pid) and battery.due(k):
                controller.compensate(battery.measure(twin.pack_voltage))
            command = motor_commands(y, thrust, idle, mix)
            rows.put(k, twin, command)
            read = quantised_rate(twin.step(command, samples)[-seen:])
            if gyro_filters.rpm is not None:
                gyro.add_all(read[:-1])
                gyro.told(twin.told_speed)
                read = read[-1:]
            gyro.add_all(read)
            if progress is not None:
                progress(k + 1, steps)
    finally:
        twin.close()
    return rows.flights(wanted, 1.0 / control_rate_hz, task, samples)


def figures(flights: Flights) -> Evaluation:
    """Return all figures of recorded flights."""
    return summary(scores(flights))


def scores(flights: Flights) -> Scores:
    """Return the figures of each episode."""
    episodes, step_s, rows = len(flights.rate), flights.step_s, flights.commanded
    setpoint, rate, output = (part[:, rows] for part in (flights.setpoint, flights.rate, flights.output))
    at_a_time = max(1, CHUNK_ROWS // max(1, rate.shape[1]))
    chunks = [slice(start, start + at_a_time) for start in range(0, episodes, at_a_time)]
    errors = [tracking(setpoint[c], rate[c], step_s) for c in chunks]
    efforts = [effort(each, step_s) for each in output]
    parts = components(output, step_s)
    held = flights.hold()
    return Scores(
        tracking=Tracking(
            *(np.concatenate([getattr(part, field.name) for part in errors]) for field in fields(Tracking))
        ),
        output=np.array([item.output for item in efforts]),
        change=np.array([item.change for item in efforts]),
        smoothness=smoothness(parts),
        spectrum=spectrum(parts),
        response=response(held) if held else None,
        motor_change=(
            None
            if flights.motors is None
            else np.array([effort(motors[rows], step_s).change for motors in flights.motors])
        ),
        power=_means(flights.power, rows),
        current=_means(flights.current, rows),
        holding=flights.holding(),
    )


def _means(values: NDArray[np.float32] | None, rows: slice) -> NDArray[np.float64] | None:
    """Return the mean of each episode (E,) over these rows of values (E, T)."""
    return None if values is None else np.asarray(values[:, rows].mean(axis=1, dtype=np.float64))


def summary(scores: Scores) -> Evaluation:
    """Return the means over the episodes with their confidence."""
    errors = [mean_of(getattr(scores.tracking, field.name)) for field in fields(Tracking)]
    output, change, rough = (mean_of(each) for each in (scores.output, scores.change, scores.smoothness))
    return Evaluation(
        episodes=len(scores.output),
        tracking=Tracking(*(mean.value for mean in errors)),
        tracking_margin=Tracking(*(mean.high - mean.value for mean in errors)),
        worst_mae=float(scores.tracking.mae.max()),
        effort=Effort(float(output.value), float(change.value)),
        effort_margin=Effort(float(output.high - output.value), float(change.high - change.value)),
        smoothness=float(rough.value),
        smoothness_margin=float(rough.high - rough.value),
        spectrum=scores.spectrum,
        response=mean_figures(scores.response, commands=scores.commands) if scores.response else None,
        motor_change=None if scores.motor_change is None else mean_of(scores.motor_change),
        holding=holding_figures(scores.holding) if scores.holding else None,
        mae_least=float(scores.floors.mae.mean()) if scores.floors else None,
        mse_least=float(scores.floors.mse.mean()) if scores.floors else None,
    )


def _by_episode(array: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.swapaxes(array, 0, 1)
