"""The tree of commands: words, a sentence and the module of each, and the words of before.

`room.file:Name` is a typed request (`cli/requests.py`), which imports its room of the project when it runs:
--help stays quick.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from typing import TYPE_CHECKING

from neuroflight.cli.parsing import Parser

if TYPE_CHECKING:
    from neuroflight.cli.requests import Request

PROGRAM = "neuroflight"


@dataclass(frozen=True)
class Leaf:
    """A command that does something."""

    summary: str
    request: str  # file below cli, and the class there
    extra: str = ""  # of pyproject.toml, what it needs at least


NOUNS = {
    "aircraft": "an aircraft's file: check, draw and import it, and measure the figures that it holds",
    "dyno": "a rotor on a dynamometer, simulated or real, and its model from the log",
    "policy": "neural controllers: train, check, compile, verify, time them",
    "pid": "PID controllers: tune their gains",
    "image": "firmware images: build, time, run them on an emulated board",
    "board": "a board that runs Neuroflight: flash it, watch it, set it up, turn its motors",
    "board policy": "the policy that the board flies: list, swap, go back",
    "board settings": "settings of the board: get, set, store, restore them",
    "board motors": "motors on the bench",
    "board target": "boards that images can be built for: list, import one",
    "board logs": "logs of flights that the board keeps",
    "log": "logs of flights as files: decode, draw, measure, replay them",
}
COMMANDS = {
    "aircraft check": Leaf(
        "figures of an aircraft and whether they can be true; exit status 1 if it cannot fly",
        "aircraft.check:Check",
    ),
    "aircraft new": Leaf(
        "an aircraft file from ten answers, each number marked as measured, typical or guessed",
        "aircraft.new:New",
    ),
    "aircraft import": Leaf(
        "an aircraft file from a model of another simulator, URDF or SDF", "aircraft.import_model:Import"
    ),
    "aircraft fit": Leaf(
        "the twin of an aircraft from logs of ordinary flights, with what they cannot tell",
        "aircraft.fit:FitAircraft",
    ),
    "aircraft sync": Leaf(
        "what changed about an aircraft since its file, by the log of a flight, and the policy's margin",
        "aircraft.sync:Sync",
    ),
    "aircraft noise": Leaf(
        "measure gyro and accelerometer noise in a log of an aircraft at rest", "aircraft.noise:MeasureNoise"
    ),
    "aircraft inertia": Leaf(
        "moments of inertia from gyro logs of the aircraft swinging on a bifilar pendulum or torsion wire",
        "aircraft.inertia:Inertia",
    ),
    "aircraft propeller": Leaf(
        "how thrust and torque fall with the advance ratio, from a propeller's wind tunnel table",
        "aircraft.propeller:Propeller",
    ),
    "aircraft stability": Leaf(
        "measure how far the links of an aircraft drift apart in pybullet", "aircraft.stability:Stability"
    ),
    "dyno run": Leaf(
        "simulate step (25, 50, 75, 100 %) and ramp (0-100-0 % in 40 s) experiments of one rotor",
        "dyno.run:Run",
    ),
    "dyno bench": Leaf(
        "drive a rotor on a dynamometer through a flight controller and record it, for `dyno fit`",
        "dyno.bench:Bench",
    ),
    "dyno calibrate": Leaf(
        "calibrate a load cell with known masses: asks for one after the other, writes its figures",
        "dyno.calibrate:Calibrate",
    ),
    "dyno fit": Leaf(
        "fit speed curve, thrust, torque and response of a rotor to a dynamometer's log", "dyno.fit:MakeFit"
    ),
    "policy train": Leaf("train a policy in the twin of an aircraft", "policy.train:Train", "train"),
    "policy sweep": Leaf(
        "train many policies at once and show those that no other beats in every figure",
        "policy.sweep:MakeSweep",
        "train",
    ),
    "policy curves": Leaf(
        "draw the training reward of runs over their steps, averaged over seeds",
        "policy.curves:Curves",
        "train",
    ),
    "policy import": Leaf(
        "turn a checkpoint, or the model of another trainer, into policy.onnx", "policy.import_model:Import"
    ),
    "policy check": Leaf(
        "say whether a policy is fit to fly an aircraft, and why not; exit status 1 if it is not",
        "policy.check:Check",
        "train",
    ),
    "policy compile": Leaf("turn policy.onnx into policy.c and policy.h", "policy.compile:Compile"),
    "policy verify": Leaf(
        "run a policy on every machine, from torch to the Cortex-M7, and compare them", "policy.verify:Verify"
    ),
    "policy time": Leaf("count what a policy takes on the board: instructions, cycles", "policy.time:Time"),
    "pid tune": Leaf(
        "find the gains of a PID, or Betaflight's settings, for an aircraft in its twin",
        "pid.tune:Tune",
        "train",
    ),
    "image build": Leaf("build a firmware image or the host program around a policy", "image.build:Build"),
    "image time": Leaf(
        "count what an image takes on the board in flight: instructions, cycles", "image.time:Time"
    ),
    "image emulate": Leaf(
        "run the image on an emulated board that lies still; other programs use its serial ports",
        "image.emulate:Emulate",
    ),
    "board info": Leaf(
        "who the firmware is, which policy it flies and what forbids arming", "board.state:Info"
    ),
    "board status": Leaf(
        "state, what forbids arming and how to lift it, battery, receiver, attitude, load",
        "board.state:Status",
    ),
    "board tasks": Leaf(
        "how long each task of the processor takes, and how often it came late", "board.state:TaskLoads"
    ),
    "board monitor": Leaf(
        "watch a running firmware live: state, attitude, channels, motors, battery, load",
        "board.monitor:Monitor",
    ),
    "board stream": Leaf(
        "what the firmware does, up to 500 times a second: a table, or a file", "board.stream:Streaming"
    ),
    "board faults": Leaf("the last fault that nobody acknowledged", "board.state:Faults"),
    "board acknowledge": Leaf(
        "acknowledge logged faults and a policy that was refused in flight, so that it arms again",
        "board.state:Acknowledge",
    ),
    "board calibrate": Leaf(
        "measure the gyro's bias anew; the aircraft has to lie still", "board.state:Calibrate"
    ),
    "board reboot": Leaf("start the firmware anew, and wait until it answers again", "board.state:Reboot"),
    "board rc": Leaf(
        "send a firmware its channels over MSP, from a script or a gamepad", "board.rc:Channels"
    ),
    "board gateway": Leaf(
        "a running firmware as a MAVLink aircraft: QGroundControl, companion computers",
        "board.gateway:Gateway",
    ),
    "board flash": Leaf("put an image onto a board that runs Neuroflight", "board.flash:Flash"),
    "board rescue": Leaf(
        "put an image on a board through the boot loader in its chip's ROM, whatever its flash holds",
        "board.rescue:Rescue",
    ),
    "board policy list": Leaf("what each policy slot holds, and which policy is flown", "board.policy:List"),
    "board policy swap": Leaf(
        "fly another policy of the same architecture: write its weights into a policy slot (seconds)",
        "board.policy:Swap",
    ),
    "board policy revert": Leaf(
        "give the policy in the flown slot up: back to the one before", "board.policy:Revert"
    ),
    "board settings get": Leaf(
        "settings with their limits and defaults; all, or those named", "board.settings:Get"
    ),
    "board settings set": Leaf(
        "change settings, all of them or none: NAME=VALUE; a value by number, name or as a mode range",
        "board.settings:Set",
    ),
    "board settings diff": Leaf(
        "the settings that differ from their defaults, as lines that `restore` reads", "board.settings:Diff"
    ),
    "board settings dump": Leaf("all settings, as lines that `restore` reads", "board.settings:Dump"),
    "board settings restore": Leaf(
        "set a file's settings, and their defaults beside them, check and save them; all or nothing",
        "board.settings:Restore",
    ),
    "board settings import": Leaf(
        "bring settings over from Betaflight's `diff all` or `dump`, and tell what is left and why",
        "board.settings_import:Import",
    ),
    "board settings save": Leaf("store all settings", "board.settings:Store"),
    "board settings defaults": Leaf("set every setting to its default", "board.settings:Defaults"),
    "board motors test": Leaf(
        "turn the motors one after the other, and say which should turn where", "board.motors:Test"
    ),
    "board motors spin": Leaf("turn one motor, or all, up a ramp and for a while", "board.motors:Spin"),
    "board motors stop": Leaf(
        "stop all motors at once and close the motor test, whoever opened it", "board.motors:Stop"
    ),
    "board motors direction": Leaf(
        "tell a motor's ESC by DShot which way it turns, and have it keep that", "board.motors:Direction"
    ),
    "board motors check": Leaf(
        "propellers on, held down: find out by the gyro what each motor does, and what mends it",
        "board.motor_check:Check",
    ),
    "board motors order": Leaf(
        "find out which output each motor is wired to, by turning them, and store it", "board.motors:Order"
    ),
    "board target list": Leaf(
        "boards that images can be built for, and what each flies without; or one, and what serves what",
        "board.target:List",
    ),
    "board target import": Leaf(
        "a target from what Betaflight's `dump hardware` or a config.h tells of a board, checked",
        "board.target:Import",
    ),
    "board logs list": Leaf("what the device of the blackbox does, and the logs it keeps", "board.logs:List"),
    "board logs fetch": Leaf(
        "get logs from the firmware into files; goes on where it was interrupted", "board.logs_fetch:Fetch"
    ),
    "board logs erase": Leaf(
        "make all files for logs empty again; refuses while one was not fetched", "board.logs_erase:Erase"
    ),
    "log list": Leaf("the logs of a file or a folder", "log.list:List"),
    "log decode": Leaf("frames to CSV or NumPy's .npz", "log.decode:Decode", "sim"),
    "log plot": Leaf("draw a flight: rates, motors, battery, events", "log.plot:Plot", "sim"),
    "log metrics": Leaf(
        "the figures of a flight that `fly` prints, against the gyro", "log.metrics:Metrics", "sim"
    ),
    "log commands": Leaf("how a pilot's commands are distributed", "log.commands:Distribution", "sim"),
    "log quality": Leaf("what a log can answer, and what it cannot", "log.quality:Quality", "sim"),
    "log replay": Leaf(
        "give the firmware again what it was given in flight, and compare every motor value",
        "log.replay:Replay",
        "sim",
    ),
    "log card": Leaf(
        "put empty files for logs onto a FAT32 card, list them, empty those that were copied",
        "log.card:OnCard",
    ),
    "compare": Leaf(
        "fly controllers side by side: on the same unseen commands, or in another suite of flights",
        "compare.compare:Compare",
        "train",
    ),
    "fly": Leaf("fly a firmware against the twin and print tracking figures", "fly.fly:Fly"),
    "view": Leaf(
        "show the aircraft in the attitudes of a flight: in a window, as a page that plays it, GIF, PNG",
        "view:View",
    ),
    "reproduce": Leaf(
        "run the dissertation's experiments again, its figures beside ours",
        "training.reproduce:Reproduce",
        "train",
    ),
    "report": Leaf("write the page of results from stored figures", "training.results:Report", "train"),
    "doctor": Leaf("what is installed, which serial ports there are, and what is missing", "doctor:Doctor"),
}
ALIASES = {  # earlier command words, accepted for one release; options or name patterns may follow
    "build": "image build",
    "compile": "policy compile",
    "verify": "policy verify",
    "timing *.bin": "image time",
    "timing": "policy time",
    "freeze": "policy import",
    "train": "policy train",
    "learning-curves": "policy curves",
    "sweep": "policy sweep",
    "tune-pid": "pid tune",
    "evaluate": "compare --one --all",
    "robustness": "compare --suite robustness",
    "failure": "compare --suite failures",
    "manoeuvres": "compare --suite manoeuvres",
    "power": "compare --suite power",
    "stability": "aircraft stability",
    "results": "report",
    "twin": "aircraft",
    "rescue": "board rescue",
    "msp get": "board settings get",
    "msp set": "board settings set",
    "msp diff": "board settings diff",
    "msp dump": "board settings dump",
    "msp restore": "board settings restore",
    "msp import": "board settings import",
    "msp save": "board settings save",
    "msp defaults": "board settings defaults",
    "msp": "board",
    "motor": "board motors",
    "rc": "board rc",
    "monitor": "board monitor",
    "gateway": "board gateway",
    "flash --list": "board policy list",
    "flash --policy": "board policy swap",
    "flash --revert": "board policy revert",
    "flash --rom": "board rescue",
    "flash": "board flash",
    "log list --port": "board logs list --port",
    "log fetch": "board logs fetch",
    "log erase": "board logs erase",
}
GONE = dict.fromkeys(  # earlier words without a command in their place, and what to do: for one release
    ("adapt", "policy adapt"),
    "aircraft sync LOG --aircraft FILE tells what changed, policy train --from RUN --aircraft FILE refines a "
    "policy and proves it, then policy check and board policy swap",
)
LONGEST = 3  # words


def rewritten(argv: Sequence[str]) -> tuple[list[str], str]:
    """Return today's words for those of before, and "'old' is now 'new'"; "" where they are today's already.

    A port that stands before the last word of a command comes behind it: `board --port PORT info`.
    """
    line = _port_behind(list(argv))
    if line[:1] == ["board"] and _idle_board(line[1:]):
        return [
            "image",
            "emulate",
            *line[1:],
        ], "'board' is now 'image emulate'; board --help lists what board is now"
    for old, new in ALIASES.items():
        *words, last = old.split()
        if last.startswith("--") or "*" in last:
            rest = line[len(words) :]
            at = next((i for i, word in enumerate(rest) if _is(word, last)), None)
            if line[: len(words)] != words or at is None:
                continue
            new_words = new.split()
            if last.startswith("--") and last not in new_words:
                value = rest[at].partition("=")[2]
                rest[at : at + 1] = [value] if value else []
            return [*(w for w in new_words if w != last), *rest], f"{old!r} is now {new!r}"
        if line[: len(words) + 1] == [*words, last]:
            rest = line[len(words) + 1 :]
            leaf = f" {rest[0]}" if new in NOUNS and rest and not rest[0].startswith("-") else ""
            return [*new.split(), *rest], f"'{old}{leaf}' is now '{new}{leaf}'"
    return line, ""


def _is(word: str, last: str) -> bool:
    """Return True if a word of the command line is one that an alias expects behind its words."""
    return word.partition("=")[0] == last if last.startswith("--") else fnmatch(word, last)


def _idle_board(rest: Sequence[str]) -> bool:
    """Return True if these words follow the `board` that is an emulated one: none, or one of its options."""
    return not rest or (
        rest[0].startswith("-") and rest[0].partition("=")[0] not in ("-h", "--help", "--port")
    )


def _port_behind(line: list[str]) -> list[str]:
    words: list[str] = []
    port: list[str] = []
    while line and len(words) < LONGEST:
        if words and line[0] == "--port" and len(line) > 1:
            port += [line.pop(0), line.pop(0)]
        elif words and line[0].startswith("--port="):
            port.append(line.pop(0))
        elif line[0].startswith("-"):
            break
        else:
            words.append(line.pop(0))
    end = line.index("--") if "--" in line else len(line)
    return [*words, *line[:end], *port, *line[end:]]


def find(line: Sequence[str]) -> tuple[str, list[str]]:
    """Return the command that a line begins with, and the words behind it; "" where there is none."""
    for count in range(min(LONGEST, len(line)), 0, -1):
        if (words := " ".join(line[:count])) in COMMANDS:
            return words, list(line[count:])
    return "", list(line)


def leaf_parser(words: str, rest: Sequence[str] = ()) -> Parser:
    """Return the parser of a command. rest: the words behind it, by which some choose their options."""
    leaf = COMMANDS[words]
    file, _, name = leaf.request.partition(":")
    module = importlib.import_module(f"{__package__}.{file}")
    request: type[Request] = getattr(module, name).chosen(rest)
    request.words = words
    parser = Parser(prog=f"{PROGRAM} {words}", description=f"{leaf.summary}{request.more}")
    request.add_arguments(parser)
    parser.set_defaults(command=words, request=request)
    return parser


def below(group: str) -> dict[str, str]:
    """Return the words below a noun, with a sentence each; "": the words that begin a command."""
    behind = f"{group} " if group else ""
    found = {}
    for words, text in [*NOUNS.items(), *((words, leaf.summary) for words, leaf in COMMANDS.items())]:
        first, *more = words.removeprefix(behind).split()
        if words.startswith(behind) and not more:
            found[first] = text
    return found
