"""`neuroflight msp`: query a running firmware over MSP; nothing is changed but what is acknowledged."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flash.acknowledge import Acknowledged
    from flash.client import Info


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the port and what can be asked."""
    parser.add_argument(
        "--port",
        required=True,
        metavar="PORT",
        help="tcp:HOST:PORT, serial:DEVICE[:BAUD] or a device such as /dev/ttyUSB0",
    )
    questions = parser.add_subparsers(dest="question", required=True, metavar="QUESTION")
    summary = "who the firmware is, which policy it flies and what forbids arming"
    info = questions.add_parser("info", help=summary, description=summary)
    info.add_argument("--json", action="store_true", help="print JSON instead of a table")
    summary = (
        "acknowledge logged faults and a policy that was refused in flight, so that the board arms again"
    )
    questions.add_parser("acknowledge", help=summary, description=summary)


def run(args: argparse.Namespace) -> int:
    """Query and print. Returns 0; raises LinkError when the firmware does not answer or refuses."""
    from flash.acknowledge import acknowledge
    from flash.client import Client, read_info
    from flash.transport import open_transport

    with Client(open_transport(args.port)) as client:
        if args.question == "acknowledge":
            print(_told(acknowledge(client)))
            return 0
        info = read_info(client)
    if args.json:
        print(json.dumps(asdict(info), indent=2))
    else:
        _print_table(info)
    return 0


def _told(known: Acknowledged) -> str:
    """What was acknowledged, in a line."""
    from toolchain.contract import FallbackCause

    told = []
    if known.fault is not None:
        told.append(f"fault {known.fault.kind.name} found by boot {known.fault.boot}, and all before it")
    if known.refused is not FallbackCause.NONE:
        told.append(f"the policy that was refused in flight: {known.refused.name}")
    return f"acknowledged: {'; '.join(told)}" if told else "there was nothing to acknowledge"


def _print_table(info: Info) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    for label, value in _rows(info):
        table.add_row(Text(label, style="bold"), Text(value, overflow="fold"))
    Console().print(table)


def _rows(info: Info) -> list[tuple[str, str]]:
    """Label and text of each line of the table."""
    board, build, policy = info.board, info.build, info.policy
    rows = [
        ("firmware", f"{info.variant} {info.version}, MSP API {info.api.major}.{info.api.minor}"),
        ("board", " ".join(filter(None, (board.identifier, board.manufacturer, board.name or board.target)))),
        ("build", f"{build.date} {build.time}, {build.revision}" if build.dated else "undated, reproducible"),
        ("name", info.name or "none given"),
        ("UID", info.uid),
    ]
    if policy is not None:
        rows += [
            ("policy", policy.name),
            ("policy sha256", policy.sha256),
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
