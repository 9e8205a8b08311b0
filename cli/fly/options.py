"""The options of `neuroflight fly`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from neuroflight.cli.image.emulated import GYROS as CHIPS
from neuroflight.cli.options import HOST, FlownSettings, Json, OfRecording, On, Plot, picture
from neuroflight.cli.requests import Option, Request
from neuroflight.toolchain.contract import GYRO_RATE_DEFAULT_HZ, GYRO_RATES_HZ

SECTION = "with --on board, see docs/explanation/emulated-board.md"
STOPPED = 3  # exit code of a flight with faults in which the firmware stopped the motors before the end
ESCS = {"dshot150": 150, "dshot300": 300, "dshot600": 600}
MOUNTS = ("centre", "rig", "free")
CONTROLLERS = ("policy", "pid")
COUNT, COUNTED = 10, ("flight", "pulses")  # commands, of these scenarios
WIND_MAX = 50.0  # [m/s]; beyond any wind that such an aircraft could fly in
RECEIVERS = ("sbus", "crsf")  # in the order of the setting's choices


@dataclass(frozen=True, kw_only=True)
class OnBoard(Request):
    """Options of the emulated board."""

    gyro: Annotated[
        str | None,
        Option(
            None,
            "the chip that is fitted; default: one that boards of the image's name carry",
            choices=CHIPS,
            section=SECTION,
        ),
    ] = None
    card: Annotated[
        Path | None,
        Option(
            "IMG",
            "what keeps logs: the raw image of an SD card, or the content of the board's flash chip, made if "
            "there is none; it is written to; default: an empty slot",
            section=SECTION,
        ),
    ] = None
    esc: Annotated[
        str | None,
        Option(
            None,
            "the speed that the ESCs are set to; default: what the setting motor_protocol says",
            choices=tuple(ESCS),
            section=SECTION,
        ),
    ] = None
    fault: Annotated[
        tuple[str, ...],
        Option(
            "NAME[=VALUE]@SECONDS",
            "let something go wrong: gyro-silent, spi-bit-errors, brown-out, reset, flash-cut, crystal, "
            "hang, processor-fault, motors-stuck, overload or receiver-broken; with --card also card-stall, "
            "card-removed, card-errors, card-worn or card-slow; @boot: from power on. "
            f"Exit code {STOPPED} if the motors stop before the end",
            once=True,
            section=SECTION,
        ),
    ] = ()
    serial: Annotated[
        tuple[str, ...],
        Option(
            "[uartN=]pty|tcp[:PORT]",
            "lead the UART where MSP is spoken to other programs; uartN=...: the board's second serial port, "
            "as uart3, with --set uart3_function=msp",
            once=True,
            section=SECTION,
        ),
    ] = ()
    gdb: Annotated[
        int | None, Option("PORT", "wait for gdb on this port, at the first instruction", section=SECTION)
    ] = None
    profile: Annotated[
        Path | None, Option("DIR", "write what the image executed into DIR", section=SECTION)
    ] = None


@dataclass(frozen=True, kw_only=True)
class FlyOptions(OnBoard, OfRecording):
    """A request for a flight, or several, without its work."""

    on: On = HOST
    build: Annotated[
        Path | None,
        Option(
            "DIR",
            "the build to fly; default: build/HOST, with board that of the board built for last, with "
            "betaflight build/BETAFLIGHT",
        ),
    ] = None
    controller: Annotated[
        str,
        Option(
            None,
            "what the pilot's switch chooses: the policy, or the PID that is built in beside it",
            choices=CONTROLLERS,
        ),
    ] = CONTROLLERS[0]
    scenario: Annotated[
        tuple[str, ...],
        Option(
            "NAME|FILE",
            "flight (ten commands and a hover, the default), pulse, pulses, roll, flip, turns, sticks, "
            "freestyle, a .toml file, or a flight's recorded commands: a trace (.npz), a table (.csv), a "
            "blackbox log (.bbl, .bfl, .txt; FILE:N for its log N); of several only the firmware's flights, "
            "a row each",
        ),
    ] = ("flight",)
    seed: Annotated[int, Option("S", "of commands, noise and bias", low=0)] = 1
    count: Annotated[int | None, Option("N", f"commands of `flight` and `pulses` ({COUNT})")] = None
    throttle: Annotated[
        float | None,
        Option(
            "T",
            "of flight, pulse, pulses, roll, flip and turns, 0..1; default: what holds the aircraft's "
            "weight; 0: closed, as the dissertation flew",
            low=0.0,
            high=1.0,
        ),
    ] = None
    aircraft: Annotated[
        str | None,
        Option("NAME|FILE", "whose twin is flown; default: the one that the firmware was built for"),
    ] = None
    gyro_hz: Annotated[int, Option(None, "samples of the gyro a second", choices=GYRO_RATES_HZ)] = (
        GYRO_RATE_DEFAULT_HZ
    )
    set: FlownSettings = ()
    receiver: Annotated[str, Option(None, "what brings the pilot's sticks", choices=RECEIVERS)] = RECEIVERS[0]
    mount: Annotated[
        str | None, Option(None, "what holds the aircraft; default: the scenario's", choices=MOUNTS)
    ] = None
    battery: Annotated[
        float | None,
        Option(
            "CHARGE",
            "fly on the aircraft's battery, charged so far, 0..1 (1); default: the bench supply",
            low=0.0,
            high=1.0,
            number="?",
            bare=1.0,
        ),
    ] = None
    wind: Annotated[
        tuple[float, ...],
        Option(
            ("NORTH", "WEST", "UP"),
            "where the air moves [m/s]",
            low=-WIND_MAX,
            high=WIND_MAX,
            unit="m/s",
            number=3,
        ),
    ] = (0.0, 0.0, 0.0)
    gust: Annotated[
        float,
        Option(
            "SPEED",
            "wind 20 feet above the ground whose turbulence is flown in [m/s]; 7.7 light, 15.4 moderate",
            low=0.0,
            high=WIND_MAX,
            unit="m/s",
        ),
    ] = 0.0
    ground: Annotated[bool, Option(None, "put ground below; with mount free only")] = False
    trace: Annotated[Path | None, Option("FILE.npz", "keep the firmware's flight", suffix=".npz")] = None
    plot: Plot = None
    telemetry: Annotated[
        Path | None,
        Option(
            "FILE.csv",
            "keep what its ESCs tell: speed, temperature, voltage, current, force and torque of each",
            suffix=".csv",
        ),
    ] = None
    telemetry_plot: Annotated[Path | None, picture("draw that")] = None
    report: Annotated[Path | None, Option("FILE.html", "plot and figures on one page", suffix=".html")] = None
    blackbox: Annotated[
        Path | None,
        Option(
            "FILE.bbl",
            "keep the firmware's log of the flight, see docs/guides/logs.md; the emulated board sends it by "
            "UART3, or, with --card, writes it there instead",
            suffix=".bbl",
        ),
    ] = None
    all: Annotated[bool, Option(None, "print every figure, not the five of most use")] = False
    json: Json = False
    jobs: Annotated[
        int | None,
        Option(
            "N",
            "flights at a time, each in a process of its own; default: the computer's cores; they are the "
            "same with any N",
            low=1,
        ),
    ] = None
