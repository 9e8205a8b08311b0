"""`neuroflight image build --target MATEKF722 --policy POLICY.onnx --aircraft NAME|FILE`."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from neuroflight.cli.board.built import built_last, host_is_older, note_built
from neuroflight.cli.image.checked import Unchecked, checked
from neuroflight.cli.report import print_json
from neuroflight.cli.requests import Either, Option, Request

if TYPE_CHECKING:
    from neuroflight.sim.control.pid_table import Beside
    from neuroflight.toolchain.image.report import AircraftFacts, Built

ROOT = Path(__file__).resolve().parents[2]
POLICIES = ROOT / "training" / "policies"
DEFAULT_AIRCRAFT = "nf1"


TOLD = Either()


@dataclass(frozen=True, kw_only=True)
class Build(Request):
    """A request for a firmware image, or the host program."""

    target: Annotated[
        str,
        Option(
            "TARGET",
            "a board of `neuroflight board target list`, a FILE.toml of `board target import`, or HOST; "
            "default: MATEKF722",
        ),
    ] = "MATEKF722"
    receiver: Annotated[
        str | None,
        Option("UARTn", "that a receiver is wired to, where it is not the board's usual one"),
    ] = None
    gyro_file: Annotated[
        Path | None,
        Option(
            "FILE.c",
            "that a board with a BMI270 needs, from the chip's maker: bmi270_maximum_fifo.c of "
            "github.com/boschsensortec/BMI270_SensorAPI",
        ),
    ] = None
    policy: Annotated[
        Path | None,
        Option(
            "POLICY.onnx",
            f"default: the shipped policy of the aircraft, without --aircraft of the {DEFAULT_AIRCRAFT}, "
            "or `any`, the one for every quadcopter",
        ),
    ] = None
    aircraft: Annotated[
        str | None,
        Option(
            "NAME|FILE",
            "that the policy was trained on, whose PID is built in beside it; needed where it is "
            "no shipped one",
        ),
    ] = None
    other_aircraft: Annotated[bool, Option(None, "--aircraft is meant, though the policy is another's")] = (
        False
    )
    no_pid: Annotated[
        bool, Option(None, "build in no PID: where the policy must not fly on, the motors stop")
    ] = False
    again: Annotated[
        bool,
        Option(
            None,
            "of the policy, aircraft and gyro's file that the target was built of last, HOST of a board's, "
            "if that was later; the first time, of the default",
        ),
    ] = False
    unchecked: Unchecked = False
    out: Annotated[Path | None, Option("DIR", "instead of build/ and firmware/generated/")] = None
    json: Annotated[bool, Option(None, "print the report as JSON", either=TOLD)] = False
    brief: Annotated[bool, Option(None, "print one line instead of the report", either=TOLD)] = False

    def run(self) -> int:
        """Build and print the report; output of the compiler is shown only when it failed."""
        from rich.console import Console

        from neuroflight.cli.output import check_folder
        from neuroflight.sim.aircraft.model import load_aircraft
        from neuroflight.sim.control.any_policy import ANY, own_file, policy_path
        from neuroflight.sim.control.pid_table import beside
        from neuroflight.toolchain.boards.gyro_file import read_gyro_file
        from neuroflight.toolchain.errors import PolicyError
        from neuroflight.toolchain.image.build import MakeError, build, find_target, stamped_gyro_file
        from neuroflight.toolchain.image.report import print_report, summary
        from neuroflight.toolchain.policy.model import read_policy

        receiver = _uart(self.receiver)
        gyro_file = read_gyro_file(self.gyro_file) if self.gyro_file else b""
        if self.again and not gyro_file:
            gyro_file = stamped_gyro_file(self.target, self.out or ROOT / "build")
        target = find_target(self.target, receiver, gyro_file)
        check_folder(self.out or ROOT / "build", "--out")
        if self.out is None:
            check_folder(ROOT / "firmware" / "generated", "--out")
        last = _last((self.out or ROOT / "build") / target.name / target.products[0])
        if self.again and self.out is None and target.name == "HOST" and host_is_older():
            last = _last(built_last() / "neuroflight.elf")  # what is to be flown is what was just built
        asked = self._as_last(last) if self.again else self
        if self.again and receiver is None and last is not None:
            receiver = last.receiver
        path = policy_path(asked._policy(last))
        if not path.exists():
            of = f" --aircraft {asked.aircraft}" if asked.aircraft else ""
            raise PolicyError(
                f"policy {path}: no such file; `neuroflight policy train{of} --out {path.parent}` makes one, "
                "or name another with --policy"
            )
        general, path = path, own_file(path, load_aircraft(asked.aircraft or DEFAULT_AIRCRAFT))
        if asked.policy is None and path != general:
            print(
                f"aircraft {asked.aircraft} has no policy of its own: building in `{ANY}`, made for it; "
                f"`neuroflight policy train --aircraft {asked.aircraft} --out DIR` makes its own",
                file=sys.stderr,
            )
        policy = read_policy(path)
        if policy.specialized:
            print(
                f"{policy.aircraft}: the image arms only once `neuroflight board motors check` was passed on "
                "its board, or with the setting motor_check=off",
                file=sys.stderr,
            )
        stands = beside(policy, str(path), asked.aircraft, other=asked.other_aircraft, no_pid=asked.no_pid)
        stamp = checked(path, policy, target, stands, unchecked=self.unchecked)
        try:
            report = build(
                self.target,
                path,
                ROOT,
                self.out,
                stands.pid,
                _facts(stands),
                check=stamp,
                receiver=receiver,
                gyro_file=gyro_file,
            )
        except MakeError as error:
            print(error.output, file=sys.stderr)
            raise
        if self.out is None and target.name != "HOST":
            note_built(target.name, self.target)
        if self.json:
            print_json(report.document())
        elif self.brief:
            print(summary(report))
        else:
            print_report(report, Console())
        return 0

    def _as_last(self, last: Built | None) -> Build:
        """Return the request with the policy and the aircraft of the last build, and say which."""
        from neuroflight.toolchain.errors import BuildError

        if self.policy is not None or self.aircraft is not None or self.other_aircraft or self.no_pid:
            raise BuildError("--again: got a policy or an aircraft beside it; give them, or --again alone")
        if last is None:
            return self
        asked, words = replace(self, policy=Path(last.policy_file)), ""
        usual = Path(last.policy_file).resolve() == default_policy(DEFAULT_AIRCRAFT)
        if (aircraft := last.aircraft) is not None:
            no_pid = last.pid_motors is None
            asked = replace(asked, aircraft=aircraft.file, other_aircraft=not aircraft.own, no_pid=no_pid)
            words = f", aircraft {aircraft.file}{', no PID' if no_pid else ''}"
            usual &= aircraft.file == DEFAULT_AIRCRAFT and not no_pid
        if not usual:
            print(f"as {self.target} was built last: policy {asked.policy}{words}", file=sys.stderr)
        return asked

    def _policy(self, last: Built | None) -> Path:
        """Return the policy to build in; say so where it is the default and was another until now."""
        from neuroflight.sim.control.any_policy import SHIPPED

        if self.policy is not None:
            return self.policy
        path = default_policy(self.aircraft or DEFAULT_AIRCRAFT)
        if not path.is_file():
            return SHIPPED
        if last is not None and Path(last.policy_file).resolve() != path:
            print(
                f"no policy is named: building the shipped one of {path.parent.name}, until now "
                f"{self.target} had {last.policy_file}",
                file=sys.stderr,
            )
        here = Path.cwd()
        return path.relative_to(here) if path.is_relative_to(here) else path


def _uart(word: str | None) -> int | None:
    """Return the number of UART4, or of 4. Raises BuildError."""
    from neuroflight.toolchain.errors import BuildError

    if word is None:
        return None
    number = word.upper().removeprefix("USART").removeprefix("UART")
    if number not in tuple("123456"):
        raise BuildError(f"--receiver: got {word[:60]!r}, expected UART1 to UART6")
    return int(number)


def _last(product: Path) -> Built | None:
    """Return the report of the target's last build; None: there is none, or it does not tell."""
    from neuroflight.toolchain.errors import BuildError
    from neuroflight.toolchain.image.report import built

    try:
        return built(product)
    except BuildError:
        return None


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
