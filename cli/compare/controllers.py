"""Controllers that fly: policies, PIDs, users' classes and Betaflight, as their names say."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from neuroflight.sim.ports.betaflight.tune import Tune

BETAFLIGHT = "betaflight"
CONTROLLER = "POLICY.onnx|pid[:NAME]|FILE.py:CLASS[:VALUES.toml]|betaflight[:tuned|:DIFF]"
CONTROLLERS_MAX = 8  # distinguishable colours, and columns that fit


class WithFacts(Protocol):
    """A controller that is flown."""

    @property
    def facts(self) -> Mapping[str, str]:
        """The description of the controller for a stored result."""
        ...


def check_ranges(*ranges: tuple[str, float | None, float, float]) -> None:
    """Raise TrainingError naming the first option outside its range, as NaN is; None is not checked."""
    from neuroflight.toolchain.errors import TrainingError

    for option, value, low, high in ranges:
        if value is not None and not low <= value <= high:
            raise TrainingError(f"{option} {value}, expected {low:g} to {high:g}")


def check_controllers(names: Sequence[str]) -> None:
    """Raise TrainingError unless there are some, all different, and not too many."""
    from neuroflight.toolchain.errors import TrainingError

    if not names:
        raise TrainingError("no controller; expected policies, pid, pid:NAME, or betaflight")
    different = len(set(names))
    if len(names) > CONTROLLERS_MAX or different < len(names):
        raise TrainingError(
            f"{len(names)} controllers, {different} of them different, expected 1 to "
            f"{CONTROLLERS_MAX} different ones"
        )


def say_foreign(controllers: Iterable[WithFacts]) -> None:
    """Print a line to stderr for each policy that was trained on another aircraft than it flies."""
    from neuroflight.training.evaluation.controllers import OTHER_AIRCRAFT

    for controller in controllers:
        if (note := controller.facts.get(OTHER_AIRCRAFT)) is not None:
            print(f"neuroflight: {note}", file=sys.stderr)


def is_betaflight(name: str) -> bool:
    """Return True if a name is Betaflight's: `betaflight`, or with a pilot's settings `betaflight:FILE`."""
    return name.partition(":")[0] == BETAFLIGHT


def is_policy(name: str) -> bool:
    """Return True if a name is that of a policy's file."""
    from neuroflight.training.evaluation.users_controller import is_users_controller

    return name.partition(":")[0] not in ("pid", BETAFLIGHT) and not is_users_controller(name)


def betaflight_tune(name: str, aircraft: str) -> Tune | None:
    """Read the settings in the name of a Betaflight; None: its defaults. aircraft: as the user wrote it.

    Settings that the simulator cannot obey are told on stderr. Raises LinkError.
    """
    from neuroflight.sim.ports.betaflight.tune import TUNED, read_tune, tune_path

    _, colon, which = name.partition(":")
    if not colon:
        return None
    tune = read_tune(tune_path(which, aircraft), TUNED if which == TUNED else None)
    if tune.without_effect:
        print(
            f"{name}: without effect in Betaflight's simulator, which has no DShot, dynamic notch or "
            f"voltage: {', '.join(tune.without_effect)}",
            file=sys.stderr,
        )
    return tune
