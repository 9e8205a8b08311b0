"""`neuroflight fly`: the firmware and the controllers that it is compared with, each freshly booted."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.board.built import built_last
from neuroflight.cli.fly.blackbox import FlightLog, emulated_settings
from neuroflight.cli.fly.emulator import keep_profile, open_image, save_profile
from neuroflight.cli.fly.options import RECEIVERS
from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.cli.fly.options import FlyOptions
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.flight.scenario import Scenario
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.sim.ports.emulator_report import EmulatedReport
    from neuroflight.sim.ports.port import FirmwarePort
    from neuroflight.toolchain.contract import FallbackCause, Mix
    from neuroflight.toolchain.image.report import Built

BUILD = Path(__file__).resolve().parents[2] / "build" / "HOST"
BY_OPTION = {"gyro_rate_hz": "--gyro-hz", "receiver_protocol": "--receiver"}  # settings that have one
BETAFLIGHT = BUILD.with_name("BETAFLIGHT")


@dataclass(frozen=True)
class Entry:
    """A firmware or controller behind its port, freshly booted."""

    name: str  # of its policy, or of the only controller that it has
    port: FirmwarePort
    idle: float  # motor fraction of its armed motors at zero thrust
    mix: Mix | None  # of its outputs and the throttle; None: by another rule than ours
    report: Callable[[float], EmulatedReport] | None = None  # of the flight of so many seconds that is over
    on_error: Callable[[], None] = lambda: None  # before it is closed after a flight that ended in an error
    kept: bool = True  # its trace is what --trace asks for
    ends: ExitStack = field(default_factory=ExitStack)  # what is attached to its port
    log: FlightLog | None = None  # of its flight, which is kept
    refused: Callable[[], FallbackCause] | None = None  # why its policy was; None: it has none
    pid: str | None = None  # of the PID that its switch chooses; None: it has no switch

    def flies(self, scenario: Scenario) -> str:
        """Return the name of the controller that the pilot's switch chooses in this flight."""
        by_pid = [segment.pid for segment in scenario.segments]
        if self.pid is None or not any(by_pid):
            return self.name
        return self.pid if all(by_pid) else f"{self.name} and PID"

    def close(self) -> None:
        """Close the port."""
        self.ends.close()
        self.port.close()
        if self.log is not None:
            self.log.close()


def _product(args: FlyOptions) -> Path:
    """Return the file of the build that is flown."""
    if args.on == "board":
        return Path(args.build or built_last()) / "neuroflight.bin"
    return Path(args.build or BUILD) / ("neuroflight" if args.on == "host" else "libneuroflight.so")


def built_firmware(args: FlyOptions) -> Built | None:
    """Return the report of the build of the firmware that is to fly; None: not known, or Betaflight."""
    from neuroflight.toolchain.errors import BuildError
    from neuroflight.toolchain.image.report import built

    if args.on == "betaflight":
        return None
    try:
        return built(_product(args))
    except BuildError:
        return None  # opening the build raises the error


def foreign_note(args: FlyOptions, firmware: Built | None, aircraft: Aircraft) -> str | None:
    """Return a line where the firmware's controller is for another aircraft than the one that is flown."""
    from neuroflight.sim.aircraft.identity import other_aircraft_note

    if firmware is None:
        return None
    if args.controller == "policy":
        what, name, sha256 = "the policy", firmware.trained_on, firmware.trained_on_sha256
    elif firmware.aircraft is not None:
        what, name, sha256 = "the PID", firmware.aircraft.name, firmware.aircraft.sha256
    else:
        return None
    return other_aircraft_note(what, name, sha256, aircraft)


def open_firmware(args: FlyOptions, aircraft: Aircraft) -> Entry:
    """Boot the firmware that `--on` names."""
    log = FlightLog(args.blackbox) if args.blackbox is not None or args.card is not None else None
    try:
        return _open_firmware(args, aircraft, log)
    except BaseException:
        if log is not None:
            log.close()
        raise


def _open_firmware(args: FlyOptions, aircraft: Aircraft, log: FlightLog | None) -> Entry:
    from neuroflight.flash.settings.values import check_known, parse_change
    from neuroflight.sim.ports.host import HostPort
    from neuroflight.sim.ports.library import ReferencePort
    from neuroflight.sim.ports.port import flight_settings, twin_settings
    from neuroflight.toolchain.image.report import built_motors, needed_settings

    if args.on == "betaflight":
        return _open_betaflight(args, aircraft)
    product = _product(args)
    settings = {**twin_settings(aircraft), **needed_settings(product), "ground_detection": int(args.ground)}
    settings |= dict(parse_change(text) for text in args.set)
    for name, option in BY_OPTION.items():
        if name in settings:
            raise NeuroflightError(f"--set {name}: has an option of its own; use {option}")
    if args.receiver != RECEIVERS[0]:
        settings["receiver_protocol"] = RECEIVERS.index(args.receiver)
    settings = {name: int(value) if value == int(value) else value for name, value in settings.items()}
    check_known(flight_settings(settings))
    if args.on == "board":
        return _open_emulator(args, {**settings, **emulated_settings(args)}, log)
    port: HostPort | ReferencePort
    if args.on == "host":
        port = HostPort(product, args.gyro_hz, settings, None if log is None else log.aside)
    else:
        port = ReferencePort(product, args.gyro_hz, settings)
    if log is not None:
        log.told = port.logged
        if isinstance(port, ReferencePort):
            log.source = port.reference.blackbox
    try:
        policy, pid = _names(product)
        motors = built_motors(product, pid=args.controller == "pid")
        return Entry(policy, port, motors.idle, motors.mix, log=log, refused=port.refused, pid=pid)
    except NeuroflightError:
        port.close()
        raise


def _names(product: Path) -> tuple[str, str]:
    """Return the names of the policy and of the PID in `product`, a file of a build."""
    from neuroflight.toolchain.image.report import built
    from neuroflight.toolchain.policy.label import policy_label

    found = built(product)
    return policy_label(found.policy_file), f"firmware's PID {found.pid}"


def open_pid(args: FlyOptions, aircraft: Aircraft, control_rate_hz: int) -> Entry:
    """Return the aircraft's PID in the firmware's control path."""
    from neuroflight.sim.control.pid import aircraft_pid
    from neuroflight.sim.control.pid_table import pid_settings
    from neuroflight.sim.ports.python_controller import ControllerPort

    settings = pid_settings(aircraft)
    port = ControllerPort(
        aircraft_pid(aircraft, 1, control_rate_hz),
        aircraft.motor_count,
        args.gyro_hz,
        control_rate_hz,
        settings.idle,
        mix=settings.mix,
        gyro_filters=settings.gyro_filters,
    )
    name = f"PID {next(iter(dict(aircraft.pids)))}"
    return Entry(name, port, settings.idle, settings.mix, kept=False)


def _open_emulator(args: FlyOptions, settings: dict[str, float], log: FlightLog | None) -> Entry:
    """Return the image on a board of its own."""
    from neuroflight.sim.ports.emulator_report import emulated_report
    from neuroflight.toolchain.image.report import built_motors

    image = _product(args)
    with ExitStack() as undo:
        began = time.perf_counter()
        ends = undo.enter_context(ExitStack())
        port = open_image(args, image, settings, ends, log)
        undo.callback(port.close)

        def report(flight_s: float) -> EmulatedReport:
            told = emulated_report(port, image, flight_s, time.perf_counter() - began)
            if args.profile is not None:
                save_profile(args.profile, port.board)
            return told

        policy, pid = _names(image)
        motors = built_motors(image, pid=args.controller == "pid")
        undo.pop_all()
        if log is not None:
            log.told = port.logged
        told = partial(keep_profile, args, port.board)
        return Entry(
            policy,
            port,
            motors.idle,
            motors.mix,
            report=report,
            on_error=told,
            ends=ends,
            log=log,
            refused=port.refused,
            pid=pid,
        )


def built_betaflight(aircraft: Aircraft, folder: Path | None, *, quiet: bool) -> Betaflight:
    """Return Betaflight, built unless it is there; each stage of the build is printed to stderr.

    Raises AircraftError if Betaflight cannot fly the aircraft.
    """
    from rich.console import Console

    from neuroflight.sim.ports.betaflight.build import build_betaflight
    from neuroflight.sim.ports.betaflight.port import aircraft_settings

    aircraft_settings(aircraft)
    console = Console(stderr=True)
    with nullcontext() if quiet or not sys.stderr.isatty() else console.status("Betaflight") as status:

        def say(stage: str) -> None:
            console.print(f"Betaflight is not built yet, once: {stage}", highlight=False)
            if status is not None:
                status.update(stage)

        return build_betaflight(folder or BETAFLIGHT, say)


def _open_betaflight(args: FlyOptions, aircraft: Aircraft) -> Entry:
    """Start Betaflight, which is built."""
    from neuroflight.sim.ports.betaflight.build import build_betaflight
    from neuroflight.sim.ports.betaflight.port import IDLE, BetaflightPort, aircraft_settings

    settings = aircraft_settings(aircraft)
    betaflight = build_betaflight(args.build or BETAFLIGHT, lambda _: None)
    port = BetaflightPort(betaflight, args.gyro_hz, settings, motor_count=aircraft.motor_count)
    return Entry("Betaflight 4.6", port, IDLE, mix=None)
