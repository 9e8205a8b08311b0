"""The table taken from the vendor's description, against independent facts."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import pytest

from neuroflight.sim.board.peripherals.option_bytes import FLASH_SIZE_ADDRESS, UID_ADDRESS
from neuroflight.sim.board.registers.bus import TABLE, load_table
from neuroflight.sim.board.registers.extract import MODELLED, extract, main, render
from neuroflight.toolchain.errors import BuildError

ROOT = Path(__file__).resolve().parents[4]
# The vendor's description of the STM32F7x2, version 1.3, from which the committed table comes.
SVD_SHA256 = "8d411b234d33dad0d4daa56acdc03991d45feb91ab6ffecf49b2cfca83c119d9"
SMALL = """<device><name>X</name><version>1</version><peripherals>
{peripherals}
</peripherals></device>"""
PERIPHERAL = "<peripheral><name>{}</name><baseAddress>{}</baseAddress><registers>{}</registers></peripheral>"
REGISTER = "<register><name>{}</name><addressOffset>{}</addressOffset>{}</register>"
FIELD = "<fields><field><name>{}</name><bitOffset>{}</bitOffset><bitWidth>1</bitWidth></field></fields>"


def test_table_has_the_manuals_addresses_when_loaded() -> None:
    blocks = load_table().blocks
    # RM0431 2.2.2, register boundary addresses; offsets from the register maps.
    for name, register, address in (
        ("RCC", "CSR", 0x40023874),
        ("DMA2", "S7M0AR", 0x400264C4),
        ("DMA1", "S5CR", 0x40026088),
        ("TIM8", "DMAR", 0x4001044C),
        ("USART2", "RDR", 0x40004424),
        ("ADC_Common", "CCR", 0x40012304),
        ("IWDG", "RLR", 0x40003008),
        ("OTG_FS_GLOBAL", "DIEPTXF5", 0x50000114),
        ("OTG_FS_DEVICE", "DOEPTSIZ5", 0x50000BB0),
        ("OTG_FS_PWRCLK", "PCGCCTL", 0x50000E00),
        ("OTG_FS_FIFO5", "DFIFO", 0x50006000),
    ):
        assert blocks[name].base + blocks[name].registers[register].offset == address
    assert load_table().interrupt("EXTI3") == 9
    assert load_table().interrupt("DMA2_STREAM2") == 58
    assert load_table().interrupt("OTG_FS") == 67


def test_usb_registers_are_the_manuals_when_the_description_is_another_cores() -> None:
    blocks = load_table().blocks
    # RM0431, OTG_FS: after reset the core is off the bus, idle, and its one transceiver is chosen.
    assert blocks["OTG_FS_DEVICE"].registers["DCTL"].reset == 0x2
    assert blocks["OTG_FS_GLOBAL"].registers["GRSTCTL"].reset == 0x80000000
    assert blocks["OTG_FS_GLOBAL"].registers["GUSBCFG"].fields["PHYSEL"].access == "r"
    # The program enables and disables endpoint 0 as it does the others.
    for name in ("DIEPCTL0", "DOEPCTL0", "DIEPCTL3", "DOEPCTL3"):
        assert blocks["OTG_FS_DEVICE"].registers[name].fields["EPENA"].access == "rw"
        assert "STALL" in blocks["OTG_FS_DEVICE"].registers[name].fields
    found = load_table().find(0x50000FFC)
    assert found is not None and found[0].name == "OTG_FS_PWRCLK"
    found = load_table().find(0x50001400)
    assert found is not None and found[0].name == "OTG_FS_FIFO0"


def test_the_committed_table_is_the_scripts_when_the_description_is_at_hand() -> None:
    svd = Path(os.environ.get("NEUROFLIGHT_SVD", ROOT.parent / "shared" / "svd" / "stm32f7x2.svd"))
    if not svd.is_file():
        pytest.skip(f"needs the vendor's description, SHA-256 {SVD_SHA256}; set NEUROFLIGHT_SVD to its path")
    assert load_table().sha256 == SVD_SHA256 == hashlib.sha256(svd.read_bytes()).hexdigest()
    assert render(extract(svd)) == TABLE.read_text()


def test_a_row_edited_by_hand_is_refused_when_read(tmp_path: Path) -> None:
    edited = tmp_path / "registers.json"
    edited.write_text(TABLE.read_text().replace('"base": "0x40023800"', '"base": "0x40023804"', 1))
    with pytest.raises(BuildError, match=r"registers\.json: its rows are not those that were extracted"):
        load_table(edited)


def test_find_names_a_peripheral_when_it_is_not_modelled() -> None:
    found = load_table().find(0x40005404)
    assert found is not None
    assert found[0].name == "I2C1"
    assert load_table().find(0x4002F000) is None
    assert (UID_ADDRESS, FLASH_SIZE_ADDRESS) == (0x1FF07A10, 0x1FF07A22)


def test_masks_part_a_register_when_some_fields_are_not_modelled() -> None:
    register = load_table().blocks["TIM8"].registers["CR1"]
    assert register.writable == 0x8F  # CEN UDIS URS OPM ARPE
    assert register.unmodelled == 0xB70 & ~0x80  # DIR CMS CKD UIFREMAP
    assert register.reserved == 0xFFFFF400


def small(peripherals: dict[str, str], core: str = "") -> str:
    """A description of peripherals by name with these registers, and one of the core's."""
    rows = [PERIPHERAL.format(name, "0x40000000", registers) for name, registers in peripherals.items()]
    return SMALL.format(peripherals="".join(rows) + PERIPHERAL.format("SCB", "0xE000ED00", core))


EMPTY = dict.fromkeys(MODELLED, "")
MOVED = REGISTER.format("SHCSR", "0x24", FIELD.format("USGFAULTENA", 19))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("no xml", "syntax error"),
        ("<device/>", "has no ADC1"),
        (small({"TIM2": ""}), "has no ADC1"),
        (small(EMPTY), "RCC of the description lacks AHB1ENR"),
        (small(EMPTY, core=MOVED), "SCB_SHCSR USGFAULTENA is elsewhere than stated"),
    ],
)
def test_extraction_names_the_mistake_when_the_file_is_another(
    text: str, says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.svd"
    other.write_text(text)
    assert main([str(other), "--out", str(tmp_path / "x.json")]) == 1
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
    assert main([str(tmp_path / "none.svd"), "--out", str(tmp_path / "x.json")]) == 1
    assert "none.svd" in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()


def test_render_writes_a_register_a_line_when_given_a_table() -> None:
    registers = [{"name": "CR", "offset": "0x0"}, {"name": "SR", "offset": "0x4"}]
    text = render(
        {"device": "X", "peripherals": {"P": {"base": "0x0", "size": "0x400", "registers": registers}}}
    )
    assert '   {"name": "CR", "offset": "0x0"},\n   {"name": "SR", "offset": "0x4"}]' in text
