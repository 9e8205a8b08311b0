"""`neuroflight fly`: the firmware and a PID fly the same scenario in the same twin, side by side."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from typing import TYPE_CHECKING

from neuroflight.cli.fly.blackbox import check_blackbox
from neuroflight.cli.fly.emulator import check_emulator, emulator_words, exit_code, keep, say
from neuroflight.cli.fly.options import COUNT, COUNTED, FlyOptions
from neuroflight.cli.fly.output import Flown, conditions, document, print_flight, print_several, sentence
from neuroflight.cli.fly.ports import (
    Entry,
    built_betaflight,
    built_firmware,
    foreign_note,
    open_firmware,
    open_pid,
)
from neuroflight.cli.fly.telemetry import asks_telemetry, save_telemetry
from neuroflight.cli.fly.thrust import Thrust, chosen_thrust
from neuroflight.cli.log.reading import header_lines
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json
from neuroflight.toolchain.errors import NeuroflightError
from neuroflight.toolchain.workers import Crew, Show, usable_cores

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.flight.scenario import Scenario
    from neuroflight.sim.flight.trace import Trace

DEFAULT_AIRCRAFT = "nf1"
# Options that belong to one flight.
OUTPUTS = ("trace", "plot", "telemetry", "telemetry_plot", "report", "blackbox")
SINGLE = (*OUTPUTS, "profile", "gdb", "serial", "fault", "card")


class Fly(FlyOptions):
    """A request for a flight, or several."""

    def run(self) -> int:
        """Fly, write the outputs, print the figures. Returns 0, or STOPPED."""
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.analysis.flight_report import save_plot, save_report
        from neuroflight.sim.flight.trace import save_trace

        _check(self)
        firmware = built_firmware(self)
        known = None if firmware is None else firmware.aircraft
        aircraft = load_aircraft(self.aircraft or (DEFAULT_AIRCRAFT if known is None else known.file))
        if (note := foreign_note(self, firmware, aircraft)) is not None:
            say(note)
        thrust = chosen_thrust(self, aircraft, firmware)
        scenarios = _scenarios(self, thrust)
        if self.on == "betaflight":
            built_betaflight(aircraft, self.build, quiet=self.json)
        if len(scenarios) > 1:
            return _run_several(self, aircraft, scenarios, thrust)
        (scenario,) = scenarios
        flown = _fly_all(self, aircraft, scenario)
        flights = [one.flight for one in flown]
        title = f"{aircraft.name}: {scenario.name}, seed {self.seed}"
        note = ", ".join(conditions(self, scenario, thrust, flown[0].refused))
        verdict = sentence(scenario, thrust, flown)
        try:
            if self.trace:
                save_trace(self.trace, flights[0].trace)
            if self.plot:
                save_plot(self.plot, flights, title)
            save_telemetry(self, flown[0].esc, flights[0].trace.control_rate_hz, title)
            if self.report:
                words = f"{note}{emulator_words(flown[0].report)}. {verdict}"
                save_report(self.report, flights, title, words)
        finally:  # print the figures even if an output file cannot be written
            if self.json:
                print_json(document(self, aircraft, scenario, thrust, flown))
            else:
                print_flight(title, note, flown, verdict, every=self.all)
        return exit_code(self, flown[0].report)


def _check(args: FlyOptions) -> None:
    """Check scenarios and output files before anything is loaded."""
    check_emulator(args)
    check_blackbox(args)
    if args.on == "betaflight":
        args.refuse("set", because="Betaflight has settings of its own; leave it out")
        args.refuse("receiver", because="Betaflight takes the sticks from the simulator; leave it out")
        args.refuse("controller", because="Betaflight flies its own PID; leave it out")
    if len(args.scenario) > 1:
        args.refuse(*SINGLE, because="belongs to one flight; give one scenario")


def _scenarios(args: FlyOptions, thrust: Thrust) -> list[Scenario]:
    """Return the scenarios, in the order of flight."""
    from neuroflight.sim.physics.world import Mount
    from neuroflight.sim.recorded.files import load_flight

    if args.count is not None and not set(args.scenario) & set(COUNTED):
        say(f"--count: of {' and '.join(COUNTED)} alone; {', '.join(args.scenario)} has its own commands")
    count = COUNT if args.count is None else args.count
    mount = None if args.mount is None else Mount(args.mount)
    throttle = thrust.value or 0.0
    taken, told = args.part, header_lines(args)
    scenarios = []
    for name in args.scenario:
        scenario, warnings = load_flight(
            name, args.seed, count, mount, taken, told, cut=args.cut_rates, throttle=throttle
        )
        scenarios.append(scenario)
        for words in warnings:
            say(words)
    if args.controller == "pid":
        scenarios = [scenario.under_pid() for scenario in scenarios]
    for scenario in scenarios:
        if scenario.by_eye and not args.ground:
            raise NeuroflightError(f"scenario {scenario.name}: takes off and lands; add --ground")
        if args.ground and scenario.mount is not Mount.FREE:
            raise NeuroflightError(
                f"--ground: the aircraft hangs in mount {scenario.mount.value}, expected free; "
                f"add --mount free"
            )
    return scenarios


def _run_several(args: FlyOptions, aircraft: Aircraft, scenarios: list[Scenario], thrust: Thrust) -> int:
    """Fly each scenario with the firmware, and print one table."""
    tasks = [_task(args, aircraft, scenario) for scenario in scenarios]
    names = [scenario.name for scenario in scenarios]
    flown = []
    if (jobs := _jobs(args)) == 1:
        for name, task in zip(names, tasks, strict=True):
            with progress_bars(args.json) as show:
                flown.append(task(show(name)))
    else:
        import neuroflight.sim.physics.twin  # noqa: F401 - once, before the processes are forked

        with Crew(tasks, jobs) as crew, progress_bars(args.json) as show:
            flown = crew.results([show(name) for name in names])
    if args.json:
        documents = [
            document(args, aircraft, scenario, thrust, [one])
            for scenario, one in zip(scenarios, flown, strict=True)
        ]
        print_json(documents)
    else:
        print_several(f"{aircraft.name}, seed {args.seed}", args, scenarios, thrust, flown)
    return 0


def _task(args: FlyOptions, aircraft: Aircraft, scenario: Scenario) -> Callable[[Show], Flown]:
    """Return a function that flies `scenario` with the firmware from its boot on."""
    return lambda show: _fly(args, aircraft, scenario, open_firmware(args, aircraft), show)


def _jobs(args: FlyOptions) -> int:
    """Return the number of flights at a time; one where a debugger, serial line or profile is on."""
    if args.given("gdb", "serial", "profile"):
        return 1
    return usable_cores() if args.jobs is None else args.jobs


def _fly_all(args: FlyOptions, aircraft: Aircraft, scenario: Scenario) -> list[Flown]:
    """Fly the firmware, and beside it the PID if the aircraft has gains for one."""
    import neuroflight.sim.physics.twin  # noqa: F401 - once, before a process is forked

    firmware = open_firmware(args, aircraft)
    with closing(firmware):
        rate_hz = firmware.port.control_rate_hz

        def beside(show: Show) -> Flown:
            return _fly(args, aircraft, scenario, open_pid(args, aircraft, rate_hz), show)

        if not aircraft.pids or _jobs(args) == 1:
            with progress_bars(args.json) as show:
                flown = [_fly(args, aircraft, scenario, firmware, show(firmware.name))]
                return [*flown, beside(show("PID"))] if aircraft.pids else flown
        with Crew([beside], 1) as crew, progress_bars(args.json) as show:
            here, there = show(firmware.name), show("PID")

            def both(part: float) -> None:
                here(part)
                for other in crew.poll().values():
                    there(other)

            return [_fly(args, aircraft, scenario, firmware, both), *crew.results([there])]


def _fly(args: FlyOptions, aircraft: Aircraft, scenario: Scenario, entry: Entry, progress: Show) -> Flown:
    """Fly once in a fresh twin of the seed, and close the port."""
    import numpy as np

    from neuroflight.sim.analysis.flight_report import Flight
    from neuroflight.sim.analysis.holding import holding
    from neuroflight.sim.analysis.metrics import figures
    from neuroflight.sim.analysis.stick_flight import stick_figures
    from neuroflight.sim.flight.esc_record import EscRecord
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.flight.motion import Motion
    from neuroflight.sim.flight.trace import save_trace
    from neuroflight.sim.physics.twin import Twin

    rng = np.random.default_rng((args.seed, 1))  # another stream than the scenario's commands

    def broken_off(trace: Trace) -> None:
        """Write the trace up to an error, if it was asked for."""
        if (path := args.trace) is None or not entry.kept:
            return

        def write() -> None:
            save_trace(path, trace)
            length = len(trace.t) / entry.port.control_rate_hz
            say(f"{path}: {length:.3f} of {scenario.duration_s:g} s, up to the error")

        keep("trace", write)

    north, west, up = args.wind
    with closing(entry):
        twin = Twin(
            aircraft,
            rate_hz=args.gyro_hz,
            mount=scenario.mount,
            charge=args.battery,
            wind=(north, west, up),
            gust=args.gust,
            ground=args.ground,
            rng=rng,
        )
        with closing(twin):
            try:
                motion, esc = Motion(twin), EscRecord(twin)
                watched = [motion] * scenario.by_eye + [esc] * asks_telemetry(args)

                def watch() -> None:
                    for one in watched:
                        one()

                trace = fly(
                    twin,
                    entry.port,
                    scenario,
                    progress=progress,
                    broken_off=broken_off,
                    logged=None if entry.log is None else entry.log.watch,
                    watch=watch,
                )
            except BaseException:  # an interruption by the user as well
                entry.on_error()
                if entry.log is not None:
                    keep("log", entry.log.rescue)
                raise
        log = None if entry.log is None else entry.log.report()
        report = None if entry.report is None else entry.report(scenario.duration_s)
        refused = None if entry.refused is None else entry.refused()
    progress(1.0)
    hover = round(scenario.hover_s * entry.port.control_rate_hz)
    before, held = len(trace.t) - hover, None
    if hover:
        count, step_s = scenario.episodes(), 1.0 / entry.port.control_rate_hz
        held = holding(trace.setpoint[None], trace.rate[None], step_s, count, before)
    name = entry.flies(scenario)
    flight = Flight(
        f"{name}, then PID" if refused else name,
        trace,
        figures(trace.first(before), scenario.episodes(), entry.idle, entry.mix),
        held,
        hover,
    )
    by_eye = stick_figures(scenario, motion, entry.port.control_rate_hz) if scenario.by_eye else None
    topics = esc.topics if asks_telemetry(args) else None
    return Flown(flight, report, log, by_eye, topics, refused.name if refused else None)
