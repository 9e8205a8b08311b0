"""The machines that can run a policy: torch, onnxruntime, the evaluator, this machine's C, the Cortex-M7's.

A machine takes sequences of observations (S, T, inputs) and gives actions (S, T, outputs); every sequence
begins with cleared state. Opening one raises NotRunError where a tool is missing, MachineError where the
policy is at fault.
"""

from __future__ import annotations

import platform
import shutil
import signal
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from neuroflight.toolchain.codegen.compiler import CompiledPolicy
from neuroflight.toolchain.codegen.emit import ARITHMETIC
from neuroflight.toolchain.contract import POLICY_INPUT, POLICY_OUTPUT, SELFTEST_COUNT
from neuroflight.toolchain.errors import BuildError, PolicyError
from neuroflight.toolchain.files import write_text
from neuroflight.toolchain.ir.float32 import Float32
from neuroflight.toolchain.ir.interpreter import advance, clear_state, evaluate
from neuroflight.toolchain.ir.network import Network
from neuroflight.toolchain.rendering.jinja import render

if TYPE_CHECKING:
    import onnx

SANITIZERS = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer")
ADDRESS, UNDEFINED = "ERROR: AddressSanitizer: ", ": runtime error: "  # what begins a sanitizer's report
RUN_SECONDS_MAX = 600  # of one run of a program: beyond, it hangs
MESSAGE_MAX = 200  # characters of another program's words


class NotRunError(Exception):
    """A machine that cannot be had here; the message is the reason."""


class MachineError(Exception):
    """A machine on which the policy fails before there is anything to compare."""

    def __init__(self, law: str, message: str) -> None:
        """law: the law of toolchain.verification.verify that is broken."""
        super().__init__(message)
        self.law = law


@dataclass(frozen=True, eq=False)
class SelfTest:
    """The vectors inside policy.c and what the machine made of them, in one sequence."""

    observation: Float32  # (SELFTEST_COUNT, inputs)
    promised: Float32  # (SELFTEST_COUNT, outputs)
    given: Float32  # (SELFTEST_COUNT, outputs)


@dataclass(frozen=True, eq=False)
class Machine:
    """A program that runs the policy."""

    is_ours: bool  # runs the compiled network, and so is held to the evaluator's bits
    actions: Callable[[Float32], Float32]
    selftest: Callable[[], SelfTest] | None = None


def open_onnxruntime(data: bytes) -> Machine:
    """Open the policy's file in onnxruntime; recurrent state is carried through added inputs and outputs."""
    try:
        import onnx
        import onnxruntime
    except ImportError as error:
        raise NotRunError(f"{error.name} is not installed; run: pip install onnxruntime") from error
    model = onnx.load_model_from_string(data)
    cells = _expose_state(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.log_severity_level = 1, 3
    try:
        session = onnxruntime.InferenceSession(
            model.SerializeToString(), options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # onnxruntime's exceptions have no common class of its own
        raise MachineError("runs", f"does not load the policy: {first_line(str(error))}") from error
    names = [POLICY_OUTPUT, *(out for _, out, _ in cells)]

    def actions(observation: Float32) -> Float32:
        rows = []
        for sequence in observation:
            state = {given: np.zeros((1, 1, units), np.float32) for given, _, units in cells}
            for row in sequence:
                action, *after = session.run(names, {POLICY_INPUT: row[None], **state})
                state = {given: value for (given, _, _), value in zip(cells, after, strict=True)}
                rows.append(action[0])
        return np.array(rows, np.float32).reshape(*observation.shape[:2], -1)

    return Machine(False, actions)


def _expose_state(model: onnx.ModelProto) -> list[tuple[str, str, int]]:
    """Make the state of each RNN, GRU and LSTM an input and output of `model`; return names and width."""
    from onnx import TensorProto, helper

    cells = []
    for index, node in enumerate(model.graph.node):
        slots = {"RNN": ((5, 1),), "GRU": ((5, 1),), "LSTM": ((5, 1), (6, 2))}.get(node.op_type, ())
        for given, result in slots:
            units = next(attribute.i for attribute in node.attribute if attribute.name == "hidden_size")
            node.input.extend([""] * (given + 1 - len(node.input)))
            node.output.extend([""] * (result + 1 - len(node.output)))
            node.input[given] = before = f"verify_state_{index}_{result}"
            node.output[result] = after = node.output[result] or f"verify_state_after_{index}_{result}"
            for place, name in ((model.graph.input, before), (model.graph.output, after)):
                place.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, 1, units]))
            cells.append((before, after, units))
    return cells


def open_torch(checkpoint: Path, inputs: int, outputs: int) -> Machine:
    """Open the actor as it was trained, before anything was folded: scaling, layers, output map, clip."""
    from neuroflight.toolchain.verification.actor import read_actor

    actions = read_actor(checkpoint)
    try:
        fits = actions(np.zeros((1, 1, inputs), np.float32)).shape[-1] == outputs
    except RuntimeError:  # torch's word for tensors whose shapes or types do not fit
        fits = False
    if not fits:
        raise PolicyError(
            f"{checkpoint}: its network does not take {inputs} values and give {outputs} as the policy does; "
            "name the checkpoint that the policy was frozen from, or leave torch out with --no-torch"
        )
    return Machine(False, actions)


def open_evaluator(network: Network) -> Machine:
    """Open the compiled network in numpy, with the C's order of operations."""

    def actions(observation: Float32) -> Float32:
        if not network.recurrent:
            flat = evaluate(network, observation.reshape(-1, network.inputs))
            return flat.reshape(*observation.shape[:2], network.outputs)
        state = clear_state(network, len(observation))
        steps = []
        for step in range(observation.shape[1]):
            action, state = advance(network, observation[:, step], state)
            if not all(np.isfinite(values).all() for values in state):
                raise MachineError("state", f"recurrent state is not finite after step {step} of a sequence")
            steps.append(action)
        return np.stack(steps, axis=1)

    return Machine(True, actions)


def open_host(policy: CompiledPolicy, directory: Path, compiler: str, *, sanitize: bool = False) -> Machine:
    """Compile policy.c for this machine; a sanitizer's report becomes a MachineError."""
    if shutil.which(compiler) is None:
        raise NotRunError(f"{compiler} is not installed; run: sudo apt-get install {compiler}")
    write_text(directory / "policy.h", policy.emission.header)
    write_text(directory / "policy.c", policy.emission.source)
    write_text(directory / "verify.c", render("verify.c.j2"))
    options = [*ARITHMETIC, *(("-O1", *SANITIZERS) if sanitize else ("-O2",))]
    options += ["-mfma"] if platform.machine() in ("x86_64", "AMD64") else []
    program = directory / "verify"
    command = [compiler, *options, "policy.c", "verify.c", "-o", program.name]
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, errors="replace")
    if done.returncode:
        error = next((line for line in done.stderr.splitlines() if "error" in line), done.stderr)
        if sanitize and "cannot find" in done.stderr:
            raise NotRunError(f"{compiler} comes without its sanitizers: {first_line(done.stderr)}")
        raise MachineError("runs", f"does not compile policy.c: {first_line(error)}")
    inputs, outputs = policy.policy.observation_count, policy.policy.action_count

    def actions(observation: Float32) -> Float32:
        shape = np.array(observation.shape[:2], np.uint32)
        given = _run(program, shape.tobytes() + np.ascontiguousarray(observation).tobytes())
        return given.reshape(*observation.shape[:2], outputs)

    def selftest() -> SelfTest:
        given = _run(program, bytes(8))
        count = SELFTEST_COUNT
        observation, promised, action = np.split(given, [count * inputs, count * (inputs + outputs)])
        return SelfTest(
            observation.reshape(count, inputs),
            promised.reshape(count, outputs),
            action.reshape(count, outputs),
        )

    return Machine(True, actions, selftest)


def _run(program: Path, data: bytes) -> Float32:
    environment = {"ASAN_OPTIONS": "detect_leaks=0:exitcode=99", "UBSAN_OPTIONS": "exitcode=99"}
    try:
        done = subprocess.run(
            [program], input=data, capture_output=True, env=environment, timeout=RUN_SECONDS_MAX
        )
    except subprocess.TimeoutExpired as error:
        raise MachineError("runs", f"did not come back within {RUN_SECONDS_MAX} s") from error
    if done.returncode:
        if report := _sanitizer_report(done.stderr.decode(errors="replace").splitlines()):
            raise MachineError("sanitizer", first_line(report))
        end = signal.Signals(-done.returncode).name if done.returncode < 0 else f"status {done.returncode}"
        raise MachineError("runs", f"ended with {end}")
    return np.frombuffer(done.stdout, np.float32)


def _sanitizer_report(lines: Sequence[str]) -> str | None:
    """Return a sanitizer's finding and place, without addresses; None if `lines` hold no report."""
    for line in lines:
        if UNDEFINED in line:
            return line
        if ADDRESS in line:
            places = (frame.rpartition("/")[2] for frame in lines if "policy.c:" in frame)
            return f"{line.partition(ADDRESS)[2].partition(' on ')[0]} at {next(places, 'an unknown place')}"
    return None


def open_arm(policy: CompiledPolicy, directory: Path) -> Machine:
    """Compile policy.c with the firmware's flags, to be executed on an emulated Cortex-M7."""
    try:
        from neuroflight.toolchain.cortex_m7.arm_policy import COMPILER, ArmPolicy, build_policy_elf
        from neuroflight.toolchain.cortex_m7.emulator import FaultError, load_program
    except ImportError as error:
        raise NotRunError(f"{error.name} is not installed; run: pip install unicorn") from error
    if shutil.which(COMPILER) is None:
        raise NotRunError(f"{COMPILER} is not installed; run: sudo apt-get install gcc-arm-none-eabi")
    inputs, outputs = policy.policy.observation_count, policy.policy.action_count
    try:
        program = load_program(build_policy_elf(policy.emission, directory))
        arm = ArmPolicy(program, inputs, outputs)
    except (BuildError, FaultError) as error:
        raise MachineError("runs", first_line(str(error))) from error

    def sequence(observation: Float32) -> Float32:
        try:
            arm.init()
            return arm.actions(observation)
        except FaultError as error:
            raise MachineError("runs", str(error)) from error

    def actions(observation: Float32) -> Float32:
        return np.stack([sequence(rows) for rows in observation])

    def vectors(name: str, width: int) -> Float32:
        data = arm.machine.read(program.symbol(name).address, 4 * SELFTEST_COUNT * width)
        return np.frombuffer(data, np.float32).reshape(SELFTEST_COUNT, width)

    def selftest() -> SelfTest:
        observation = vectors("policy_selftest_observation", inputs)
        return SelfTest(observation, vectors("policy_selftest_action", outputs), sequence(observation))

    return Machine(True, actions, selftest)


def first_line(text: str) -> str:
    """Return the first line of another program's output, shortened if too long."""
    line = next((line.strip() for line in text.splitlines() if line.strip()), "")
    return line if len(line) <= MESSAGE_MAX else line[: MESSAGE_MAX - 3] + "..."
