"""`neuroflight view`: the aircraft in the attitudes of a flight, as PNG or animated GIF."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from sim.aircraft.model import Aircraft
    from sim.flight.trace import Trace

FPS, STRIP = 20, 6  # FPS: 1 / FRAME_S of the pictures
STRIP_MAX, FRAMES_MAX = 12, 600
ROWS_MAX = 2_000_000  # of a flight: half an hour at 1 kHz


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare flight and picture."""
    parser.add_argument(
        "flight",
        metavar="TRACE.npz|LOG.bbl|POLICY.onnx|pid[:NAME]",
        help="a flight's trace or log; or who is to fly --scenario now",
    )
    parser.add_argument(
        "--out", type=Path, required=True, metavar="FILE.gif|FILE.png", help="an animation, or poses"
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="which is drawn, and flown")
    parser.add_argument("--scenario", default="roll", metavar="NAME|FILE", help="as of `fly`; default: roll")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and bias")
    parser.add_argument(
        "--at", type=float, nargs="+", metavar="SECONDS", help="PNG: the poses at these times"
    )
    parser.add_argument("--strip", type=int, metavar="N", help=f"PNG: N poses in equal steps ({STRIP})")
    parser.add_argument("--speed", type=float, default=1.0, help="GIF: 0.25 is four times slower; default: 1")


def run(args: argparse.Namespace) -> int:
    """Read or fly, integrate, draw. Returns 0."""
    import numpy as np

    from cli.output import check_output
    from sim.aircraft.model import load_aircraft

    suffix = args.out.suffix
    if suffix not in (".gif", ".png"):
        raise NeuroflightError(f"--out {args.out}: expected a name that ends in .gif or .png")
    check_output(args.out, suffix)
    if not 0.01 <= args.speed <= 10:
        raise NeuroflightError(f"--speed: got {args.speed:g}, expected 0.01 to 10")
    if args.strip is not None and not 1 <= args.strip <= STRIP_MAX:
        raise NeuroflightError(f"--strip: got {args.strip}, expected 1 to {STRIP_MAX}")
    if args.at is not None and len(args.at) > STRIP_MAX:
        raise NeuroflightError(f"--at: got {len(args.at)} times, expected at most {STRIP_MAX}")
    if args.at is not None and args.strip is not None:
        raise NeuroflightError("--at and --strip both choose the poses; give one of them")
    if suffix == ".gif" and (args.at is not None or args.strip is not None):
        raise NeuroflightError(f"--at and --strip choose the poses of a .png, got --out {args.out}")
    aircraft = load_aircraft(args.aircraft)
    trace = _trace(args, aircraft)
    if len(trace.t) > ROWS_MAX:
        raise NeuroflightError(f"{args.flight}: {len(trace.t)} rows, expected at most {ROWS_MAX}")
    end = float(trace.t[-1])
    if suffix == ".png":
        times = args.at if args.at is not None else np.linspace(0.0, end, args.strip or STRIP).tolist()
        if not all(0.0 <= time <= end for time in times):
            raise NeuroflightError(f"--at: expected times of the flight, 0 to {end:.3f} s")
    else:
        times = np.arange(0.0, end + 1e-9, args.speed / FPS).tolist()
        if len(times) > FRAMES_MAX:
            raise NeuroflightError(
                f"{args.flight}: {end:.1f} s are {len(times)} frames, expected at most {FRAMES_MAX}; "
                f"raise --speed, or choose a .png"
            )
    _draw(args.out, aircraft, trace, np.searchsorted(trace.t, np.array(times) - 1e-9).tolist())
    print(
        f"{args.out}: {len(times)} poses of {end:.2f} s; attitude integrated from the rates, level at first"
    )
    return 0


def _trace(args: argparse.Namespace, aircraft: Aircraft) -> Trace:
    from sim.recorded.log import SUFFIXES, split_number

    path, number = split_number(Path(args.flight))
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from sim.flight.trace import load_trace

        return load_trace(path)
    if suffix in SUFFIXES:
        from sim.blackbox.flight import log_trace
        from sim.blackbox.log import read_log

        return log_trace(read_log(path, number))
    if suffix == ".onnx" or args.flight.split(":")[0] == "pid":
        return _fly(args, aircraft)
    raise NeuroflightError(
        f"{args.flight}: expected a trace (.npz), a log ({', '.join(SUFFIXES)}), a policy (.onnx) or pid"
    )


def _fly(args: argparse.Namespace, aircraft: Aircraft) -> Trace:
    from contextlib import closing

    import numpy as np

    from sim.flight.loop import fly
    from sim.flight.scenario import load_scenario
    from sim.physics.twin import Twin
    from training.evaluation.manoeuvres import load_contender

    if args.seed < 0:
        raise NeuroflightError(f"--seed: got {args.seed}, expected 0 or more")
    scenario = load_scenario(args.scenario, args.seed)
    with closing(load_contender(args.flight, aircraft, None).open()) as port:
        rng = np.random.default_rng((args.seed, 1))
        with closing(Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)) as twin:
            return fly(twin, port, scenario)


def _draw(out: Path, aircraft: Aircraft, trace: Trace, rows: list[int]) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from sim.viewing.pictures import FRAME_S, save_gif, save_strip
    from sim.viewing.poses import attitudes

    rotation = attitudes(trace.t, trace.rate)
    if out.suffix == ".png":
        save_strip(out, aircraft, trace, rotation, rows)
        return
    hidden = not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task("drawing", total=1.0)
        save_gif(out, aircraft, trace, rotation, rows, FRAME_S, lambda done: bar.update(task, completed=done))
