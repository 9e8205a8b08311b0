"""`neuroflight pid tune --of betaflight`: settings of Betaflight for an aircraft, by a PID's search."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from neuroflight.cli.pid.options import BETAFLIGHT, TuneOptions
from neuroflight.cli.pid.report import DEFAULTS, TUNED, Checked, keeps_limit, print_searched, searched_told
from neuroflight.cli.pid.search import by_thrust, chosen_tuner, final_flights, search_bar, tell_interruption
from neuroflight.cli.progress import progress_bars

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.ports.betaflight.build import Betaflight
    from neuroflight.training.pid_tuning.betaflight_tuning import Settings


def tune_betaflight_of(args: TuneOptions, aircraft: Aircraft) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where nothing better keeps the limit."""
    from neuroflight.cli.fly.ports import built_betaflight
    from neuroflight.sim.ports.betaflight.tune import tune_text
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.pid_tuning.betaflight_tuning import tune_betaflight

    built = built_betaflight(aircraft, args.build, quiet=args.json)
    with search_bar(args.budget, "Betaflight's defaults") as show:
        tuning = tune_betaflight(
            built,
            aircraft,
            args.limit,
            seed=args.seed,
            budget=args.budget,
            progress=show,
            tuner=chosen_tuner(args),
        )
    tell_interruption(tuning)
    checked = _fly_unseen(args, built, aircraft, tuning.best.settings)
    found = tuning.best.settings
    lines = [f"set {setting} = {value}" for setting, value in found.items()]
    if args.write and found:
        write_text(args.write, tune_text(found, searched_told(args, tuning, checked)))
        flown = f"fly it as betaflight:{args.write}, or paste it into Betaflight's command line"
        lines.append(f"\n{args.write}: {flown}")
    facts = {"of": BETAFLIGHT, "settings": dict(found)}
    print_searched(args, aircraft, "Betaflight 4.6", tuning, checked, facts, lines)
    if not found:
        print(
            "nothing was found that beats Betaflight's defaults; try a larger --candidates", file=sys.stderr
        )
        return 1
    return keeps_limit(args, checked[TUNED])


def _fly_unseen(args: TuneOptions, built: Betaflight, aircraft: Aircraft, best: Settings) -> Checked:
    """Return the figures of the defaults and of the settings in the flights of a PID's check."""
    from neuroflight.sim.ports.betaflight.fleet import ArmedBetaflight
    from neuroflight.sim.ports.betaflight.port import IDLE
    from neuroflight.training.evaluation.betaflight import record_betaflight
    from neuroflight.training.pid_tuning.betaflight_tuning import as_tune

    task, throttle = final_flights(aircraft, IDLE, args.unseen)
    checked: Checked = {}
    with progress_bars() as bar:
        for name, tune in ((DEFAULTS, None), (TUNED, as_tune(best) if best else None)):
            show = bar(f"{name}: {args.unseen} unseen commands at each thrust")
            with ArmedBetaflight(built, aircraft, tune) as armed:
                flown = record_betaflight(
                    (armed,),
                    aircraft,
                    task,
                    episodes=len(throttle),
                    seed=args.seed,
                    throttle=throttle,
                    progress=show,
                )
            checked[name] = by_thrust(flown)
    return checked
