"""A whole installation on a board in memory: how it ends by what becomes of the new image and of the line."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.flash.image.board import check_ready, read_board
from neuroflight.flash.image.files import Image, ImageFile, Policy
from neuroflight.flash.image.install import Installation, Installed, Stage
from neuroflight.flash.image.plan import plan_install
from neuroflight.flash.image.settings_kept import read_settings
from neuroflight.flash.image.trial import Ending
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.transport import Transport
from neuroflight.toolchain.contract import Msp, Refusal, image_header
from neuroflight.toolchain.errors import LinkError, NeuroflightError
from tests.flash.image.board_model import HANDLERS, BoardModel, Fate, ModelLine, Setting, board_with
from tests.flash.image.conftest import policy_of_build, stamped

OLD, NEW = b"oldbuild", b"newbuild"


@pytest.fixture
def board(board_images: list[bytes], board_policy: Policy) -> BoardModel:
    return board_with(stamped(board_images[0], build=OLD), policy_of_build(board_policy, OLD).data)


@pytest.fixture
def file(board_images: list[bytes], board_policy: Policy) -> ImageFile:
    """A newer build than the one that the board runs."""
    return file_of(board_images, board_policy, NEW)


def file_of(contents: list[bytes], policy: Policy, build: bytes, **fields: bytes) -> ImageFile:
    """The images as those of another build."""
    images = []
    for content in contents:
        data = stamped(content, build=build, **fields)
        header = image_header(data)
        assert header is not None
        images.append(Image(header, data))
    return ImageFile(Path("new.nfi"), tuple(images), policy_of_build(policy, build))


class Tried:
    """An installation, and what it told."""

    def __init__(
        self,
        board: BoardModel,
        file: ImageFile,
        line: ModelLine | None = None,
        *,
        keep_policy: bool = False,
    ) -> None:
        self.board = board
        self.line = line or ModelLine(board)
        self.steps: list[tuple[str, int, int]] = []
        client = Client(self.line, self.line.clock)
        state = read_board(client)
        check_ready(state)
        plan = plan_install(state, file, keep_policy=keep_policy)
        self.settings = read_settings(client)
        self.installation = Installation(
            client, plan, self.reopen, lambda *step: self.steps.append(step), self.line.clock, board.advance
        )

    def reopen(self) -> Transport:
        return ModelLine(self.board)

    def run(self) -> Installed:
        done = self.installation.run(self.settings)
        assert done is not None
        return done


# --- The new image's fate -----------------------------------------------------------------------------
def test_the_new_image_runs_when_it_is_good(board: BoardModel, file: ImageFile) -> None:
    tried = Tried(board, file)
    done = tried.run()
    assert done.trial.ending is Ending.KEPT and done.restarts == 1
    assert board.running == 1 and board.banks[1].data == file.images[1].data
    assert board.banks[1].confirmed
    assert (board.flown, board.slots[1]) == (1, file.policy.blob(1) if file.policy else b"")
    assert done.kept is not None and done.kept.lines == []
    assert tried.steps[-1] == ("prove", 1, 1)
    assert [step[1] for step in tried.steps if step[0] == "write"][-1] == len(file.images[1].data)
    assert tried.installation.stage is Stage.ENDED


def test_the_hash_is_asked_for_before_the_switch(board: BoardModel, file: ImageFile) -> None:
    Tried(board, file).run()
    wanted = (Msp.IMAGE_END, Msp.IMAGE_HASH, Msp.POLICY_SLOT_END, Msp.IMAGE_SWITCH, Msp.REBOOT)
    order = [c for c in board.commands if c in wanted]
    assert order == [*wanted, Msp.IMAGE_HASH]


def test_the_board_flashes_the_other_way_when_it_runs_bank_b(
    board: BoardModel, file: ImageFile, board_policy: Policy
) -> None:
    Tried(board, file).run()
    older = file_of([image.data for image in file.images], board_policy, OLD)
    done = Tried(board, older).run()
    assert done.trial.ending is Ending.KEPT
    assert board.running == 0 and board.banks[0].data == older.images[0].data
    assert (board.flown, board.number(0)) == (0, 2)


def test_the_policy_that_is_flown_stays_when_it_is_kept(
    board: BoardModel, file: ImageFile, board_policy: Policy
) -> None:
    with pytest.raises(NeuroflightError, match=r"slot A .* came with the image that runs .* leave it out"):
        Tried(board, file, keep_policy=True)
    board.slots[0] = policy_of_build(board_policy, bytes(8)).data
    done = Tried(board, file, keep_policy=True).run()
    assert done.trial.ending is Ending.KEPT and board.running == 1
    assert board.flown == 0 and board.slots[1] == b"" and Msp.POLICY_SLOT_BEGIN not in board.commands


def test_a_policy_of_other_code_cannot_be_kept(
    board: BoardModel, board_images: list[bytes], board_policy: Policy
) -> None:
    board.slots[0] = policy_of_build(board_policy, bytes(8)).data
    other = file_of(board_images, board_policy, NEW, architecture_hash=b"\1\2\3\4")
    with pytest.raises(NeuroflightError, match="is of another architecture than the new image's"):
        Tried(board, other, keep_policy=True)


def test_the_new_image_is_not_switched_to_when_its_policy_does_not_arrive(
    board: BoardModel, file: ImageFile
) -> None:
    handlers = pytest.MonkeyPatch()
    handlers.setitem(HANDLERS, Msp.POLICY_SLOT_END, lambda _, payload: Refusal.BLOB)
    try:
        with pytest.raises(LinkError, match=r"was not written.*not started before its policy is there"):
            Tried(board, file).run()
    finally:
        handlers.undo()
    assert not board.banks[1].numbered and Msp.IMAGE_SWITCH not in board.commands
    assert Tried(board, file).run().trial.ending is Ending.KEPT, "the same command goes on"


@pytest.mark.parametrize(
    ("fate", "ending", "running", "words"),
    [
        (
            Fate.CRASHES,
            Ending.WENT_BACK,
            0,
            "went back to bank A, version 0.1.0: the new image was started 2",
        ),
        (Fate.CRASHES_LATE, Ending.WENT_BACK, 0, "the new image was started and failed"),
        (Fate.POLICY_BAD, Ending.POLICY_BAD, 1, "its policy failed the self-test: the motors stay stopped"),
        (Fate.UNPROVEN, Ending.UNPROVEN, 1, "did not confirm itself within 30 s"),
    ],
)
def test_it_is_told_how_the_new_image_failed(
    board: BoardModel, file: ImageFile, fate: Fate, ending: Ending, running: int, words: str
) -> None:
    board.fate = fate
    done = Tried(board, file).run()
    assert (done.trial.ending, board.running) == (ending, running)
    assert words in done.trial.why


def test_it_says_that_the_board_decides_when_it_does_not_answer_any_more(
    board: BoardModel, file: ImageFile
) -> None:
    board.fate = Fate.SILENT
    with pytest.raises(LinkError, match=r"did not answer again .* goes back to it by itself unless"):
        Tried(board, file).run()


# --- Settings -----------------------------------------------------------------------------------------
def test_settings_are_put_back_and_told_when_the_new_version_reads_them_otherwise(
    board: BoardModel, file: ImageFile
) -> None:
    board.settings = {
        "deadband_us": Setting(7),
        "roll_expo": Setting(1),
        "gone": Setting(3),
        "yaw_expo": Setting(9),
    }
    board.of_new_image = {
        "deadband_us": Setting(0),
        "roll_expo": Setting(1),
        "yaw_expo": Setting(0, high=5),
        "fresh": Setting(2),
    }
    done = Tried(board, file).run()
    assert board.settings["deadband_us"].value == 7 and board.settings["yaw_expo"].value == 0
    assert done.kept is not None and done.restarts == 2
    told = done.kept.lines
    assert told[0] == "put back as they were: deadband_us"
    assert told[1] == "the new version knows no gone; it was 3"
    assert told[2].startswith("yaw_expo has another value now: setting yaw_expo got 9, expected 0 to 5")
    assert told[3] == "new, at their defaults: fresh"


# --- The line -------------------------------------------------------------------------------------------
Fault = Callable[[random.Random, bytes], bytes]


def corrupted(rng: random.Random, data: bytes) -> bytes:
    at = rng.randrange(len(data))
    return data[:at] + bytes([data[at] ^ rng.randrange(1, 256)]) + data[at + 1 :]


@pytest.mark.parametrize(
    "fault",
    [
        corrupted,
        lambda rng, data: b"",
        lambda rng, data: data + data,
        lambda rng, data: data[: rng.randrange(len(data))],
        lambda rng, data: b"$X<\0\x52\x4e\xff\x01" + data,
    ],
    ids=["corrupted", "dropped", "doubled", "cut", "behind-half-a-frame"],
)
@pytest.mark.parametrize("way", ["down", "up"])
def test_the_right_image_arrives_when_every_tenth_frame_is_spoilt(
    board: BoardModel, file: ImageFile, fault: Fault, way: str
) -> None:
    rng = random.Random(3)
    active = False
    spoilt = 0

    def change(data: bytes) -> bytes:
        nonlocal spoilt
        if not active or rng.random() > 0.1:
            return data
        spoilt += 1
        return fault(rng, data)

    tried = Tried(board, file, ModelLine(board, **{way: change}))
    active = True
    done = tried.run()
    assert spoilt > 10
    assert done.trial.ending is Ending.KEPT and board.banks[1].data == file.images[1].data
    assert board.erased == 1


@pytest.mark.parametrize("at", [1, 40, 206, 208])
def test_it_goes_on_when_the_line_stalls_for_ten_seconds(board: BoardModel, file: ImageFile, at: int) -> None:
    """`at`: the frame of the update at whose begin the line stalls."""
    frames = 0
    until = -1.0

    def stall(data: bytes) -> bytes:
        nonlocal frames, until
        frames += active
        if frames == at and until < 0:
            until = board.now + 10.0
        return b"" if board.now < until else data

    active = False
    tried = Tried(board, file, ModelLine(board, down=stall))
    active = True
    before = board.now
    done = tried.run()
    assert done.trial.ending is Ending.KEPT and board.now - before > 10.0
    assert board.banks[1].data == file.images[1].data


def test_it_gives_up_when_the_line_stays_silent(board: BoardModel, file: ImageFile) -> None:
    frames = 0

    def cut(data: bytes) -> bytes:
        nonlocal frames
        frames += active
        return b"" if frames > 100 else data

    active = False
    tried = Tried(board, file, ModelLine(board, down=cut))
    active = True
    with pytest.raises(
        LinkError, match=r"got silence.*bank B has 4\d,\d{3} of \d{3},\d{3} bytes .* goes on from there"
    ):
        tried.run()
    assert board.now < 120.0 and board.running == 0


def test_it_is_written_anew_when_it_arrives_damaged_though_every_frame_was_right(
    board: BoardModel, file: ImageFile
) -> None:
    """A wrong frame with a right checksum: one in 256 of those with several wrong bytes."""
    tried = Tried(board, file)
    write = board.image_write
    damaged = 0

    def worn(payload: bytes) -> object:
        nonlocal damaged
        result = write(payload)
        if damaged == 0 and board.written > 50_000:
            damaged += 1
            bank = board.banks[1]
            bank.data = bank.data[:1000] + b"\0\0\0\1" + bank.data[1004:]
        return result

    handlers = pytest.MonkeyPatch()
    handlers.setitem(HANDLERS, Msp.IMAGE_WRITE, lambda _, payload: worn(payload))
    try:
        assert tried.run().trial.ending is Ending.KEPT
    finally:
        handlers.undo()
    assert board.erased == 2 and board.banks[1].data == file.images[1].data


# --- Refusals -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"armed": True}, "the motors are armed, expected a disarmed board; disarm first"),
        ({"battery_level": 2}, "the battery is low, 12.84 V of 4 cells, expected one above `battery_low_v`"),
        (
            {"firmware": "other"},
            "Betaflight 0.1.0 on MATEKF722, expected Neuroflight; install Neuroflight with",
        ),
        (
            {"has_images": False},
            "takes no images over MSP: it is of an older layout, expected one with two banks",
        ),
        (
            {"layout": None},
            "takes images of layout 1, older than 3, which this tool writes; install Neuroflight with",
        ),
        ({"layout": 4}, "takes images of layout 4, newer than 3, which this tool writes; use this tool"),
    ],
)
def test_a_board_is_refused_when_it_is_not_ready(
    board_images: list[bytes],
    board_policy: Policy,
    file: ImageFile,
    facts: dict[str, object],
    words: str,
) -> None:
    board = board_with(board_images[0], board_policy.data, **facts)
    with pytest.raises(LinkError) as caught:
        Tried(board, file)
    assert words in str(caught.value)
    assert board.erased == 0


def test_the_image_to_go_back_to_stays_when_the_running_one_is_not_proven(
    board: BoardModel, file: ImageFile
) -> None:
    board.banks[1 - board.running] = replace(board.banks[board.running])
    board.banks[board.running].confirmed, board.fate = False, Fate.UNPROVEN
    kept = board.banks[1 - board.running].data
    with pytest.raises(LinkError, match="has not proven itself yet, and bank B holds the one"):
        Tried(board, file).run()
    assert board.banks[1 - board.running].data == kept and board.erased == 0


def test_usb_power_alone_is_enough(board: BoardModel, file: ImageFile) -> None:
    for level in (0, 1, 3):
        board.battery_level = level
        Tried(board, file)


def test_an_image_of_another_board_is_refused(
    board: BoardModel, board_images: list[bytes], board_policy: Policy
) -> None:
    other = file_of(board_images, board_policy, NEW, board=b"MAMBAF405".ljust(24, b"\0"))
    with pytest.raises(NeuroflightError, match=r"it is built for the board MAMBAF405, and .* is a MATEKF722"):
        Tried(board, other)


# --- The plan ---------------------------------------------------------------------------------------------
def test_the_plan_says_where_how_much_and_how_long(board: BoardModel, file: ImageFile) -> None:
    plan = Tried(board, file).installation.plan
    assert (plan.bank, plan.sectors, plan.bytes) == (1, (6,), len(file.images[1].data))
    assert plan.frames == -(-plan.bytes // 508)
    assert not plan.same_build and not plan.failed_before
    assert 14 < plan.seconds(115_200) < 22
    assert plan.seconds(921_600) < 10


def test_the_plan_knows_what_runs_and_what_failed(board: BoardModel, file: ImageFile) -> None:
    board.fate = Fate.CRASHES
    Tried(board, file).run()
    assert Tried(board, file).installation.plan.failed_before
    board.fate = Fate.GOOD
    Tried(board, file).run()
    plan = Tried(board, file).installation.plan
    assert plan.same_build and plan.bank == 0
