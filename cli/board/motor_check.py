"""`neuroflight board motors check`: motors, propellers and gyro of an aircraft that is held down."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.board.motor_places import motor_layout, motor_places
from neuroflight.cli.board.motors import OnBench, OnTheBench, Person, heard
from neuroflight.cli.board.props_off import confirm
from neuroflight.cli.board.state import connect
from neuroflight.cli.report import Account
from neuroflight.cli.requests import Option
from neuroflight.toolchain.contract import MOTOR_TEST_MAX

if TYPE_CHECKING:
    from neuroflight.flash.board.turn import Axes
    from neuroflight.flash.hold_down.check import Checked
    from neuroflight.flash.hold_down.mends import Mend
    from neuroflight.flash.link.client import Client

FRACTION_DEFAULT, LIMIT_DEFAULT = 0.1, 0.15  # motor fractions
TIED_DOWN = "tied down"


@dataclass(frozen=True, kw_only=True)
class Check(OnBench):
    """A request to find out by the gyro what each motor does."""

    aircraft: OnTheBench = None
    fraction: Annotated[float, Option("F", f"of the first pulses, 0..1 (default {FRACTION_DEFAULT})")] = (
        FRACTION_DEFAULT
    )
    limit: Annotated[
        float,
        Option(
            "F",
            f"of the last ones, if others do not tell (default {LIMIT_DEFAULT}, at most {MOTOR_TEST_MAX})",
        ),
    ] = LIMIT_DEFAULT
    tied_down: Annotated[bool, Option(None, "it is, and nobody is near: do not ask")] = False
    no_nose: Annotated[
        bool, Option(None, "take the gyro as it is set: do not have the nose raised before")
    ] = False

    def act(self, person: Person) -> int:
        """Have the nose raised, then turn each motor, and say what is wrong and what mends it."""
        from neuroflight.flash.hold_down.check import check
        from neuroflight.flash.hold_down.mends import LEVEL, gyro_mends, motor_mends
        from neuroflight.flash.link import messages
        from neuroflight.flash.motors.readiness import read_bench
        from neuroflight.flash.motors.session import check_fraction, check_limit
        from neuroflight.flash.settings.values import Settings
        from neuroflight.toolchain.contract import Msp

        check_limit(self.limit)
        check_fraction("--fraction", self.fraction, self.limit)
        with connect(self.port) as client:
            bench = read_bench(client)
            on_bench = self.aircraft, bench.aircraft, bench.motor_count, bench.reversed
            layout, places = motor_layout(*on_bench), motor_places(*on_bench)
            told = Account(self.json)
            seen = LEVEL if self.no_nose else _raised_nose(client, person, told)
            angles = [float(Settings(client).get(f"board_{axis}_deg")) for axis in ("roll", "pitch", "yaw")]
            mends = gyro_mends(seen, angles)
            _say(told, mends, self.port)
            if bench.warning:
                print(f"neuroflight: {bench.warning}", file=sys.stderr)
            confirm(
                self.tied_down,
                TIED_DOWN,
                "--tied-down",
                f"check turns each motor at {self.limit:g} at most, propellers on",
                "Tie the aircraft down at its middle on something soft, stand back",
            )
            control_rate = messages.policy_info(client.request(Msp.POLICY_INFO)).control_rate_hz
            checked = check(client, layout, control_rate, seen, self.fraction, self.limit, told.say)
            where = [place.where for place in places]
            found = motor_mends(
                checked.wiring, checked.reactions, bench.outputs, where, reversed=bench.reversed
            )
            _say(told, found, self.port)
            mends += found
            unsure = _unsure(checked, where, self.limit)
            good = checked.wiring.right and not mends
            kept = _keep(client, person) if good else False
        for line in unsure:
            told.say(line)
        line = "every motor is in its place, turns the right way and pushes up"
        if kept:
            line += "; the board keeps that until motors, gyro or aircraft are set otherwise"
        told.end(_document(checked, mends, unsure, good), line if good else "")
        return 0 if good else 1


def _keep(client: Client, person: Person) -> bool:
    """Store that the check was passed; returns whether the firmware keeps that."""
    from neuroflight.flash.link import records
    from neuroflight.flash.motors.readiness import await_standing
    from neuroflight.flash.settings.values import Settings
    from neuroflight.toolchain.contract import Msp

    key = records.safety(client.request(Msp.SAFETY)).motor_key
    if key is None:
        return False
    await_standing(client, person.clock, person.sleep)  # flash is not written beside a motor test
    Settings(client).change({"motors_checked": float(key)}, save=True)
    return True


def _raised_nose(client: Client, person: Person, told: Account) -> Axes:
    """Return how the gyro is turned, from gravity with the nose raised."""
    from neuroflight.flash.hold_down.check import acceleration
    from neuroflight.flash.hold_down.nose import seen_turn

    heard(person, "lay the aircraft down level: Enter ")
    level = acceleration(client)
    heard(person, "raise its nose by a hand's breadth and hold it so: Enter ")
    seen = seen_turn(level, acceleration(client))
    told.say("nose and top are known")
    return seen


def _say(told: Account, mends: Sequence[Mend], port: str) -> None:
    """Print faults and what mends them."""
    for mend in mends:
        if mend.fault:
            told.say(mend.fault)
        if mend.settings or mend.do:
            told.say(f"  mend: {_command(mend, port) or mend.do}")


def _command(mend: Mend, port: str) -> str:
    """Return the command that mends it; "" where no setting does."""
    from neuroflight.flash.settings.text import value_text

    changes = " ".join(f"{name}={value_text(name, value)}" for name, value in mend.settings.items())
    return changes and f"neuroflight board settings set {changes} --save --reboot --port {port}"


def _unsure(checked: Checked, where: Sequence[str], limit: float) -> list[str]:
    """Return what could not be told, and why."""
    wiring = checked.wiring
    lines = [
        f"motor {i + 1}, {where[i]}: cannot tell about {axes}: the aircraft hardly turned by it"
        for i, axes in enumerate(wiring.unsure)
        if axes
    ]
    if lines and (seen := _rotor_words(wiring.rotors, where)):
        lines.append(f"so far, and not sure: {'; '.join(seen)}")
    if lines:
        lines.append(
            f"held too stiffly, or nothing turns at {limit:g}: hold it softer, or give "
            f"--limit {min(2 * limit, MOTOR_TEST_MAX):g}"
        )
    if wiring.instead is not None:
        lines.append(
            "another explanation is as likely: "
            + "; ".join(_rotor_words(wiring.instead, where))
            + ". Look which way the air blows: a rotor that blows upwards pushes down"
        )
    return lines


def _rotor_words(rotors: Sequence[Any], where: Sequence[str]) -> list[str]:
    return [
        f"motor {i + 1} is the {where[rotor.place]} rotor, pushes {'up' if rotor.pushes > 0 else 'down'}"
        + ("" if rotor.right_way is not False else ", turns the wrong way")
        for i, rotor in enumerate(rotors)
        if rotor is not None
    ]


def _document(checked: Checked, mends: Sequence[Mend], unsure: Sequence[str], good: bool) -> dict[str, Any]:
    """Return the JSON document."""
    return {
        "passed": good,
        "fraction": checked.fraction,
        "motors": [
            {
                "place": None if rotor is None else rotor.place + 1,
                "pushes": None if rotor is None else rotor.pushes,
                "right_way": None if rotor is None else rotor.right_way,
                "push_rad_s2": [round(float(each), 4) for each in reaction.push],
                "sureness": [round(float(each), 1) for each in reaction.sureness],
                "rpm": reaction.rpm,
            }
            for rotor, reaction in zip(checked.wiring.rotors, checked.reactions, strict=True)
        ],
        "mends": [{"fault": mend.fault, "settings": dict(mend.settings), "do": mend.do} for mend in mends],
        "unsure": list(unsure),
    }
