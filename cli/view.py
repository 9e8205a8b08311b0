"""`neuroflight view`: the aircraft in the attitudes of a flight, in a window, as HTML page, GIF or PNG."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.errors import NeuroflightError

if TYPE_CHECKING:
    from neuroflight.sim.aircraft.model import Aircraft
    from neuroflight.sim.blackbox.log import Log
    from neuroflight.sim.viewing.scene import Scene

FORMS = (".html", ".gif", ".png")
FPS, STRIP = 20, 6  # FPS: 1 / FRAME_S of the pictures
STRIP_MAX, FRAMES_MAX = 12, 600
ROWS_MAX = 2_000_000  # of a flight: half an hour at 1 kHz
MOUNTS = ("centre", "rig", "free")
SHORTER = "choose a part of it by --from and --to"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare flight and picture."""
    from neuroflight.cli.log.reading import add_part_arguments

    parser.add_argument(
        "flight",
        metavar="TRACE.npz|LOG.bbl[:N]|POLICY.onnx|pid[:NAME]",
        help="a flight's trace or log; or who is to fly --scenario now",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE.html|FILE.gif|FILE.png",
        help="a page that plays the flight, an animation, or poses; default: a window",
    )
    parser.add_argument("--aircraft", default="nf1", metavar="NAME|FILE", help="which is drawn, and flown")
    parser.add_argument("--scenario", default="roll", metavar="NAME|FILE", help="as of `fly`; default: roll")
    parser.add_argument("--mount", choices=MOUNTS, help="as of `fly`: free shows where the aircraft goes")
    parser.add_argument("--seed", type=int, default=1, metavar="S", help="of commands, noise and bias")
    add_part_arguments(parser, "the first armed row")
    parser.add_argument(
        "--at", type=float, nargs="+", metavar="SECONDS", help="PNG: the poses at these times"
    )
    parser.add_argument("--strip", type=int, metavar="N", help=f"PNG: N poses in equal steps ({STRIP})")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="of playing: 0.25 is four times slower; default: 1"
    )


def run(args: argparse.Namespace) -> int:
    """Read or fly, find the attitude, draw or play. Returns 0."""
    from neuroflight.cli.log.reading import tell_damage
    from neuroflight.sim.aircraft.model import load_aircraft

    _check(args)
    scene, log = _scene(args, load_aircraft(args.aircraft))
    steps, motors = scene.trace.dshot.shape
    if motors != scene.aircraft.motor_count:
        raise NeuroflightError(
            f"{args.flight}: a flight of {motors} motors, {scene.aircraft.name} has "
            f"{scene.aircraft.motor_count}; say by --aircraft which one flew"
        )
    if steps > ROWS_MAX:
        raise NeuroflightError(f"{args.flight}: {steps} rows, expected at most {ROWS_MAX}; {SHORTER}")
    told = _out(args, scene)
    print(f"{told}; {scene.source}")
    if log is not None:
        tell_damage(log)
    return 0


def _check(args: argparse.Namespace) -> None:
    import os

    from neuroflight.cli.log.reading import check_part
    from neuroflight.cli.output import check_output

    suffix = None if args.out is None else args.out.suffix
    if suffix is None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            raise NeuroflightError("no display for a window (DISPLAY is not set); give --out FILE.html")
    elif suffix not in FORMS:
        raise NeuroflightError(f"--out {args.out}: expected a name that ends in {', '.join(FORMS)}")
    else:
        check_output(args.out, suffix)
    check_part(args)
    if not 0.01 <= args.speed <= 10:
        raise NeuroflightError(f"--speed: got {args.speed:g}, expected 0.01 to 10")
    if args.strip is not None and not 1 <= args.strip <= STRIP_MAX:
        raise NeuroflightError(f"--strip: got {args.strip}, expected 1 to {STRIP_MAX}")
    if args.at is not None and len(args.at) > STRIP_MAX:
        raise NeuroflightError(f"--at: got {len(args.at)} times, expected at most {STRIP_MAX}")
    if args.at is not None and args.strip is not None:
        raise NeuroflightError("--at and --strip both choose the poses; give one of them")
    if suffix != ".png" and (args.at is not None or args.strip is not None):
        raise NeuroflightError(f"--at and --strip choose the poses of a .png, got --out {args.out}")


def _scene(args: argparse.Namespace, aircraft: Aircraft) -> tuple[Scene, Log | None]:
    """Return the flight, and the log that it was read from."""
    from neuroflight.cli.log.reading import part
    from neuroflight.sim.recorded.log import SUFFIXES, split_number
    from neuroflight.sim.viewing.scene import recorded

    path, number = split_number(Path(args.flight))
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from neuroflight.sim.blackbox.flight import cut
        from neuroflight.sim.flight.trace import load_trace

        trace = cut(load_trace(path), part(args))
        return recorded(path.name, aircraft, trace, args.start), None
    if suffix in SUFFIXES:
        from neuroflight.sim.blackbox.flight import log_trace
        from neuroflight.sim.blackbox.log import read_log

        log = read_log(path, number)
        name = f"{path.name}, log {log.number}"
        return recorded(name, aircraft, log_trace(log, part(args)), args.start), log
    if suffix == ".onnx" or args.flight.split(":")[0] == "pid":
        return _fly(args, aircraft).part(part(args)), None
    raise NeuroflightError(
        f"{args.flight}: expected a trace (.npz), a log ({', '.join(SUFFIXES)}), a policy (.onnx) or pid"
    )


def _fly(args: argparse.Namespace, aircraft: Aircraft) -> Scene:
    from contextlib import closing

    import numpy as np

    from neuroflight.cli.compare.controllers import say_foreign
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.flight.scenario import load_scenario
    from neuroflight.sim.physics.twin import Twin
    from neuroflight.sim.physics.world import Mount
    from neuroflight.sim.viewing.scene import Watch
    from neuroflight.training.evaluation.manoeuvres import port_controller

    if args.seed < 0:
        raise NeuroflightError(f"--seed: got {args.seed}, expected 0 or more")
    mount = None if args.mount is None else Mount(args.mount)
    scenario = load_scenario(args.scenario, args.seed, mount=mount)
    flown = port_controller(args.flight, aircraft)
    say_foreign([flown])
    with closing(flown.open()) as port:
        rng = np.random.default_rng((args.seed, 1))
        with closing(Twin(aircraft, rate_hz=port.gyro_rate_hz, mount=scenario.mount, rng=rng)) as twin:
            watch = Watch(twin)
            trace = fly(twin, port, scenario, watch=watch)
    return watch.scene(f"{flown.label}: {scenario.name}", aircraft, trace)


def _out(args: argparse.Namespace, scene: Scene) -> str:
    """Play or write the scene; return a line about it."""
    import numpy as np

    begin, end = float(scene.trace.t[0]), float(scene.trace.t[-1])
    if args.out is None:
        from time import monotonic, sleep

        from neuroflight.sim.viewing.window import play

        play(scene, args.speed, monotonic, sleep)
        return f"{scene.title}: {end - begin:.2f} s"
    if args.out.suffix == ".html":
        from neuroflight.sim.viewing import page

        times, limit = page.page_times(scene), page.FRAMES_MAX
    elif args.out.suffix == ".gif":
        times, limit = np.arange(begin, end + 1e-9, args.speed / FPS), FRAMES_MAX
    else:
        times, limit = np.linspace(begin, end, args.strip or STRIP), STRIP_MAX
        if args.at is not None:
            times = np.array(args.at)
            if not ((begin <= times) & (times <= end)).all():
                raise NeuroflightError(f"--at: expected times of the flight, {begin:g} to {end:.3f} s")
    if len(times) > limit:
        faster = " or raise --speed" if args.out.suffix == ".gif" else ""
        raise NeuroflightError(
            f"{args.flight}: {end - begin:.1f} s are {len(times)} frames, a {args.out.suffix} holds at most "
            f"{limit}; {SHORTER}{faster}"
        )
    if args.out.suffix == ".html":
        page.save_page(args.out, scene, args.speed)
    else:
        _draw(args.out, scene, scene.rows(times))
    return f"{args.out}: {len(times)} pose{'s' * (len(times) > 1)} of {end - begin:.2f} s"


def _draw(out: Path, scene: Scene, rows: list[int]) -> None:
    from rich.console import Console
    from rich.progress import Progress

    from neuroflight.sim.viewing.pictures import FRAME_S, save_gif, save_strip

    if out.suffix == ".png":
        save_strip(out, scene, rows)
        return
    hidden = not sys.stderr.isatty()
    with Progress(console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task("drawing", total=1.0)
        save_gif(out, scene, rows, FRAME_S, lambda done: bar.update(task, completed=done))
