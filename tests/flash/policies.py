"""For tests of policy slots: policies like the shipped one; a host program that starts anew as a board."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

START_S = 10.0  # from start to its `ready` line


def another_policy(
    source: Path, path: Path, seed: int = 1, metadata: Mapping[str, str] | None = None
) -> Path:
    """A policy of the same architecture with weights of its own; metadata: by key, changed in it."""
    model, rng = onnx.load(source), np.random.default_rng(seed)
    for tensor in model.graph.initializer:
        values = numpy_helper.to_array(tensor)
        if values.dtype == np.float32 and values.ndim == 2:
            noisy = values * (1 + 0.01 * rng.standard_normal(values.shape)).astype(np.float32)
            tensor.CopyFrom(numpy_helper.from_array(noisy.astype(np.float32), tensor.name))
    for entry in model.metadata_props:
        entry.value = (metadata or {}).get(entry.key, entry.value)
    onnx.save(model, path)
    return path


class HostBoard:
    """The host program with a flash of its own on one port, started again whenever it ends: as a board is.

    No sample ever comes to it, so that its motors stand.
    """

    def __init__(self, program: Path, flash: Path) -> None:
        self.program, self.flash = program, flash
        self.starts = 0
        self._number, self._stopping = 0, False
        self._process = self._start()
        self._thread = threading.Thread(target=self._keep, daemon=True)
        self._thread.start()

    @property
    def port(self) -> str:
        return f"tcp:127.0.0.1:{self._number}"

    def _start(self) -> subprocess.Popen[str]:
        free = [f"--{name}-port=0" for name in ("state", "receiver", "power")]
        options = [
            "--gyro-hz=1000",
            f"--settings={self.flash}",
            f"--msp-port={self._number}",
            "--with-parent",
        ]
        process = subprocess.Popen([self.program, *options, *free], stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        ready = dict(word.split("=") for word in process.stdout.readline().split()[1:])
        self._number = int(ready["msp"])
        self.starts += 1
        return process

    def _keep(self) -> None:
        while True:
            self._process.communicate()
            if self._stopping:
                return
            self._process = self._start()

    def close(self) -> None:
        self._stopping = True
        self._process.terminate()
        self._thread.join(timeout=START_S)


@contextmanager
def host_board(program: Path, flash: Path) -> Iterator[HostBoard]:
    """A HostBoard, closed at the end."""
    board = HostBoard(program, flash)
    try:
        yield board
    finally:
        board.close()
