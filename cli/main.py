"""The `neuroflight` command: parses, makes one call into a room, prints, returns an exit code.

Each module named in `COMMANDS` owns one subcommand: `add_arguments(parser)` and `run(args) -> int`.
It imports its room inside `run`, so that `--help` stays quick.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import importlib.util
import os
import sys
from collections.abc import Sequence

from neuroflight.toolchain.errors import NeuroflightError

SUMMARY = (
    "From the digital twin of an aircraft to a flight firmware whose rate controller is a neural network."
)
ROOMS = {  # which folder of cli/ holds the module of a command; its name is the command's
    "toolchain": ("build", "compile", "verify", "timing", "freeze"),
    "sim": ("dyno", "stability", "fly", "board", "twin", "aircraft", "view"),
    "training": (
        "train",
        "policy",
        "learning-curves",
        "sweep",
        "tune-pid",
        "adapt",
        "results",
        "reproduce",
    ),
    "training/evaluation": ("evaluate", "compare", "robustness", "failure", "manoeuvres", "power"),
    "flash": ("msp", "flash", "rescue", "motor", "rc", "monitor", "gateway"),
    "logs": ("log",),
}
COMMANDS = {
    "build": "build a firmware image or the host program around a policy",
    "compile": "turn policy.onnx into policy.c and policy.h",
    "verify": "run a policy on every machine, from torch to the Cortex-M7, and compare them",
    "timing": "count what a policy, or an image in flight, takes on the board: instructions, cycles",
    "freeze": "turn a checkpoint, or the model of another trainer, into policy.onnx",
    "train": "train a policy in the twin of an aircraft",
    "policy": "check that a policy is fit to fly before it is built and flashed",
    "learning-curves": "draw the training reward of runs over their steps, averaged over seeds",
    "sweep": "train many policies at once and show those that no other beats in every figure",
    "tune-pid": "find the gains of a PID, or Betaflight's settings, for an aircraft in its twin",
    "evaluate": "measure a policy or the PID on unseen commands",
    "compare": "compare policies and PIDs on the same unseen commands",
    "robustness": "measure controllers on aircraft whose parameters differ from their file",
    "failure": "fly controllers through a motor that fails, or a payload that comes, goes or shifts",
    "adapt": "refine a policy on what a flight told of the aircraft, and prove it",
    "manoeuvres": "fly roll, flip, Split-S, punch-out, dive, prop wash freely, with drag, battery, gusts",
    "power": "measure what controllers draw from the battery: disarmed, armed idling, in flight",
    "dyno": "measure a rotor on a dynamometer, simulated or real, and fit its model to the log",
    "stability": "measure how far the links of an aircraft drift apart in pybullet",
    "results": "write the page of results from stored figures",
    "reproduce": "run the dissertation's experiments again, its figures beside ours",
    "fly": "fly a firmware against the twin and print tracking figures",
    "board": "run the image on an emulated board that lies still; other programs use its serial ports",
    "twin": "gyro noise, moments of inertia and a propeller's fall of thrust, from recordings",
    "aircraft": "check and draw an aircraft file",
    "view": "show the aircraft in the attitudes of a flight: in a window, as a page that plays it, GIF, PNG",
    "rescue": "put an image on a board through the boot loader in its chip's ROM, whatever its flash holds",
    "msp": "ask a running firmware over MSP, change and keep its settings",
    "motor": "turn motors on the bench, propellers off; stop them; set their directions and order",
    "rc": "send a firmware its channels over MSP, from a script or a gamepad",
    "monitor": "watch a running firmware live: state, attitude, channels, motors, battery, load",
    "gateway": "a running firmware as a MAVLink aircraft: QGroundControl, companion computers",
    "flash": "put an image or another policy onto a board that runs Neuroflight; list, go back",
    "log": "logs of flights: cards for them, getting them off the aircraft, reading them",
}
EXTRAS = {  # of pyproject.toml: packages that not every command needs, under the names they are imported by
    "gateway": ("pymavlink",),
    "sim": ("PIL", "cffi", "matplotlib", "pybullet", "scipy", "trimesh"),
    "train": (
        "gymnasium",
        "onnxruntime",
        "onnxscript",
        "sb3_contrib",
        "stable_baselines3",
        "tensorboard",
        "torch",
    ),
    "sweep": ("ray",),
}
ROOM_EXTRAS = {"training": "train", "training/evaluation": "train"}  # what every command there needs at least
# Matrices here are small: a second thread gains little, loses twenty times as much to a busy neighbour, and
# may round otherwise than the first alone, so that a seed would no longer say what a run gives.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


MENDS = {  # an operating system's error: what the user does about it
    errno.ENOSPC: "make room there, or choose another place",
    errno.EDQUOT: "make room there, or choose another place",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f), or choose another place",
    errno.EROFS: "choose a place that can be written, or make this one writable",
    errno.EACCES: "choose a place that you may use, or change its permissions",
    errno.EPERM: "choose a place that you may use, or change its permissions",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENOTDIR: "choose another place",
    errno.EISDIR: "name a file",
    errno.ENOENT: "check the name",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENOMEM: "close other programs, or ask for less at once",
    errno.EIO: "check the disk",
}
OF_WRITING = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
LINE_MAX = 2000  # characters of an error; what is longer quotes something of the user's at length
NAME_SHOWN = 200  # characters of a file's name


def parser() -> argparse.ArgumentParser:
    """The whole command line."""
    top = argparse.ArgumentParser(prog="neuroflight", description=SUMMARY)
    room_of = {name: room for room, names in ROOMS.items() for name in names}
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, summary in COMMANDS.items():
        sub = commands.add_parser(name, help=summary, description=summary)
        module = importlib.import_module(
            f"neuroflight.cli.{room_of[name].replace('/', '.')}.{name.replace('-', '_')}"
        )
        module.add_arguments(sub)
        sub.set_defaults(run=module.run)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command. Returns 0, or 1 after one line on stderr about a mistake of the user's."""
    for name in THREADS:  # numpy and torch read them when they are first imported, in a command's run
        os.environ.setdefault(name, "1")
    _open_standard_streams()
    try:
        args = parser().parse_args(argv)
        _check_stdout()
        code = run_command(args)
        sys.stdout.flush()
        return code
    except NeuroflightError as error:
        return _fail(f"{error}")
    except KeyboardInterrupt:
        _fail("interrupted; what was finished is kept")
        return 130
    except BrokenPipeError:  # the reader, `head` say, has seen enough
        _silence_stdout()
        return 1
    except OSError as error:
        return _fail(os_error_line(error))


def os_error_line(error: OSError) -> str:
    """What the operating system refused, where, and what the user does about it."""
    what = error.strerror or str(error) or type(error).__name__
    where = _where(error)
    mend = MENDS.get(error.errno or 0)
    return f"{where}{': ' if where else ''}{what}{'; ' if mend else ''}{mend or ''}"


def _where(error: OSError) -> str:
    """The file of an error. Whoever writes a file names it: an error without one is of other outputs."""
    if error.filename is not None:
        name = os.fsdecode(error.filename) if isinstance(error.filename, bytes) else str(error.filename)
        return name if len(name) <= NAME_SHOWN else f"{name[:NAME_SHOWN]}... ({len(name)} characters)"
    return "stdout or a temporary file" if error.errno in OF_WRITING else ""


def _fail(line: str) -> int:
    """Print one line on stderr; what stdout still holds is written before it, or never. Returns 1."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        _silence_stdout()
    if len(line) > LINE_MAX:
        line = f"{line[: LINE_MAX // 2]} ... {line[-LINE_MAX // 2 :]}"
    with contextlib.suppress(OSError):
        print(f"neuroflight: {line}", file=sys.stderr)
    return 1


def _silence_stdout() -> None:
    """What stdout still holds goes nowhere: else the interpreter tries again as it ends, and complains."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _open_standard_streams() -> None:
    """Numbers 0 to 2 that are closed lead nowhere: the next file that is opened would get one of them."""
    while (handle := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(handle, True)
    os.close(handle)
    if sys.stderr is None:
        sys.stderr = open(2, "w", closefd=False)  # noqa: SIM115 - open until the end


def _check_stdout() -> None:
    """Raise NeuroflightError if nobody could read the result of the work."""
    if sys.stdout is None:
        sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115 - open until the end
        raise NeuroflightError("stdout is closed; give it a place, such as >/dev/null")


def run_command(args: argparse.Namespace) -> int:
    """The command's exit code. Raises NeuroflightError where a package of an extra is not installed."""
    try:
        return int(args.run(args))
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        brings = [extra for extra, packages in EXTRAS.items() if package in packages]
        if not brings or importlib.util.find_spec(package) is not None:
            raise
        brings += [extra for room, extra in ROOM_EXTRAS.items() if args.command in ROOMS[room]]
        extra = max(brings, key=list(EXTRAS).index)  # the larger brings the smaller
        raise NeuroflightError(
            f"{args.command} needs {package}, which is not installed; "
            f"run: make setup EXTRA={extra}, or pip install 'neuroflight[{extra}]'"
        ) from error


if __name__ == "__main__":
    sys.exit(main())
