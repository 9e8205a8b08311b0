"""The opponent: PyPI's emx-onnx-cgen, compiled with our flags and counted by our code.

It is fetched by pip into build/, at a pinned version, and run as a program of its own. Its C calls libm's
tanhf; newlib's is linked and its blocks are counted like all others.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from neuroflight.toolchain.codegen.emit import ARITHMETIC
from neuroflight.toolchain.cortex_m7.arm_policy import CODE, DATA, compile_arm
from neuroflight.toolchain.cortex_m7.emulator import CortexM7, load_program
from neuroflight.toolchain.cortex_m7.timing import Cost, call_cost
from neuroflight.toolchain.errors import BuildError
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.ir.onnx_export import to_model

VERSION = "1.4.0"
REQUIREMENTS = (f"emx-onnx-cgen=={VERSION}", "emx-regex-cgen==0.2.0")  # what else it needs, we have
FOLDER = Path(__file__).resolve().parents[2] / "build" / "bench" / f"emx-onnx-cgen-{VERSION}"
FETCH_SECONDS_MAX = 120
LIBRARIES = ("-nostartfiles", "-lm", "-lc", "--specs=nosys.specs")
LINK = f"-Wl,-Ttext={CODE:#x},-Tdata={DATA:#x},-z,separate-code,-z,max-page-size=0x1000,-e,model"


def fetch() -> str | None:
    """Have the program in build/. Returns why not, in one line, or None."""
    if (FOLDER / "emx_onnx_cgen").is_dir():
        return None
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--target", str(FOLDER)]
    try:
        done = subprocess.run(
            [*command, *REQUIREMENTS], capture_output=True, text=True, timeout=FETCH_SECONDS_MAX
        )
    except subprocess.TimeoutExpired:
        return f"pip did not fetch {REQUIREMENTS[0]} within {FETCH_SECONDS_MAX} s"
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if line.startswith("ERROR")] or ["no reason given"]
        return f"pip could not fetch {REQUIREMENTS[0]}: {lines[-1].removeprefix('ERROR: ')}"
    return None


def generate(network: Network, folder: Path) -> None:
    """model.c of `network` in `folder`. Raises BuildError when the program refuses."""
    (folder / "model.onnx").write_bytes(to_model(network).SerializeToString())
    # Temporaries on the stack, never on a heap.
    command = [sys.executable, "-m", "emx_onnx_cgen", "compile", "--large-temp-threshold", "0"]
    command += ["model.onnx", "model.c"]
    environment = os.environ | {"PYTHONPATH": str(FOLDER)}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    if done.returncode != 0:
        raise BuildError(f"emx-onnx-cgen refuses the network: {done.stderr.strip()[-200:]}")


def cost(network: Network, folder: Path, optimization: str, observations: Float32) -> tuple[Cost, Float32]:
    """What model() costs over `observations` (N, inputs), and the action of the last of them.

    folder: where `generate` left model.c.
    """
    flags = ("-g", optimization, *ARITHMETIC, LINK)
    compile_arm(*flags, "model.c", *LIBRARIES, out=folder / "model.elf")
    machine = CortexM7(load_program(folder / "model.elf"))
    observation, action = machine.allocate(4 * network.inputs), machine.allocate(4 * network.outputs)
    found = call_cost(machine, ("model", observation, action), observation, observations)
    machine.write(observation, observations[-1].tobytes())
    machine.call("model", observation, action)
    return found, np.frombuffer(machine.read(action, 4 * network.outputs), np.float32)
