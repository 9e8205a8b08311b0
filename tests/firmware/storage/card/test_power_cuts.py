"""Power cuts at any block write, and cards pulled at any moment: file system and log stay whole."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from neuroflight.sim.board.devices.sd_card import CardFault, Cut
from neuroflight.toolchain.contract import LogError, LogState
from tests.firmware.storage.card.conftest import FILE_BYTES, LOGS, MakeRecorder
from tests.firmware.storage.card.images import check, content, places
from tests.firmware.storage.card.recorder import CYCLES_A_SECOND, DONE, FAILED, PowerCut, Recorder
from tests.firmware.storage.card.test_card_log import some

RATE = 125_000.0  # bytes a second
LOG = some(400_000)  # 3.2 s


def sound(path: Path, recorder: Recorder) -> int:
    """How many bytes of the log a computer finds on the card, whose file system is sound.

    The log is the beginning of what was written; nothing follows it.
    """
    check(path)
    assert recorder.changed <= places(path, LOGS)
    there = content(path, LOGS[0])
    end = len(there.rstrip(b"\0"))
    assert there[:end] == LOG[:end]
    assert content(path, LOGS[1]) == bytes(FILE_BYTES)
    return end


def cut_at(slot: MakeRecorder, write: int, cut: Cut, kept: int) -> None:
    recorder = slot(seed=write)
    recorder.ready()
    recorder.card.schedule(CardFault.POWER_CUT, write=write, cut=cut, kept_bytes=kept)
    assert recorder.begin() == DONE
    with pytest.raises(PowerCut):
        recorder.record(LOG, RATE)
        recorder.end()
    recorder.close()
    path = recorder.card.image.path
    there = sound(path, recorder)
    sure = max((taken for at, taken in recorder.history if at <= recorder.seconds - 1.0), default=0)
    assert there >= sure, "up to the last whole second"
    # The next start finds it, and goes on in the next file.
    again = slot(path, seed=write)
    again.ready()
    again.known()
    if there:
        assert again.entry(0) in ((LOGS[0], there), (LOGS[0], there + 1))
        assert again.read_at(0, there - 1)[:1] == LOG[there - 1 : there]
    assert again.status.empty == (1 if there else 2)
    again.close()


def moments(count: int) -> list[tuple[int, Cut, int]]:
    """Block write, what a cut leaves of it, bytes of a torn one."""
    chance = random.Random(20)
    return [(chance.randrange(1, 780), chance.choice(list(Cut)), chance.randrange(513)) for _ in range(count)]


@pytest.mark.parametrize(("write", "cut", "kept"), [(1, Cut.OLD, 0), (1, Cut.TORN, 3), *moments(4)])
def test_log_and_file_system_are_whole_when_the_power_goes(
    slot: MakeRecorder, write: int, cut: Cut, kept: int
) -> None:
    cut_at(slot, write, cut, kept)


@pytest.mark.slow
def test_log_and_file_system_are_whole_when_the_power_goes_at_any_of_200_writes(slot: MakeRecorder) -> None:
    for write, cut, kept in moments(200):
        cut_at(slot, write, cut, kept)


def pull_at(slot: MakeRecorder, seconds: float) -> None:
    """Pulled so long after the log's begin; put back once the motors stand."""
    recorder = slot(seed=round(seconds * 1000))
    recorder.known()
    assert recorder.begin() == DONE
    pulled = recorder.cycle + round(seconds * CYCLES_A_SECOND)
    recorder.card.schedule(CardFault.REMOVED, cycle=pulled)
    taken, told = 0, 0
    begun = recorder.cycle
    while recorder.cycle < pulled + 2 * CYCLES_A_SECOND and not told:
        due = int((recorder.cycle - begun) / CYCLES_A_SECOND * RATE) + 1
        taken += recorder.write(LOG[taken:due])
        recorder.step()
        if recorder.state == LogState.ABSENT:
            told = recorder.cycle
    assert told - pulled < 0.8 * CYCLES_A_SECOND
    assert recorder.error == LogError.NO_CARD
    assert recorder.write(b"more") == 0
    assert recorder.end() == FAILED
    there = sound(recorder.card.image.path, recorder)
    assert there >= (seconds - 1.0) * RATE
    assert recorder.most == 1
    recorder.card.schedule(CardFault.INSERTED, cycle=recorder.cycle)
    recorder.until(lambda: recorder.state == LogState.READY)
    recorder.known()
    if there:
        assert recorder.entry(0) in ((LOGS[0], there), (LOGS[0], there + 1))
    assert recorder.begin() == DONE
    assert recorder.status.error == LogError.NONE
    recorder.close()


def pulls(count: int) -> list[float]:
    chance = random.Random(50)
    return [chance.uniform(0.0, 3.0) for _ in range(count)]


@pytest.mark.parametrize("seconds", [0.0, 0.01, *pulls(2)])
def test_log_and_file_system_are_whole_when_the_card_is_pulled(slot: MakeRecorder, seconds: float) -> None:
    pull_at(slot, seconds)


@pytest.mark.slow
def test_log_and_file_system_are_whole_when_the_card_is_pulled_at_any_of_50_moments(
    slot: MakeRecorder,
) -> None:
    for seconds in pulls(50):
        pull_at(slot, seconds)


@pytest.mark.parametrize("seconds", [0.001, 0.1, 0.2, 0.3, 0.302, 0.31, 2.0])
def test_a_card_is_found_when_it_was_pulled_while_it_was_looked_at(
    slot: MakeRecorder, seconds: float
) -> None:
    recorder = slot()
    recorder.card.schedule(CardFault.REMOVED, cycle=recorder.cycle + round(seconds * CYCLES_A_SECOND))
    recorder.step(round(4000 * (seconds + 1.5)))
    assert (recorder.state, recorder.error) == (LogState.ABSENT, LogError.NO_CARD)
    recorder.card.schedule(CardFault.INSERTED, cycle=recorder.cycle)
    recorder.known()
    assert recorder.status.empty == 2
    assert recorder.changed == set()


def test_erasing_goes_on_from_the_end_when_the_power_went(slot: MakeRecorder) -> None:
    """A file whose first sector is blank is blank all over."""
    for after in range(1, 60, 4):  # rounds
        recorder = slot()
        recorder.known()
        assert recorder.begin() == DONE
        recorder.record(LOG[:100_000], RATE)
        assert recorder.end() == DONE
        recorder.device.erase(recorder.device.context)
        recorder.step(after)
        recorder.card.power_off(recorder.cycle)
        recorder.close()
        there = content(recorder.card.image.path, LOGS[0])
        assert there[:512] != bytes(512) or there == bytes(FILE_BYTES)
        check(recorder.card.image.path)
