"""`neuroflight view`: the aircraft in the attitudes of a flight, in a window, as HTML page, GIF or PNG."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json, OfPart
from neuroflight.cli.progress import progress_bars
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Argument, Option
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


@dataclass(frozen=True, kw_only=True)
class View(OfPart):
    """A request to see the aircraft in a flight."""

    flight: Annotated[
        str,
        Argument(
            "TRACE.npz|LOG.bbl[:N]|POLICY.onnx|pid[:NAME]",
            "a flight's trace or log; or who is to fly --scenario now",
        ),
    ]
    out: Annotated[
        Path | None,
        Option(
            "FILE.html|FILE.gif|FILE.png",
            "a page that plays the flight, an animation, or poses; default: a window",
        ),
    ] = None
    aircraft: Annotated[str, Option("NAME|FILE", "which is drawn, and flown")] = "nf1"
    scenario: Annotated[str, Option("NAME|FILE", "as of `fly`; default: roll")] = "roll"
    mount: Annotated[
        str | None, Option(None, "as of `fly`: free shows where the aircraft goes", choices=MOUNTS)
    ] = None
    seed: Annotated[int, Option("S", "of commands, noise and bias", low=0)] = 1
    at: Annotated[tuple[float, ...] | None, Option("S", "PNG: the poses at these times", most=STRIP_MAX)] = (
        None
    )
    strip: Annotated[
        int | None, Option("N", f"PNG: N poses in equal steps ({STRIP})", low=1, high=STRIP_MAX)
    ] = None
    speed: Annotated[
        float, Option("FACTOR", "of playing: 0.25 is four times slower; default: 1", low=0.01, high=10.0)
    ] = 1.0
    json: Json = False

    def run(self) -> int:
        """Read or fly, find the attitude, draw or play. Returns 0."""
        from neuroflight.cli.log.reading import tell_damage
        from neuroflight.sim.aircraft.model import load_aircraft

        _check(self)
        scene, log = _scene(self, load_aircraft(self.aircraft))
        steps, motors = scene.trace.dshot.shape
        if motors != scene.aircraft.motor_count:
            raise NeuroflightError(
                f"{self.flight}: a flight of {motors} motors, {scene.aircraft.name} has "
                f"{scene.aircraft.motor_count}; say by --aircraft which one flew"
            )
        if steps > ROWS_MAX:
            raise NeuroflightError(f"{self.flight}: {steps} rows, expected at most {ROWS_MAX}; {SHORTER}")
        told = _out(self, scene)
        if self.json:
            print_json({"flight": self.flight, "title": scene.title, "attitude": scene.source, **told})
        else:
            print(f"{_told(told)}; {scene.source}")
        if log is not None:
            tell_damage(log)
        return 0


def _check(args: View) -> None:
    import os

    from neuroflight.cli.output import check_output

    suffix = None if args.out is None else args.out.suffix
    if suffix is None:
        if sys.platform == "linux" and not os.environ.get("DISPLAY"):
            raise NeuroflightError("no display for a window (DISPLAY is not set); give --out FILE.html")
    elif suffix not in FORMS:
        raise NeuroflightError(f"--out {args.out}: expected a name that ends in {', '.join(FORMS)}")
    else:
        check_output(args.out, suffix)
    if args.at is not None and args.strip is not None:
        raise NeuroflightError("--at and --strip both choose the poses; give one of them")
    if suffix != ".png" and (args.at is not None or args.strip is not None):
        raise NeuroflightError(f"--at and --strip choose the poses of a .png, got --out {args.out}")


def _scene(args: View, aircraft: Aircraft) -> tuple[Scene, Log | None]:
    """Return the flight, and the log that it was read from."""
    from neuroflight.sim.recorded.log import SUFFIXES, split_number
    from neuroflight.sim.viewing.scene import recorded

    path, number = split_number(Path(args.flight))
    suffix = path.suffix.lower()
    if suffix == ".npz":
        from neuroflight.sim.blackbox.flight import cut
        from neuroflight.sim.flight.trace import load_trace

        trace = cut(load_trace(path), args.part)
        return recorded(path.name, aircraft, trace, args.part.start_s), None
    if suffix in SUFFIXES:
        from neuroflight.sim.blackbox.flight import log_trace
        from neuroflight.sim.blackbox.log import read_log

        log = read_log(path, number)
        name = f"{path.name}, log {log.number}"
        return recorded(name, aircraft, log_trace(log, args.part), args.part.start_s), log
    if suffix == ".onnx" or args.flight.split(":")[0] == "pid":
        return _fly(args, aircraft).part(args.part), None
    raise NeuroflightError(
        f"{args.flight}: expected a trace (.npz), a log ({', '.join(SUFFIXES)}), a policy (.onnx) or pid"
    )


def _fly(args: View, aircraft: Aircraft) -> Scene:
    from contextlib import closing

    import numpy as np

    from neuroflight.cli.compare.controllers import say_foreign
    from neuroflight.sim.flight.loop import fly
    from neuroflight.sim.flight.scenario import load_scenario
    from neuroflight.sim.physics.twin import Twin
    from neuroflight.sim.physics.world import Mount
    from neuroflight.sim.viewing.scene import Watch
    from neuroflight.training.evaluation.manoeuvres import port_controller

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


def _told(told: Mapping[str, Any]) -> str:
    """Return what `_out` did, in words."""
    if told["written"] is None:
        return f"{told['title']}: {told['seconds']:.2f} s"
    return f"{told['written']}: {told['poses']} pose{'s' * (told['poses'] > 1)} of {told['seconds']:.2f} s"


def _out(args: View, scene: Scene) -> dict[str, Any]:
    """Play or write the scene; return what was done."""
    import numpy as np

    begin, end = float(scene.trace.t[0]), float(scene.trace.t[-1])
    if args.out is None:
        from time import monotonic, sleep

        from neuroflight.sim.viewing.window import play

        play(scene, args.speed, monotonic, sleep)
        return {"title": scene.title, "written": None, "seconds": end - begin}
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
        _draw(args.out, scene, scene.rows(times), quiet=args.json)
    return {"title": scene.title, "written": str(args.out), "poses": len(times), "seconds": end - begin}


def _draw(out: Path, scene: Scene, rows: list[int], *, quiet: bool) -> None:
    from neuroflight.sim.viewing.pictures import FRAME_S, save_gif, save_strip

    if out.suffix == ".png":
        save_strip(out, scene, rows)
        return
    with progress_bars(quiet) as bar:
        save_gif(out, scene, rows, FRAME_S, bar("drawing"))
