"""One run of libFuzzer, and what it says of itself."""

from __future__ import annotations

import re
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from tests.firmware.fuzz.corpus import WORDS, write

INPUT_MAX = 2048  # bytes
SLOW_S = 10  # an input that takes longer is a finding


@dataclass(frozen=True)
class Run:
    """What came of it."""

    target: str
    seconds: int
    executions: int
    edges: int  # of the control flow that some input took
    inputs: int  # kept, as each took an edge or a count of it that no other did
    findings: tuple[Path, ...]  # inputs that broke a promise or a sanitizer's rule

    def __str__(self) -> str:
        found = "no finding" if not self.findings else f"FOUND {', '.join(map(str, self.findings))}"
        return (
            f"{self.target}: {self.executions} executions in {self.seconds} s, "
            f"{self.edges} edges, {self.inputs} inputs, {found}"
        )


def fuzz(program: Path, target: str, seconds: int, jobs: int, scratch: Path) -> Run:
    """Run `program` for so long in so many processes, from the seeds on."""
    kept = scratch / "findings" / target
    kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=f"fuzz-{target}-") as folder:
        grown = Path(folder) / "corpus"
        write(target, grown)
        before = set(kept.iterdir())
        command = [
            str(program),
            f"-max_total_time={seconds}",
            f"-max_len={INPUT_MAX}",
            f"-timeout={SLOW_S}",
            f"-artifact_prefix={kept}/",
            "-print_final_stats=1",
        ]
        if target in WORDS:
            (Path(folder) / "words").write_text(WORDS[target]())
            command.append(f"-dict={folder}/words")
        processes = [
            subprocess.Popen(
                [*command, f"-seed={number + 1}", str(grown)],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
                errors="replace",
            )
            for number in range(jobs)
        ]
        words = [process.communicate()[1] for process in processes]
        inputs = len(list(grown.iterdir()))
    findings = tuple(sorted(set(kept.iterdir()) - before))
    failed = [word for word, process in zip(words, processes, strict=True) if process.returncode != 0]
    for number, word in enumerate(failed):
        (kept / f"words-{number}.txt").write_text(word)
    if failed and not findings:
        findings = (kept / "words-0.txt",)
    counted = [int(count) for word in words for count in re.findall(r"number_of_executed_units: (\d+)", word)]
    edges = [int(count) for word in words for count in re.findall(r"cov: (\d+)", word)]
    return Run(target, seconds, sum(counted), max(edges, default=0), inputs, findings)
