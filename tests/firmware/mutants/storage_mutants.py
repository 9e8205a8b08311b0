"""Mistakes in storage/ and msp/."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

SLOTS, BLOB, LOG = "storage/policy_slots.c", "storage/policy_blob.c", "storage/fault_log.c"
SETTINGS, STORE = "storage/settings.c", "storage/settings_store.c"
MSP, COMMANDS, REPLIES = "msp/msp.c", "msp/msp_commands.c", "msp/msp_replies.c"
OF_SLOTS, OF_BLOB, OF_LOG = (
    "storage/test_policy_slots.py",
    "storage/test_policy_blob.py",
    "storage/test_fault_log.py",
)
OF_SETTINGS, OF_STORE, OF_WEIGHTS = (
    "storage/test_settings.py",
    "storage/test_settings_store.py",
    "joined/test_weights.py",
)
OF_MSP, OF_COMMANDS, OF_PAYLOAD = "msp/test_msp.py", "msp/test_msp_commands.py", "msp/test_msp_payload.py"

STORAGE_MUTANTS = (
    Mutant(
        name="a full stick may ask for more than is flown",
        file="storage/settings.c",
        old="if (settings->rates_style != NF_RATES_STYLE_BETAFLIGHT)\n\t\treturn true; /* each",
        new="if (settings->rates_style <= NF_RATES_STYLE_BETAFLIGHT)\n\t\treturn true; /* each",
        tests=("storage/test_settings.py",),
    ),
    Mutant(
        name="a mended rate is the other style's",
        file="storage/settings.c",
        old="settings_put_default(settings, index, settings_info_beside(settings, index));\n}",
        new="settings_put_default(settings, index, &table[index]);\n}",
        tests=("storage/test_settings.py",),
    ),
    Mutant(
        name="the hold may last longer than until the drop",
        file="storage/settings.c",
        old="return settings->failsafe_hold_ms < settings->failsafe_delay_ms;",
        new="return settings->failsafe_hold_ms < 2 * settings->failsafe_delay_ms;",
        tests=("storage/test_settings.py",),
    ),
    Mutant(
        name="weights are compared with the first ones in flash",
        file=SLOTS,
        old="blob + NF_POLICY_BLOB_HEADER_BYTES + first * sizeof weights[0];",
        new="blob + NF_POLICY_BLOB_HEADER_BYTES;",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="only a weight's first byte is compared",
        file=SLOTS,
        old="memcmp(weights + first, kept, count * sizeof weights[0]) == 0;",
        new="memcmp(weights + first, kept, count) == 0;",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="weights are restored from a broken blob",
        file=SLOTS,
        old="\tslots->found[source] = policy_slots_check(slots, source);\n"
        "\tif (slots->found[source] != NF_OK)\n\t\treturn false;\n\tif (policy_slots_use",
        new="\tif (policy_slots_use",
        tests=(OF_WEIGHTS,),
    ),
    Mutant(
        name="a policy flies without its self-test",
        file=SLOTS,
        old="\tif (!policy_slots_selftest(policy, weights, &header, blob))\n\t\treturn false;\n",
        new="\t(void)policy_slots_selftest(policy, weights, &header, blob);\n",
        tests=(OF_SLOTS, OF_WEIGHTS),
    ),
    Mutant(
        name="one step of a self-test makes up for another",
        file=SLOTS,
        old="same &= memcmp(action, expected, sizeof action) == 0;",
        new="same = memcmp(action, expected, sizeof action) == 0;",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="the older of two policies flies",
        file=SLOTS,
        old="return policy_slots_newer(slots, POLICY_SLOT_B, POLICY_SLOT_A) ? POLICY_SLOT_B : POLICY_SLOT_A;",
        new="return policy_slots_newer(slots, POLICY_SLOT_A, POLICY_SLOT_B) ? POLICY_SLOT_B : POLICY_SLOT_A;",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="the slot that flies is written",
        file=SLOTS,
        old="return slots->flown == POLICY_SLOT_A ? POLICY_SLOT_B : POLICY_SLOT_A;",
        new="return slots->flown == POLICY_SLOT_A ? POLICY_SLOT_A : POLICY_SLOT_B;",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="half a policy may end its update",
        file=SLOTS,
        old=" || update.written != update.total)",
        new=")",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="an update is good although it has an old number",
        file=SLOTS,
        old="\tif (!policy_slots_takes(slots, policy_slots_sequence_of(blob)))\n"
        "\t\treturn policy_slots_give_up(slots, NF_REFUSAL_SEQUENCE);\n",
        new="",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="a blob's head is written first",
        file=SLOTS,
        old="\t\tfrom += sizeof update->head;\n\t\toffset += (uint32_t)sizeof update->head;\n"
        "\t\tbytes -= sizeof update->head;\n",
        new="",
        tests=(OF_SLOTS,),
    ),
    Mutant(
        name="a blob may be longer than its place",
        file=BLOB,
        old="header->total_bytes == total && total <= size;",
        new="header->total_bytes == total && total <= size + 4;",
        tests=(OF_BLOB,),
    ),
    Mutant(
        name="a self-test may end within a run",
        file=BLOB,
        old=" &&\n\t       header->selftest_count % header->selftest_steps == 0;",
        new=";",
        tests=(OF_BLOB,),
    ),
    Mutant(
        name="the largest idle is refused",
        file=BLOB,
        old="return policy_blob_bits(value) <= policy_blob_bits(most);",
        new="return policy_blob_bits(value) < policy_blob_bits(most);",
        tests=(OF_BLOB,),
    ),
    Mutant(
        name="a policy behind other filters is good",
        file=BLOB,
        old="\tif (header.filters_hash != running->filters_hash)\n\t\treturn NF_ERR_BLOB_FILTERS;\n",
        new="",
        tests=(OF_BLOB,),
    ),
    Mutant(
        name="an acknowledgement that was cut counts",
        file=LOG,
        old="entry.acknowledged == 0)",
        new="entry.acknowledged != FLASH_ERASED)",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="the number of boots is lost with an old fault's new log",
        file=LOG,
        old="if (!log->pending || log->boot != log->boots)",
        new="if (!log->pending)",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a fault that flash did not take is forgotten",
        file=LOG,
        old="\tif (entry.record.kind == FAULT_NONE)\n\t\treturn;\n\tlog->pending = true;",
        new="\tif (entry.record.kind == FAULT_NONE || !log->logged)\n\t\treturn;\n\tlog->pending = true;",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="the first of several faults is told",
        file=LOG,
        old="\t\tif (entry.record.kind == FAULT_NONE || entry.acknowledged == 0)\n",
        new="\t\tif (log->pending || entry.record.kind == FAULT_NONE || entry.acknowledged == 0)\n",
        tests=(OF_LOG, "joined/test_acknowledge.py"),
    ),
    Mutant(
        name="another style keeps the rates of that before",
        file=SETTINGS,
        old="if (settings->rates_style == style)",
        new="if (settings->rates_style == style || index < NF_SETTING_COUNT)",
        tests=(OF_SETTINGS, "joined/test_background.py"),
    ),
    Mutant(
        name="what is no number is within the limits of a setting",
        file=SETTINGS,
        old="return value->as_float >= limits->low.as_float && value->as_float <= limits->high.as_float;",
        new="return !(value->as_float < limits->low.as_float || value->as_float > limits->high.as_float);",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="two channels may be the same",
        file=SETTINGS,
        old="\t\tmet |= bit;\n",
        new="\t\tmet = bit;\n",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="the delay of the last filter does not count",
        file=SETTINGS,
        old="stage < SETTING_AT_dynamic_notch_count; stage += 3)",
        new="stage + 3 < SETTING_AT_dynamic_notch_count; stage += 3)",
        tests=(OF_SETTINGS,),
    ),
    Mutant(
        name="the older settings are loaded",
        file=STORE,
        old="serial_number_newer(head->sequence, other.sequence)",
        new="serial_number_newer(other.sequence, head->sequence)",
        tests=(OF_STORE,),
    ),
    Mutant(
        name="new settings overwrite the newest",
        file=STORE,
        old="&places[(last + 1) % NF_FLASH_SETTINGS_COUNT]",
        new="&places[last % NF_FLASH_SETTINGS_COUNT]",
        tests=(OF_STORE,),
    ),
    Mutant(
        name="settings that contradict each other are saved",
        file=STORE,
        old="\tif (settings_conflict(settings) != NF_SETTING_COUNT)\n\t\treturn NF_REFUSAL_CONFLICT;\n",
        new="",
        tests=(OF_STORE, OF_COMMANDS),
    ),
    Mutant(
        name="a request with a wrong checksum is carried out",
        file=MSP,
        old="return byte == msp->checksum;",
        new="return byte == msp->checksum || byte != 0;",
        tests=(OF_MSP,),
    ),
    Mutant(
        name="a payload may be a byte too long",
        file=MSP,
        old="if (msp->size > NF_MSP_PAYLOAD_MAX)",
        new="if (msp->size > NF_MSP_PAYLOAD_MAX + 1)",
        tests=(OF_MSP,),
    ),
    Mutant(
        name="a reply is cut where there is no room",
        file=MSP,
        old="if (header_end + size + 1 > capacity)",
        new="if (header_end + size > capacity)",
        tests=(OF_MSP,),
    ),
    Mutant(
        name="what may only be done disarmed is done armed",
        file=COMMANDS,
        old="\tif (q->status->trace.armed)\n\t\treturn NF_REFUSAL_ARMED;\n",
        new="",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="nothing arms any more after flash was written",
        file=COMMANDS,
        old="\t(void)s->storing(s->context, false);\n",
        new="",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="flash is written although the motors were armed meanwhile",
        file=COMMANDS,
        old="\tif (refusal != NF_REFUSAL_NONE)\n\t\treturn refusal;\n\tconst enum nf_refusal result",
        new="\t(void)refusal;\n\tconst enum nf_refusal result",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="a payload may be too short",
        file=COMMANDS,
        old="*fits = size >= found->shortest && ",
        new="*fits = ",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="negative fractions are rounded up",
        file="msp/msp_payload.c",
        old="held < 0.0f ? held - 0.5f : held + 0.5f",
        new="held + 0.5f",
        tests=(OF_PAYLOAD,),
    ),
    Mutant(
        name="the heading turns left",
        file=REPLIES,
        old="const float right = -angles[2];",
        new="const float right = angles[2];",
        tests=(OF_MSP,),
    ),
    Mutant(
        name="a refused policy is not told",
        file=REPLIES,
        old="msp_put_u8(w, status->refused_cause);",
        new="msp_put_u8(w, status->refused_cause & 0u);",
        tests=(OF_MSP, "joined/test_acknowledge.py"),
    ),
)
