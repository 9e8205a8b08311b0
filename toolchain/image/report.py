"""The report of a build: report.json for programs and a short table for people."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from neuroflight.toolchain.contract import FLASH_BANKS, IDLE_MAX, Mix, image_header
from neuroflight.toolchain.cortex_m7.cycles import CORE_HZ
from neuroflight.toolchain.cortex_m7.stack_use import StackUse
from neuroflight.toolchain.errors import BuildError, PolicyError
from neuroflight.toolchain.files import file_size
from neuroflight.toolchain.image.elf import MemoryUse, Section
from neuroflight.toolchain.policy.check_stamp import Stamp, parse_stamp
from neuroflight.toolchain.policy.gyro_filters import GyroFilters

if TYPE_CHECKING:
    from rich.console import Console

REPORT_BYTES_MAX = 1 << 20
DIGEST_SHOWN = 12  # digits of an aircraft's digest, for people
NO_PID = "NONE: where the policy must not fly on, the motors stop"
UNCHECKED = "UNCHECKED: no `neuroflight policy check` found it fit to fly"
CACHE_LINE_BYTES = 32  # of the Cortex-M7's instruction cache
TRAINING_SHOWN = ("algorithm", "steps", "seed")  # the entries of the training that the table has room for


@dataclass(frozen=True)
class Stage:
    """One of the three stages of the line: what it did, and how long it took [s] if it ran now."""

    name: str
    did: str
    seconds: float | None


@dataclass(frozen=True)
class PolicyFacts:
    """The policy in an image."""

    file: str
    sha256: str
    network: str
    observation: str
    control_rate_hz: int
    idle: float
    mix: str  # of outputs and throttle
    filters: tuple[object, ...]  # of the gyro, that it was trained behind
    weights: int
    architecture_hash: str
    aircraft: str
    aircraft_sha256: str
    training: dict[str, object]


@dataclass(frozen=True)
class AircraftFacts:
    """The aircraft that an image is for."""

    name: str
    sha256: str  # of what its twin flies
    file: str  # a shipped one's name, or the absolute path of its file
    own: bool  # whether the policy was trained on it; else the user said so


@dataclass(frozen=True)
class PidFacts:
    """The PID beside the policy."""

    aircraft: str
    name: str  # in the aircraft's file
    idle: float
    mix: str


@dataclass(frozen=True)
class BoardFacts:
    """The board that an image is for, and what serves what on it. None: it flies without."""

    name: str
    receiver: int  # number of its UART
    receiver_told: bool  # the user named it
    msp: int | None  # number of its UART
    second: int | None
    log: bool
    motors: int  # outputs
    left: tuple[str, ...]  # what it flies without and why


@dataclass(frozen=True)
class ImageSize:
    """The size of the image, by its ELF file [bytes]."""

    text_data_bss: int  # all sections that occupy memory while it runs, without the stack
    flash: int  # what is written to flash: boot part, code, constants, load images
    policy_code: int  # functions of policy.c
    policy_code_in_flash: int  # of them those that find no room in ITCM
    policy_weights: int  # its table


@dataclass(frozen=True)
class OutputFile:
    """A file that the build made, relative to the project."""

    path: str
    size: int
    sha256: str


@dataclass(frozen=True)
class BankImage:
    """The image for one bank of a board: what a board that runs it tells."""

    bank: str  # A or B
    build: str  # 16 hexadecimal digits, the same for both banks
    version: str
    bytes: int
    sha256: str


def bank_images(content: bytes) -> tuple[BankImage, ...]:
    """Return the images in a neuroflight.nfi, one behind the other."""
    found: list[BankImage] = []
    while (header := image_header(content)) is not None and header.image_bytes > 0:
        image, content = content[: header.image_bytes], content[header.image_bytes :]
        sha256 = hashlib.sha256(image).hexdigest()
        bank = "AB"[header.bank] if header.bank < len(FLASH_BANKS) else str(header.bank)
        found.append(BankImage(bank, header.build.hex(), header.version, len(image), sha256))
    return tuple(found)


@dataclass(frozen=True)
class BuildReport:
    """All that is known of a finished build."""

    target: str
    stages: tuple[Stage, ...]
    policy: PolicyFacts
    sections: tuple[Section, ...]
    memory: tuple[MemoryUse, ...]  # empty on the host
    files: tuple[OutputFile, ...]
    step_instructions: int | None  # of policy_step in this image, exactly; on the host None
    predicted_cycles: int | None  # of policy_step in this image
    predicted_cycles_reason: str | None  # why they are None
    pid: PidFacts | None = None  # None: none is built in
    aircraft: AircraftFacts | None = None  # None: not known
    budgets: tuple[MemoryUse, ...] = ()  # of the image's flash and RAM; empty on the host
    stack: StackUse | None = None  # at its deepest, by analysis
    stack_reason: str | None = None  # why it is not known
    image_size: ImageSize | None = None  # None on the host
    images: tuple[BankImage, ...] = ()  # one for each bank; none on the host
    check: Stamp | None = None  # that found the policy fit to fly; None: nothing did
    board: BoardFacts | None = None  # None on the host

    def document(self) -> dict[str, object]:
        """Return the content of report.json."""
        stack = None if self.stack is None else asdict(self.stack) | {"margin": self.stack.margin}
        check = None if self.check is None else dict(self.check.document)
        return asdict(replace(self, check=None)) | {"stack": stack, "check": check}


@dataclass(frozen=True)
class MotorFacts:
    """The mapping of a controller's outputs to motor values."""

    idle: float  # motor fraction without thrust
    mix: Mix


@dataclass(frozen=True)
class Built:
    """A build's report about one of its files."""

    sha256: str  # of the file
    policy: str  # its network, as "6-64-64-4 tanh"
    policy_file: str  # as it was named
    policy_sha256: str
    trained_on: str  # name of the policy's aircraft
    trained_on_sha256: str
    aircraft: AircraftFacts | None  # that it was built for; None: not known
    policy_motors: MotorFacts
    pid_motors: MotorFacts | None  # None: no PID is built in
    pid: str | None = None  # its name in the aircraft's file
    receiver: int | None = None  # UART of the receiver, where the user named one
    settings: Mapping[str, float] = field(default_factory=dict)  # without which the policy is refused


def built(product: Path) -> Built:
    """Read what is inside `product`, a file of a build, from the report.json beside it.

    Raises BuildError, one line, if that is missing, unreadable or about another file.
    """
    path = product.with_name("report.json")
    try:
        if (size := file_size(path)) > REPORT_BYTES_MAX:
            raise BuildError(f"{path} is {size} bytes, expected at most {REPORT_BYTES_MAX}; build it anew")
        report = json.loads(path.read_bytes())
        known = {str(file["sha256"]) for file in report["files"]}
        policy, pid, aircraft = report["policy"], report["pid"], report.get("aircraft")
        board = report.get("board") or {}
        found = Built(
            sha256=hashlib.sha256(product.read_bytes()).hexdigest(),
            policy=str(policy["network"]),
            policy_file=str(policy["file"]),
            policy_sha256=str(policy["sha256"]),
            trained_on=str(policy["aircraft"]),
            trained_on_sha256=str(policy["aircraft_sha256"]),
            aircraft=None if aircraft is None else _aircraft(aircraft),
            policy_motors=MotorFacts(float(policy["idle"]), Mix.of(str(policy["mix"]))),
            pid_motors=None if pid is None else MotorFacts(float(pid["idle"]), Mix.of(str(pid["mix"]))),
            pid=None if pid is None else str(pid["name"]),
            receiver=int(board["receiver"]) if board.get("receiver_told") is True else None,
            settings=GyroFilters.of(policy.get("filters", [])).settings,
        )
    except OSError as error:
        raise BuildError(f"cannot read {path} ({error.strerror}); build {product.name} anew") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BuildError(f"{path} does not tell what is inside; build {product.name} anew") from error
    for motors in filter(None, (found.policy_motors, found.pid_motors)):
        if not 0.0 <= motors.idle <= IDLE_MAX:
            raise BuildError(
                f"{path}: the policy's idle is {motors.idle}, expected 0 to {IDLE_MAX}; build it anew"
            )
    if found.sha256 not in known:
        raise BuildError(f"{path} is the report of another build than {product.name}; build it anew")
    return found


def needed_settings(product: Path) -> Mapping[str, float]:
    """Return the settings without which the firmware refuses the policy inside `product`, a file of a build.

    Empty if the report beside it does not tell.
    """
    try:
        return built(product).settings
    except BuildError:
        return {}


def _aircraft(table: Mapping[str, object]) -> AircraftFacts:
    words = {key: str(table[key]) for key in ("name", "sha256", "file")}
    return AircraftFacts(**words, own=table["own"] is True)


def read_check(product: Path) -> Stamp | None:
    """Read the stamp of the policy inside `product`, a file of a build, from the report.json beside it, or
    None.

    Raises BuildError or PolicyError if that is unreadable; neither names `product`.
    """
    path = product.with_name("report.json")
    try:
        if (size := file_size(path)) > REPORT_BYTES_MAX:
            raise BuildError(f"is not told of by {path}, which is {size} bytes")
        report = json.loads(path.read_bytes())
        found = report["check"]
    except OSError as error:
        raise BuildError(f"is not known to be checked: cannot read {path} ({error.strerror})") from error
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BuildError(f"is not told of by {path}") from error
    if found is None:
        return None
    try:
        return parse_stamp(found)
    except PolicyError as error:
        raise PolicyError(f"has no good stamp in {path}: {error}") from error


def built_motors(product: Path, *, pid: bool = False) -> MotorFacts:
    """Return idle and mix of the policy inside `product`, a file of a build, or of its PID.

    Raises BuildError as `built`, and when there is no PID.
    """
    found = built(product)
    if not pid:
        return found.policy_motors
    if found.pid_motors is None:
        raise BuildError(f"{product} has no PID built in; build it with --aircraft NAME|FILE")
    return found.pid_motors


def summary(report: BuildReport) -> str:
    """Return one sentence: what was built, of which policy, whether that may fly, what it falls back to."""
    policy, pid, aircraft = report.policy, report.pid, report.aircraft
    said = [UNCHECKED if report.check is None else report.check.text]
    if aircraft is not None and not aircraft.own:
        said.append(f"for aircraft {aircraft.name}, NOT the one that it was trained on")
    said.append(f"PID {NO_PID}" if pid is None else f"PID {pid.name} beside it")
    return f"{report.files[0].path}: policy {policy.file}, {', '.join(said)}"


def print_report(report: BuildReport, console: Console) -> None:
    """Print the table: stages, policy, memory, files."""
    from rich.table import Table

    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    table.add_column(style="bold", no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for index, stage in enumerate(report.stages):
        took = "" if stage.seconds is None else f" ({stage.seconds:.1f} s)"
        table.add_row("" if index else report.target, stage.name, stage.did + took)
    policy = report.policy
    training = ", ".join(_training(policy.training)) or "not told"
    table.add_row("policy", "network", f"{policy.network}, {policy.weights} weights, {policy.observation}")
    table.add_row("", "training", f"{policy.aircraft}, {policy.control_rate_hz} Hz, {training}")
    table.add_row("", "file", policy.file)
    table.add_row("", "sha256", f"{policy.sha256[:16]}… (whole in report.json)")
    table.add_row("", "aircraft", f"{policy.aircraft}, digest {policy.aircraft_sha256[:DIGEST_SHOWN]}")
    if needed := GyroFilters.of(policy.filters).settings:
        asked = " ".join(f"{name}={value:g}" for name, value in needed.items())
        table.add_row("", "settings", f"{asked}; with others the board refuses it")
    table.add_row("", "check", UNCHECKED if report.check is None else report.check.text)
    if report.step_instructions is not None:
        table.add_row("", "a step", _step(report))
    if report.image_size is not None:
        table.add_row("", "code", _code(report.image_size))
    if (aircraft := report.aircraft) is not None:
        whose = "the policy's own" if aircraft.own else "NOT the one that the policy was trained on"
        digest = aircraft.sha256[:DIGEST_SHOWN]
        table.add_row("aircraft", aircraft.name, f"{aircraft.file}, digest {digest}: {whose}")
    pid = report.pid
    fallback = NO_PID if pid is None else f"{pid.name} of aircraft {pid.aircraft}"
    table.add_row("PID", "built in", fallback)
    for title, uses in (("memory", report.memory), ("budget", report.budgets)):
        for index, use in enumerate(uses):
            share = f"{use.used:7,} of {use.size:7,} bytes, {100 * use.used / use.size:4.1f} %"
            table.add_row("" if index else title, use.region, share)
    if report.stack is not None:
        stack = report.stack
        at_most = f"{stack.worst:7,} of {stack.size:7,} bytes at worst, {stack.margin:,} to spare"
        table.add_row("", "stack", at_most)
    elif report.memory:
        table.add_row("", "stack", f"not known: {report.stack_reason}")
    if report.memory:
        sections = " · ".join(f"{section.name} {section.size:,}" for section in report.sections)
        table.add_row("", "sections", sections)
    for row in _board_rows(report.board):
        table.add_row(*row)
    if report.images:
        first = report.images[0]
        table.add_row("build", first.build, f"version {first.version}, as the board tells it")
    for index, file in enumerate(report.files):
        table.add_row("" if index else "files", f"{file.size:,} bytes", file.path)
    console.print(table)


def _board_rows(board: BoardFacts | None) -> Iterator[tuple[str, str, str]]:
    """Yield what serves what on the board, and what it flies without."""
    if board is None:
        return
    lines = (("receiver", board.receiver), ("MSP", board.msp), ("second serial port", board.second))
    uarts = ", ".join(f"{what} UART{number}" for what, number in lines if number is not None)
    yield "board", board.name, f"{board.motors} motor outputs, {uarts}"
    for one in board.left:
        part, _, why = one.partition(": ")
        yield "", "flies without", f"{part}: {why}"


def _training(facts: Mapping[str, object]) -> Iterator[str]:
    """Yield the entries of TRAINING_SHOWN in words: for a table, such as the algorithm's, its name."""
    for key in TRAINING_SHOWN:
        value = facts.get(key)
        value = value.get("name") if isinstance(value, dict) else value
        if isinstance(value, str | int):
            yield f"{key} {value:,}" if isinstance(value, int) else f"{key} {value}"


def _step(report: BuildReport) -> str:
    """Describe the cost of the policy's control step."""
    counted = f"{report.step_instructions:,} instructions"
    if report.predicted_cycles is None:
        return f"{counted}; no predicted cycles: {report.predicted_cycles_reason}"
    seconds = report.predicted_cycles / CORE_HZ
    return (
        f"{counted}, {report.predicted_cycles:,} cycles predicted: {1e6 * seconds:.0f} µs, "
        f"{100 * seconds * report.policy.control_rate_hz:.1f} % of its period"
    )


def _code(size: ImageSize) -> str:
    """Describe where the policy's code runs."""
    if size.policy_code_in_flash == 0:
        return f"{size.policy_code:,} bytes, all in ITCM"
    lines = -(-size.policy_code_in_flash // CACHE_LINE_BYTES)
    return (
        f"{size.policy_code:,} bytes, {size.policy_code_in_flash:,} of them run from flash for want of ITCM: "
        f"{lines} lines of the cache, whose misses no prediction counts"
    )
