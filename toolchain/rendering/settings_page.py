"""Renders the contract's SETTINGS as docs/settings.md: `python -m toolchain.rendering.settings_page FILE`."""

from __future__ import annotations

import sys
from pathlib import Path

from toolchain.contract import SETTINGS, ModeRange, Setting
from toolchain.files import write_text

HEAD = """# Settings

What a pilot may change without a new image. Settings lie in flash, in two sectors that are written
alternately, so that a loss of power leaves the old or the new set; a changed one is flown from the next boot
on. On the board they are read and written over MSP (`SETTING_INFO`, `SETTING_GET`, `SETTING_SET`,
`EEPROM_WRITE`), disarmed; the host program also takes `--set NAME=VALUE`.

A policy flies behind the gyro filters that it was trained with: one that was trained without any cannot arm
while `filter1_kind` and its like are other than `none`. The PID flies behind all of them:
together they may delay slow motion by 3.5 ms at most, and a slower chain is refused. A low-pass of 100 Hz
delays by 1.6 ms (pt1), 2.0 (pt2), 2.4 (pt3) or 2.3 (biquad of the usual quality), a notch of that quality by
2.3; at half the frequency twice as much.

Each of the two styles of rates has limits and defaults of its own. Changing `rates_style` sets the nine
rates to the defaults of the new style, so it comes first: rates that are set before it are lost. Among the
changes of one start (`--set`) it is taken first wherever it stands. No stick asks for more than 1998 deg/s in
either style.

**Modes.** `mode1` to `mode20` each say which mode is on while which AUX channel is in which range:
`arm aux1 1700 2100` is on from 1700 us to below 2100 us of AUX 1. AUX 1 to 12 are the channels behind the
four sticks. Ends are 900 to 2100 us in steps of 25; what a receiver sends beyond them counts as the nearest
value inside. A mode is on while any of its ranges holds. Ranges with `and` behind them switch it on only
while all ranges of that mode with `and` hold. A mode without a range is never on; no mode is on while the
receiver is lost; for as long as its silence is bridged modes stay as they are.

| mode | box | what it does |
|---|---|---|
| arm | 0 | the arm switch: it must be seen off first, so that a range over the whole channel never arms |
| beeper | 13 | the beeper sounds, to find the aircraft |
| pid | 40 | the PID flies instead of the policy |
| trial | 41 | with `policy_trial` on, the policy flies only while this is on |

**Map.** `map_roll` to `map_aux4` say on which of the receiver's first eight channels (0 to 7) each of these
comes; each channel is used once. Channels 8 to 15 are AUX 5 to 12.

**Beeper.** A setting `beep_...` that is off mutes the beeper for that condition: it tells the next one that
holds. The LED tells all of them, and the mode `beeper` is never muted.

`msp_baud` is the speed of the very line that settings go over: from the next boot on both ends have to speak
at the new one. The host program has no such line and takes no notice.

`motor1_output` and its like say which of the board's outputs each motor's ESC is wired to. Motors are
numbered as in the aircraft file, and everything that names a motor (motor test, DShot commands, traces,
MSP's motor values) means the motor; only the last step, from motors to outputs, looks here. The outputs of
an aircraft's motors are 1 to their number, none twice; the settings of motors that it does not have are
ignored. A simulator wires each motor to the output of its own number: `neuroflight fly` with another order
flies a wrongly wired aircraft.

`motors_reversed` is for an aircraft whose motors all turn the other way than in its file ("props out"): roll
and pitch are as ever, and yaw reacts the other way. Policy and PID then see and are asked for yaw with the
other sign; nothing else changes. A policy flies so in the twin as well as the usual way. Set
wrongly, the aircraft yaws faster and faster: the runaway detection stops the motors within half a second of
their lifting, under either controller, so leave `runaway_detection` on for the first flight. Which way the
motors turn is told by DShot commands to the ESCs or by their wires, not here.

`board_roll_deg`, `board_pitch_deg` and `board_yaw_deg` say how the board is turned in the aircraft, with the
signs and in the order of Betaflight's `align_board_*`: from a board that lies flat with its arrow forward,
first by yaw (clockwise seen from above), then by pitch (the arrow upwards), then by roll (its left side
downwards), each about the board's own axes. The arrow points 45 degrees to the right: yaw 45; to the left:
yaw -45 (where Betaflight has 315, here -45). The board hangs upside down, its arrow forward: roll 180; upside
down with the arrow backwards: pitch 180. `gyro_alignment` is how the chip is turned on the board, and comes
before. Check it on the bench: the attitude that MSP tells must follow the aircraft in all three axes. A
wrong sign of an axis is not noticed before it flies, but a board upside down is no level board and does not
arm.

`pid_roll_p` and its like multiply the gains of the PID that is built in; 1 leaves them as they are. The
policy does not use them: it has no gains. Their limits were flown in the twin, without gyro filters:
within them NF1 and hexacopter fly, from throttle 0.1 to 1. A slow chain of gyro filters takes the margin
that another gain needs: with a factor other than 1 the chain may delay by 2 ms at most, and a slower one is
refused. One thing the limits do not cover: the Iris's built-in PID has little margin of its own; with a P of
1.25 and a D of 0.75 it swings, so raise D with P.

This page is written by `python -m toolchain.rendering.settings_page docs/settings.md`.

| setting | range | default | unit | meaning |
|---|---|---|---|---|
"""


def settings_page() -> str:
    """The text of the page, a row a setting, in the contract's order."""
    return HEAD + "".join(_row(setting) for setting in SETTINGS)


def _row(setting: Setting) -> str:
    if setting.kind == "text":
        span, default = f"{setting.high:g} characters of printable ASCII", ""
    elif setting.kind == "mode":
        span, default = "", str(ModeRange.unpack(int(setting.default)) or "none")
    elif setting.choices:
        span, default = ", ".join(setting.choices), setting.choices[int(setting.default)]
    else:
        span, default = f"{setting.low:g} to {setting.high:g}", f"{setting.default:g}"
    unit, other = setting.unit, setting.betaflight
    if other is not None:
        span = _both(span, f"{other.low:g} to {other.high:g}")
        default, unit = _both(default, f"{other.default:g}"), _both(unit, other.unit)
    return f"| `{setting.name}` | {span} | {default} | {unit} | {setting.meaning} |\n"


def _both(actual: str, betaflight: str) -> str:
    """What holds in each of the two styles of rates."""
    return actual if actual == betaflight else f"{actual}; betaflight: {betaflight}"


if __name__ == "__main__":
    write_text(Path(sys.argv[1]), settings_page())
