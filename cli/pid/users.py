"""`neuroflight pid tune --of FILE.py:CLASS`: parameters of a user's own controller, by a PID's search."""

from __future__ import annotations

from typing import TYPE_CHECKING

from neuroflight.cli.pid.report import DEFAULTS, TUNED, Checked, keeps_limit, print_searched, searched_told
from neuroflight.cli.pid.search import by_thrust, chosen_tuner, final_flights, search_bar, tell_interruption
from neuroflight.cli.progress import progress_bars

if TYPE_CHECKING:
    from neuroflight.cli.pid.options import TuneOptions
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.training.evaluation.users_controller import UsersController
    from neuroflight.training.pid_tuning.trial import Tuning
    from neuroflight.training.pid_tuning.users_tuning import Values


def tune_users_of(args: TuneOptions, aircraft: Aircraft) -> int:
    """Tune, fly unseen commands, write and print. Returns 1 where the limit is not kept."""
    from neuroflight.toolchain.files import write_text
    from neuroflight.training.evaluation.users_controller import load_users_controller, values_text
    from neuroflight.training.pid_tuning.users_tuning import check_names, tune_users

    controller = load_users_controller(args.of)
    names = list(args.parameters or controller.parameters)
    check_names(controller, names)
    with search_bar(args.budget, "as its class says") as show:
        tuning = tune_users(
            controller,
            aircraft,
            args.limit,
            names=names,
            seed=args.seed,
            budget=args.budget,
            progress=show,
            tuner=chosen_tuner(args),
        )
    tell_interruption(tuning)
    checked = _fly_unseen(args, controller, aircraft, tuning)
    if args.write:
        comment = "\n".join(searched_told(args, tuning, checked))
        write_text(args.write, values_text(tuning.best.settings, comment))
    found = tuning.best.settings
    facts = {
        "of": controller.name,
        "file_sha256": controller.sha256,
        "costs": {DEFAULTS: tuning.start.cost, TUNED: tuning.best.cost},
        "parameters": dict(found),
    }
    lines = [f"{name} = {value!r}" for name, value in found.items()]
    if args.write:
        lines.append(f"\n{args.write}: fly it as {controller.name}:{args.write}")
    print_searched(args, aircraft, controller.name, tuning, checked, facts, lines)
    return keeps_limit(args, checked[TUNED])


def _fly_unseen(
    args: TuneOptions, controller: UsersController, aircraft: Aircraft, tuning: Tuning[Values]
) -> Checked:
    """Return the figures as the class says and as found, in the flights of a PID's check."""
    from neuroflight.training.evaluation.evaluation import record

    task, throttle = final_flights(aircraft, controller.idle, args.unseen)
    both: dict[str, Values] = {DEFAULTS: controller.values, TUNED: tuning.best.settings}
    checked: Checked = {}
    with progress_bars() as bar:
        for name, values in both.items():
            flown = record(
                controller.build(aircraft, len(throttle), values),
                aircraft,
                task,
                episodes=len(throttle),
                seed=args.seed,
                control_rate_hz=controller.control_rate_hz,
                throttle=throttle,
                idle=controller.idle,
                mix=controller.mix,
                gyro_filters=controller.gyro_filters,
                progress=bar(f"{name}: {args.unseen} unseen commands at each thrust"),
            )
            checked[name] = by_thrust(flown)
    return checked
