"""`neuroflight image build --target MATEKF722 --policy POLICY.onnx --aircraft NAME|FILE`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.cli.image.checked import add_argument, checked

if TYPE_CHECKING:
    from neuroflight.sim.control.pid_table import Beside
    from neuroflight.toolchain.image.report import AircraftFacts, Built

ROOT = Path(__file__).resolve().parents[2]
POLICIES = ROOT / "training" / "policies"
DEFAULT_AIRCRAFT = "nf1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--target", default="MATEKF722", help="MATEKF722 (default) or HOST")
    parser.add_argument(
        "--policy",
        type=Path,
        metavar="POLICY.onnx",
        help=f"default: the shipped policy of the aircraft, without --aircraft of the {DEFAULT_AIRCRAFT}",
    )
    parser.add_argument(
        "--aircraft",
        metavar="NAME|FILE",
        help="that the policy was trained on, whose PID is built in beside it; needed where it is "
        "no shipped one",
    )
    parser.add_argument(
        "--other-aircraft", action="store_true", help="--aircraft is meant, though the policy is another's"
    )
    parser.add_argument(
        "--no-pid",
        action="store_true",
        help="build in no PID: where the policy must not fly on, the motors stop",
    )
    parser.add_argument(
        "--again",
        action="store_true",
        help="of the policy and aircraft that the target was built of last; the first time, of the default",
    )
    add_argument(parser)
    parser.add_argument("--out", type=Path, metavar="DIR", help="instead of build/ and firmware/generated/")
    told = parser.add_mutually_exclusive_group()
    told.add_argument("--json", action="store_true", help="print the report as JSON")
    told.add_argument("--brief", action="store_true", help="print one line instead of the report")


def run(args: argparse.Namespace) -> int:
    """Build and print the report; output of the compiler is shown only when it failed."""
    from rich.console import Console

    from neuroflight.cli.output import check_folder
    from neuroflight.sim.control.pid_table import beside
    from neuroflight.toolchain.errors import PolicyError
    from neuroflight.toolchain.image.build import MakeError, build, find_target
    from neuroflight.toolchain.image.report import print_report, summary
    from neuroflight.toolchain.policy.model import read_policy

    target = find_target(args.target)
    check_folder(args.out or ROOT / "build", "--out")
    if args.out is None:
        check_folder(ROOT / "firmware" / "generated", "--out")
    last = _last((args.out or ROOT / "build") / target.name / target.products[0])
    if args.again:
        _take_up(args, last)
    path = _policy(args, last)
    if not path.exists():
        of = f" --aircraft {args.aircraft}" if args.aircraft else ""
        raise PolicyError(
            f"policy {path}: no such file; `neuroflight policy train{of} --out {path.parent}` makes one, "
            "or name another with --policy"
        )
    policy = read_policy(path)
    stands = beside(policy, str(path), args.aircraft, other=args.other_aircraft, no_pid=args.no_pid)
    stamp = checked(path, policy, target, stands, unchecked=args.unchecked)
    try:
        report = build(args.target, path, ROOT, args.out, stands.pid, _facts(stands), check=stamp)
    except MakeError as error:
        print(error.output, file=sys.stderr)
        raise
    if args.json:
        print(json.dumps(report.document(), indent=2))
    elif args.brief:
        print(summary(report))
    else:
        print_report(report, Console())
    return 0


def _last(product: Path) -> Built | None:
    """Return the report of the target's last build; None: there is none, or it does not tell."""
    from neuroflight.toolchain.errors import BuildError
    from neuroflight.toolchain.image.report import built

    try:
        return built(product)
    except BuildError:
        return None


def _take_up(args: argparse.Namespace, last: Built | None) -> None:
    """Give `args` the policy and the aircraft of the last build, and say which."""
    from neuroflight.toolchain.errors import BuildError

    if args.policy is not None or args.aircraft is not None or args.other_aircraft or args.no_pid:
        raise BuildError("--again: got a policy or an aircraft beside it; give them, or --again alone")
    if last is None:
        return
    args.policy, words = Path(last.policy_file), ""
    usual = args.policy.resolve() == default_policy(DEFAULT_AIRCRAFT)
    if (aircraft := last.aircraft) is not None:
        args.aircraft, args.other_aircraft = aircraft.file, not aircraft.own
        args.no_pid = last.pid_motors is None
        words = f", aircraft {aircraft.file}{', no PID' if args.no_pid else ''}"
        usual &= aircraft.file == DEFAULT_AIRCRAFT and not args.no_pid
    if not usual:
        print(f"as {args.target} was built last: policy {args.policy}{words}", file=sys.stderr)


def _policy(args: argparse.Namespace, last: Built | None) -> Path:
    """Return the policy to build in; say so where it is the default and was another until now."""
    from neuroflight.toolchain.errors import PolicyError

    if args.policy is not None:
        return Path(args.policy)
    path = default_policy(args.aircraft or DEFAULT_AIRCRAFT)
    if not path.is_file():
        raise PolicyError(
            f"no policy ships for aircraft {args.aircraft}: name one with --policy; `neuroflight policy "
            f"train --aircraft {args.aircraft} --out DIR` makes one"
        )
    if last is not None and Path(last.policy_file).resolve() != path:
        print(
            f"no policy is named: building the shipped one of {path.parent.name}, until now "
            f"{args.target} had {last.policy_file}",
            file=sys.stderr,
        )
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def default_policy(aircraft: str) -> Path:
    """Return the policy that ships for an aircraft, if one does."""
    return POLICIES / aircraft / "policy.onnx"


def _facts(stands: Beside) -> AircraftFacts | None:
    """Return the aircraft's facts for the report."""
    from neuroflight.sim.aircraft.model import aircraft_file, shipped
    from neuroflight.sim.aircraft.props_out import SUFFIX
    from neuroflight.toolchain.image.report import AircraftFacts

    if (aircraft := stands.aircraft) is None:
        return None
    file = stands.name
    if file.removesuffix(SUFFIX) not in shipped():
        file = f"{aircraft_file(file).resolve()}{SUFFIX if file.endswith(SUFFIX) else ''}"
    return AircraftFacts(aircraft.name, aircraft.sha256, file, stands.own)
