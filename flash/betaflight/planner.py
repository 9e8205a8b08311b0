"""Plan how a Betaflight file changes a firmware's settings: each line is imported or left out with a reason.

Only settings in the file are imported, except for rates, which have no meaning one by one: rates that the
flown profile leaves out take the default of the version that wrote the file.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

from neuroflight.flash.betaflight.board_turn import BOARD_TURN, NOT_TURNED, pilots_turn
from neuroflight.flash.betaflight.counterparts import (
    BEEPERS,
    COMMANDS,
    NOT_A_COMMAND,
    SETTINGS,
    Counterpart,
    number,
    reason_without,
)
from neuroflight.flash.betaflight.diff_file import Diff, Line
from neuroflight.flash.betaflight.mode_ranges import HIGH_US, PREARM, box_name, placed, read_aux, unpacked
from neuroflight.flash.betaflight.motor_order import MOTORS, motor_outputs, read_pin
from neuroflight.flash.betaflight.plan import Group, ImportPlan, Left
from neuroflight.flash.betaflight.rate_profiles import RateProfiles
from neuroflight.flash.board.turn import BOARD_AXES, Turn
from neuroflight.flash.settings.text import STYLE, Value, known_setting
from neuroflight.toolchain.contract import MODE_LOW_US, Mode, ModeRange

HOST = "HOST"  # the host program's target name, which takes any board's file
USB_PORT, SOFT_SERIAL = 20, 30  # first numbers of these kinds of ports in a serial line
RECEIVER_UART, RX_SERIAL = 2, 1 << 6  # UART2; bit of a serial line's functions
FUNCTIONS = (  # of a serial line: names of its bits, src/main/io/serial.h
    *("MSP", "GPS", "FrSky telemetry", "HoTT telemetry", "LTM telemetry", "SmartPort telemetry", "receiver"),
    *("blackbox", "bit 8", "MAVLink telemetry", "ESC sensor", "SmartAudio", "iBus telemetry", "Tramp"),
    *("RunCam", "lidar", "FrSky OSD", "MSP DisplayPort"),
)
MAP_LETTERS = {
    "A": "roll",
    "E": "pitch",
    "T": "throttle",
    "R": "yaw",
    **{str(n): f"aux{n}" for n in range(1, 5)},
}
RECEIVER_MSP = float(known_setting("receiver_protocol").choices.index("msp"))
SCALE, DIVIDER, MULTIPLIER = VOLTAGE = ("vbat_scale", "vbat_divider", "vbat_multiplier")
DIVIDER_DEFAULT, MULTIPLIER_DEFAULT = 10, 1


def plan_import(
    diff: Diff,
    board: str,
    present: Mapping[str, Value],
    rate_profile: int | None = None,
    outputs: Sequence[str] = (),
    turn: Turn | None = NOT_TURNED,
) -> ImportPlan:
    """Plan which settings `diff` changes in a firmware for `board` whose settings are `present`.

    rate_profile: instead of the active one. outputs: pins of the motor outputs of the file's board, as C06;
    () if it is not known. turn: what the maker of the file's board turns it by, (roll, pitch, yaw) [deg];
    None: that is not known. Raises LinkError if the file has none of that number.
    """
    return _Planner(diff, board, present, rate_profile, outputs, turn).plan()


class _Planner:
    """A planner that takes the lines one by one, then those that only make sense together."""

    def __init__(
        self,
        diff: Diff,
        board: str,
        present: Mapping[str, Value],
        rate_profile: int | None,
        outputs: Sequence[str],
        turn: Turn | None,
    ) -> None:
        self._diff = diff
        self._present = present
        self._outputs, self._turn = outputs, turn
        self._turned: dict[str, tuple[float, Line]] = {}  # of the whole board, by axis
        self._same_board = bool(outputs) and board in (diff.board, HOST)
        self._groups: dict[str, Group] = {}
        self._left: list[Left] = []
        self._notes: list[str] = []
        self._rates = RateProfiles(diff, rate_profile)
        self._over_msp = False  # the channels come over MSP, not by a receiver's line
        self._pins: dict[int, str] = {}
        self._order = list(range(MOTORS))
        self._mixer = ""
        self._motor_lines: list[Line] = []
        self._limits: list[tuple[int, int, Line]] = []  # the motors' limit [%] of each profile
        self._voltage: dict[str, tuple[int, Line]] = {}
        self._ranges: list[tuple[ModeRange, Line]] = []
        self._lost_boxes: set[int] = set()  # modes with a range that could not be imported
        self._switches: dict[int, set[str]] = {}  # modes and other functions that each AUX channel switched

    def plan(self) -> ImportPlan:
        for line in self._counting_lines():
            try:
                self._take(line)
            except ValueError as error:
                self._leave(line, str(error))
        self._join_modes()
        self._join_motors()
        self._join_limits()
        self._join_voltage()
        self._join_turn()
        self._join_rates()
        self._note_kept_ranges()
        groups = [group for group in self._groups.values() if group.changes]
        return ImportPlan(
            tuple(groups), tuple(sorted(self._left, key=lambda one: one.line.number)), tuple(self._notes)
        )

    # --- One line --------------------------------------------------------------------------------
    def _counting_lines(self) -> Iterator[Line]:
        """Yield the lines that take effect; note as left out those that a later line overwrites."""
        keyed = [(line, _key(line)) for line in self._diff.lines]
        last = {key: line for line, key in keyed if key}
        for line, key in keyed:
            if key and last[key] is not line:
                self._leave(line, f"line {last[key].number} says it again")
            else:
                yield line

    def _take(self, line: Line) -> None:
        command = line.words[0]
        if line.assigned is not None:
            self._set(line, *line.assigned)
        elif self._rates.take(line):
            pass
        elif command in _COMMANDS:
            _COMMANDS[command](self, line)
        else:
            known = command in COMMANDS
            self._leave(line, reason_without(" ".join(line.words[:2])) if known else NOT_A_COMMAND)

    def _set(self, line: Line, name: str, value: str) -> None:
        if self._rates.take(line):
            return
        if name in VOLTAGE:
            self._voltage[name] = number(value), line
        elif name in BOARD_TURN:
            self._turned[BOARD_TURN[name]] = number(value), line
        elif name == "motor_output_limit":
            self._limits.append((self._rates.profile.current, number(value), line))
        elif name == "motor_output_reordering":
            self._order = [number(part.strip()) for part in value.split(",")]
            self._motor_lines.append(line)
        elif name == "serialrx_provider" and self._over_msp:
            self._leave(line, "the channels come over MSP (feature RX_MSP)")
        elif name in SETTINGS:
            self._bring_counterpart(line, SETTINGS[name], value)
        else:
            if name in ("yaw_control_reversed", "yaw_control_direction") and value.upper() in ("ON", "-1"):
                self._notes.append("the yaw stick was reversed in Betaflight: reverse it in the transmitter")
            self._leave(line, reason_without(name))

    def _bring_counterpart(self, line: Line, counterpart: Counterpart, value: str) -> None:
        if counterpart.of_board and not self._same_board:
            raise ValueError(self._other_board())
        self._bring(counterpart.group, counterpart.convert(value), line)

    def _bring(self, group: str, changes: Mapping[str, Value], *lines: Line) -> None:
        found = self._groups.setdefault(group, Group(group))
        found.changes.update(changes)
        found.lines.extend(lines)

    def _leave(self, line: Line, reason: str) -> None:
        self._left.append(Left(line, reason))

    def _leave_all(self, lines: Iterable[Line], reason: str) -> None:
        self._left += [Left(line, reason) for line in lines]

    def _other_board(self) -> str:
        return f"a fact of the board {self._diff.board or 'that the file does not name'}, and this is another"

    def _name(self, line: Line) -> None:
        kind = "name" if line.words[0] == "name" else "display_name"
        self._bring_counterpart(line, SETTINGS[kind], line.text.partition(" ")[2].strip())

    def _map(self, line: Line) -> None:
        letters = line.words[1].upper() if len(line.words) == 2 else ""
        if sorted(letters) != sorted(MAP_LETTERS):
            raise ValueError(f"expected each of {''.join(MAP_LETTERS)} once")
        self._bring(
            "channel map",
            {f"map_{MAP_LETTERS[letter]}": float(at) for at, letter in enumerate(letters)},
            line,
        )

    def _aux(self, line: Line) -> None:
        if self._diff.version < (3, 0):
            raise ValueError(f"numbers of modes before Betaflight 3.0, and this is {self._diff.release}")
        numbers = [number(word) for word in line.words[1:]]
        if len(numbers) >= 5 and numbers[3] < numbers[4]:
            self._switches.setdefault(numbers[2] + 1, set()).add(box_name(numbers[1]))
            if numbers[1] == PREARM:
                self._notes.append(
                    "Betaflight armed only with PREARM on besides: here the arm switch alone arms"
                )
        try:
            found = read_aux(numbers)
        except ValueError:
            self._lost_boxes |= set(numbers[1:2])
            raise
        if found is None:
            raise ValueError("an unused slot")
        self._ranges.append((found, line))

    def _feature(self, line: Line) -> None:
        name = line.text.split()[1].upper() if len(line.words) == 2 else ""
        off, name = name.startswith("-"), name.removeprefix("-")
        if name == "MOTOR_STOP":
            self._bring("motors at zero throttle", {"motor_stop": float(not off)}, line)
        elif name == "RX_MSP" and not off:
            self._over_msp = True
            self._bring("receiver", {"receiver_protocol": RECEIVER_MSP}, line)
        elif name == "AIRMODE":
            self._leave(line, "the attitude always comes before the throttle here")
        else:
            if name == "3D" and not off:
                self._notes.append("motors that turn both ways (3D) are not flown here")
            self._leave(line, reason_without(" ".join(line.words[:2])))

    def _beeper(self, line: Line) -> None:
        name = line.text.split()[1].upper() if len(line.words) == 2 else ""
        sounds, name = not name.startswith("-"), name.removeprefix("-")
        if name != "ALL" and name not in BEEPERS:
            raise ValueError("the beeper has no such condition here")
        told = BEEPERS.values() if name == "ALL" else [BEEPERS[name]]
        self._bring("beeper", {setting: float(sounds) for setting in told}, line)

    def _serial(self, line: Line) -> None:
        words = line.words
        functions = number(words[2]) if len(words) > 2 else 0
        uart = _uart(words[1]) if len(words) > 1 else ""
        names = [name for bit, name in enumerate(FUNCTIONS) if functions >> bit & 1]
        if functions & RX_SERIAL and uart != f"UART{RECEIVER_UART}":
            self._notes.append(f"the receiver was on {uart}: here it goes to UART{RECEIVER_UART}")
        told = f"{uart}: {', '.join(names) or 'nothing'}" if uart else ""
        self._leave(line, f"{reason_without('serial')}; {told}" if told else reason_without("serial"))

    def _resource(self, line: Line) -> None:
        words = line.words
        if len(words) != 4 or words[1] != "motor":
            raise ValueError(reason_without("resource"))
        motor = number(words[2])
        if not self._same_board:
            raise ValueError(f"{self._other_board()}; `neuroflight board motors order`")
        if motor > MOTORS:
            raise ValueError(f"four motors fly here, and this is a pin of motor {motor}")
        self._pins[motor] = read_pin(words[3])
        self._motor_lines.append(line)

    def _mixer_line(self, line: Line) -> None:
        self._mixer = line.words[1].upper() if len(line.words) > 1 else ""
        self._leave(line, "the policy gives each motor its fraction")

    def _custom_mix(self, line: Line) -> None:
        if len(line.words) > 2:  # `mmix reset` says nothing
            self._mixer = "CUSTOM"
        self._leave(line, "the policy gives each motor its fraction")

    # --- Several lines together ------------------------------------------------------------------------
    def _join_modes(self) -> None:
        ranges = []
        for found, line in self._ranges:
            if found.and_others and found.mode in self._lost_boxes:
                self._leave(
                    line, "another condition of this mode has no counterpart; alone it would hold too often"
                )
            else:
                ranges.append((found, line))
        if not ranges:
            return
        present = {name: value for name, value in self._present.items() if known_setting(name).kind == "mode"}
        lines = [line for _, line in ranges]
        try:
            changes = placed(
                [found for found, _ in ranges], {name: float(value) for name, value in present.items()}
            )
        except ValueError as error:
            self._leave_all(lines, str(error))
            return
        self._bring("modes", changes, *lines)
        for found, _ in ranges:
            if found.mode is Mode.ARM and (found.low_us, found.high_us) == (MODE_LOW_US, HIGH_US):
                self._notes.append(f"{found} is always on: it never arms, as it must be seen off first")

    def _note_kept_ranges(self) -> None:
        changed = self._groups["modes"].changes if "modes" in self._groups else {}
        for name, value in self._present.items():
            if known_setting(name).kind != "mode" or name in changed:
                continue
            found = unpacked(float(value))
            if found is not None and found.aux in self._switches:
                told = ", ".join(sorted(self._switches[found.aux]))
                self._notes.append(f"{name} = {found} stays, and in the file AUX {found.aux} switched {told}")

    def _join_motors(self) -> None:
        lines = self._motor_lines
        if self._mixer not in ("", "QUADX"):
            mixer = self._mixer[:20]
            self._leave_all(
                lines, f"the mixer {mixer} may number motors otherwise; `neuroflight board motors order`"
            )
            return
        if not self._same_board:
            self._leave_all(lines, f"{self._other_board()}; `neuroflight board motors order`")
            return
        try:
            outputs = motor_outputs(self._outputs, self._pins, self._order)
        except ValueError as error:
            self._leave_all(lines, str(error))
            return
        changes = {f"motor{motor}_output": float(output) for motor, output in enumerate(outputs, start=1)}
        self._bring("motor order", changes, *lines)
        if lines:
            self._notes.append(
                "check the motors' order, propellers off: neuroflight board motors order --port PORT"
            )

    def _join_limits(self) -> None:
        selection = self._rates.profile
        for profile, percent, line in self._limits:
            if profile != selection.current:
                self._leave(line, f"of profile {profile}, which was not flown")
            elif selection.unsure:
                self._leave(line, "which profile was flown does not show")
            else:
                self._bring("motor limit", {"motor_limit": percent / 100}, line)

    def _join_turn(self) -> None:
        """Bring what the pilot has turned the board by; an axis that is left out is as the maker's."""
        lines = [line for _, line in self._turned.values()]
        if self._turn is None:
            own = "whether the board's description has this turn already is not known here"
            self._leave_all(lines, f"{own}: set board_yaw_deg and its kin to what the arrow is off")
        elif lines:
            makers = dict(zip(BOARD_AXES, self._turn, strict=True))
            whole = [self._turned[axis][0] if axis in self._turned else makers[axis] for axis in BOARD_AXES]
            turn = dict(zip(BOARD_AXES, pilots_turn(whole, self._turn), strict=True))
            told = BOARD_AXES if any(self._turn) else tuple(self._turned)
            self._bring("board's turn", {f"board_{axis}_deg": turn[axis] for axis in told}, *lines)

    def _join_voltage(self) -> None:
        lines = [line for _, line in self._voltage.values()]
        if not lines:
            return
        told = {name: value for name, (value, _) in self._voltage.items()}
        divider = told.get(DIVIDER, DIVIDER_DEFAULT) * told.get(MULTIPLIER, MULTIPLIER_DEFAULT)
        if not self._same_board:
            reason = self._other_board()
        elif SCALE not in told:
            reason = "vbat_scale is not in the file, and they say nothing alone"
        elif divider <= 0:
            reason = "expected a divider and a multiplier above 0"
        else:
            self._bring("voltage divider", {"battery_scale": round(told[SCALE] / divider, 6)}, *lines)
            return
        self._leave_all(lines, reason)

    def _join_rates(self) -> None:
        found = self._rates.result()
        self._left += [Left(line, reason) for line, reason in found.left]
        self._notes += found.notes
        if found.style is not None:
            style = known_setting(STYLE).choices.index(found.style.name)
            self._bring("rates", {STYLE: float(style), **found.style.values}, *found.lines)


_COMMANDS = {
    "name": _Planner._name,
    "display_name": _Planner._name,
    "map": _Planner._map,
    "aux": _Planner._aux,
    "feature": _Planner._feature,
    "beeper": _Planner._beeper,
    "serial": _Planner._serial,
    "resource": _Planner._resource,
    "mixer": _Planner._mixer_line,
    "mmix": _Planner._custom_mix,
}


def _key(line: Line) -> tuple[str, ...]:
    """Return a key that is the same for lines which overwrite each other; (): no line overwrites this one."""
    words = line.words
    if line.assigned is not None:
        name = line.assigned[0]
        return ("set", name) if name in {*SETTINGS, *VOLTAGE, *BOARD_TURN} else ()
    if words[0] in ("name", "display_name", "map", "mixer"):
        return (words[0],)
    if words[0] == "aux" and len(words) > 1:
        return ("aux", words[1])
    if words[0] in ("feature", "beeper") and len(words) == 2:
        return (words[0], words[1].removeprefix("-"))
    return ("motor", words[2]) if words[:2] == ["resource", "motor"] and len(words) == 4 else ()


def _uart(word: str) -> str:
    """Return the name of the port that the first word of a serial line stands for."""
    if not word.isdecimal():
        return word.upper()
    at = int(word)
    if at < USB_PORT:
        return f"UART{at + 1}"
    return "USB" if at == USB_PORT else f"soft serial {at - SOFT_SERIAL + 1}"
