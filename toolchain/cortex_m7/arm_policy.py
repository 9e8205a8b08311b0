"""A compiled policy on the emulated Cortex-M7: its C linked alone, or inside an image that was built."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from elftools.elf.elffile import ELFFile

from neuroflight.toolchain.codegen.emit import ARITHMETIC, Emission
from neuroflight.toolchain.contract import DTCM, POLICY_WEIGHT_COUNT_MAX, Region
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, Program
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.files import write_text
from neuroflight.toolchain.ir.float32 import Float32

COMPILER = "arm-none-eabi-gcc"
PACKAGE = "gcc-arm-none-eabi"  # the system's package that brings it
CORE = ("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard")
CODE, DATA = 0x00010000, 0x20000000  # where code with its constants and where variables are linked
STATE_BYTES_MAX = DTCM.size  # of struct policy
# Code, constants and variables on pages of their own, so that the emulator can protect them.
LINK = (
    "-nostdlib",
    f"-Wl,-Ttext={CODE:#x},-Tdata={DATA:#x},-z,separate-code,-z,max-page-size=0x1000",
    "-Wl,-e,policy_step",
)


def build_policy_elf(emission: Emission, directory: Path, *options: str, optimization: str = "-O2") -> Path:
    """Write policy.c and policy.h into `directory` and link them, alone, to policy.elf. Returns its path.

    The flags are the firmware's; `options` come after them. Raises BuildError when the compiler is
    missing or refuses.
    """
    write_text(directory / "policy.h", emission.header)
    write_text(directory / "policy.c", emission.source)
    program = directory / "policy.elf"
    compile_arm("-g", optimization, *ARITHMETIC, *options, *LINK, "policy.c", "-lgcc", out=program)
    return program


def compile_arm(*arguments: str, out: Path) -> None:
    """Run the compiler for the Cortex-M7 in the folder of `out`, its output. Raises BuildError."""
    if shutil.which(COMPILER) is None:
        raise BuildError(f"{COMPILER} is not installed; run: sudo apt-get install {PACKAGE}")
    command = [COMPILER, *CORE, *arguments, "-o", out.name]
    plain = os.environ | {"LC_ALL": "C"}  # of quotes, in what the compiler says
    done = subprocess.run(command, cwd=out.parent, env=plain, capture_output=True, text=True)
    if done.returncode != 0:
        words = next(
            (line for line in done.stderr.splitlines() if "error" in line), done.stderr.strip()[:200]
        )
        raise BuildError(f"{COMPILER} cannot build {out.name}: {words}")


def state_bytes(program: Path) -> int:
    """Read sizeof(struct policy) from an ELF that was compiled with -g. Raises BuildError without it."""
    with program.open("rb") as file:
        elf = ELFFile(file)
        units = elf.get_dwarf_info().iter_CUs() if elf.has_dwarf_info() else ()
        for unit in units:
            for entry in unit.get_top_DIE().iter_children():
                name, size = entry.attributes.get("DW_AT_name"), entry.attributes.get("DW_AT_byte_size")
                if entry.tag == "DW_TAG_structure_type" and name and size and name.value == b"policy":
                    return int(size.value)
    raise BuildError(f"{program.name} does not tell the size of struct policy; compile it with -g")


def compiler_version() -> str:
    """Name and version of the compiler."""
    done = subprocess.run([COMPILER, "-dumpfullversion"], capture_output=True, text=True, check=True)
    return f"{COMPILER} {done.stdout.strip()}"


class ArmPolicy:
    """policy_init and policy_step of a program, called on an emulated core."""

    def __init__(self, program: Program, inputs: int, outputs: int, memory: Sequence[Region] = ()) -> None:
        """Load `program`, whose policy takes `inputs` and gives `outputs` values, and make the policy ready.

        memory: see CortexM7.
        """
        self.machine = CortexM7(program, memory)
        self.inputs, self.outputs = inputs, outputs
        self._state = self.machine.allocate(STATE_BYTES_MAX)
        self.observation = self.machine.allocate(4 * inputs)  # where `step` reads it
        self._action = self.machine.allocate(4 * outputs)
        self._table = self.machine.allocate(4 * POLICY_WEIGHT_COUNT_MAX)
        self._own = program.symbol("policy_weights").address
        self.step = ("policy_step", self._state, self.observation, self._action)
        self.init()

    def init(self, table: Float32 | None = None) -> None:
        """Call policy_init with another table of weights, or with the program's own if it is None."""
        if table is None:
            self.machine.call("policy_init", self._state, self._own)
            return
        self.machine.write(self._table, np.asarray(table, np.float32).tobytes())
        self.machine.call("policy_init", self._state, self._table)

    def observe(self, observation: Float32) -> None:
        """Put one observation (inputs,) where `step` reads it."""
        self.machine.write(self.observation, np.asarray(observation, np.float32).tobytes())

    def actions(self, observations: Float32) -> Float32:
        """Compute the actions (N, outputs) of observations (N, inputs), one call of policy_step each."""
        actions = np.empty((len(observations), self.outputs), np.float32)
        for observation, action in zip(observations, actions, strict=True):
            self.observe(observation)
            self.machine.call(*self.step)
            action[:] = np.frombuffer(self.machine.read(self._action, action.nbytes), np.float32)
        return actions
