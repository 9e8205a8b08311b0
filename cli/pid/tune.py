"""neuroflight pid tune: PID gains for an aircraft, by Ziegler and Nichols' rules, then by CMA-ES.

Or, with `--of betaflight`, settings of Betaflight by the same search, or with `--of FILE.py:CLASS` the
parameters of a user's own controller.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.pid.betaflight import tune_betaflight_of
from neuroflight.cli.pid.options import BETAFLIGHT, DISSERTATION, FLYING, PID, SUBJECTS, TuneOptions
from neuroflight.cli.pid.report import comment, document, print_tables
from neuroflight.cli.pid.search import (
    by_thrust,
    check_thrusts_only,
    chosen_tuner,
    final_flights,
    search_bar,
    tell_interruption,
)
from neuroflight.cli.pid.users import tune_users_of
from neuroflight.cli.progress import Update, progress_bars
from neuroflight.cli.report import print_json
from neuroflight.toolchain.errors import TrainingError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from neuroflight.sim.aircraft.model import Aircraft, PidSettings
    from neuroflight.training.evaluation.evaluation import Evaluation, Flights
    from neuroflight.training.pid_tuning.trial import Limits
    from neuroflight.training.pid_tuning.tuning import PidTuning
    from neuroflight.training.tasks.task import Task


class Tune(TuneOptions):
    """A request for the gains of a PID, or the settings of another controller."""

    def run(self) -> int:
        """Tune, fly unseen commands, write and print the results. Returns 0; 1 if a limit is exceeded."""
        _check(self)

        from neuroflight.sim.aircraft.model import FOLDER, load_aircraft, shipped
        from neuroflight.sim.aircraft.pid_write import write_pid
        from neuroflight.sim.plotting import save_png
        from neuroflight.training.pid_tuning.tuning_plot import draw_tuning

        aircraft = load_aircraft(self.aircraft)
        if self.of == BETAFLIGHT:
            return tune_betaflight_of(self, aircraft)
        if self.of != PID:
            return tune_users_of(self, aircraft)
        if any(aircraft.gyro.vibration):
            print("gains are sought without the rotors' shaking of the gyro", file=sys.stderr)
            aircraft = _still(aircraft)
        limits = _limits(self, aircraft)
        tuning = _tune(self, aircraft, limits)
        tell_interruption(tuning)
        checked = _fly_unseen(self, aircraft, tuning)
        best = replace(tuning.best.settings, nominal_voltage=aircraft.propulsion.supply_voltage)
        if self.write:
            name = self.aircraft
            source = FOLDER / f"{name}.toml" if name in shipped() else Path(name)
            write_pid(source, self.write, self.table, best, comment(self, checked))
        if self.plot:
            title = f"{aircraft.name}: PID tuning, seed {self.seed}"
            save_png(self.plot, draw_tuning(tuning, aircraft, limits, _throttle(self, aircraft), title))
        if self.json:
            print_json(document(self, aircraft, limits, tuning, checked))
        else:
            print_tables(self, aircraft, tuning, checked)
        kept = all(
            _keeps(evaluation, limits) for name, evaluation in checked.items() if name not in tuning.rules
        )
        if not kept:
            output = f"mean output {limits.output:g}, " if limits.output < 1.0 else ""
            asked = f"{output}change {limits.change:g}"
            print(
                f"no settings keep the limits ({asked}); try a larger --candidates or wider limits",
                file=sys.stderr,
            )
        return 0 if kept else 1


def _check(args: TuneOptions) -> None:
    """Refuse what does not belong together. Raises NeuroflightError."""
    from neuroflight.cli.output import check_output
    from neuroflight.sim.aircraft.pid_write import NAME
    from neuroflight.training.evaluation.users_controller import is_users_controller

    if args.of not in SUBJECTS and not is_users_controller(args.of):
        raise TrainingError(f"--of {args.of}, expected {', '.join(SUBJECTS)} or FILE.py:CLASS")
    if args.of in SUBJECTS:
        args.refuse("parameters", because="of a controller of yours; add --of FILE.py:CLASS")
    if args.of != BETAFLIGHT:
        args.refuse("build", because="of Betaflight; add --of betaflight")
    if args.of != PID:
        check_thrusts_only(args)
        return
    if args.terms == FLYING:
        none = "a limit of --terms dissertation; by flying terms there is none"
        args.refuse("max_output", because=none)
    if not NAME.fullmatch(args.table):
        raise TrainingError(f"--name {args.table!r}, expected 1 to 32 letters, digits, dashes, underscores")
    check_output(args.write, ".toml")


def _still(aircraft: Aircraft) -> Aircraft:
    """Return the aircraft without its rotors' shaking of the gyro.

    The limit of the motors' change is of what noise makes. Where a log tells that rotors shake the gyro by 20
    deg/s, that alone is twice the limit at four weights, and the search finds only gains that hardly steer.
    """
    return replace(aircraft, gyro=replace(aircraft.gyro, vibration=(0.0, 0.0, 0.0)))


def _limits(args: TuneOptions, aircraft: Aircraft) -> Limits:
    """Return the limits by the terms, where the user names none."""
    from neuroflight.training.pid_tuning import dissertation, flying
    from neuroflight.training.pid_tuning.trial import Limits
    from neuroflight.training.pid_tuning.tuning import idle_limit

    def given(value: float | None, usual: float) -> float:
        return usual if value is None else value

    most = idle_limit(aircraft)
    if args.terms == FLYING:
        idle, change = given(args.max_idle, min(flying.IDLE, most)), given(args.max_change, flying.CHANGE)
        return Limits(1.0, change, idle, of_motors=True)
    output = given(args.max_output, dissertation.OUTPUT)
    return Limits(output, given(args.max_change, dissertation.CHANGE), given(args.max_idle, most))


def _tune(args: TuneOptions, aircraft: Aircraft, limits: Limits) -> PidTuning:
    from neuroflight.training.pid_tuning.dissertation import DissertationTrials
    from neuroflight.training.pid_tuning.flying import FlyingTrials
    from neuroflight.training.pid_tuning.trial import streams
    from neuroflight.training.pid_tuning.tuning import tune

    draw_tuning, search = streams(args.seed)
    tuner = chosen_tuner(args)
    with search_bar(args.budget, "ultimate gains") as show:
        if args.terms == DISSERTATION:
            trials = DissertationTrials.of(aircraft, limits, args.seed, draw_tuning)
            return tune(trials, budget=args.budget, rng=search, progress=show, tuner=tuner)
        others = [settings for name, settings in aircraft.pids if name != args.table]
        begin = [settings for settings in others if settings.mixer is None]
        flights = FlyingTrials(aircraft, limits, draw_tuning)
        return tune(flights, budget=args.budget, rng=search, progress=show, begin=begin, tuner=tuner)


def _throttle(args: TuneOptions, aircraft: Aircraft) -> float:
    """Return the throttle of drawn responses."""
    from neuroflight.training.pid_tuning.flying import IDLE, throttle_for

    return 0.0 if args.terms == DISSERTATION else throttle_for(aircraft, 1.0, IDLE)


def _fly_unseen(args: TuneOptions, aircraft: Aircraft, tuning: PidTuning) -> dict[str, Evaluation]:
    """Return figures in the twin, on commands of `evaluate --seed` that the search did not fly.

    By the dissertation's terms of the first rule and of the tuned settings, in pulses; by flying terms of
    the tuned settings at each thrust, in flights.
    """
    from neuroflight.training.evaluation.evaluation import figures
    from neuroflight.training.pid_tuning.flying import LEVELS
    from neuroflight.training.tasks.task import PulseTask

    checked = {}
    best = tuning.best.settings
    with progress_bars() as bar:
        if args.terms == DISSERTATION:
            rule, first = next(iter(tuning.rules.items()))
            for name, settings in ((rule, first.settings), ("tuned", best)):
                show = bar(f"{name}: {args.unseen} unseen commands")
                flown = _flights(args, aircraft, settings, PulseTask(), args.unseen, 0.0, show)
                checked[name] = figures(flown)
            return checked
        task, levels = final_flights(aircraft, best.idle, args.unseen)
        show = bar(f"{args.unseen} unseen commands at each of {len(LEVELS)} thrusts")
        return by_thrust(_flights(args, aircraft, best, task, len(levels), levels, show))


def _flights(
    args: TuneOptions,
    aircraft: Aircraft,
    settings: PidSettings,
    task: Task,
    count: int,
    throttle: float | NDArray[np.float32],
    progress: Update,
) -> Flights:
    from neuroflight.sim.control.pid import Pid
    from neuroflight.sim.control.pid_table import mixer
    from neuroflight.training.evaluation.evaluation import record
    from neuroflight.training.pid_tuning.trial import RATE_HZ

    return record(
        Pid(mixer(aircraft), settings, count, RATE_HZ),
        aircraft,
        task,
        episodes=count,
        seed=args.seed,
        control_rate_hz=RATE_HZ,
        throttle=throttle,
        idle=settings.idle,
        mix=settings.mix,
        gyro_filters=settings.gyro_filters,
        progress=progress,
    )


def _keeps(evaluation: Evaluation, limits: Limits) -> bool:
    effort = evaluation.effort
    return effort.output <= limits.output and effort.change <= limits.change
