"""The twin's equations for a fit: rotors turned by logged motors, and the turning that each parameter makes.

Rotors run open loop: the logged command, late by the delay, makes the speed that the curve says at the logged
voltage, which rotors follow by the twin's own response. Their forces make angular accelerations that are
linear in most parameters; the rates couple the axes. Both, measured rates and the integral of what the model
says, pass the same high-pass, so that nothing drifts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d

from neuroflight.sim.aircraft.model import Aircraft, FirstOrderResponse, Propulsion, TorqueResponse
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.flight import Flight, Piece
from neuroflight.sim.identification.fit.noise import high_pass
from neuroflight.sim.physics.rotor import speeds_along, target_speed, thrust_and_torque
from neuroflight.toolchain.contract import AXES

LEAKS = (
    2 * np.pi * 1.0,
    2 * np.pi * 5.0,
)  # [1/s] of the high-pass: of a fit, and of the one that it is held against
DELAY_MAX_S = 0.03
SLOW_VOLTS_S = 2.0  # beside which the filters of logged volts are quick
SLOPE = 1e-3  # step of a factor, for a slope

Theta = dict[str, float]


@dataclass(frozen=True)
class Layout:
    """The parameters of a fit in order: their names, values of the start file and what is known before."""

    names: tuple[str, ...]
    start: Array  # (P,)
    spread: Array  # (P,) standard deviation of the start's value before a log is seen
    shape: int  # the first of them change the rotors' course; the others are linear
    curve: tuple[float, float]  # of the start: bend, and foot over top
    top: float  # [rad/s] of the start
    usual: float  # motor value that authority and kick are taken at

    def at(self, name: str) -> int:
        return self.names.index(name)

    def values(self, theta: Array) -> Theta:
        """Return the parameters of the equations.

        A fit moves authority and kick at the usual motor value, which logs tell whatever the curve is; the
        equations take moment and momentum over inertia.
        """
        values = dict(zip(self.names, map(float, theta), strict=True))
        return {name: value * self.scale(name, values) for name, value in values.items()}

    def scale(self, name: str, values: Mapping[str, float]) -> float:
        """Return what a unit of a fit's parameter is in the equations."""
        if name != "kick" and not name.startswith("factor."):
            return 1.0
        top = float(np.exp(values["log_top"])) / self.top if "log_top" in values else 1.0
        foot = values.get("foot", self.curve[1])
        (level, rise), (level_then, rise_then) = (
            _curve(bend, end, self.usual) for bend, end in ((values["bend"], foot), self.curve)
        )
        if name == "kick":
            return rise_then / (rise * top)
        return level_then * rise_then / (level * rise * top**2)


def _curve(bend: float, foot: float, at: float) -> tuple[float, float]:
    """Return the speed over that at full command, and its slope, at a motor value; not near 0."""
    level, rise = foot + (1.0 + bend - foot - bend * at) * at, 1.0 + bend - foot - 2.0 * bend * at
    return max(level, 0.02), max(rise, 0.02)


def layout(aircraft: Aircraft, *, speeds: bool, pack: bool, usual: float = 0.4) -> Layout:
    """Lay out the parameters for an aircraft.

    speeds: rotor speeds are logged; pack: it flew on its battery; usual: motor value of the flights.
    """
    propulsion, motors = aircraft.propulsion, aircraft.motor_count
    a, _, c = propulsion.speed_curve
    top = sum(propulsion.speed_curve)
    rows: list[tuple[str, float, float]] = []
    if isinstance(propulsion.response, FirstOrderResponse):
        rows += [
            ("log_up", np.log(propulsion.response.time_constant_up), 0.7),
            # Both ways differ little; a log tells it less well than their mean.
            (
                "log_ratio",
                np.log(propulsion.response.time_constant_down / propulsion.response.time_constant_up),
                0.3,
            ),
        ]
    else:
        inertia = propulsion.rotor_inertia
        rows += [
            ("log_gain", np.log(propulsion.response.gain / inertia), 1.0),
            ("log_torque_up", np.log(propulsion.response.torque_up / inertia), 1.0),
            ("log_torque_down", np.log(propulsion.response.torque_down / inertia), 1.0),
        ]
    rows += [("delay_s", propulsion.delay, 0.004), ("bend", -a / top, 0.15)]
    if speeds:
        rows += [("log_top", np.log(top), 1.0), ("foot", c / top, 0.1), ("told_late_s", 0.001, 0.003)]
    if aircraft.battery is not None and propulsion.supply_voltage is not None:
        rows += [("sag", 1.0, 0.5) if pack else ("sag", 0.0, 1.0)]
    shape = len(rows)
    rows += [(f"factor.{axis}", 1.0, 0.7) for axis in AXES]
    rows += [("kick", 1.0, 0.7)]
    rows += [(f"motor.{number + 1}", 0.0, 0.1) for number in range(motors - 1)]  # the last: all sum up to 0
    rows += [("centre.x", 0.0, 0.01), ("centre.y", 0.0, 0.01), ("air.x", 0.0, 5.0), ("air.y", 0.0, 5.0)]
    advance = propulsion.advance
    rows += [
        (f"turn.{axis}", float(turn), 0.05)
        for axis, turn in zip(AXES, aircraft.gyro.misalignment, strict=True)
    ]
    rows += [("inflow", 0.0 if advance is None else -advance.thrust[0], 0.5), ("drag", 1.0, 0.7)]
    names, start, spread = zip(*rows, strict=True)
    curve = (-a / top, c / top)
    return Layout(names, np.array(start), np.array(spread), shape, curve, float(top), usual)


def shaped(propulsion: Propulsion, values: Mapping[str, float]) -> Propulsion:
    """Return the propulsion with the curve and the response of `values`."""
    top, (_, _, foot) = sum(propulsion.speed_curve), propulsion.speed_curve
    if "log_top" in values:
        scale = float(np.exp(values["log_top"]))
        foot = values["foot"] * scale
        top = scale
    a = -values["bend"] * top
    response: FirstOrderResponse | TorqueResponse
    if "log_up" in values:
        up = float(np.exp(values["log_up"]))
        response = FirstOrderResponse(up, up * float(np.exp(values["log_ratio"])))
    else:
        old, inertia = propulsion.response, propulsion.rotor_inertia
        assert isinstance(old, TorqueResponse)
        rates = [
            float(np.exp(values[f"log_{name}"])) * inertia for name in ("gain", "torque_up", "torque_down")
        ]
        response = TorqueResponse(rates[0], rates[1], rates[2], min(old.friction, 0.9 * rates[0]))
    return replace(propulsion, speed_curve=(a, top - a - foot, foot), response=response)


class PieceModel:
    """One piece of a flight under the equations of an aircraft."""

    def __init__(self, flight: Flight, piece: Piece, aircraft: Aircraft, leak: float = LEAKS[0]) -> None:
        self.flight, self.piece, self.aircraft, self.leak = flight, piece, aircraft, leak
        self.dt = piece.step_s / self.finer
        self.motors = np.clip(self.fine(piece.motors), 0.0, 1.0)
        self.rate = self.fine(piece.gyro)  # without the noise, as far as it is known
        known = aircraft.propulsion.supply_voltage is not None and piece.voltage is not None
        # Logged volts are filtered and late: the slow part is theirs, what is quicker is the sag's.
        self.voltage = None
        if known and piece.voltage is not None:
            self.voltage = self.fine(self.slow(piece.voltage, piece.step_s)[:, None])
        self.measured = self.passed(piece.gyro[1:] - piece.gyro[:-1], piece.step_s)

    @cached_property
    def finer(self) -> int:
        """Steps of the model in one row."""
        return max(1, int(np.ceil(self.piece.step_s / 0.0012)))

    def fine(self, values: Array) -> Array:
        """Return rows (N, K) at the model's steps."""
        if self.finer == 1:
            return values
        # Straight lines would weaken what is quick, which looks like rotors that are quicker and later.
        rows = np.arange((len(values) - 1) * self.finer + 1) / self.finer
        return np.asarray(CubicSpline(np.arange(len(values)), values)(rows), np.float64)

    def passed(self, gains: Array, step: float) -> Array:
        """Sum gains (N - 1, K) of each row over the row before through the high-pass: (N, K)."""
        return high_pass(gains, self.leak, step)

    def course(self, gains: Array) -> Array:
        """Return the course of gains of fine steps, at the log's rows."""
        if self.finer > 1:
            count = len(gains) // self.finer
            gains = gains[: count * self.finer].reshape(count, self.finer, -1).sum(axis=1)
        return self.passed(gains, self.piece.step_s)

    def speeds(self, values: Mapping[str, float]) -> Array:
        """Return rotor speeds of the fine steps (K, M) [rad/s]."""
        propulsion = shaped(self.aircraft.propulsion, values)
        hold = self.flight.control_s
        late = float(np.clip(values["delay_s"], 0.0, DELAY_MAX_S)) + 0.5 * (hold - self.dt)
        acting = delayed(self.motors, late / self.dt)
        targets = target_speed(acting, propulsion, self.voltage)
        speeds = speeds_along(targets[0], targets, self.dt, propulsion)
        if "sag" in values:
            targets = np.ascontiguousarray(targets * self._sagged(speeds, values)[:, None])
            speeds = speeds_along(targets[0], targets, self.dt, propulsion)
        return speeds[:-1]

    def _sagged(self, speeds: Array, values: Mapping[str, float]) -> Array:
        """Return the voltage (K,) over its slow part, by the power that rotors of speeds (K + 1, M) draw.

        The slow part is that of logged volts, without these the mean. The sag of `values` is that of the
        pack's resistance times the power over the start file's.
        """
        propulsion, battery = self.aircraft.propulsion, self.aircraft.battery
        assert battery is not None and propulsion.supply_voltage is not None
        drag = thrust_and_torque(np.ascontiguousarray(speeds[1:]), propulsion)[1]
        gained = propulsion.rotor_inertia * np.diff(speeds, axis=0) / self.dt
        torque = abs(values["factor.yaw"]) * drag + abs(values["kick"]) * gained
        power = np.maximum(speeds[1:] * torque, 0.0).sum(axis=1) / propulsion.efficiency
        usual = power.mean() if self.voltage is None else self.slow(power, self.dt)
        lost = values["sag"] * battery.resistance / propulsion.supply_voltage**2 * (power - usual)
        return np.asarray(np.clip(1.0 - lost, 0.5, 1.5), np.float64)

    @staticmethod
    def slow(values: Array, step: float) -> Array:
        """Return the mean of values (N,) over SLOW_VOLTS_S around."""
        return np.asarray(uniform_filter1d(values, round(SLOW_VOLTS_S / step), mode="nearest"), np.float64)

    def over(self, course: Array) -> Array:
        """Return the means (K - 1, J) of a load (K, J) over the fine steps.

        The twin takes that of its step's end, half a step early, while the kick comes with the speeds.
        """
        lead = 0.5 * min(1.0, self.flight.twin_s / self.dt)
        return np.asarray((0.5 - lead) * course[:-1] + (0.5 + lead) * course[1:], np.float64)

    def told(self, speeds: Array, values: Mapping[str, float]) -> Array:
        """Return the speeds (N, M) [rad/s] that ESCs tell of these, at the log's rows."""
        late = values["told_late_s"] / self.dt  # beside the gyro, which may be the later of both
        moved = delayed(speeds, late) if late >= 0.0 else delayed(speeds[::-1], -late)[::-1]
        return moved[:: self.finer]

    def clean(self, residual: Array) -> None:
        """Take the residual (N, 3) of a fit out of the rates that brake and couple the turning."""
        self.rate = self.fine(self.piece.gyro - residual)


def delayed(values: Array, steps: float) -> Array:
    """Return rows `steps` earlier, between two rows their mean by the share; before the start the first."""
    steps = max(steps, 0.0)
    whole = int(steps)
    part = steps - whole
    padded = np.vstack([np.repeat(values[:1], whole + 1, axis=0), values])
    count = len(values)
    return (1.0 - part) * padded[1 : count + 1] + part * padded[:count]


@dataclass(frozen=True, eq=False)
class Loads:
    """Moments (K, 3) [N m] of one piece by their causes, and what turns rotors' acceleration into a kick."""

    each: Array  # (K, M, 3) of the motors' thrust and drag torque
    lift: Array  # (K,) [N] of all motors
    inflow: Array  # of a unit
    drag: Array  # of the start file's
    air: tuple[Array, Array]  # of air at 1 m/s along x and y
    momentum: Array  # (K, M) [N m s] of each rotor along z


def loads(model: PieceModel, speeds: Array, order: Array, spins: Array) -> Loads:
    """Compute the moments of rotors at `speeds` (K, M)."""
    propulsion = model.aircraft.propulsion
    places = model.aircraft.rotor_positions[order]
    thrust, torque = thrust_and_torque(np.ascontiguousarray(speeds), propulsion)
    rate, still = model.rate, np.zeros(len(speeds))
    inflow = np.zeros((len(speeds), 3))
    if propulsion.propeller_diameter is not None:
        # Thrust at advance ratio J: 1 - inflow J of it; J = 2 pi V / (w D), V the hub's speed along its axis.
        loss = thrust / np.maximum(speeds, 1.0) * (2 * np.pi / propulsion.propeller_diameter)
        lost = loss * (rate[:, :1] * places[:, 1] - rate[:, 1:2] * places[:, 0])
        inflow[:, 0], inflow[:, 1] = -lost @ places[:, 1], lost @ places[:, 0]
    turns = propulsion.drag_coefficient * speeds  # [N s/m] of each rotor's drag through the air
    x, y, z = turns @ places[:, 0], turns @ places[:, 1], turns @ places[:, 2]
    return Loads(
        each=np.stack([places[:, 1] * thrust, -places[:, 0] * thrust, -spins * torque], axis=2),
        lift=thrust.sum(axis=1),
        inflow=inflow,
        drag=_braking(speeds, rate, places, propulsion),
        air=(np.column_stack([still, -z, y]), np.column_stack([z, still, -x])),
        momentum=propulsion.rotor_inertia * speeds * spins,
    )


def _braking(speeds: Array, rate: Array, places: Array, propulsion: Propulsion) -> Array:
    """Return the moments (K, 3) of the rotors' drag and rolling moment, by the turning alone."""
    moment = np.zeros((len(speeds), 3))
    for speed, (x, y, z) in zip(speeds.T, places, strict=True):
        along = speed * (rate[:, 1] * z - rate[:, 2] * y), speed * (rate[:, 2] * x - rate[:, 0] * z)
        force = [-propulsion.drag_coefficient * each for each in along]
        moment[:, 0] += -z * force[1] - propulsion.rolling_coefficient * along[0]
        moment[:, 1] += z * force[0] - propulsion.rolling_coefficient * along[1]
        moment[:, 2] += x * force[1] - y * force[0]
    return moment


def strengths(values: Mapping[str, float], motors: int) -> Array:
    """Return the thrust of each motor (M,) over the mean, less 1: they sum up to 0."""
    own = [values[f"motor.{number + 1}"] for number in range(motors - 1)]
    return np.array([*own, -sum(own)])


def factors_of(values: Mapping[str, float]) -> Array:
    """Return the factors (3,) of moment over inertia."""
    return np.array([values[f"factor.{axis}"] for axis in AXES])


def _summed(moment: Array, model: PieceModel, inverse: Array) -> Array:
    """Return gains of rates (K - 1, 3) of a moment (K, 3) [N m]."""
    return np.asarray(model.dt * model.over(moment) @ inverse.T, np.float64)


def _turning(model: PieceModel, momentum: Array, values: Mapping[str, float]) -> Array:
    """Return the accelerations (K, 3) by the turning of the body and of its rotors' momentum (K,).

    The body's moments are as the fit writes them: roll's and pitch's over their factors, yaw's with both.
    """
    rate, moments = model.rate, np.diag(model.aircraft.mass_properties.inertia)
    safe = np.clip(np.abs(factors_of(values)[:2]), 0.05, 20.0)
    x, y = moments[:2] / safe
    more = (x + y) / (moments[0] + moments[1])
    z = moments[2] * more
    spin = momentum * values["kick"] * more
    return np.column_stack(
        [
            ((y - z) * rate[:, 2] - spin) * rate[:, 1] / x,
            ((z - x) * rate[:, 2] + spin) * rate[:, 0] / y,
            (x - y) / z * rate[:, 0] * rate[:, 1],
        ]
    )


def gains(model: PieceModel, load: Loads, values: Mapping[str, float]) -> Array:
    """Return the gains of rates (K - 1, 3) that the model says."""
    inverse = np.linalg.inv(model.aircraft.mass_properties.inertia)
    factors, strong = factors_of(values), strengths(values, load.each.shape[1])
    moment = np.einsum("kmj,m->kj", load.each, 1.0 + strong) + values["inflow"] * load.inflow
    moment[:, 0] -= values["centre.y"] * load.lift
    moment[:, 1] += values["centre.x"] * load.lift
    others = values["drag"] * load.drag + values["air.x"] * load.air[0] + values["air.y"] * load.air[1]
    momentum = load.momentum @ (1.0 + 0.5 * strong)
    acceleration = (moment @ inverse.T) * factors + others @ inverse.T + _turning(model, momentum, values)
    said = model.dt * model.over(acceleration)
    # A motor of more thrust turns faster by half of that: its momentum, too.
    said[:, 2] -= values["kick"] * np.diff(momentum) * inverse[2, 2]
    return np.asarray(said)


def columns(model: PieceModel, load: Loads, values: Mapping[str, float]) -> dict[str, Array]:
    """Return what a unit of each linear parameter adds to the gains, (K - 1, 3) each."""
    inverse = np.asarray(np.linalg.inv(model.aircraft.mass_properties.inertia), np.float64)
    motors = load.each.shape[1]
    factors, strong = factors_of(values), strengths(values, motors)

    def along_z(course: Array) -> Array:
        one = np.zeros((len(course), 3))
        one[:, 2] = course
        return one

    found: dict[str, Array] = {}
    moment = np.einsum("kmj,m->kj", load.each, 1.0 + strong) + values["inflow"] * load.inflow
    moment[:, 0] -= values["centre.y"] * load.lift
    moment[:, 1] += values["centre.x"] * load.lift
    total = _summed(moment, model, inverse)
    for axis, name in enumerate(AXES):
        one = np.zeros_like(total)
        one[:, axis] = total[:, axis]
        found[f"factor.{name}"] = one
    spun = -np.diff(load.momentum, axis=0) * inverse[2, 2]
    found["kick"] = along_z(spun @ (1.0 + 0.5 * strong))
    momentum = load.momentum @ (1.0 + 0.5 * strong)
    turning = _turning(model, momentum, values)
    for name in ("factor.roll", "factor.pitch", "kick"):
        other = _turning(model, momentum, {**values, name: values[name] + SLOPE})
        found[name] += model.dt * model.over((other - turning) / SLOPE)
    for number in range(motors - 1):
        own = _summed(load.each[:, number] - load.each[:, -1], model, inverse) * factors
        own[:, 2] += 0.5 * values["kick"] * (spun[:, number] - spun[:, -1])
        more = 0.5 * (load.momentum[:, number] - load.momentum[:, -1])
        own += model.dt * model.over(_turning(model, momentum + more, values) - turning)
        found[f"motor.{number + 1}"] = own
    lift = np.zeros((len(load.lift), 3))
    lift[:, 1] = load.lift
    found["centre.x"] = _summed(lift, model, inverse) * factors
    found["centre.y"] = _summed(-lift[:, [1, 0, 2]], model, inverse) * factors
    found["inflow"] = _summed(load.inflow, model, inverse) * factors
    found["drag"] = _summed(load.drag, model, inverse)
    found["air.x"], found["air.y"] = (_summed(one, model, inverse) for one in load.air)
    return found


def turned(rates: Array, values: Mapping[str, float]) -> Array:
    """Return rates (N, 3) as a gyro reads them that is turned by small angles about the axes."""
    return rates + np.cross(rates, np.array([values[f"turn.{axis}"] for axis in AXES]))
