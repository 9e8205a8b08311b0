"""A board whose gyro is a BMI270, which its maker's file makes measure: SPEEDYBEEF7V3."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from neuroflight.sim.ports.emulator import EmulatedPort
from neuroflight.sim.ports.library import ReferencePort
from neuroflight.sim.ports.port import Reply, Sample
from neuroflight.toolchain.boards.allocation import allocate
from neuroflight.toolchain.boards.description import pack
from neuroflight.toolchain.boards.gyro_file import read_gyro_file
from neuroflight.toolchain.boards.table import find_board
from neuroflight.toolchain.errors import LinkError
from neuroflight.toolchain.image.stamp import stamp
from tests.flights.test_boards import flat
from tests.flights.test_timed_gyro import flight
from tests.sampling import sampled
from tests.toolchain.boards.gyro_file import C_FILE

BOARD = find_board("SPEEDYBEEF7V3")


class AtItsRate(ReferencePort):
    """The library behind a chip that measures at 3200 Hz and is read at 4000 Hz: each fifth sample is old."""

    def __init__(self, library: Path) -> None:
        super().__init__(library)
        self._seen: list[Sample] = []

    def exchange(self, sample: Sample, channels_us: Sequence[int] | None) -> Reply:
        read = len(self._seen)
        gyro, force = sample.gyro.copy(), sample.specific_force.copy()
        self._seen.append(Sample(0.0, gyro, np.eye(3), np.zeros(3), np.zeros(3), force))
        measured = self._seen[read * 4 // 5 * 5 // 4]  # at whose exchange the latest of the chip's was taken
        sample.gyro[:], sample.specific_force[:] = measured.gyro, measured.specific_force
        try:
            return super().exchange(sample, channels_us)
        finally:
            sample.gyro[:], sample.specific_force[:] = gyro, force


def stamped(board_image: Path, folder: Path, gyro_file: bytes) -> Path:
    elf = folder / "bmi270.elf"
    stamp(board_image, pack(allocate(BOARD)) + gyro_file, elf)
    return flat(elf)


@pytest.mark.slow
def test_it_flies_the_librarys_bits_when_the_image_has_its_makers_file(
    board_image: Path, reference_library: Path, tmp_path: Path
) -> None:
    text = tmp_path / "maker.c"
    text.write_text(C_FILE)
    with closing(EmulatedPort(stamped(board_image, tmp_path, read_gyro_file(text)))) as port:
        on_board = flight(port)
    assert flight(AtItsRate(reference_library)).same(on_board)


OTHERS = {"none": b"", "another": bytes.fromhex("c82e002f").ljust(328, b"\1")}


@pytest.mark.slow
@pytest.mark.parametrize("gyro_file", sampled(list(OTHERS), "another"))
def test_no_sample_comes_without_the_file_or_with_another(
    board_image: Path, tmp_path: Path, gyro_file: str
) -> None:
    with pytest.raises(LinkError, match=r"reads no gyro sample .*GYRO_BAD"):
        EmulatedPort(stamped(board_image, tmp_path, OTHERS[gyro_file]))
