"""Builds that are refused or fail leave everything as it was; those that succeed say what they made."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from neuroflight.toolchain.codegen.compiler import compile_policy
from neuroflight.toolchain.contract import MOTOR_COUNT_MAX, Mix, image_header
from neuroflight.toolchain.cortex_m7.llvm_mca import find_pricer
from neuroflight.toolchain.errors import BuildError, NeuroflightError, PolicyError, WiringError
from neuroflight.toolchain.image.build import MakeError, build, check_fit, find_target
from neuroflight.toolchain.image.elf import read_image
from neuroflight.toolchain.image.report import MotorFacts, built_motors
from neuroflight.toolchain.policy.model import read_policy
from neuroflight.toolchain.rendering.pid_table import PidTable

if TYPE_CHECKING:
    from tests.toolchain.conftest import Kit

ROOT = Path(__file__).resolve().parents[3]
MAKEFILE = """
all:
\t@mkdir -p $(BUILD)
\t@echo "gcc -c {word}"
\t@printf {word} > $(BUILD)/libneuroflight.so
\t@cp {program} $(BUILD)/neuroflight
\t@{last}
"""


def project(root: Path, word: str = "one", last: str = "true") -> Path:
    """A project whose firmware is a Makefile of six lines."""
    (root / "firmware").mkdir(parents=True, exist_ok=True)
    program = shutil.which("true")
    text = MAKEFILE.format(word=word, last=last, program=program)
    (root / "firmware" / "Makefile").write_text(text)
    return root


def tree(root: Path) -> dict[str, bytes]:
    """Every file under `root` with its content."""
    return {str(p.relative_to(root)): p.read_bytes() for p in sorted(root.rglob("*")) if p.is_file()}


@pytest.fixture
def policy_file(kit: Kit, tmp_path: Path) -> Path:
    """A policy that fits every target."""
    path = tmp_path / "policy.onnx"
    path.write_bytes(kit.mlp().data())
    return path


def refused(target: str, policy: Path, root: Path, error: type[NeuroflightError]) -> str:
    """The line with which the build is refused; nothing is written."""
    before = tree(root)
    with pytest.raises(error) as caught:
        build(target, policy, root)
    assert tree(root) == before
    assert not (root / "build").exists()
    assert not (root / "firmware" / "generated").exists()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_build_is_refused_with_the_known_targets_when_the_target_is_unknown(
    tmp_path: Path, policy_file: Path
) -> None:
    root = project(tmp_path / "root")
    message = refused("MATEKF411", policy_file, root, WiringError)
    assert message.startswith("unknown board 'MATEKF411', did you mean MATEKF722 or")


def test_build_is_refused_with_the_command_when_the_compiler_is_missing(
    tmp_path: Path, policy_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    message = refused("MATEKF722", policy_file, project(tmp_path / "root"), BuildError)
    assert message == (
        "arm-none-eabi-gcc is not installed; "
        "run: sudo apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi"
    )


MISFITS: list[tuple[tuple[int, ...], dict[str, str], str]] = [  # widths, metadata, words
    ((6, 8, 9), {}, "the policy drives 9 motors, MATEKF722 has 8; train it for an aircraft with no more"),
    ((6, 8, 4), {"control_rate_hz": "500"}, "the policy runs at 500 Hz, the firmware at 1000, 2000, 4000 Hz"),
    (
        (6, 8, 4),
        {"filters": '["pt1:100"]'},
        'trained behind gyro filters ["pt1:100"], expected chains as [], [["mean"]], ',
    ),
    (
        (66, 8, 4),
        {"observation": ",".join(["rate"] * 22)},
        "the policy cannot be flown: the observation has 66 values, expected at most 64",
    ),
    (
        (18, 8, 4),
        {"observation": ",".join(["rate@16"] * 6)},
        "the policy cannot be flown: the observation remembers 288 values, expected at most 256",
    ),
    (
        (6, 8, 4),
        {"observation": "rate,gravity@1"},
        "the policy observes gravity, which the firmware has no source for; train it on other blocks",
    ),
    (
        (6, 100, 111, 4),
        {},
        "13,032 weights, DTCM has room for 12,288: 2,976 bytes too many; train a smaller network",
    ),
    (
        (6, 600, 4),
        {},
        "1,200 floats to work on, DTCM has room for 640: 2,240 bytes too many; train one with narrower",
    ),
    (
        (6, *[4] * 414, 4),
        {},
        "831 kernel calls, the bank has room for 800: 992 bytes too many; train fewer layers",
    ),
]


@pytest.mark.parametrize(("widths", "metadata", "words"), MISFITS)
def test_build_is_refused_when_the_policy_does_not_fit(
    kit: Kit, tmp_path: Path, widths: tuple[int, ...], metadata: dict[str, str], words: str
) -> None:
    policy, chain = tmp_path / "policy.onnx", kit.mlp(widths)
    chain.metadata |= {f"neuroflight.{key}": value for key, value in metadata.items()}
    policy.write_bytes(chain.data())
    assert words in refused("MATEKF722", policy, project(tmp_path / "root"), PolicyError)


@pytest.mark.parametrize(("target", "motors"), [("MATEKF722", 8), ("APEXF7", 4), ("HOST", MOTOR_COUNT_MAX)])
def test_a_target_serves_as_many_motors_as_it_has_outputs(
    kit: Kit, tmp_path: Path, target: str, motors: int
) -> None:
    policy = tmp_path / "policy.onnx"
    for count in (4, motors):
        policy.write_bytes(kit.mlp((6, 8, count)).data())
        check_fit(compile_policy(read_policy(policy)), find_target(target))
    policy.write_bytes(kit.mlp((6, 8, motors + 1)).data())
    with pytest.raises(PolicyError, match=f"drives {motors + 1} motors, {target} has {motors}"):
        check_fit(compile_policy(read_policy(policy)), find_target(target))


def test_build_is_refused_when_the_policy_is_truncated(tmp_path: Path, policy_file: Path) -> None:
    policy_file.write_bytes(policy_file.read_bytes()[:5000])
    assert "truncated" in refused("HOST", policy_file, project(tmp_path / "root"), PolicyError)


def test_report_says_what_was_built_when_it_succeeds(tmp_path: Path, policy_file: Path) -> None:
    root = project(tmp_path / "root")
    report = build("HOST", policy_file, root)
    written = json.loads((root / "build" / "HOST" / "report.json").read_text())
    assert written == json.loads(json.dumps(report.document()))
    assert written["target"] == "HOST"
    assert written["policy"]["network"] == "6-64-64-4 tanh"
    assert written["predicted_cycles"] is None
    assert written["predicted_cycles_reason"].startswith("cycles are predicted for a board's")
    assert [stage["name"] for stage in written["stages"]] == ["synthesis", "optimization", "compilation"]
    assert "1 files compiled" in written["stages"][2]["did"]
    assert [file["path"] for file in written["files"]] == [
        "build/HOST/neuroflight",
        "build/HOST/libneuroflight.so",
    ]
    generated = sorted(p.name for p in (root / "firmware" / "generated" / "HOST").iterdir())
    assert generated == ["nf_contract.h", "pid_table.c", "policy.c", "policy.h"]


def table(motors: int) -> PidTable:
    return PidTable("nf9", "tuned", np.full((3, 3), 0.5), 15.0, 0.125, np.ones((motors, 3)))


def test_the_pid_stands_in_report_and_sources_when_one_is_given(tmp_path: Path, policy_file: Path) -> None:
    root = project(tmp_path / "root")
    build("HOST", policy_file, root, pid=table(4))
    written = json.loads((root / "build" / "HOST" / "report.json").read_text())
    assert written["pid"] == {"aircraft": "nf9", "name": "tuned", "idle": 0.125, "mix": "attitude-first"}
    source = (root / "firmware" / "generated" / "HOST" / "pid_table.c").read_text()
    assert "PID tuned of aircraft nf9" in source and ".idle = 0.125f" in source
    product = root / "build" / "HOST" / "neuroflight"
    assert built_motors(product, pid=True) == MotorFacts(0.125, Mix.ATTITUDE_FIRST)
    build("HOST", policy_file, root)
    assert json.loads((root / "build" / "HOST" / "report.json").read_text())["pid"] is None
    with pytest.raises(BuildError, match="has no PID built in; build it with --aircraft"):
        built_motors(product, pid=True)


def test_build_is_refused_when_the_pid_is_of_another_number_of_motors(
    tmp_path: Path, policy_file: Path
) -> None:
    root = project(tmp_path / "root")
    with pytest.raises(BuildError, match="the PID of aircraft nf9 drives 6 motors, the policy 4; name"):
        build("HOST", policy_file, root, pid=table(6))
    assert not (root / "build").exists()


def test_products_and_sources_keep_their_dates_when_nothing_changed(
    tmp_path: Path, policy_file: Path
) -> None:
    root = project(tmp_path / "root")
    paths = [root / "build/HOST/libneuroflight.so", root / "firmware/generated/HOST/policy.c"]
    build("HOST", policy_file, root)
    before = [path.stat().st_mtime_ns for path in paths]
    build("HOST", policy_file, root)
    assert [path.stat().st_mtime_ns for path in paths] == before


def test_last_good_products_stay_when_make_fails_halfway(tmp_path: Path, policy_file: Path) -> None:
    root = project(tmp_path / "root")
    build("HOST", policy_file, root)
    out = root / "build" / "HOST"
    before = {name: data for name, data in tree(out).items() if not name.startswith("make/")}
    project(root, word="two", last="echo the compiler is unhappy >&2; exit 3")
    with pytest.raises(MakeError, match="the last good image is kept") as caught:
        build("HOST", policy_file, root)
    assert "the compiler is unhappy" in caught.value.output
    after = {name: data for name, data in tree(out).items() if not name.startswith("make/")}
    assert after == before
    project(root, word="three")
    build("HOST", policy_file, root)
    assert (out / "libneuroflight.so").read_text() == "three"


def test_no_earlier_image_is_promised_when_the_first_build_fails(tmp_path: Path, policy_file: Path) -> None:
    root = project(tmp_path / "root", last="exit 3")
    with pytest.raises(MakeError, match="there is no image of an earlier build"):
        build("HOST", policy_file, root)


def test_region_and_bytes_are_named_when_the_linker_finds_no_room(tmp_path: Path, policy_file: Path) -> None:
    """Let the linker itself write the error: a table of 3,000 bytes in a region of 1,000."""
    root = project(tmp_path / "root", last="arm-none-eabi-gcc -nostdlib -T tiny.ld table.c -o table.elf")
    (root / "firmware" / "table.c").write_text(
        "const char table[3000] = { 1 };\nint data = 2;\nvoid _start(void) {}\n"
    )
    (root / "firmware" / "tiny.ld").write_text(
        "MEMORY { BANK (rx) : ORIGIN = 0x08000000, LENGTH = 1000 }\n"
        "SECTIONS { .text : { *(.text) } > BANK .rodata : { *(.rodata) } > BANK "
        ".data : { *(.data) } > BANK }\n"
    )
    with pytest.raises(BuildError) as caught:
        build("HOST", policy_file, root)
    assert not isinstance(caught.value, MakeError)
    assert re.fullmatch(
        r"the firmware around this policy does not fit HOST: 2,\d\d\d bytes too many for BANK; train fewer "
        "layers or fewer kinds of activation; there is no image of an earlier build",
        str(caught.value),
    )


ODD_PLACE = "Flüge: it's #1 of 50 % (a=b) $HOME"  # of what make takes for its own


def test_a_product_is_found_when_a_path_has_what_make_takes_for_its_own(
    tmp_path: Path, policy_file: Path
) -> None:
    place = tmp_path / ODD_PLACE
    build("HOST", policy_file, project(place), place / "out")
    assert (place / "out" / "HOST" / "libneuroflight.so").read_text() == "one"


@pytest.mark.slow
@pytest.mark.parametrize("where", ["checkout", "folder for outputs"])
def test_the_firmware_is_built_when_a_path_has_what_make_takes_for_its_own(
    tmp_path: Path, policy_file: Path, where: str
) -> None:
    place = tmp_path / ODD_PLACE
    root, folder = (place, None) if where == "checkout" else (ROOT, place / "out")
    if folder is None:
        left_out = shutil.ignore_patterns("generated")
        shutil.copytree(ROOT / "firmware", root / "firmware", ignore=left_out)
    build("HOST", policy_file, root, folder)
    program = (folder or root / "build") / "HOST" / "neuroflight"
    done = subprocess.run([program, "--help"], capture_output=True, text=True)
    assert done.stdout.startswith("usage: neuroflight")


def test_outer_make_does_not_reach_the_inner_one_when_it_calls_the_build(
    tmp_path: Path, policy_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAKEFLAGS", " -- BUILD=/nonexistent/elsewhere TARGET=OTHER")
    build("HOST", policy_file, project(tmp_path / "root"))
    assert (tmp_path / "root/build/HOST/neuroflight").is_file()


def test_board_image_and_host_program_are_what_the_targets_promise(
    board_image: Path, host_program: Path
) -> None:
    for path, target in ((board_image, "MATEKF722"), (host_program, "HOST")):
        assert all((path.parent / name).is_file() for name in find_target(target).products)
        report = json.loads((path.parent / "report.json").read_text())
        assert report["target"] == target
        assert (report["step_instructions"] is None) == (target == "HOST")
        assert (report["predicted_cycles"] is None) == bool(report["predicted_cycles_reason"])
    report = json.loads((board_image.parent / "report.json").read_text())
    multiply_accumulates = 4736  # of the shipped policy
    assert report["step_instructions"] > multiply_accumulates
    if find_pricer():
        assert report["predicted_cycles"] > multiply_accumulates
    image_size = report["image_size"]
    assert image_size["policy_weights"] == 4 * report["policy"]["weights"]
    assert 0 < image_size["policy_code"] < 4096 < image_size["policy_weights"] < image_size["flash"]
    stack = next(section["size"] for section in report["sections"] if section["name"] == ".stack")
    assert image_size["text_data_bss"] == sum(section["size"] for section in report["sections"]) - stack
    assert image_size["flash"] == next(use["used"] for use in report["memory"] if use["region"] == "flash")
    assert read_image(board_image).machine == "ARM"


def test_the_report_tells_the_image_of_each_bank_as_the_board_does(
    board_image: Path, host_program: Path
) -> None:
    report = json.loads((board_image.parent / "report.json").read_text())
    content = board_image.with_suffix(".nfi").read_bytes()
    a, b = report["images"]
    assert (a["bank"], b["bank"], a["build"]) == ("A", "B", b["build"])
    both = a["bytes"] + b["bytes"]
    (slot,) = (use["used"] for use in report["budgets"] if use["region"] == "policy slot")
    assert both + slot == len(content), "their policy lies behind them"
    for told, image in ((a, content[: a["bytes"]]), (b, content[a["bytes"] : both])):
        assert told["sha256"] == hashlib.sha256(image).hexdigest()
        header = image_header(image)
        assert header is not None and told["build"] == header.build.hex()
    assert json.loads((host_program.parent / "report.json").read_text())["images"] == []
