"""The seeds of the fuzz targets break no promise of the firmware; libFuzzer finds no other."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.firmware.fuzz.build import TARGETS, Workbench, sanitized
from tests.firmware.fuzz.corpus import SEEDS, write
from tests.firmware.fuzz.fuzzer import fuzz

SECONDS = 30


@pytest.fixture(scope="module")
def replay() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs inputs through a target that gcc has built, under the sanitizers."""
    bench = sanitized()

    def run(target: str, *inputs: Path) -> subprocess.CompletedProcess[str]:
        return subprocess.run([bench.program(target), *inputs], capture_output=True, text=True)

    return run


@pytest.fixture(scope="module")
def libfuzzer(tmp_path_factory: pytest.TempPathFactory) -> Workbench:
    """Where clang builds the targets."""
    bench = Workbench(tmp_path_factory.mktemp("libfuzzer"), "clang")
    bench.make()
    return bench


@pytest.mark.parametrize("target", TARGETS)
def test_no_promise_is_broken_when_the_corpus_is_replayed(
    replay: Callable[..., subprocess.CompletedProcess[str]], target: str, tmp_path: Path
) -> None:
    inputs = write(target, tmp_path / "inputs")
    done = replay(target, *inputs)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout[-200:] + done.stderr
    assert done.stdout.count("\n") == len(inputs)


@pytest.mark.slow
@pytest.mark.parametrize("target", TARGETS)
def test_libfuzzer_finds_nothing_when_it_looks_for_half_a_minute(
    libfuzzer: Workbench, target: str, tmp_path: Path
) -> None:
    run = fuzz(libfuzzer.program(target), target, SECONDS, 1, tmp_path)
    print(run)
    assert run.findings == (), str(run)
    assert run.executions > len(SEEDS[target]())
