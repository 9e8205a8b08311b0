"""The table taken from the vendor's description, against independent facts."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim.board.peripherals.option_bytes import FLASH_SIZE_ADDRESS, UID_ADDRESS
from sim.board.registers.bus import load_table
from sim.board.registers.extract import extract, main, render
from toolchain.errors import BuildError
from toolchain.rendering.register_table import load

TARGET = Path(__file__).resolve().parents[4] / "firmware" / "targets" / "MATEKF722"

SMALL = """<device><name>X</name><version>1</version><peripherals>
<peripheral><name>{name}</name><baseAddress>0x40000000</baseAddress><registers/></peripheral>
</peripherals></device>"""


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
    ):
        assert blocks[name].base + blocks[name].registers[register].offset == address
    assert load_table().interrupt("EXTI3") == 9
    assert load_table().interrupt("DMA2_STREAM2") == 58


def test_table_agrees_with_the_firmwares_when_both_have_a_register() -> None:
    """Both come from one description by two scripts."""
    compared = 0
    for register in load(TARGET).registers:
        found = load_table().find(register.address)
        if register.source != "svd" or register.address >= 0xE0000000 or found is None or found[1] is None:
            continue
        block, ours = found
        if ours is not None and ours.modelled:
            compared += 1
            assert (ours.reset, ours.access) == (register.reset, register.access), (block.name, ours.name)
            assert {f.name: f.mask for f in register.fields}.items() <= {
                f.name: f.mask for f in ours.fields.values()
            }.items(), (block.name, ours.name)
    assert compared > 100


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


def test_extraction_names_the_mistake_when_the_file_is_another(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = tmp_path / "other.svd"
    other.write_text(SMALL.format(name="TIM2"))
    with pytest.raises(BuildError, match="has no ADC1"):
        extract(other)
    assert main([str(tmp_path / "none.svd"), "--out", str(tmp_path / "x.json")]) == 1
    assert "none.svd" in capsys.readouterr().err
    assert not (tmp_path / "x.json").exists()


def test_render_writes_a_register_a_line_when_given_a_table() -> None:
    registers = [{"name": "CR", "offset": "0x0"}, {"name": "SR", "offset": "0x4"}]
    text = render(
        {"device": "X", "peripherals": {"P": {"base": "0x0", "size": "0x400", "registers": registers}}}
    )
    assert '   {"name": "CR", "offset": "0x0"},\n   {"name": "SR", "offset": "0x4"}]' in text
