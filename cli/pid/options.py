"""The options of `neuroflight pid tune`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli import options
from neuroflight.cli.options import Json, picture
from neuroflight.cli.requests import Option, Request

PID, BETAFLIGHT = SUBJECTS = ("pid", "betaflight")
FLYING, DISSERTATION = TERMS = ("flying", "dissertation")


@dataclass(frozen=True, kw_only=True)
class TuneOptions(Request):
    """A request for a search of gains, without its work."""

    of: Annotated[
        str,
        Option(
            "|".join([*SUBJECTS, "FILE.py:CLASS"]),
            "what is tuned: the PID that stands beside a policy; Betaflight, so that `compare` can fly one "
            "as a pilot would have it; or a controller of a file of yours",
            usual=True,
        ),
    ] = PID
    aircraft: options.Aircraft = "nf1"
    seed: Annotated[int, Option("S", "of commands, noise and search", low=0, high=2**32 - 1)] = 1
    terms: Annotated[
        str,
        Option(
            None,
            "flying (default): at four thrusts, commands one after another, mean of the gyro's samples, "
            "centred mix; dissertation: from rest without throttle, idle searched",
            choices=TERMS,
            usual=True,
        ),
    ] = FLYING
    budget: Annotated[
        int,
        Option(
            "N",
            "candidates to try, about",
            low=1,
            high=100_000,
            usual=True,
            name="--candidates",
            old=("--budget",),
        ),
    ] = 720
    max_output: Annotated[
        float | None, Option("U", "dissertation: mean output, fraction above idle (0.12)", low=1e-3, high=1.0)
    ] = None
    max_change: Annotated[
        float | None,
        Option(
            "DU",
            "mean |change| in 1 ms of a motor value, default 0.0045; dissertation: of an output, 0.012",
            low=1e-4,
            high=1.0,
        ),
    ] = None
    max_idle: Annotated[
        float | None,
        Option(
            "IDLE",
            "fraction of idling motors; default: flying 0.055, dissertation where all together lift three "
            "quarters of the weight",
            low=0.0,
            high=0.5,
        ),
    ] = None
    parameters: Annotated[
        tuple[str, ...] | None,
        Option("NAME", "of a controller of yours: those to search; default: all that its class declares"),
    ] = None
    tuner: Annotated[
        str | None, Option("FILE.py:CLASS", "a search of yours, with ask() and tell(), instead of CMA-ES")
    ] = None
    name: Annotated[
        str | None, Option("NAME", "of the [pid.NAME] table that is written; default: flying, or tuned")
    ] = None
    check: Annotated[
        int | None,
        Option(
            "N",
            "unseen commands for the final figures; default: 50 at each thrust, dissertation 1000",
            low=1,
            high=4096,
            name="--unseen",
            old=("--check",),
            recorded=False,
        ),
    ] = None
    write: Annotated[
        Path | None,
        Option(
            "FILE",
            "the settings: a copy of the aircraft's file with them, FILE.toml; Betaflight's as FILE.txt, "
            "for `betaflight:FILE.txt` and the command line of its app",
            name="--out",
            old=("--write",),
            recorded=False,
        ),
    ] = None
    plot: Annotated[Path | None, picture("draw responses and search")] = None
    build: options.Build = None
    json: Json = False

    @property
    def unseen(self) -> int:
        """Number of commands of the final figures, at each thrust."""
        return (50 if self.terms == FLYING else 1000) if self.check is None else self.check

    @property
    def table(self) -> str:
        """Name of the [pid.NAME] table."""
        return ("flying" if self.terms == FLYING else "tuned") if self.name is None else self.name

    @property
    def limit(self) -> float:
        """The most that motor values may change in 1 ms, by flying terms."""
        from neuroflight.training.pid_tuning.flying import CHANGE

        return CHANGE if self.max_change is None else self.max_change
