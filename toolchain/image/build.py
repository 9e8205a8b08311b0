"""Builds a target around a policy: check, compile the policy, run make, read the image, report.

Whatever can be rejected is rejected before the first file is written. Make works in its own directory
and its products replace the old ones when all of them are there, so that a build that fails or is
interrupted leaves the last good image in place.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from neuroflight.toolchain import contract
from neuroflight.toolchain.boards.allocation import Allocation, allocate
from neuroflight.toolchain.boards.board_file import BESIDE, board_text, named_board
from neuroflight.toolchain.boards.description import BOARD_BYTES, pack
from neuroflight.toolchain.boards.gyro_kinds import FILES, with_kin
from neuroflight.toolchain.codegen.compiler import CompiledPolicy, compile_policy
from neuroflight.toolchain.cortex_m7.arm_policy import ArmPolicy
from neuroflight.toolchain.cortex_m7.emulator import load_program
from neuroflight.toolchain.cortex_m7.stack_use import StackError, StackUse, stack_use
from neuroflight.toolchain.cortex_m7.timing import Cost, mixed_observations, step_cost
from neuroflight.toolchain.errors import BuildError, PolicyError, WiringError
from neuroflight.toolchain.files import (
    locked,
    replacing,
    write_bytes_if_changed,
    write_text,
    write_text_if_changed,
)
from neuroflight.toolchain.image.elf import FLASH, Image, image_budgets, memory_use, read_image
from neuroflight.toolchain.image.fit import check_memories, policy_code, split
from neuroflight.toolchain.image.report import (
    AircraftFacts,
    BoardFacts,
    BuildReport,
    ImageSize,
    OutputFile,
    PidFacts,
    PolicyFacts,
    Stage,
    bank_images,
)
from neuroflight.toolchain.policy.check_stamp import Stamp
from neuroflight.toolchain.policy.model import PolicyModel, read_policy
from neuroflight.toolchain.rendering.contract_header import render_contract
from neuroflight.toolchain.rendering.pid_table import PidTable, render_pid_table

BOARD_FAMILY = "STM32F722"
BOARD_TABLE = "board.bin"  # what make stamps into the images of a board
BOARD_MEMORY = (contract.ITCM, contract.DTCM, contract.SRAM1, contract.SRAM2, FLASH)
NFI = "neuroflight.nfi"  # both banks' images, one behind the other
OBSERVATIONS = 12  # that a step inside the image is counted with: it takes the same route for all
PLAIN = re.compile(r"[\w./+@,-]+")  # a path that make takes for one word without a meaning of its own
STACK_SECTION = ".stack"  # of an image: room that nothing is linked into
NO_STACK = "the operating system gives this program its stack"
NO_CYCLES = "cycles are predicted for a board's Cortex-M7 only; build one"


@dataclass(frozen=True)
class Target:
    """Something that the firmware can be built for."""

    name: str
    family: str  # firmware/targets/<family>; what is compiled for one of a family serves all
    compiler: str
    packages: str  # the system's packages that bring the compiler
    products: tuple[str, ...]  # made by make; the first is the ELF that the report describes
    board: Allocation | None = None  # None: a program of this machine
    gyro_file: bytes = b""  # a gyro chip's configuration for the image; empty: none

    @property
    def motors(self) -> int:
        """Motor outputs: the host program has as many as the core drives."""
        return contract.MOTOR_COUNT_MAX if self.board is None else len(self.board.motors)

    @property
    def has_board_memory(self) -> bool:
        """Return True if it runs from a board's memories."""
        return self.board is not None


def stamped_gyro_file(name: str, base: Path) -> bytes:
    """Return the gyro chip's configuration that the target `name` was built with last; empty: none."""
    if name == HOST.name:
        return b""
    table = base / named_board(name).name / "make" / BOARD_TABLE
    kept = table.read_bytes()[BOARD_BYTES:] if table.is_file() else b""
    return kept if len(kept) == contract.GYRO_FILE_BYTES else b""  # else an older layout's


HOST = Target(
    name="HOST",
    family="HOST",
    compiler="gcc",
    packages="build-essential",
    products=("neuroflight", "libneuroflight.so"),
)


def find_target(name: str, receiver: int | None = None, gyro_file: bytes = b"") -> Target:
    """Return the target HOST, the board of that name, or the one that a TOML file of that name describes.

    receiver: the UART that a receiver is wired to, where it is not the usual one. gyro_file: what
    `read_gyro_file` has read; empty: nothing. Raises WiringError, and BuildError.
    """
    if name == HOST.name:
        if receiver is not None:
            raise BuildError(f"--receiver UART{receiver}: {HOST.name} has no UARTs; leave it out")
        if gyro_file:
            raise BuildError(f"--gyro-file: {HOST.name} has no gyro chip; leave it out")
        return HOST
    board = named_board(name)
    allocation = allocate(board, receiver)
    lacking = [] if gyro_file else [kind for kind in allocation.gyro_kinds if kind in FILES]
    for kind in lacking:
        if set(with_kin(board.gyro_kinds)) <= FILES.keys():
            raise WiringError(
                f"{board.name}: its gyro, a {kind}, measures only with its maker's configuration, which is "
                f"not here: give --gyro-file FILE, {FILES[kind]}"
            )
        allocation = replace(
            allocation,
            left=(
                *allocation.left,
                f"gyro {kind}: flown with --gyro-file, {FILES[kind]}, and gyro_alignment set",
            ),
        )
    return Target(
        name=board.name,
        family=BOARD_FAMILY,
        compiler="arm-none-eabi-gcc",
        packages="gcc-arm-none-eabi libnewlib-arm-none-eabi",
        products=(
            *("neuroflight.elf", "neuroflight.hex", "neuroflight.bin", "neuroflight.map"),
            *("neuroflight.dfu", "neuroflight-b.elf", NFI),
        ),
        board=allocation,
        gyro_file=gyro_file,
    )


# GNU ld's message when memory runs out in a way that `check_memories` does not foresee, and what to do about
# it for each region.
OVERFLOW = re.compile(r"region [`'\"]?(\w+)'? overflowed by (\d+) bytes")
ADVICE = {
    "BANK": "train fewer layers or fewer kinds of activation",
    "ITCM": "train fewer kinds of activation",
    "SRAM1": "observe fewer values",
}


class MakeError(BuildError):
    """A compilation that failed; `output` is all that make and the compiler said."""

    def __init__(self, message: str, output: str) -> None:
        """message: one line for the user; output: the compiler's own, for whoever mends the code."""
        super().__init__(message)
        self.output = output


def build(
    name: str,
    policy: Path,
    root: Path,
    folder: Path | None = None,
    pid: PidTable | None = None,
    aircraft: AircraftFacts | None = None,
    check: Stamp | None = None,
    receiver: int | None = None,
    gyro_file: bytes = b"",
) -> BuildReport:
    """Build the target `name` around the policy file `policy` in the project at `root`, and write its report.

    pid: what flies when the policy must not or the pilot does not want it to; None: nothing does.
    aircraft: that the image is for, for the report.
    check: found the policy fit to fly, for the report; `flash` refuses an image without.
    receiver: the UART that one is wired to, where it is not the board's usual one.
    gyro_file: what `read_gyro_file` has read, for a board with a gyro chip that needs it.

    Outputs go to root/build/<target>, objects to root/build/<family> and generated sources to
    root/firmware/generated/<family>, or all of them into `folder`, which leaves the user's images alone.
    Raises PolicyError or BuildError, one line, when something is missing or does not fit.
    """
    target = find_target(name, receiver, gyro_file)
    started = time.perf_counter()
    model = read_policy(policy)
    compiled = compile_policy(model)
    check_fit(compiled, target)
    _check_pid(pid, model)
    _check_tools(target)
    optimized = time.perf_counter()
    base = folder or root / "build"
    out, shared = base / target.name, base / target.family
    generated = shared / "generated" if folder else root / "firmware" / "generated" / target.family
    with locked(shared), nullcontext() if shared == out else locked(out):
        _write_generated(compiled, pid, generated)
        built = run_make(target, root, out, generated, shared)
        made, objects = out / "make" / target.products[0], shared / "make" / "obj"
        image = read_image(made)
        memory = memory_use(image) if target.has_board_memory else ()
        cost = _step_cost(compiled, made) if target.has_board_memory else None
        stack, no_stack = _stack(target, made, objects)
        files = tuple(_publish(out / "make" / name, out / name, root) for name in target.products)
        finished = time.perf_counter()
        report = BuildReport(
            target=target.name,
            stages=_stages(compiled, built, (optimized - started, finished - optimized)),
            policy=_facts(compiled, policy),
            pid=None if pid is None else PidFacts(pid.aircraft, pid.name, pid.idle, pid.mix.text),
            aircraft=aircraft,
            sections=image.sections,
            memory=memory,
            files=files,
            step_instructions=cost.instructions[1] if cost else None,
            predicted_cycles=round(cost.cycles[1]) if cost and cost.cycles else None,
            predicted_cycles_reason=cost.no_cycles_reason if cost else NO_CYCLES,
            budgets=image_budgets(image) if target.has_board_memory else (),
            stack=stack,
            stack_reason=no_stack,
            image_size=_image_size(image, objects, compiled) if target.has_board_memory else None,
            images=bank_images((out / NFI).read_bytes()) if NFI in target.products else (),
            check=check,
            board=_board_facts(target.board, told=receiver is not None),
        )
        if target.board is not None:
            write_text_if_changed(out / BESIDE, board_text(target.board.board))
        write_text(out / "report.json", json.dumps(report.document(), indent=2) + "\n")
    return report


def check_fit(compiled: CompiledPolicy, target: Target) -> None:
    """Raise PolicyError naming the first figure of the policy that this firmware cannot serve."""
    policy = compiled.policy
    rates = contract.CONTROL_RATES_HZ
    if policy.action_count > target.motors:
        raise PolicyError(
            f"the policy drives {policy.action_count} motors, {target.name} has {target.motors}; "
            "train it for an aircraft with no more"
        )
    if lacking := [term.name for term in policy.blocks if not term.block.in_firmware]:
        raise PolicyError(
            f"the policy observes {lacking[0]}, which the firmware has no source for; "
            "train it on other blocks"
        )
    try:
        contract.check_observation(policy.blocks, policy.action_count)
    except ValueError as error:
        raise PolicyError(f"the policy cannot be flown: {error}") from error
    if policy.control_rate_hz not in rates:
        raise PolicyError(
            f"the policy runs at {policy.control_rate_hz} Hz, "
            f"the firmware at {', '.join(map(str, rates))} Hz; train it at one of these rates"
        )
    try:
        policy.gyro_filters.check(policy.action_count, policy.control_rate_hz)
    except ValueError as error:
        raise PolicyError(f"the policy cannot be flown: {error}") from error
    check_memories(compiled.plan)


def _check_pid(pid: PidTable | None, policy: PolicyModel) -> None:
    if pid is not None and pid.motor_count != policy.action_count:
        raise BuildError(
            f"the PID of aircraft {pid.aircraft} drives {pid.motor_count} motors, the policy "
            f"{policy.action_count}; name another with --aircraft"
        )


def _check_tools(target: Target) -> None:
    for tool, packages in ((target.compiler, target.packages), ("make", "make")):
        if shutil.which(tool) is None:
            raise BuildError(f"{tool} is not installed; run: sudo apt-get install {packages}")


def _write_generated(compiled: CompiledPolicy, pid: PidTable | None, directory: Path) -> None:
    policy = compiled.policy
    table = render_pid_table(pid, policy.action_count, policy.control_rate_hz)
    write_text_if_changed(directory / "policy.c", compiled.emission.source)
    write_text_if_changed(directory / "policy.h", compiled.emission.header)
    write_text_if_changed(directory / "pid_table.c", table)
    write_text_if_changed(directory / "nf_contract.h", render_contract())


def run_make(target: Target, root: Path, out: Path, generated: Path, shared: Path | None = None) -> int:
    """Compile and link root/firmware around the sources in `generated`; returns how many files that took.

    Products go to out/make, objects to shared/make/obj; shared: None: `out`. Raises MakeError.
    """
    firmware = root / "firmware"
    folders = {"BUILD": out / "make", "GENERATED": generated, "OBJ": (shared or out) / "make" / "obj"}
    if target.board is not None:
        write_bytes_if_changed(out / "make" / BOARD_TABLE, pack(target.board) + target.gyro_file)
    with _named_for_make(folders, firmware) as names:
        command = ["make", "-C", str(firmware), f"-j{os.cpu_count() or 1}", f"TARGET={target.family}", *names]
        done = subprocess.run(
            [*command, "PYTHON=" + sys.executable.replace("$", "$$")],
            capture_output=True,
            text=True,
            errors="replace",
            env=_environment(os.environ),
        )
    if done.returncode != 0:
        kept = (out / target.products[0]).is_file()
        end = "the last good image is kept" if kept else "there is no image of an earlier build"
        words = done.stdout + done.stderr
        if (full := os.strerror(errno.ENOSPC)) in words:
            raise OSError(errno.ENOSPC, full, str(out))
        if (found := OVERFLOW.search(words)) is not None:
            region, over = found[1], int(found[2])
            advice = ADVICE.get(region, "train a smaller network")
            raise BuildError(
                f"the firmware around this policy does not fit {target.name}: {over:,} bytes too many for "
                f"{region}; {advice}; {end}"
            )
        raise MakeError(f"the firmware for {target.name} does not build; {end}", words)
    return sum(" -c " in line for line in done.stdout.splitlines())


@contextmanager
def _named_for_make(folders: Mapping[str, Path], firmware: Path) -> Iterator[list[str]]:
    """Yield NAME=PATH of folders for make, which cannot handle a space and some other characters in a path.

    A checkout in such a place still has plain paths relative to `firmware`, where make works. A folder
    elsewhere is reached by a link of a plain name.
    """
    with ExitStack() as links:
        named = []
        for name, path in folders.items():
            real = os.path.realpath(path)
            ways = (real, os.path.relpath(real, os.path.realpath(firmware)))
            plain = [way for way in ways if PLAIN.fullmatch(way)]
            if not plain:
                Path(real).mkdir(parents=True, exist_ok=True)
                link = Path(links.enter_context(tempfile.TemporaryDirectory(prefix="neuroflight-"))) / name
                link.symlink_to(real, target_is_directory=True)
                plain = [str(link)]
            named.append(f"{name}={plain[0]}")
        yield named


def _environment(environment: Mapping[str, str]) -> dict[str, str]:
    """Return `environment` without the job slots and variables of an outer make."""
    outer = ("MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL")
    return {name: value for name, value in environment.items() if name not in outer} | {"LC_ALL": "C"}


def _step_cost(compiled: CompiledPolicy, image: Path) -> Cost:
    """Measure policy_step inside the image. Raises FaultError if it fails there."""
    policy = compiled.policy
    arm = ArmPolicy(load_program(image), policy.observation_count, policy.action_count, BOARD_MEMORY)
    return step_cost(arm, mixed_observations(OBSERVATIONS, policy.observation_count))


def _image_size(image: Image, objects: Path, compiled: CompiledPolicy) -> ImageSize:
    code = policy_code(objects / "policy.o")
    _, slow = split(code)
    return ImageSize(
        text_data_bss=sum(section.size for section in image.sections if section.name != STACK_SECTION),
        flash=sum(segment.size for segment in image.segments),
        policy_code=sum(section.size for section in code),
        policy_code_in_flash=sum(section.size for section in slow),
        policy_weights=int(compiled.plan.table.nbytes),
    )


def _stack(target: Target, image: Path, objects: Path) -> tuple[StackUse | None, str | None]:
    """Compute the deepest stack of the image; None with the reason if that is unknown."""
    if not target.has_board_memory:
        return None, NO_STACK
    try:
        return stack_use(image, objects), None
    except StackError as error:
        return None, str(error)


def _publish(made: Path, published: Path, root: Path) -> OutputFile:
    """Put a product of make where users look for it, if it is another than the one there."""
    data = made.read_bytes()
    if not published.is_file() or published.read_bytes() != data:
        with replacing(published) as aside:
            aside.write_bytes(data)
        published.chmod(made.stat().st_mode & 0o777)
    name = published.relative_to(root) if published.is_relative_to(root) else published
    return OutputFile(str(name), len(data), hashlib.sha256(data).hexdigest())


def _stages(compiled: CompiledPolicy, built: int, seconds: tuple[float, float]) -> tuple[Stage, ...]:
    model = compiled.policy
    saved = sum(saving.operations for saving in compiled.savings)
    rewrites = ", ".join(saving.rewrite for saving in compiled.savings) or "nothing left to fold"
    made = f"{built} files compiled and linked" if built else "nothing changed"
    return (
        Stage("synthesis", f"trained earlier on aircraft {model.aircraft}", None),
        Stage("optimization", f"{rewrites}; {saved} operations saved", seconds[0]),
        Stage("compilation", f"{len(compiled.plan.calls)} kernel calls in C; {made}", seconds[1]),
    )


def _board_facts(board: Allocation | None, *, told: bool) -> BoardFacts | None:
    if board is None:
        return None
    return BoardFacts(
        name=board.board.name,
        receiver=board.receiver,
        receiver_told=told,
        msp=board.msp,
        second=board.second,
        log=board.log,
        motors=len(board.motors),
        left=board.left,
    )


def _facts(compiled: CompiledPolicy, file: Path) -> PolicyFacts:
    model: PolicyModel = compiled.policy
    return PolicyFacts(
        file=str(file),
        sha256=model.source_sha256,
        network=model.network.text,
        observation=model.observation,
        control_rate_hz=model.control_rate_hz,
        idle=model.idle,
        mix=model.mix.text,
        filters=tuple(model.filters),
        weights=int(compiled.plan.table.size),
        architecture_hash=f"{compiled.plan.architecture_hash:08x}",
        aircraft=model.aircraft,
        aircraft_sha256=model.aircraft_sha256,
        training=dict(model.training),
    )
