"""Logs of hidden twins: a pilot (hidden_pilot.py) flies them freely in wind, gusts and their own wash.

Betaflight's SITL writes its own blackbox, without volts and rotor speeds, at 2000 to 250 rows a second. Our
firmware flies the policy for any aircraft, as its pilot has it before there is a file of his own, and logs
volts; the rotors' speeds where ESCs tell them. Beside each log stands what the pilot knows, and what is true.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from neuroflight.cli.fly.blackbox import END
from neuroflight.sim.aircraft.model import parse_aircraft
from neuroflight.sim.aircraft.typical import Answers, Propeller, typical
from neuroflight.sim.control.any_policy import ANY, own_policy
from neuroflight.sim.flight.loop import fly
from neuroflight.sim.flight.scenario import Scenario, Segment
from neuroflight.sim.flight.trace import Trace
from neuroflight.sim.physics.twin import Twin
from neuroflight.sim.physics.world import Mount
from neuroflight.sim.ports.betaflight.build import Betaflight, build_betaflight
from neuroflight.sim.ports.betaflight.port import BetaflightPort, aircraft_settings
from neuroflight.sim.ports.betaflight.process import STEP_NS
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import FirmwarePort
from neuroflight.toolchain.files import write_bytes, write_text
from tests.conftest import ROOT, build_kept
from tests.sim.identification.hidden_pilot import STYLES, PilotedPort
from tests.sim.identification.hidden_twins import CLASSES, Hidden, hover, loop_parameters

IDLE = 0.055  # of Betaflight's motors
AFTER = 1000  # steps of Betaflight's time in which it ends its log
ROWS = (  # of its log: 2000, 1000, 500, 250 a second
    ("set blackbox_sample_rate = 1/4",),
    ("set blackbox_sample_rate = 1/8",),
    ("set blackbox_sample_rate = 1/16",),
    ("set pid_process_denom = 2", "set blackbox_sample_rate = 1/16"),
)
BETAFLIGHT = ROOT / "build" / "tests" / "BETAFLIGHT"
BETAFLIGHT_GYRO_HZ, OWN_GYRO_HZ = 2000, 4000
BY = {"betaflight": ".bbl", "own": ".bfl", "rotors": ".bfl"}  # who flies; ours without and with rotor speeds


@dataclass(frozen=True, eq=False)
class Flight:
    """A flight of a hidden aircraft."""

    trace: Trace
    volts: float  # its battery's mean under load
    fell: tuple[float, float]  # from, to [V]
    delay_s: float  # in whole samples of its gyro


def betaflight_log(
    hidden: Hidden,
    style: str,
    length_s: float,
    seed: int,
    settings: Sequence[str] = (),
    gyro_rate_hz: int = BETAFLIGHT_GYRO_HZ,
) -> tuple[bytes, Flight]:
    """Fly it with Betaflight's SITL; returns the log that Betaflight wrote, and what was true."""
    chosen = (*aircraft_settings(hidden.aircraft), "set blackbox_device = VIRTUAL", *settings)
    port = BetaflightPort(sitl(), gyro_rate_hz, chosen)
    with contextlib.closing(port):
        flight = flown(hidden, port, style, length_s, seed)
        for _ in range(AFTER):
            port.process.run(STEP_NS)
        (log,) = port.process._folder.glob("LOG*")
        return log.read_bytes(), flight


def own_log(
    hidden: Hidden, style: str, length_s: float, seed: int, *, rotors: bool, every: int = 1
) -> tuple[bytes, Flight]:
    """Fly it with this firmware and the policy for any aircraft; returns its log, with speeds (`rotors`).

    every: control steps for a row, of 1000 a second.
    """
    policy = own_policy(ANY, parse_aircraft(typical_text(hidden).encode(), hidden.name))
    folder = build_kept("HOST", policy, f"hidden-{hidden.name}")
    settings = {"motor_telemetry": int(rotors), "blackbox_divider": every}
    port = ReferencePort(folder / "libneuroflight.so", OWN_GYRO_HZ, settings)
    heard = bytearray()

    def logged() -> bool:
        heard.extend(port.reference.blackbox())
        return heard.endswith(END)

    with contextlib.closing(port):
        flight = flown(hidden, port, style, length_s, seed, logged)
        return bytes(heard), flight


def typical_text(hidden: Hidden) -> str:
    """Return what `aircraft new` writes from what its pilot knows."""
    answers = Answers(
        weight_kg=hidden.told_weight,
        arm_m=hidden.told_arm,
        propeller=Propeller.parse(hidden.told_propeller),
        name=hidden.name,
    )
    return typical(answers).text


def sitl() -> Betaflight:
    """Betaflight's SITL, fetched and built the first time."""
    return build_betaflight(BETAFLIGHT, print)


def flown(
    hidden: Hidden,
    port: FirmwarePort,
    style: str,
    length_s: float,
    seed: int,
    logged: Callable[[], bool] | None = None,
) -> Flight:
    """Fly the aircraft freely in its air, its motors and battery as drawn."""
    aircraft = hidden.aircraft
    moves = STYLES[style](np.random.default_rng((seed, 7)), length_s)
    piloted = PilotedPort(port, moves, (hover(aircraft) - IDLE) / (1 - IDLE))
    twin = Twin(
        aircraft,
        rate_hz=port.gyro_rate_hz,
        mount=Mount.FREE,
        charge=hidden.charge,
        wind=hidden.wind,
        gust=hidden.gust,
        rng=np.random.default_rng((seed, 1)),
    )
    with contextlib.closing(twin):
        twin.weaken(np.array(hidden.shares))
        volts: list[float] = []
        scenario = Scenario(style, (Segment(length_s),), Mount.FREE)
        watch = lambda: volts.append(float(twin.pack_voltage[0]))  # noqa: E731
        trace = fly(twin, piloted, scenario, watch=watch, logged=logged)
        late = max(1, round(aircraft.propulsion.delay * twin.rate_hz)) / twin.rate_hz
        return Flight(trace, float(np.mean(volts)), (volts[0], volts[-1]), late)


def write(hidden: Hidden, log: Path, by: str, style: str, length_s: float, seed: int) -> None:
    """Write a log of `by` (BY), what its pilot knows and what is true (.json), and the true file.

    The log is the last of them: where it is, all are.
    """
    if by == "betaflight":
        number = next(number for number, kind in enumerate(CLASSES) if kind.name == hidden.name)
        data, flight = betaflight_log(hidden, style, length_s, seed, ROWS[(number + seed) % len(ROWS)])
    else:
        data, flight = own_log(hidden, style, length_s, seed, rotors=by == "rotors")
    at = float(np.median(flight.trace.motors))
    known = {key: value for key, value in asdict(hidden).items() if key != "text"}
    true = loop_parameters(hidden.aircraft, at, flight.volts, hidden.shares) | {"delay_s": flight.delay_s}
    error = np.rad2deg(np.abs(flight.trace.rate - flight.trace.setpoint).mean(axis=0))
    facts = {"by": by, "at": at, "volts": flight.volts, "fell": flight.fell, "true": true}
    facts |= {"style": style, "seed": seed, "seconds": float(flight.trace.t[-1]), "mae": error.tolist()}
    write_text(log.with_name(f"{hidden.name}.true.toml"), hidden.text)
    write_text(log.with_suffix(".json"), json.dumps(known | facts, indent=1))
    write_bytes(log, data)
