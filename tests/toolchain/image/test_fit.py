"""Which functions of a policy run from ITCM, and what an image has room for."""

from __future__ import annotations

from pathlib import Path

from neuroflight.toolchain.image.elf import Section, memory_use, read_image
from neuroflight.toolchain.image.fit import ALIGNMENT, POLICY_ITCM_BYTES, VENEER_BYTES, split

KIB = 1024
IMAGE_BYTES_MAX = 122 * KIB  # of the bank, which has 127.9; USB took 7, all boards' chips and wires 12
ITCM_FREE_MIN = 3 * KIB // 2
RAM_BYTES_MAX = 204 * KIB  # listening to ESCs and logs on flash chips took 4


def code(**sizes: int) -> list[Section]:
    return [Section(f".text.{name}", 0, size, True) for name, size in sizes.items()]


def names(sections: list[Section]) -> list[str]:
    return [section.name.removeprefix(".text.") for section in sections]


def test_all_functions_run_from_itcm_when_they_have_room_there() -> None:
    fast, slow = split(code(policy_step=400, linear8=480, elu=300))
    assert (sorted(names(fast)), slow) == (["elu", "linear8", "policy_step"], [])


def test_inner_loops_come_first_and_code_that_is_run_once_last_when_room_is_scarce() -> None:
    sizes = {"policy_step": 800, "silu": 600, "elu": 200, "linear8.constprop.0": 900, "look_up": 900}
    fast, slow = split(code(**sizes))
    assert names(fast) == ["linear8.constprop.0", "look_up", "elu", "silu"]
    assert names(slow) == ["policy_step"]


def test_a_function_in_flash_costs_its_veneer_when_the_next_one_is_placed() -> None:
    rest = POLICY_ITCM_BYTES - 800
    (left_out,) = split(code(linear8=800, policy_step=rest + 1))[1]
    assert left_out.name == ".text.policy_step"
    for room, fits in ((rest - VENEER_BYTES, True), (rest - VENEER_BYTES + 1, False)):
        fast, _ = split(code(linear8=800, linear4=rest + ALIGNMENT, policy_init=room))
        assert ("policy_init" in names(fast)) == fits


def test_the_shipped_image_keeps_to_its_budgets_when_linked(board_image: Path) -> None:
    image = read_image(board_image)
    use = {part.region: part for part in memory_use(image)}
    bank = image.symbols["image_bytes"]
    itcm_free = use["ITCM"].size - use["ITCM"].used
    ram = sum(part.used for name, part in use.items() if name != "flash")
    print(f"bank {bank:,} bytes, ITCM {itcm_free:,} free, RAM {ram:,}")
    assert bank <= IMAGE_BYTES_MAX
    assert itcm_free >= ITCM_FREE_MIN
    assert ram <= RAM_BYTES_MAX


def test_the_policys_part_of_itcm_is_the_linkers_when_functions_are_placed(board_image: Path) -> None:
    assert read_image(board_image).symbols["POLICY_ITCM"] == POLICY_ITCM_BYTES
