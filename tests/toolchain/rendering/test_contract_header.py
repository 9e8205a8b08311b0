"""nf_contract.h through a C compiler against the contract itself."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from neuroflight.toolchain import contract
from neuroflight.toolchain.rendering.contract_header import render_contract

EXPRESSIONS = {
    "NF_GYRO_COUNTS": contract.GYRO_COUNTS,
    "NF_CHANNEL_AUX1": contract.CHANNEL_AUX1,
    "NF_SIM_POWER_MAGIC": contract.SIM_POWER_MAGIC,
    "NF_SIM_STATE_BYTES": 18 * 8,
    "NF_SIM_RECEIVER_BYTES": 8 + 16 * 2,
    "NF_SIM_SERVO_BYTES": 4 + 16 * 4,
    "NF_FLASH_BANK_A_ADDRESS": 0x08020000,
    "NF_FLASH_BANK_A_SIZE": 128 * 1024,
    "NF_FLASH_SECTORS_COUNT": 8,
    "NF_FLASH_SECTORS_4_SIZE": 64 * 1024,
    "NF_DTCM_ADDRESS": contract.DTCM.address,
    "NF_OBSERVATION_BLOCK_COUNT": sum(block.in_firmware for block in contract.OBSERVATION_BLOCKS),
    "sizeof(struct nf_policy_blob_header)": 584,
    "NF_POLICY_BLOB_HEADER_BYTES": 584,
    "NF_POLICY_BLOB_MAGIC": int.from_bytes(b"NFPB", "little"),
    "offsetof(struct nf_policy_blob_header, architecture_hash)": 16,
    "offsetof(struct nf_policy_blob_header, weight_count)": 36,
    "offsetof(struct nf_policy_blob_header, policy_sha256)": 308,
    "offsetof(struct nf_policy_blob_header, model_reaction)": 480,
    "sizeof(NF_MSP_VARIANT)": len(contract.MSP_VARIANT) + 1,
    "sizeof(NF_CALIBRATION_MOTION_DEG_S)": 4,
    **{f"NF_OBSERVATION_{block.name.upper()}": block.code for block in contract.OBSERVATION_BLOCKS},
    **{f"NF_MIX_{mix.name}": mix.value for mix in contract.Mix},
    **{f"NF_MSP_{item.name}": item.value for item in contract.Msp},
    **{f"NF_ARMING_REASON_{item.name}": item.value for item in contract.ArmingReason},
}


@pytest.mark.parametrize("compiler", ["gcc", "arm-none-eabi-gcc"])
def test_header_says_what_the_contract_does_when_c_reads_it(tmp_path: Path, compiler: str) -> None:
    (tmp_path / "nf_contract.h").write_text(render_contract())
    checks = "".join(f'_Static_assert({e} == {v}, "{e}");\n' for e, v in EXPRESSIONS.items())
    rates = ", ".join(str(rate) for rate in contract.GYRO_RATES_HZ)
    sources = [block for block in contract.OBSERVATION_BLOCKS if block.in_firmware]
    widths = sum(block.code * block.width for block in sources)
    source = f"""
#include "nf_contract.h"
{checks}
static const unsigned rates[NF_GYRO_RATES_HZ_COUNT] = NF_GYRO_RATES_HZ, expected[] = {{ {rates} }};
_Static_assert(sizeof rates == sizeof expected, "rates");
#define COUNT(name, code, width) + 1
_Static_assert(0 NF_OBSERVATION_BLOCKS(COUNT) == NF_OBSERVATION_BLOCK_COUNT, "blocks");
#define CODE(name, code, width) + code * width
_Static_assert(0 NF_OBSERVATION_BLOCKS(CODE) == {widths}, "widths");
int use(int i);
int use(int i) {{ return (int)(rates[i] - expected[i]); }}
"""
    flags = ["-std=c11", "-Wall", "-Wextra", "-Wconversion", "-Wpadded", "-pedantic"]
    command = [compiler, *flags, "-Werror", "-fsyntax-only", f"-I{tmp_path}", "-x", "c", "-"]
    done = subprocess.run(command, input=source, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


def test_floats_are_single_precision_when_c_reads_them() -> None:
    assert "#define NF_RATE_ERROR_INTEGRAL_LIMIT_RAD 0.6f\n" in render_contract()


def test_header_leaves_out_what_only_python_speaks_when_rendered() -> None:
    text = render_contract()
    assert "NF_META_" not in text
    assert "NF_CHECKPOINT_" not in text
    assert "_FORMAT" not in text


def test_header_has_one_struct_for_the_blob_when_rendered() -> None:
    text = render_contract()
    assert text.count("struct nf_policy_blob_header {") == 1
    assert "NF_POLICY_BLOB_FIELDS" not in text


def test_header_is_the_same_when_rendered_twice() -> None:
    assert render_contract() == render_contract()
