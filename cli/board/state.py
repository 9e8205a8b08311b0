"""`neuroflight board` info, status, tasks, faults, acknowledge, calibrate, reboot."""

from __future__ import annotations

from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from neuroflight.cli.options import Json, Port
from neuroflight.cli.report import Account, print_facts, print_json, print_table
from neuroflight.cli.requests import Either, Option, Request

if TYPE_CHECKING:
    from neuroflight.flash.board.acknowledge import Acknowledged
    from neuroflight.flash.board.info import Info as FirmwareInfo
    from neuroflight.flash.board.overview import Overview
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.link.messages import EscReport
    from neuroflight.flash.link.records import Fault, Tasks


INSTEAD = Either()


@dataclass(frozen=True, kw_only=True)
class OnPort(Request):
    """A request to a running firmware."""

    port: Port


def connect(port: str) -> Client:
    """Return a client on the port that the user named, whose other end speaks an MSP that this tool knows."""
    from neuroflight.flash.board.info import check_api
    from neuroflight.flash.link.client import Client
    from neuroflight.flash.link.transport import open_transport

    client = Client(open_transport(port))
    try:
        check_api(client)  # first: it closes a command line that another program left open on this port
    except BaseException:
        client.close()
        raise
    return client


# --- info ------------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Info(OnPort):
    """A request for the firmware's identity."""

    json: Json = False

    def run(self) -> int:
        """Print the identity of the firmware."""
        from neuroflight.flash.board.info import read_info

        with connect(self.port) as client:
            told = read_info(client)
        if self.json:
            print_json(asdict(told))
        else:
            print_facts(_info_rows(told))
        return 0


def _info_rows(info: FirmwareInfo) -> list[tuple[str, str]]:
    board, build, policy = info.board, info.build, info.policy
    rows = [
        ("firmware", f"{info.variant} {info.version}, MSP API {info.api.major}.{info.api.minor}"),
        (
            "board",
            " ".join(
                dict.fromkeys(filter(None, (board.identifier, board.manufacturer, board.target, board.name)))
            ),
        ),
        ("build", f"{build.date} {build.time}, {build.revision}" if build.dated else "undated, reproducible"),
        ("name", info.name or "none given"),
        ("UID", info.uid),
    ]
    if policy is not None:
        rows += [
            ("policy", policy.name),
            ("policy sha256", policy.sha256),
            ("trained on", _trained_on(policy.name, policy.sha256)),
            (
                "network",
                f"{policy.observation_count} observations to {policy.action_count} actions, "
                f"{policy.weight_count} weights, architecture {policy.architecture_hash:08x}",
            ),
            ("policy check", "passed" if policy.good else "FAILED: the motors stay stopped"),
            ("rates", f"control {policy.control_rate_hz} Hz, gyro {policy.gyro_rate_hz} Hz"),
        ]
    else:
        rows.append(("policy", "none: not a Neuroflight firmware"))
    rows += [
        ("armed", "yes" if info.armed else "no"),
        ("arming held by", ", ".join(info.arming_reasons) or "nothing"),
    ]
    return rows


def _trained_on(name: str, sha256: str) -> str:
    """Return the aircraft of a policy by SHA-256: the board tells its name, the policy's file the digest."""
    from neuroflight.cli.board.image_aircraft import DIGITS
    from neuroflight.cli.board.known_policies import known_policies

    known = known_policies([sha256], Path.cwd()).get(sha256)
    digest = "not known: the policy's file is not here" if known is None else known.aircraft_sha256[:DIGITS]
    return f"aircraft {name}, digest {digest}"


# --- status ----------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Status(OnPort):
    """A request for the state of the firmware."""

    json: Json = False

    def run(self) -> int:
        """Print the state of the firmware."""
        from neuroflight.flash.board.overview import read_overview

        with connect(self.port) as client:
            told = read_overview(client)
        if self.json:
            print_json(asdict(told))
        else:
            print_facts(_status_rows(told))
        return 0


def _status_rows(told: Overview) -> list[tuple[str, str]]:
    from neuroflight.cli.board.image_aircraft import NO_PID
    from neuroflight.flash.board.hints import brown_out, words

    flight, battery, attitude = told.flight, told.battery, told.attitude
    rows = [("armed", "yes" if told.armed else "no")]
    if flight is not None:
        if told.armed and flight.airborne is not None:
            rows[0] = ("armed", "yes, in the air" if flight.airborne else "yes, on the ground")
        rows.insert(0, ("state", words(flight.state)))
        rows += [
            ("flies", flight.flies),
            ("policy", f"{flight.policy}, {'good' if flight.policy_good else 'BAD: it does not fly'}"),
            ("PID", "built in" if flight.pid_built_in else NO_PID),
        ]
        level = flight.brown_out_level
        warmth = f"{flight.gyro_temperature_deg_c:.1f} deg C"
    held = [f"{name}: {hint}" if hint else name for name, hint in told.arming_reasons.items()]
    rows += [("arming held by" if i == 0 else "", line) for i, line in enumerate(held or ["nothing"])]
    if flight is not None:
        rows += [
            ("motors stopped last", words(flight.stop_cause)),
            ("PID took over last", words(flight.fallback_cause)),
            ("policy refused", "no" if flight.refused_cause == "NONE" else words(flight.refused_cause)),
            ("faults pending", "none" if flight.fault is None else f"{words(flight.fault)}; see `faults`"),
            ("boots", str(flight.boots)),
            *([] if level is None else [("brown-out", brown_out(level))]),
            ("gyro", ", ".join(filter(None, (flight.gyro_chip, words(flight.gyro_health), warmth)))),
        ]
    cells = f"{battery.cells} cells" if battery.cells else "cells not known"
    rows += [
        (
            "battery",
            f"{battery.voltage_v:.2f} V, {cells}, {words(battery.level.name)}; "
            f"{battery.current_a:.2f} A, {battery.drawn_mah} mAh drawn",
        ),
        ("receiver", f"{told.receiver_percent} %"),
        (
            "attitude",
            f"roll {attitude.roll_deg:.1f}, pitch {attitude.pitch_deg:.1f}, "
            f"heading {attitude.heading_deg:.0f} deg",
        ),
        ("load", f"{told.load_percent} %, control period {told.control_period_us} us"),
        *([("rotors", ", ".join(map(_rotor, told.escs)))] if told.escs else []),
    ]
    return rows


def _rotor(esc: EscReport) -> str:
    """Return what one motor's ESC tells: 7,210 rpm (31 deg C, 2 % of its answers lost)."""
    if esc.errors >= 1.0:
        return "silent"
    told = [f"{esc.temperature_c} deg C"] if esc.temperature_c else []
    told += [f"{esc.volts:.2f} V"] if esc.volts else []
    told += [f"{esc.amps:.1f} A"] if esc.amps else []
    told += [f"{100 * esc.errors:.1f} % of its answers lost"] if esc.errors else []
    return f"{esc.speed_rpm:,} rpm{' (' + ', '.join(told) + ')' if told else ''}"


# --- tasks -----------------------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class TaskLoads(OnPort):
    """A request for the processor's time, task by task."""

    json: Json = False

    def run(self) -> int:
        """Print the processor's time, task by task."""
        from neuroflight.flash.link import records
        from neuroflight.toolchain.contract import Msp

        with connect(self.port) as client:
            told = records.tasks(client.request(Msp.TASKS))
        rows = task_rows(told)
        if self.json:
            print_json({"cycles_hz": told.cycles_hz, "tasks": rows})
            return 0
        heads = ("task", "rate Hz", "runs", "worst us", "mean us", "best us", "variability %", "missed")
        us = ("worst_us", "mean_us", "best_us", "variability_percent")
        cells = [
            (
                str(row["task"]).lower(),
                str(row["rate_hz"] or "when due"),
                str(row["runs"]),
                *(f"{row[key]:.2f}" for key in us),
                str(row["misses"]),
            )
            for row in rows
        ]
        print_table("", [heads, *cells], numbers=heads[1:])
        return 0


def task_rows(told: Tasks) -> list[dict[str, str | int | float]]:
    us = 1e6 / told.cycles_hz
    return [
        {
            "task": load.task.name,
            "rate_hz": load.rate_hz,
            "runs": load.runs,
            "misses": load.misses,
            "worst_us": load.worst_cycles * us,
            "mean_us": load.mean_cycles * us,
            "best_us": load.best_cycles * us,
            "variability_percent": 100 * load.variability,
        }
        for load in told.loads
    ]


# --- faults, acknowledge ---------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Faults(OnPort):
    """A request for the newest fault."""

    json: Json = False
    ack: Annotated[bool, Option(None, "acknowledge it")] = False

    def run(self) -> int:
        """Print the record of the newest fault; acknowledge it if asked to."""
        from neuroflight.flash.link import records, requests
        from neuroflight.toolchain.contract import Msp

        with connect(self.port) as client:
            told = records.faults(client.request(Msp.FAULTS))
            gyro = records.safety(client.request(Msp.SAFETY)).gyro_chip
            if self.ack and told.pending is not None:
                client.request(Msp.FAULTS, requests.acknowledge(told.pending.boot))
        if self.json:
            known = None if told.pending is None else _fault_document(told.pending)
            acknowledged = bool(known and self.ack)
            print_json({"boots": told.boots, "fault": known, "acknowledged": acknowledged, "gyro": gyro})
        elif told.pending is None:
            print(f"no fault is pending; this is boot {told.boots}")
        else:
            print_facts([*_fault_rows(told.pending, told.boots), *([("gyro", gyro)] if gyro else [])])
            if self.ack:
                print(f"acknowledged: the fault that boot {told.pending.boot} found")
        return 0


def _fault_document(fault: Fault) -> dict[str, Any]:
    return asdict(fault) | {"kind": fault.kind.name}


def _fault_rows(fault: Fault, boots: int) -> list[tuple[str, str]]:
    from neuroflight.flash.board.hints import FAULTS
    from neuroflight.toolchain.contract import FaultKind

    rows = [
        ("fault", f"{fault.kind.name}: {FAULTS[fault.kind.name]}"),
        ("found by boot", f"{fault.boot}; this is boot {boots}"),
        ("after", f"{fault.uptime_steps} control steps"),
    ]
    if fault.file:
        rows.append(("at", f"{fault.file}:{fault.line}"))
    elif fault.kind is FaultKind.HARD:
        rows.append(("exception", str(fault.line)))
    registers = [f"{name} {value:08x}" for name, value in fault.registers.items()]
    if any(fault.registers.values()):
        lines = [", ".join(registers[at : at + 4]) for at in range(0, len(registers), 4)]
        rows += [("registers" if at == 0 else "", line) for at, line in enumerate(lines)]
    return rows


@dataclass(frozen=True, kw_only=True)
class Acknowledge(OnPort):
    """A request to acknowledge the conditions that keep the board from arming."""

    json: Json = False

    def run(self) -> int:
        """Acknowledge the conditions that keep the board from arming, and print them."""
        from neuroflight.flash.board.acknowledge import acknowledge

        with connect(self.port) as client:
            known = acknowledge(client)
        fault = None if known.fault is None else _fault_document(known.fault)
        return Account(self.json).end({"fault": fault, "refused": known.refused.name}, _acknowledged(known))


def _acknowledged(known: Acknowledged) -> str:
    from neuroflight.toolchain.contract import FallbackCause

    told = []
    if known.fault is not None:
        told.append(f"fault {known.fault.kind.name} found by boot {known.fault.boot}, and all before it")
    if known.refused is not FallbackCause.NONE:
        told.append(f"the policy that was refused in flight: {known.refused.name}")
    return f"acknowledged: {'; '.join(told)}" if told else "there was nothing to acknowledge"


# --- calibrate, reboot -----------------------------------------------------------------------------
@dataclass(frozen=True, kw_only=True)
class Calibrate(OnPort):
    """A request to measure the gyro's bias anew."""

    json: Json = False

    def run(self) -> int:
        """Have the gyro's bias measured anew and wait until it is known."""
        from neuroflight.flash.board.calibration import calibrate

        with connect(self.port) as client:
            calibrate(client)
            told = f"{client.name}: the gyro is calibrated"
            return Account(self.json).end({"port": client.name, "calibrated": True}, told)


@dataclass(frozen=True, kw_only=True)
class Reboot(OnPort):
    """A request to start the firmware anew."""

    rom: Annotated[
        bool,
        Option(None, "start the boot loader in the chip's ROM instead, for `board rescue`", either=INSTEAD),
    ] = False
    dfu: Annotated[
        bool, Option(None, "likewise, and wait until its USB boot loader is there", either=INSTEAD)
    ] = False
    card: Annotated[
        bool,
        Option(
            None,
            "show the SD card as a disk by USB instead, until it is ejected; a flash chip cannot be",
            either=INSTEAD,
        ),
    ] = False
    json: Json = False

    def run(self) -> int:
        """Start the firmware anew and wait until it answers, or the chip's ROM, or its card as a disk."""
        from neuroflight.flash.board.restart import enter_rom, show_card
        from neuroflight.flash.rom.dfu_board import into_dfu

        if self.dfu:
            port = into_dfu(connect(self.port))
            told = (
                f"{port}: the board waits in its ROM's USB boot loader\n"
                f"next: neuroflight board rescue IMAGE --port {port}; pulling the plug brings the firmware "
                "back"
            )
        elif self.rom:
            with connect(self.port) as client:
                enter_rom(client)
            told = (
                f"{client.name}: the board starts the boot loader in its chip's ROM\n"
                f"next: neuroflight board rescue IMAGE --port {self.port}; pulling the plug brings the "
                "firmware back"
            )
        elif self.card:
            with connect(self.port) as client:
                show_card(client)
            told = (
                f"{client.name}: the board shows its SD card as a disk by USB, which can be read, not "
                "written\n"
                "next: copy the logs; eject the disk, or pull the plug, and the firmware runs again"
            )
        else:
            told = started_anew(self.port)
        started = "card" if self.card else "dfu" if self.dfu else "rom" if self.rom else "firmware"
        return Account(self.json).end({"started": started}, told)


def started_anew(port: str) -> str:
    """Start the firmware anew, wait until it answers, and say so."""
    from neuroflight.flash.board.restart import restart
    from neuroflight.flash.link.transport import open_transport

    with closing(restart(connect(port), lambda: open_transport(port))) as client:
        return f"{client.name}: the firmware has started anew and answers"
