"""The parameters that a fit reports: values, honest intervals, and what would tell the rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from operator import itemgetter

import numpy as np

from neuroflight.sim.aircraft.model import Aircraft
from neuroflight.sim.arrays import Array
from neuroflight.sim.identification.fit.estimate import Data, Estimate, Wiring
from neuroflight.sim.identification.fit.flight import Flight
from neuroflight.sim.identification.fit.model import Layout, Theta, shaped
from neuroflight.sim.identification.fit.result import Parameter
from neuroflight.sim.identification.fit.shaking import shaking
from neuroflight.sim.identification.fit.standing import standing
from neuroflight.sim.physics.rotor import target_speed, thrust_and_torque
from neuroflight.toolchain.contract import AXES

NORMAL = 1.96
SMALL = 1e-4
# What the equations leave out, as a standard deviation: relative of authority and times, [s] of the delay,
# [deg] of the chip's turns, which products of inertia resemble.
LEFT_OUT, LEFT_OUT_S, LEFT_OUT_DEG = 0.015, 1.2e-4, 0.1
# Half of a relative interval from which a log does not tell a parameter; a typical aircraft of the same
# weight, arm and propellers is off by 0.3 to 0.4 (six published builds: one standard deviation).
WIDE, WIDE_TIME, WIDE_KICK = 0.2, 0.34, 0.4
DELAY_WIDE_S, BEND_WIDE, SAG_WIDE = 1.5e-3, 0.2, 0.5
TURN_WIDE = 0.65  # [deg]: chips and boards are mounted straight to about a degree (from memory)
ROLLS = "three rolls each way, or quick stick taps of all axes in a hover"
PUNCH = "a punch-out: full throttle for a second, then none, three times"
YAW = "quick yaw taps to both sides in a hover"


def parameters(
    flights: Sequence[Flight],
    data: Sequence[Data],
    start: Aircraft,
    laid: Layout,
    found: Estimate,
    wiring: Wiring,
) -> dict[str, Parameter]:
    """Report every parameter of a fit, in the order that people read them."""
    motors = np.concatenate([one.model.piece.motors[one.used] for one in data])
    usual, voltage = flown_at(data)
    whence = f"{len(motors) * data[0].model.piece.step_s:.0f} s of motors and gyro"
    spoken = "eRPM" if any(flight.has_speed for flight in flights) else whence
    rows: list[Parameter] = []

    def spread(of: Callable[[Theta], float]) -> float:
        """Return the standard deviation of a function of the parameters, by its slope."""
        at = found.theta
        slope = np.zeros(len(at))
        middle = of(laid.values(at))
        for number in range(len(at)):
            if found.covariance[number, number] > 0.0:
                moved = at.copy()
                step = SMALL * max(1.0, abs(at[number])) if not laid.names[number].endswith("_s") else 1e-6
                moved[number] += step
                slope[number] = (of(laid.values(moved)) - middle) / step
        return float(np.sqrt(max(0.0, float(slope @ found.covariance @ slope))))

    def add(
        key: str,
        words: str,
        unit: str,
        of: Callable[[Theta], float],
        by: str,
        manoeuvre: str,
        *,
        relative: bool = False,
        more: float = 0.0,
        wide: float = WIDE,
    ) -> None:
        """Report one; relative: its logarithm has the interval; more: left out; wide: from where not told."""
        first, value = of(laid.values(laid.start)), of(laid.values(found.theta))
        if relative and value > 0.0:
            sigma = float(np.hypot(spread(lambda theta: float(np.log(max(of(theta), 1e-12)))), LEFT_OUT))
            low, high = value * np.exp(-NORMAL * sigma), value * np.exp(NORMAL * sigma)
            half = NORMAL * sigma
            # A start's number that is further off than either can be is none to stay with.
            told = half < wide or (first > 0.0 and abs(float(np.log(value / first))) > half + wide)
        else:
            sigma = float(np.hypot(spread(of), more))
            low, high = value - NORMAL * sigma, value + NORMAL * sigma
            told = NORMAL * sigma < wide
        rows.append(
            Parameter(key, words, unit, first, value, float(low), float(high), bool(told), by, manoeuvre)
        )

    def axis_authority(axis: int, theta: Theta) -> float:
        return float(authority(start, theta, wiring, usual, voltage)[axis])

    for axis, name in enumerate(AXES):
        add(
            f"authority.{name}",
            f"{name} authority at the flown throttle",
            "rad/s²",
            partial(axis_authority, axis),
            whence,
            YAW if name == "yaw" else ROLLS,
            relative=True,
        )
    for name in AXES:
        add(
            f"factor.{name}",
            f"{name} moment over inertia, of the start's",
            "",
            itemgetter(f"factor.{name}"),
            whence,
            YAW if name == "yaw" else ROLLS,
            relative=True,
        )
    if "log_up" in laid.names:
        for side, word in (("up", "faster"), ("down", "slower")):
            add(
                f"response.{side}_s",
                f"rotors' response, turning {word}",
                "s",
                partial(_time, side),
                spoken,
                ROLLS,
                relative=True,
                wide=WIDE_TIME,
            )
    else:
        for name, words, unit in (
            ("gain", "rotors' gain over inertia", "1/s"),
            ("torque_up", "most acceleration of a rotor", "rad/s²"),
            ("torque_down", "most braking of a rotor", "rad/s²"),
        ):
            add(
                f"response.{name}",
                words,
                unit,
                partial(_exponential, f"log_{name}"),
                spoken,
                ROLLS if name == "gain" else PUNCH,
                relative=True,
                wide=WIDE_TIME,
            )
    steps = max(flight.control_s for flight in flights)
    add(
        "delay_s",
        "delay from command to rotor",
        "s",
        lambda t: t["delay_s"],
        f"{whence}; gyro: {'; '.join(dict.fromkeys(flight.path.words for flight in flights))}",
        "log the unfiltered gyro (gyroUnfilt), and quick taps",
        wide=DELAY_WIDE_S,
        more=float(np.hypot(LEFT_OUT_S, 0.15 * steps)),
    )
    add(
        "curve",
        "bend of the speed over the motor value",
        "",
        lambda t: t["bend"],
        spoken,
        PUNCH,
        wide=BEND_WIDE,
        more=0.01,
    )
    if "sag" in laid.names:
        add(
            "sag",
            "sag of the battery under load, of the start's",
            "",
            itemgetter("sag"),
            whence,
            f"log the voltage (vbat), and {PUNCH}",
            wide=SAG_WIDE,
        )
    if "log_top" in laid.names:
        add(
            "speed_max",
            "rotor speed at full command",
            "rad/s",
            lambda t: float(np.exp(t["log_top"])),
            "eRPM",
            PUNCH,
            relative=True,
        )
    add(
        "kick",
        "rotor inertia over the yaw inertia, of the start's",
        "",
        lambda t: t["kick"],
        whence,
        YAW,
        relative=True,
        wide=WIDE_KICK,
    )
    add(
        "inflow",
        "loss of thrust over the advance ratio",
        "",
        lambda t: t["inflow"],
        whence,
        "rolls and flips",
        wide=0.3,
    )
    add(
        "drag",
        "yaw damping, of the start's",
        "",
        lambda t: t["drag"],
        whence,
        "a fast pirouette each way",
        wide=1.0,
    )
    count = start.motor_count
    for number in range(count):
        name = f"motor.{number + 1}"

        def strength(theta: Theta, name: str = name) -> float:
            own = [theta[f"motor.{other + 1}"] for other in range(count - 1)]
            return 1.0 + (theta[name] if name in theta else -sum(own))

        add(
            name,
            f"thrust of motor {number + 1} over the mean",
            "",
            strength,
            whence,
            ROLLS,
            wide=0.1,
            more=0.01,
        )
    for name in AXES:
        add(
            f"gyro.turn.{name}",
            f"turn of the gyro's chip about {name}",
            "deg",
            partial(_degrees, f"turn.{name}"),
            whence,
            ROLLS,
            more=LEFT_OUT_DEG,
            wide=TURN_WIDE,
        )
    rows += standing(data, laid, found, wiring)
    raw = all(abs(abs(flight.path.response(np.array([200.0]))[0]) - 1.0) < 0.05 for flight in flights)
    shaken = np.rad2deg([start.gyro.noise, start.gyro.vibration])
    rows += shaking(data, laid.values(found.theta), flights[0].rate_hz, shaken, raw)
    rows += _facts(flights, motors)
    return {one.key: one for one in rows}


def _exponential(name: str, theta: Theta) -> float:
    return float(np.exp(theta[name]))


def _degrees(name: str, theta: Theta) -> float:
    return float(np.rad2deg(theta[name]))


def _time(side: str, theta: Theta) -> float:
    return float(np.exp(theta["log_up"] + (theta["log_ratio"] if side == "down" else 0.0)))


def authority(
    start: Aircraft, theta: Mapping[str, float], wiring: Wiring, motors: Array, voltage: float | None
) -> Array:
    """Return the angular acceleration (3,) [rad/s^2] a unit of motor differences at motor values (M,).

    All motors that turn an axis one way get more by the unit, the others less, at the speed they settle at.
    """
    propulsion = shaped(start.propulsion, theta)
    volts = voltage if propulsion.supply_voltage is not None else None
    step = 1e-4
    loads = [
        thrust_and_torque(
            target_speed(np.clip(motors + side * step, 0.0, 1.0), propulsion, volts), propulsion
        )
        for side in (-1, 1)
    ]
    thrust, torque = ((loads[1][kind] - loads[0][kind]) / (2 * step) for kind in (0, 1))
    places = start.rotor_positions[list(wiring.order)]
    inverse = np.diag(np.linalg.inv(start.mass_properties.inertia))
    made = np.array(
        [
            np.abs(places[:, 1]) @ thrust,
            np.abs(places[:, 0]) @ thrust,
            np.abs(np.array(wiring.spins)) @ torque,
        ]
    )
    return np.asarray(made * inverse * np.array([abs(theta[f"factor.{axis}"]) for axis in AXES]))


def faster_by(start: Aircraft, theta: Mapping[str, float], motors: Array, voltage: float | None) -> float:
    """Return by how much [rad/s] all rotors turn faster a unit of motor values, at motor values (M,)."""
    propulsion = shaped(start.propulsion, theta)
    volts = voltage if propulsion.supply_voltage is not None else None
    step = 1e-4
    less, more = (
        target_speed(np.clip(motors + side * step, 0.0, 1.0), propulsion, volts) for side in (-1, 1)
    )
    return float((more - less).sum() / (2 * step))


def flown_at(data: Sequence[Data]) -> tuple[Array, float | None]:
    """Return the usual motor values (M,) of flights and their mean voltage; None: it was not logged."""
    motors = np.concatenate([one.model.piece.motors[one.used] for one in data])
    volts = [one.model.piece.voltage[one.used] for one in data if one.model.piece.voltage is not None]
    return np.median(motors, axis=0), float(np.mean(np.concatenate(volts))) if volts else None


def _facts(flights: Sequence[Flight], motors: Array) -> list[Parameter]:
    """Report idle and saturation."""
    rows = []
    idle = next((flight.idle for flight in flights if flight.idle is not None), None)
    least = float(np.quantile(motors, 0.001)) if idle is None else idle
    rows.append(
        Parameter(
            "idle",
            "idle of the motors",
            "",
            least,
            least,
            least,
            least,
            True,
            "header" if idle is not None else "least motor value",
        )
    )
    full = float((motors >= 0.995).any(axis=1).mean())
    rows.append(
        Parameter(
            "saturated", "share of the time that a motor is full", "", 0.0, full, full, full, True, "motors"
        )
    )
    return rows
