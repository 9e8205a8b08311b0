"""The section about training runs on the page of results."""

from __future__ import annotations

from collections.abc import Sequence

from neuroflight.training.results_page.markdown import table
from neuroflight.training.results_page.stored_results import Stored

GOOD_DEG_S = 5.0  # mean error of a policy that flies


def training_section(runs: Sequence[Stored]) -> str:
    """Return the durations of the runs, and the results of monitored ones."""
    body = []
    for run in runs:
        seconds, steps = run.number("seconds"), run.number("steps")
        seen = run.entries("monitor") if run.has("monitor") and run.get("monitor") else []
        good = [r.number("steps") for r in seen if r.number("mae", "mean") < GOOD_DEG_S]
        chosen = run.has("chosen", "steps")
        body.append(
            (
                f"{run.text('config', 'algorithm', 'name')}, {run.text('config', 'aircraft', 'name')}, "
                f"`{run.text('config', 'observation')}`, seed {run.number('config', 'seed'):g}",
                f"{steps / 1e6:.1f}",
                f"{seconds:.0f}",
                f"{run.number('steps_per_second'):,.0f}",
                f"{seconds * good[0] / steps:.0f}" if good else "",
                f"{run.number('chosen', 'steps') / 1e6:.1f}" if chosen else "",
                f"{run.number('chosen', 'mae', 'mean'):.2f}" if chosen else "",
            )
        )
    headings = (
        "run",
        "M steps",
        "seconds",
        "steps/s",
        "below 5 deg/s after, s",
        "chosen at, M steps",
        "MAE there",
    )
    return f"## Training\n\n{ABOUT_TRAINING}\n\n{table(headings, body)}"


ABOUT_TRAINING = """Seconds are from the first step to the last file, on at most two cores of the machine that
made the policies. A monitor flies each checkpoint in five episodes that are not part of any figure above. The
last columns say when the mean error on them was first below 5 deg/s, at the run's mean speed, which
checkpoint the selection rule chose, and its error on them."""
