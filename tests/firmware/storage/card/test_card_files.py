"""card_files.c: which file systems and files are accepted; none makes it hang or write elsewhere."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from neuroflight.sim.board.devices.sd_card import CardTiming
from neuroflight.toolchain.contract import LogError, LogState
from tests.firmware.storage.card.conftest import LOGS, MakeRecorder
from tests.firmware.storage.card.images import BLOCK, SIZE, Volume, content, copy_image, make_image, run
from tests.firmware.storage.card.recorder import DONE, Recorder
from tests.firmware.storage.card.test_card_log import flight, some

NOW = (0.0, 0.0)
QUICK = CardTiming(
    start=NOW,
    write=NOW,
    pause_share=0.0,
    wake=NOW,
    stop=NOW,
    read=NOW,
    register=NOW,
    erase=NOW,
    erase_unit=NOW,
)  # a card without a delay


def patch(path: Path, at: int, data: bytes) -> None:
    with path.open("r+b") as file:
        file.seek(at)
        file.write(data)


def entry_of(path: Path, name: str) -> int:
    """Where the directory's entry of a file stands in the image."""
    wanted = name.replace(".", "").encode().ljust(11)
    return next(at for at, entry in Volume(path).entries() if entry[:11] == wanted)


def first_cluster(volume: Volume, entry: int) -> int:
    return int.from_bytes(volume.image[entry + 26 : entry + 28], "little")


def settle(recorder: Recorder) -> None:
    """Until all was looked at, or nothing can be."""
    recorder.until(lambda: recorder.state not in (LogState.ABSENT, LogState.STARTING), 60.0)
    recorder.known()


@pytest.mark.parametrize(("start", "cluster_sectors"), [(0, 1), (0, 8), (2048, 1), (63, 2)])
def test_a_log_is_where_a_computer_reads_it(
    slot: MakeRecorder, tmp_path: Path, start: int, cluster_sectors: int
) -> None:
    path = tmp_path / "card.img"
    make_image(path, {LOGS[0]: 100_000, LOGS[1]: 100_000}, start=start, cluster_sectors=cluster_sectors)
    recorder = slot(path)
    recorder.ready()
    flight(recorder, some(50_000))
    recorder.close()
    assert content(path, LOGS[0], start)[:50_000] == some(50_000)


def test_files_are_taken_by_name_when_there_are_more_than_are_remembered(
    slot: MakeRecorder, tmp_path: Path
) -> None:
    names = [f"LOG{i:05d}.BBL" for i in range(1, 71)]
    path = make_image(tmp_path / "card.img", dict.fromkeys(reversed(names), 2 * BLOCK))
    recorder = slot(path, timing=QUICK)
    recorder.known()
    assert recorder.status.empty == 64
    for i in range(2):
        flight(recorder, some(900, i))
    recorder.close()
    assert [content(path, name)[:900] for name in names[:2]] == [some(900, i) for i in range(2)]


def no_files(path: Path) -> None:
    run("mdel", "-i", path, *(f"::{name}" for name in LOGS))


def fat16(path: Path) -> None:
    run("mkfs.vfat", "-F", "16", path)


def exfat(path: Path) -> None:
    patch(path, 0, b"\xeb\x76\x90EXFAT   " + bytes(500 - 11))


def unformatted(path: Path) -> None:
    patch(path, 0, bytes(BLOCK))


def without_end(path: Path) -> None:
    """The root directory's chain is a circle; it is full of deleted files."""
    volume = Volume(path)
    patch(path, volume.directory().pop() * BLOCK, b"\xe5" * BLOCK)
    patch(path, volume.fat * BLOCK + 4 * volume.root, struct.pack("<I", volume.root))


def larger_than_the_card(path: Path) -> None:
    patch(path, 32, struct.pack("<I", SIZE // BLOCK + 1))


def counted_in_16_bits(path: Path) -> None:
    patch(path, 19, struct.pack("<H", 0x7FFF))


def of_a_later_version(path: Path) -> None:
    patch(path, 42, struct.pack("<H", 1))


def one_table_in_use(path: Path) -> None:
    """The tables are no copies of each other: the first may be the old one."""
    patch(path, 40, struct.pack("<H", 0x81))


def no_clusters(path: Path) -> None:
    patch(path, 13, b"\0")


def tables_everywhere(path: Path) -> None:
    patch(path, 36, struct.pack("<I", 0xFFFFFFFF))


def short_tables(path: Path) -> None:
    patch(path, 36, struct.pack("<I", 100))


@pytest.mark.parametrize(
    ("harm", "error"),
    [
        (no_files, LogError.NO_FILE),
        (fat16, LogError.FILE_SYSTEM),
        (exfat, LogError.FILE_SYSTEM),
        (unformatted, LogError.FILE_SYSTEM),
        (without_end, LogError.FILE_SYSTEM),
        (larger_than_the_card, LogError.FILE_SYSTEM),
        (counted_in_16_bits, LogError.FILE_SYSTEM),
        (of_a_later_version, LogError.FILE_SYSTEM),
        (one_table_in_use, LogError.FILE_SYSTEM),
        (no_clusters, LogError.FILE_SYSTEM),
        (tables_everywhere, LogError.FILE_SYSTEM),
        (short_tables, LogError.FILE_SYSTEM),
    ],
)
def test_the_reason_is_told_when_a_card_cannot_take_a_log(
    slot: MakeRecorder, empty_card: Path, tmp_path: Path, harm: Callable[[Path], None], error: LogError
) -> None:
    path = copy_image(empty_card, tmp_path / "harmed.img")
    harm(path)
    recorder = slot(path)
    settle(recorder)
    assert (recorder.state, recorder.error) == (LogState.FAULT, error)
    assert recorder.begin() != DONE


def in_pieces(path: Path) -> None:
    """The sixth cluster of the first file follows elsewhere."""
    volume = Volume(path)
    at = entry_of(path, LOGS[0])
    first = first_cluster(volume, at)
    patch(path, volume.fat * BLOCK + 4 * (first + 5), struct.pack("<I", first + 7))


def circle(path: Path) -> None:
    volume = Volume(path)
    first = first_cluster(volume, entry_of(path, LOGS[0]))
    patch(path, volume.fat * BLOCK + 4 * (first + 5), struct.pack("<I", first))


def shorter_chain(path: Path) -> None:
    volume = Volume(path)
    first = first_cluster(volume, entry_of(path, LOGS[0]))
    patch(path, volume.fat * BLOCK + 4 * (first + 5), struct.pack("<I", 0x0FFFFFFF))


def behind_the_end(path: Path) -> None:
    patch(path, entry_of(path, LOGS[0]) + 28, struct.pack("<I", 0xFFFFFE00))


def nowhere(path: Path) -> None:
    patch(path, entry_of(path, LOGS[0]) + 26, struct.pack("<H", 1))


def on_the_directory(path: Path) -> None:
    """It is the root directory itself, which its size fits."""
    at, volume = entry_of(path, LOGS[0]), Volume(path)
    patch(path, at + 20, struct.pack("<H", volume.root >> 16))
    patch(path, at + 26, struct.pack("<HI", volume.root & 0xFFFF, BLOCK))


@pytest.mark.parametrize(
    ("harm", "error"),
    [
        (in_pieces, LogError.FRAGMENTED),
        (circle, LogError.FRAGMENTED),
        (shorter_chain, LogError.FRAGMENTED),
        (behind_the_end, LogError.FILE_SYSTEM),
        (nowhere, LogError.FILE_SYSTEM),
        (on_the_directory, LogError.FILE_SYSTEM),
    ],
)
def test_a_file_is_passed_over_when_it_is_not_in_one_piece(
    slot: MakeRecorder, empty_card: Path, tmp_path: Path, harm: Callable[[Path], None], error: LogError
) -> None:
    path = copy_image(empty_card, tmp_path / "harmed.img")
    harm(path)
    recorder = slot(path)
    recorder.known()
    assert (recorder.state, recorder.error, recorder.status.empty) == (LogState.READY, error, 1)
    second = set(next(Volume(path).file(e) for _, e in Volume(path).entries() if e[:8] == b"LOG00002"))
    flight(recorder, some(50_000))
    assert recorder.error == LogError.NONE or error == recorder.error
    assert recorder.erase() == DONE
    assert recorder.changed
    assert recorder.changed <= second


def test_only_one_of_two_files_is_taken_when_they_share_clusters(
    slot: MakeRecorder, empty_card: Path, tmp_path: Path
) -> None:
    path = copy_image(empty_card, tmp_path / "harmed.img")
    first = Volume(path).image[entry_of(path, LOGS[0]) + 20 : entry_of(path, LOGS[0]) + 28]
    patch(path, entry_of(path, LOGS[1]) + 20, first)
    recorder = slot(path)
    recorder.known()
    assert (recorder.status.empty, recorder.error) == (1, LogError.FILE_SYSTEM)


def mutate(path: Path, seed: int) -> None:
    """Changes a few numbers of boot sector, directory and tables, to values that such numbers like to be."""
    chance, volume = random.Random(seed), Volume(path)
    logs = [entry_of(path, name) for name in LOGS]
    first = first_cluster(volume, logs[0])
    words = [volume.fat * BLOCK + 4 * (first + i) for i in range(40)] + [volume.fat * BLOCK + 4 * volume.root]
    spots = [
        (at, size) for at, size in ((11, 2), (13, 1), (14, 2), (16, 1), (17, 2), (19, 2), (22, 2), (32, 4))
    ]
    spots += [(36, 4), (40, 2), (42, 2), (44, 4), (510, 2)]
    spots += [
        (at + offset, size) for at in logs for offset, size in ((0, 1), (11, 1), (20, 2), (26, 2), (28, 4))
    ]
    spots += [(at, 4) for at in words]
    for _ in range(chance.randrange(1, 5)):
        at, size = chance.choice(spots)
        now = int.from_bytes(volume.image[at : at + size], "little")
        near = (now + 1, now - 1, now * 2, now // 2, now ^ 1 << chance.randrange(8 * size))
        value = chance.choice((*near, 0, 1, 2, 0x0FFFFFFF, 0xFFFFFFFF, chance.getrandbits(32)))
        patch(path, at, (value % (1 << 8 * size)).to_bytes(size, "little"))


def check_mutated(slot: MakeRecorder, path: Path, empty_card: Path, seed: int) -> bool:
    copy_image(empty_card, path)
    mutate(path, seed)
    recorder = slot(path, timing=QUICK)
    settle(recorder)
    ready = recorder.state == LogState.READY
    if ready:
        volume = Volume(path)
        files = [entry for _, entry in volume.entries() if entry[8:11] == b"BBL" and entry[0] != 0xE5]
        allowed = {block for entry in files for block in volume.file(entry)} - volume.directory()
        while recorder.begin() == DONE:
            recorder.record(some(20_000)[: 20 * recorder.log.files.files[recorder.log.file].sectors], 1e6)
            recorder.end()
        recorder.erase()
        assert recorder.changed
        assert recorder.changed <= allowed
    recorder.close()
    return ready


def test_nothing_outside_of_files_is_written_when_a_file_system_is_damaged(
    slot: MakeRecorder, empty_card: Path, tmp_path: Path
) -> None:
    ready = [check_mutated(slot, tmp_path / "mutated.img", empty_card, seed) for seed in range(30)]
    assert 5 < sum(ready) < 30, "some are accepted, some are not"


@pytest.mark.slow
def test_nothing_outside_of_files_is_written_when_any_of_1000_file_systems_is_damaged(
    slot: MakeRecorder, empty_card: Path, tmp_path: Path
) -> None:
    for seed in range(30, 1030):
        check_mutated(slot, tmp_path / "mutated.img", empty_card, seed)
