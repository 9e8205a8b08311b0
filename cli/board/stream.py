"""`neuroflight board stream`: a live table, lines, or a file."""

from __future__ import annotations

import csv
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.state import OnPort, connect
from neuroflight.cli.options import Json
from neuroflight.cli.output import check_output
from neuroflight.cli.report import console, print_json
from neuroflight.cli.requests import Option
from neuroflight.toolchain.errors import LinkError, NeuroflightError

if TYPE_CHECKING:
    from rich.table import Table

    from neuroflight.flash.monitoring.recording import Shape
    from neuroflight.flash.monitoring.stream import Sample, Stream

SHOWN_HZ = 10.0  # of the live table
Show = Callable[["Sample"], None]


@dataclass(frozen=True, kw_only=True)
class Streaming(OnPort):
    """A request for samples of the running firmware."""

    json: Json = False
    rate: Annotated[int, Option("HZ", "samples a second (default 100)")] = 100
    seconds: Annotated[float | None, Option("S", "end after so long; else by Ctrl-C")] = None
    out: Annotated[Path | None, Option("FILE", "write the samples to FILE.csv or FILE.npz")] = None

    def run(self) -> int:
        """Take samples until the time is over, or Ctrl-C; show or keep them."""
        from neuroflight.flash.link import messages
        from neuroflight.flash.monitoring.recording import Shape, write_recording
        from neuroflight.flash.monitoring.stream import Stream, decode_sample
        from neuroflight.toolchain.contract import Msp

        _check(self)
        with connect(self.port) as client:
            policy = messages.policy_info(client.request(Msp.POLICY_INFO))
            shape = Shape(policy.action_count, policy.observation_count, policy.action_count)
            stream = Stream(client, self.rate, policy.control_rate_hz)
            taken: list[Sample] = []
            problem: LinkError | None = None
            interrupted = False
            try:
                stream.begin()
                with _showing(self, stream, shape) as show:
                    _take(stream, self.seconds, taken if self.out else None, show)
            except LinkError as error:
                problem = error
            except KeyboardInterrupt:
                interrupted = True  # Ctrl-C is the usual way to end it
            finally:
                stream.stop()
            if interrupted and self.out:
                taken += [decode_sample(payload) for payload in stream.rest()]
        facts = {
            "rate_hz": stream.rate_hz,
            "asked_rate_hz": self.rate,
            "control_rate_hz": policy.control_rate_hz,
            "received": stream.received,
            "lost": stream.lost,
            "corrupt": client.corrupt,
            "policy": policy.name,
            "policy_sha256": policy.sha256,
        }
        if self.out is not None and taken:
            write_recording(self.out, taken, policy.control_rate_hz, shape, facts)
            if self.json:
                print_json({"file": str(self.out)} | facts)
            else:
                print(f"{self.out}: {_summary(stream, self.rate)}")
        elif sys.stdout.isatty() and not self.json:
            print(_summary(stream, self.rate))
        if problem is not None:
            raise problem
        return 0


def _check(args: Streaming) -> None:
    if args.seconds is not None and not 0 < args.seconds < 1e6:
        raise NeuroflightError(f"--seconds got {args.seconds:g}, expected more than 0")
    if args.out is not None:
        suffix = Path(args.out).suffix
        check_output(args.out, suffix if suffix in (".csv", ".npz") else ".csv or .npz")


def _take(stream: Stream, seconds: float | None, taken: list[Sample] | None, show: Show) -> None:
    from neuroflight.flash.monitoring.stream import decode_sample

    for payload in stream.payloads(seconds):
        sample = decode_sample(payload)
        if taken is not None:
            taken.append(sample)
        show(sample)


@contextmanager
def _showing(args: Streaming, stream: Stream, shape: Shape) -> Iterator[Show]:
    """Yield a function that shows each sample."""
    if sys.stdout.isatty() and not args.json:
        with _live(stream) as show:
            yield show
    elif args.out is not None:
        yield lambda sample: None
    elif args.json:
        yield lambda sample: print(json.dumps(asdict(sample)))
    else:
        yield _rows(stream, shape)


def _rows(stream: Stream, shape: Shape) -> Show:
    """Return a function that prints each sample as a line of CSV on stdout."""
    from neuroflight.flash.monitoring.recording import columns, row

    writer = csv.writer(sys.stdout, lineterminator="\n")

    def show(sample: Sample) -> None:
        if stream.received == 1:
            writer.writerow(columns(shape))
        writer.writerow(row(sample, stream.flown_s, shape))

    return show


@contextmanager
def _live(stream: Stream) -> Iterator[Show]:
    """Show a table on the terminal that follows the newest sample."""
    from rich.live import Live

    every = max(1, round(stream.rate_hz / SHOWN_HZ))
    with Live(console=console(), auto_refresh=False) as live:
        yield (
            lambda sample: (
                live.update(_table(sample, stream), refresh=True) if stream.received % every == 0 else None
            )
        )


def _table(sample: Sample, stream: Stream) -> Table:
    import math

    from rich.table import Table

    from neuroflight.flash.board.hints import words

    def angles(rates: tuple[float, ...]) -> str:
        return "  ".join(f"{math.degrees(rate):8.1f}" for rate in rates)

    rows = (
        ("time", f"{stream.flown_s:.2f} s, control step {sample.step}, {sample.cycles} cycles"),
        ("state", f"{words(sample.state)}, {'armed' if sample.armed else 'not armed'}"),
        ("flies", "PID" if sample.pid_flies else "policy"),
        ("setpoint", f"{angles(sample.setpoint)}  deg/s roll, pitch, yaw"),
        ("gyro", f"{angles(sample.gyro)}  deg/s"),
        ("throttle", f"{sample.throttle:8.3f}"),
        ("action", "  ".join(f"{value:8.3f}" for value in sample.action)),
        ("motors", "  ".join(f"{value:8d}" for value in sample.dshot) + "  DShot"),
        ("samples", f"{stream.received} at {stream.rate_hz} Hz, {stream.lost} lost; Ctrl-C ends"),
    )
    table = Table.grid(padding=(0, 2))
    for label, text in rows:
        table.add_row(label, text, style=None)
    return table


def _summary(stream: Stream, asked_hz: int) -> str:
    told = f"{stream.received} samples, {stream.flown_s:.2f} s, {stream.rate_hz} Hz"
    if stream.rate_hz != asked_hz:
        told += f" (asked for {asked_hz})"
    told += f", {stream.lost} lost"
    return f"{told}: choose a lower --rate or a faster msp_baud" if stream.lost else told
