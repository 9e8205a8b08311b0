"""`neuroflight aircraft new`: an aircraft file from ten answers."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from neuroflight.cli.options import Json
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.errors import AircraftError, NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.typical import Answers
    from neuroflight.sim.aircraft.typical.answers import Whole

UNDONE = "nothing was written"


@dataclass(frozen=True, kw_only=True)
class New(Request):
    """Answers about an aircraft of four motors."""

    out: Annotated[Path, Option("FILE.toml", "a new file", suffix=".toml")]
    weight: Annotated[float | None, Option("KG", "ready to fly, battery included")] = None
    cells: Annotated[int | None, Option("N", "of the battery, in series: 6 of a 6S")] = None
    kv: Annotated[float | None, Option("RPM_V", "of the motors, as printed on them")] = None
    motor: Annotated[str | None, Option("SIZE", "their stator's size, such as 2207 or 2806.5")] = None
    props: Annotated[
        str | None,
        Option(
            "SIZE", "propeller: 5.1x4.3x3, diameter x pitch [inch] x blades; or 31mmx4, diameter and blades"
        ),
    ] = None
    arm: Annotated[float | None, Option("M", "from a motor to the middle of the four")] = None
    props_out: Annotated[
        bool, Option(None, "propellers out: the front left one turns counter-clockwise, seen from above")
    ] = False
    capacity: Annotated[float | None, Option("AH", "of the battery: 1.3 for 1300 mAh")] = None
    esc: Annotated[str | None, Option(None, "how the ESCs are told", choices=("dshot", "oneshot", "pwm"))] = (
        None
    )
    name: Annotated[str | None, Option("NAME", "of the aircraft; default: the file's")] = None
    json: Json = False

    more: ClassVar[str] = (
        ". Questions that an option answers are not asked, with --weight none is. What is not answered is "
        "taken as typical for the weight, and marked as a guess."
    )

    def run(self) -> int:
        """Ask, write the file, print what it is and what to measure first. Returns 0."""
        from neuroflight.cli.aircraft.marks import known_document, print_known
        from neuroflight.sim.aircraft.typical import typical
        from neuroflight.sim.design.figures import aircraft_figures
        from neuroflight.toolchain.files import write_text

        if self.out.exists():
            raise AircraftError(
                f"--out {self.out}: exists; name a new file, so that nothing written by hand is lost"
            )
        made = typical(_asked(self) if self.weight is None else _given(self, self.weight))
        aircraft = made.aircraft(str(self.out))
        write_text(self.out, made.text)
        figures = aircraft_figures(aircraft)
        if self.json:
            print_json(
                {
                    "written": str(self.out),
                    "name": aircraft.name,
                    "sha256": aircraft.sha256,
                    "mass_kg": figures.mass,
                    "thrust_to_weight": figures.thrust_to_weight,
                    "hover_acceleration_rad_s2": figures.hover_acceleration.tolist(),
                    "known": known_document(self.out),
                }
            )
            return 0
        print(f"{self.out}: {aircraft.name}, {aircraft.description}")
        roll, pitch, yaw = figures.hover_acceleration
        print(
            f"thrust to weight {figures.thrust_to_weight:.1f}; in a hover up to {roll:.0f} / {pitch:.0f} / "
            f"{yaw:.0f} rad/s² about roll / pitch / yaw"
        )
        print()
        print_known(self.out)
        print(f"\ncheck it: neuroflight aircraft check {self.out} --plot {self.out.with_suffix('.png')}")
        return 0


def _given(args: New, weight: float) -> Answers:
    """Return the answers that the options give."""
    from neuroflight.sim.aircraft.typical import Answers, Propeller
    from neuroflight.sim.aircraft.typical.answers import parse_stator

    return Answers(
        weight_kg=weight,
        cells=args.cells,
        kv=args.kv,
        propeller=None if args.props is None else Propeller.parse(args.props),
        arm_m=args.arm,
        stator_mm=None if args.motor is None else parse_stator(args.motor),
        capacity_ah=args.capacity,
        protocol=args.esc,
        props_out=args.props_out,
        name=_name(args.name or args.out.stem),
    )


def _asked(args: New) -> Answers:
    """Ask what no option gives. Raises NeuroflightError where nobody can be asked."""
    from neuroflight.cli.questions import ask
    from neuroflight.sim.aircraft.typical import Propeller, typical
    from neuroflight.sim.aircraft.typical.answers import DELAYS, completed, parse_stator

    if not sys.stdin.isatty():
        raise NeuroflightError(f"--weight: not given and nobody can be asked here; {UNDONE}")
    print("Ten questions; an empty line means that you do not know: then what is typical is taken.")
    answers: Answers | None = None
    while answers is None:
        answers = ask(
            "Weight ready to fly, battery included [g]:",
            lambda text: _given(args, _number(text) / 1000),
            UNDONE,
        )

    def put(key: str, question: str, read: Callable[[str], Any], usual: Callable[[Whole], str]) -> None:
        nonlocal answers
        assert answers is not None
        if getattr(answers, key) not in (None, False):
            return
        whole = completed(answers)

        def answered(text: str) -> Answers:
            assert answers is not None
            found = replace(answers, **{key: read(text)})
            typical(found)
            return found

        answers = ask(f"{question} (typical: {usual(whole)}):", answered, UNDONE) or answers

    put("cells", "Cells of the battery in series", lambda text: int(_number(text)), lambda w: f"{w.cells}")
    put("kv", "Kv of the motors, as printed", _number, lambda w: f"{w.kv:.0f}")
    put("stator_mm", "Size of the motors, such as 2207", parse_stator, lambda w: _stator(w.stator))
    put(
        "propeller",
        "Propeller, diameter x pitch x blades in inches, or as 31mmx4",
        Propeller.parse,
        lambda w: f"{w.diameter / 0.0254:.2g}x{w.pitch / 0.0254:.2g}x{w.blades}",
    )
    put(
        "arm_m",
        "From a motor to the middle of the four [mm]",
        lambda text: _number(text) / 1000,
        lambda w: f"{1000 * w.arm:.0f}",
    )
    put("props_out", "Propellers in or out", _direction, lambda _: "in")
    put(
        "capacity_ah",
        "Capacity of the battery [mAh]",
        lambda text: _number(text) / 1000,
        lambda w: f"{1000 * w.capacity:.0f}",
    )
    put("protocol", f"ESC protocol, {', '.join(DELAYS)}", str.lower, lambda _: "dshot")
    if args.name is None:
        name = ask(f"Name (the file's: {answers.name}):", _name, UNDONE)
        answers = replace(answers, name=name or answers.name)
    return answers


def _number(text: str) -> float:
    try:
        return float(text.replace(",", "."))
    except ValueError:
        raise AircraftError(f"{text!r}: expected a number") from None


def _direction(text: str) -> bool:
    if text.lower() not in ("in", "out"):
        raise AircraftError(f"{text!r}: expected in or out")
    return text.lower() == "out"


def _stator(size: tuple[float, float]) -> str:
    width, height = size
    return f"{width:02.0f}{height:02.0f}"


def _name(text: str) -> str:
    from neuroflight.sim.aircraft.model import NAME

    if not NAME.fullmatch(text):
        raise AircraftError(
            f"name {text!r}: expected at most 32 letters, digits, dots and dashes; give --name NAME"
        )
    return text
