"""Which image a board starts, and what it makes of a new one: whole boards, from the power on."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.sim.board.core.context import TIME_HZ
from neuroflight.sim.board.core.engine import Outcome
from neuroflight.sim.board.debug.snapshot import Snapshot, restore_snapshot, take_snapshot
from neuroflight.sim.board.peripherals.flash import Cut
from neuroflight.toolchain.contract import (
    DTCM,
    FLASH_BANKS,
    IMAGE_BUILD_BYTES,
    IMAGE_NUMBER_ENTRIES,
    IMAGE_NUMBER_WORDS,
    IMAGE_PROBATION_MS,
    IMAGE_STARTS_MAX,
    Msp,
    Reboot,
    bound_policy,
    image_field_offset,
)
from neuroflight.toolchain.image.bank_state import state
from tests.firmware.board.banks import (
    INSTALLED,
    LOOP,
    NEW,
    RUN_WELL,
    UNDEFINED,
    A,
    B,
    Build,
    Marks,
    Trial,
    bad_policy,
    compose,
    patched,
    read_build,
)
from tests.firmware.images import changed, stamped
from tests.sampling import sampled

UP_S = 2.0  # for a start, with the watchdog's half a second
PROBATION_S = 3.0  # with the start before it
STARTS_AT = 4 * (1 + IMAGE_NUMBER_ENTRIES * IMAGE_NUMBER_WORDS)  # bytes into a bank's marks
ROM, MSP_RX = 0x1FF00000, "PA10"
ENTER_ROM, ARMED = struct.pack("<I", 0x4D4F5221), 0x444D5241  # kept.h

MakeTrial = Callable[[bytes], Trial]


@pytest.fixture(scope="module")
def build(board_image: Path) -> Build:
    return read_build(board_image)


@pytest.fixture
def trial(build: Build) -> Iterator[MakeTrial]:
    with ExitStack() as stack:

        def make(flash: bytes) -> Trial:
            made = Trial(flash, build.elf)
            stack.callback(made.close)
            return made

        yield make


# --- A new image that goes wrong ----------------------------------------------------------------
def wrong_board(build: Build) -> bytes:
    return changed(build.images[B], "board", b"X")


def wrong_bank(build: Build) -> bytes:
    return build.images[A]


def wrong_bank_in_its_header_alone(build: Build) -> bytes:
    return changed(build.images[B], "bank", bytes([A]))


def wrong_bank_but_for_its_header(build: Build) -> bytes:
    return changed(build.images[A], "bank", bytes([B]))


def one_wrong_bit(build: Build) -> bytes:
    image = bytearray(build.images[B])
    image[len(image) // 2] ^= 0x10
    return bytes(image)


def cut_short(build: Build) -> bytes:
    return build.images[B][: len(build.images[B]) // 2]


def with_vectors(build: Build, stack: int | None = None, reset: int | None = None) -> bytes:
    """Bank B's image, whole, whose first stack pointer or first instruction is another."""
    image = build.images[B]
    told = struct.unpack_from("<2I", image)
    vectors = [known if new is None else new for known, new in zip(told, (stack, reset), strict=True)]
    return stamped(struct.pack("<2I", *vectors) + image[8:])


DTCM_END = DTCM.address + DTCM.size
BANK_B_END = FLASH_BANKS[B].address + FLASH_BANKS[B].size
NOT_STARTED: dict[str, Callable[[Build], bytes]] = {
    "erased": lambda build: b"",
    "wrong board": wrong_board,
    "the other bank's image": wrong_bank,
    "the other bank in its header": wrong_bank_in_its_header_alone,
    "the other bank's code": wrong_bank_but_for_its_header,
    "one wrong bit": one_wrong_bit,
    "cut short": cut_short,
    "a stack below memory": lambda build: with_vectors(build, stack=DTCM.address),
    "a stack beyond memory": lambda build: with_vectors(build, stack=DTCM_END + 8),
    "a stack of half a double word": lambda build: with_vectors(build, stack=DTCM_END - 4),
    "begins in the other bank": lambda build: with_vectors(build, reset=FLASH_BANKS[A].address + 0x401),
    "begins behind its bank": lambda build: with_vectors(build, reset=BANK_B_END | 1),
    "begins with an instruction of another set": lambda build: with_vectors(
        build, reset=FLASH_BANKS[B].address + 0x400
    ),
}
FAILS_EACH_START: dict[str, tuple[str, bytes]] = {
    "faults when memory is in place": ("main", UNDEFINED),
    "faults when the hardware is up": ("background_start", UNDEFINED),
    "faults in its loop": ("msp_lines_serve", UNDEFINED),
    "hangs at its first instruction": ("reset_handler", LOOP),
    "hangs before it starts its watchdog": ("hal_init", LOOP),
    "hangs in its boot": ("background_start", LOOP),
    "hangs in its loop": ("msp_lines_serve", LOOP),
}


QUICK = [name for name in FAILS_EACH_START if name != "hangs in its loop"]


@pytest.mark.parametrize("name", sampled(NOT_STARTED, *list(NOT_STARTED)[::4]))
def test_the_old_image_is_started_at_once_when_the_new_one_is_none(
    build: Build, trial: MakeTrial, name: str
) -> None:
    board = trial(compose(build, (build.images[A], RUN_WELL), (NOT_STARTED[name](build), NEW)))
    board.until(lambda: board.bank is not None, UP_S)
    assert (board.bank, board.starts) == (A, 1)


@pytest.mark.parametrize("name", sampled(FAILS_EACH_START, *QUICK))
def test_the_old_image_flies_at_the_third_start_when_the_new_one_fails_each(
    build: Build, trial: MakeTrial, name: str
) -> None:
    new = patched(build, B, *FAILS_EACH_START[name])
    board = trial(compose(build, (build.images[A], RUN_WELL), (new, NEW)))
    board.until(lambda: board.bank == A, (IMAGE_STARTS_MAX + 1) * UP_S)
    assert board.starts == IMAGE_STARTS_MAX + 1
    assert board.marks(B).starts == IMAGE_STARTS_MAX and not board.marks(B).confirmed
    board.run(0.05)
    assert board.starts == IMAGE_STARTS_MAX + 1, "and goes on"


def test_the_new_image_gives_way_when_its_policy_fails_its_self_test(build: Build, trial: MakeTrial) -> None:
    new = changed(build.images[B], "build", b"newbuild")
    slots = build.policy, bad_policy(build, b"newbuild")
    board = trial(compose(build, (build.images[A], RUN_WELL), (new, NEW), slots=slots))
    board.until(lambda: board.bank == B, UP_S)
    board.until(lambda: board.bank == A, 2 * UP_S)
    assert board.starts == 2 and board.board.engine.resets[-1] == "software"
    assert board.marks(B).rejected
    board.board.reset()
    board.until(lambda: board.bank is not None, UP_S)
    assert board.bank == A


@pytest.mark.parametrize("held", sampled(["nothing", "bad", "another's"], "bad"))
@pytest.mark.parametrize("bank", [A, B])
def test_a_new_image_stays_on_probation_when_no_other_can_be_started(
    build: Build, trial: MakeTrial, bank: int, held: str
) -> None:
    """Its policy is bad: it says so, and can be talked to."""
    content: list[tuple[bytes, bytes] | None] = [None, None]
    content[bank] = (build.images[bank], NEW)
    own = build.images[bank][image_field_offset("build") :][:IMAGE_BUILD_BYTES]
    slots = {
        "nothing": (),
        "bad": (bad_policy(build, own),),
        "another's": (bound_policy(build.policy, b"another1"),),
    }[held]
    board = trial(compose(build, *content, slots=slots))
    board.until(lambda: board.bank == bank, UP_S)
    board.run(0.5)
    assert board.starts == 1 and not board.marks(bank).rejected
    assert {"PROBATION", "POLICY_BAD"} <= set(board.info().arming_reasons)


def test_the_only_image_is_started_when_its_starts_are_used_up(build: Build, trial: MakeTrial) -> None:
    used = bytearray(NEW)
    used[STARTS_AT : STARTS_AT + 4 * IMAGE_STARTS_MAX] = bytes(4 * IMAGE_STARTS_MAX)
    board = trial(compose(build, None, (build.images[B], bytes(used))))
    board.until(lambda: board.bank == B, UP_S)
    assert board.starts == 1


# --- One that goes well -------------------------------------------------------------------------
def test_a_new_image_confirms_itself_when_it_has_run_well(build: Build, trial: MakeTrial) -> None:
    board = trial(compose(build, (build.images[A], RUN_WELL), (build.images[B], NEW)))
    board.until(lambda: board.bank == B, UP_S)
    up = board.board.cycle
    assert "PROBATION" in board.info().arming_reasons
    board.until(lambda: board.marks(B).confirmed, PROBATION_S)
    assert IMAGE_PROBATION_MS - 50 <= (board.board.cycle - up) / TIME_HZ * 1000 <= IMAGE_PROBATION_MS + 250
    board.run(0.2)
    assert "PROBATION" not in board.info().arming_reasons
    assert (board.starts, board.marks(B)) == (1, Marks((2,), starts=1, rejected=False, confirmed=True))
    board.board.reset()
    board.until(lambda: board.bank == B, UP_S)
    assert board.marks(B).starts == 1, "no further start is counted"


@pytest.mark.slow
def test_an_image_that_the_rom_installed_numbers_and_confirms_itself(build: Build, trial: MakeTrial) -> None:
    """Over one in the other bank that has run well, so that its number has to be newer."""
    proven = state(sequence=7, confirmed=True)
    board = trial(compose(build, (build.images[A], INSTALLED), (build.images[B], proven)))
    board.until(lambda: board.bank == A, UP_S)
    board.until(lambda: board.marks(A).confirmed, PROBATION_S)
    assert board.marks(A) == Marks((8,), starts=1, rejected=False, confirmed=True)
    board.board.reset()
    board.until(lambda: board.bank is not None, UP_S)
    assert board.bank == A


def test_nothing_arms_when_flash_does_not_hold_the_image_whole(build: Build, trial: MakeTrial) -> None:
    at, image = image_field_offset("version"), build.images[A]
    board = trial(compose(build, (image[:at] + bytes([image[at] ^ 1]) + image[at + 1 :], RUN_WELL)))
    board.until(lambda: board.bank == A, UP_S)
    board.until(lambda: "IMAGE_BAD" in board.info().arming_reasons, PROBATION_S)


def test_an_image_is_checked_within_60_ms_when_it_is_on_probation(build: Build, trial: MakeTrial) -> None:
    """And one that has run well is not: after a reset in flight motors wait."""
    took = []
    for marks in (RUN_WELL, NEW):
        board = trial(compose(build, (build.images[A], marks))).board
        board.engine.set_breakpoints([build.symbols[A]["reset_handler"] & ~1])
        assert board.engine.run(TIME_HZ) is Outcome.BREAKPOINT
        took.append(board.cycle / TIME_HZ * 1000)
    print(f"from power to the image: {took[0]:.2f} ms, on probation {took[1]:.1f} ms")
    assert took[0] < 1.0 and took[1] < 60.0


# --- Into the ROM -------------------------------------------------------------------------------
def good(build: Build) -> bytes:
    return compose(build, (build.images[A], RUN_WELL))


def test_the_rom_is_entered_with_the_led_lit_when_there_is_no_image(build: Build, trial: MakeTrial) -> None:
    board = trial(compose(build, (one_wrong_bit(replace(build, images=(b"", build.images[A]))), NEW)))
    board.until(lambda: board.board.hardware.rom.runs, UP_S)
    assert board.led_lit


def test_the_led_stays_lit_when_there_is_neither_image_nor_rom(build: Build, trial: MakeTrial) -> None:
    board = trial(compose(build))
    board.board.engine.set_memory(ROM, bytes(8))
    board.run(0.1)
    assert board.led_lit and not board.board.hardware.rom.runs and board.starts == 1


@pytest.mark.parametrize(("kind", "rom"), [(None, False), (Reboot.FIRMWARE, False), (Reboot.ROM, True)])
def test_msp_starts_the_firmware_or_the_rom_anew_when_asked(
    build: Build, trial: MakeTrial, kind: Reboot | None, rom: bool
) -> None:
    board = trial(good(build))
    board.until(lambda: board.bank == A, UP_S)
    board.run(0.2)
    assert board.client().request(Msp.REBOOT, b"" if kind is None else bytes([kind])) == b""
    board.until(lambda: board.starts == 2, 0.1)
    board.until(lambda: board.board.hardware.rom.runs or board.bank is not None, UP_S)
    assert board.board.hardware.rom.runs == rom
    board.board.engine.system_reset("pin")
    board.until(lambda: board.bank == A, UP_S)  # the wish was for once


@pytest.mark.parametrize("cause", ["brown-out", "iwdg", "pin"])
def test_a_wish_for_the_rom_is_not_believed_when_no_software_reset_the_chip(
    build: Build, trial: MakeTrial, cause: str
) -> None:
    board = trial(good(build))
    board.until(lambda: board.bank == A, UP_S)
    board.board.engine.set_memory(build.symbols[A]["kept"] + 4, ENTER_ROM)
    board.board.engine.system_reset(cause)
    board.until(lambda: board.starts == 2, 0.1)
    board.until(lambda: board.board.hardware.rom.runs or board.bank == A, UP_S)
    assert not board.board.hardware.rom.runs


def proven_once(build: Build, bank: int) -> bytes:
    """An image that has run well is in that bank; a newer one, on trial, in the other."""
    content = [(build.images[A], NEW), (build.images[B], NEW)]
    content[bank] = (build.images[bank], RUN_WELL)
    return compose(build, *content)


def proven_but_none(build: Build) -> bytes:
    """What is left of an image that had run well is none for this board."""
    return compose(build, (build.images[A], NEW), (wrong_board(build), RUN_WELL))


@pytest.mark.parametrize(
    ("flash", "rom"),
    [
        (good, False),
        (lambda build: proven_once(build, A), False),
        (lambda build: proven_once(build, B), False),
        (proven_but_none, True),
    ],
    ids=["run well", "run well in bank A alone", "run well in bank B alone", "none that has run well"],
)
def test_a_low_line_holds_up_no_board_that_has_an_image_which_ran_well(
    build: Build, trial: MakeTrial, flash: Callable[[Build], bytes], rom: bool
) -> None:
    """An adapter without power, or a computer that starts."""
    board = trial(flash(build))
    board.board.hardware.pins.drive(MSP_RX, False)
    board.until(lambda: board.board.hardware.rom.runs or board.bank is not None, UP_S)
    assert board.board.hardware.rom.runs == rom


@pytest.mark.parametrize(("ms", "rom"), [(0, False), (30, False), (49, False), (60, True)])
def test_the_rom_is_entered_when_the_line_is_held_low_at_power_up(
    build: Build, trial: MakeTrial, ms: int, rom: bool
) -> None:
    board = trial(compose(build, (build.images[A], INSTALLED), None))
    board.board.hardware.pins.drive(MSP_RX, ms == 0)
    board.run(ms / 1000)
    board.board.hardware.pins.drive(MSP_RX, True)
    board.until(lambda: board.board.hardware.rom.runs or board.bank is not None, UP_S)
    assert board.board.hardware.rom.runs == rom


@pytest.mark.parametrize("cause", ["iwdg", "software", "pin"])
def test_a_low_line_does_not_hold_the_image_up_when_it_was_no_power_up(
    build: Build, trial: MakeTrial, cause: str
) -> None:
    board = trial(good(build))
    board.until(lambda: board.bank == A, UP_S)
    board.board.hardware.pins.drive(MSP_RX, False)
    engine = board.board.engine
    engine.set_breakpoints([build.symbols[A]["reset_handler"] & ~1])
    engine.system_reset(cause)
    assert engine.run() is Outcome.RESET
    assert engine.run(board.board.cycle + TIME_HZ // 1000) is Outcome.BREAKPOINT, "within a millisecond"


@pytest.mark.parametrize("cause", ["iwdg", "software", "pin"])
def test_a_low_line_is_not_listened_to_after_a_reset_when_no_image_has_run_well(
    build: Build, trial: MakeTrial, cause: str
) -> None:
    board = trial(compose(build, (build.images[A], INSTALLED), None))
    board.until(lambda: board.bank == A, UP_S)
    board.board.hardware.pins.drive(MSP_RX, False)
    board.board.engine.system_reset(cause)
    board.until(lambda: board.starts == 2, 0.1)
    board.until(lambda: board.board.hardware.rom.runs or board.bank == A, UP_S)
    assert not board.board.hardware.rom.runs


def test_a_low_line_does_not_hold_the_image_up_when_the_supply_dipped_in_flight(
    build: Build, trial: MakeTrial
) -> None:
    """As the chip is delivered a dip has the flags of a power-up; memory outlives it."""
    board = trial(compose(build, (build.images[A], INSTALLED), None))
    board.until(lambda: board.bank == A, UP_S)
    steps = 4711
    kept = build.symbols[A]["kept"]
    board.board.engine.set_memory(kept + 8, struct.pack("<2I", steps, ARMED + steps))
    assert not board.board.hardware.rcc.detects_brown_out()
    board.board.hardware.pins.drive(MSP_RX, False)
    board.board.brown_out()
    board.until(lambda: board.starts == 2, 0.1)
    board.until(lambda: board.board.hardware.rom.runs or board.bank == A, UP_S)
    assert not board.board.hardware.rom.runs


# --- Loss of power ------------------------------------------------------------------------------
@pytest.mark.parametrize("cut", Cut)
def test_a_board_starts_when_power_goes_while_a_start_is_counted(
    build: Build, trial: MakeTrial, cut: Cut
) -> None:
    board = trial(compose(build, (build.images[A], RUN_WELL), (build.images[B], NEW)))
    flash = board.board.hardware.flash
    for _ in range(2):
        flash.cut_at, flash.cut = flash.operations, cut
        board.await_start(UP_S)
    board.until(lambda: board.bank is not None, UP_S)
    expected = {Cut.BEFORE: {(B, 1)}, Cut.AFTER: {(A, 2)}}.get(cut, {(A, 2), (B, 1), (B, 2)})
    assert (board.bank, board.marks(B).starts) in expected


@pytest.mark.parametrize(
    ("operation", "cut"),
    [
        pytest.param(operation, cut, marks=[] if operation == 1 else pytest.mark.slow)
        for operation in range(3)
        for cut in Cut
    ],
)
def test_a_board_starts_when_power_goes_while_an_image_numbers_and_confirms_itself(
    build: Build, probation: tuple[Trial, Snapshot], operation: int, cut: Cut
) -> None:
    board, before = probation
    restore_snapshot(board.board.engine, before)
    flash = board.board.hardware.flash
    flash.cut_at, flash.cut = flash.operations + operation, cut
    board.await_start(0.5)
    board.until(lambda: board.bank is not None, UP_S)
    marks = board.marks(A)
    assert board.bank == A
    assert marks.numbers in ((), (1,)) and not marks.rejected
    assert not marks.confirmed or marks.numbers == (1,)


@pytest.fixture(scope="module")
def probation(build: Build) -> Iterator[tuple[Trial, Snapshot]]:
    """A factory image that is about to number and confirm itself."""
    board = Trial(compose(build, (build.images[A], INSTALLED)), build.elf)
    board.until(lambda: board.bank == A, UP_S)
    flash, snapshot = board.board.hardware.flash, None
    board.run(IMAGE_PROBATION_MS / 1000 - 0.15)
    known = flash.operations
    while flash.operations == known:
        snapshot = take_snapshot(board.board.engine)
        board.run(0.02)
    assert snapshot is not None
    yield board, snapshot
    board.close()
