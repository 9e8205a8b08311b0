"""Mistakes in image_bank.c and image_update.c, in what an image leaves behind, and in their commands."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

BANK, UPDATE, SLOTS = "storage/image_bank.c", "storage/image_update.c", "storage/policy_slots.c"
COMMANDS, SHA256 = "msp/msp_commands.c", "common/sha256.c"
OF_BANK, OF_UPDATE, OF_POWER = (
    "storage/test_image_bank.py",
    "storage/test_image_update.py",
    "storage/test_image_power.py",
)
OF_COMMANDS, OF_SHA256 = "msp/test_image_commands.py", "common/test_sha256.py"

IMAGE_MUTANTS = (
    Mutant(
        name="an image for another board fits",
        file=BANK,
        old="\tif (memcmp(header->board, board, sizeof header->board) != 0)\n"
        "\t\treturn NF_ERR_IMAGE_BOARD;\n",
        new="\t(void)board;\n",
        tests=(OF_BANK, OF_UPDATE),
    ),
    Mutant(
        name="an image may lie over its bank's marks",
        file=BANK,
        old="#define BYTES_MAX (NF_FLASH_BANK_A_SIZE - NF_IMAGE_TAIL_BYTES)",
        new="#define BYTES_MAX NF_FLASH_BANK_A_SIZE",
        tests=(OF_BANK, OF_UPDATE),
    ),
    Mutant(
        name="a number's check does not cover its floor",
        file=BANK,
        old="return crc32_more(0, number, offsetof(struct number, check));",
        new="return crc32_more(0, number, offsetof(struct number, policy_floor));",
        tests=(OF_BANK,),
    ),
    Mutant(
        name="an image without a number counts as confirmed",
        file=BANK,
        old="\t\tmarks.confirmed = state.confirmed == 0;\n",
        new="\t}\n\tmarks.confirmed = state.confirmed == 0;\n\tif (marks.numbered) {\n",
        tests=(OF_BANK,),
    ),
    Mutant(
        name="an image that was written counts as installed",
        file=BANK,
        old="marks.installed = state.written == FLASH_ERASED && !marks.numbered;",
        new="marks.installed = !marks.numbered;",
        tests=(OF_BANK, OF_UPDATE, OF_POWER),
    ),
    Mutant(
        name="a rejected image has not failed",
        file=BANK,
        old="return marks->rejected || (",
        new="return (",
        tests=(OF_BANK, OF_UPDATE),
    ),
    Mutant(
        name="a confirmed image fails by its starts",
        file=BANK,
        old="(!marks->confirmed && marks->starts >= NF_IMAGE_STARTS_MAX)",
        new="(marks->starts >= NF_IMAGE_STARTS_MAX)",
        tests=(OF_BANK,),
    ),
    Mutant(
        name="the older image is started",
        file=BANK,
        old="return serial_number_newer(a->sequence, b->sequence);",
        new="return serial_number_newer(b->sequence, a->sequence);",
        tests=(OF_BANK, OF_UPDATE),
    ),
    Mutant(
        name="a spoilt place for a number is used again",
        file=BANK,
        old="takes &= (wanted[i] & ~words[i]) == 0;",
        new="takes |= (wanted[i] & ~words[i]) == 0;",
        tests=(OF_BANK,),
    ),
    Mutant(
        name="an image for another bank is erased for",
        file=UPDATE,
        old="\tif (*why != NF_OK)\n\t\treturn NF_REFUSAL_IMAGE;\n\tif (!update->begun",
        new="\tif (!update->begun",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="an update begins anew instead of going on",
        file=UPDATE,
        old="if (!update->begun || !image_update_is_header(update, header) ||\n"
        "\t    image_bank_marks(update->flash, spare).numbered) {",
        new="{",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="an image goes on where another one was",
        file=UPDATE,
        old="if (!update->begun || !image_update_is_header(update, header) ||",
        new="if (!update->begun ||",
        tests=(OF_UPDATE, OF_COMMANDS),
    ),
    Mutant(
        name="an image that was switched to keeps its floor",
        file=UPDATE,
        old=" ||\n\t    image_bank_marks(update->flash, spare).numbered) {",
        new=") {",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="the image to go back to is erased",
        file=UPDATE,
        old="marks.confirmed && !marks.rejected &&",
        new="marks.confirmed && marks.rejected &&",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="the spare bank is not claimed",
        file=UPDATE,
        old="return flash_erase(flash, place->sector) && image_bank_claim(flash, bank);",
        new="return flash_erase(flash, place->sector);",
        tests=(OF_UPDATE, OF_POWER),
    ),
    Mutant(
        name="the old image's magic stands while it is erased",
        file=UPDATE,
        old="\tif (magic == NF_IMAGE_MAGIC &&",
        new="\tif (magic != NF_IMAGE_MAGIC &&",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="any block of the past may be repeated",
        file=UPDATE,
        old="offset + bytes == update->written && memcmp",
        new="offset + bytes <= update->written && memcmp",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a repeated block may be another",
        file=UPDATE,
        old="if (offset + bytes == update->written && "
        "memcmp(flash_at(update->flash, address), words, bytes) == 0)",
        new="if (offset + bytes == update->written)",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="half an image may end",
        file=UPDATE,
        old="if (!update->begun || update->written != update->header.image_bytes)",
        new="if (!update->begun)",
        tests=(OF_UPDATE, OF_COMMANDS),
    ),
    Mutant(
        name="an image with another header than told may end",
        file=UPDATE,
        old="\tif (!image_update_is_header(update, &header))\n\t\t*why = NF_ERR_IMAGE_HEADER;\n\telse if",
        new="\tif",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a damaged image may be switched to",
        file=UPDATE,
        old="\tif (!image_bank_whole(update->flash, spare, update->board))\n\t\treturn NF_ERR_IMAGE_CRC;\n",
        new="",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="another image than the one told is switched to",
        file=UPDATE,
        old="return memcmp(digest, told, sizeof digest) == 0 ? NF_OK : NF_ERR_IMAGE_SHA256;",
        new="return memcmp(digest, told, 4) == 0 ? NF_OK : NF_ERR_IMAGE_SHA256;",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="an image that would not be started is switched to",
        file=UPDATE,
        old="\tif (!image_update_starts(update))\n\t\treturn NF_REFUSAL_ORDER;\n",
        new="\t(void)image_update_starts(update);\n",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="an installed running image stays preferred",
        file=UPDATE,
        old="image_bank_claim(flash, spare) && image_bank_number(flash, update->running, NULL) &&",
        new="image_bank_claim(flash, spare) &&",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a switch forgets the policies to leave behind",
        file=UPDATE,
        old="floor->counts ? &floor->sequence : NULL",
        new="!floor->counts ? &floor->sequence : NULL",
        tests=(OF_UPDATE, OF_COMMANDS),
    ),
    Mutant(
        name="a policy not newer than the floor flies",
        file=SLOTS,
        old="\tif (err == NF_OK && bound && "
        "!serial_number_newer(policy_slots_sequence_of(blob), slots->floor))\n"
        "\t\treturn NF_ERR_BLOB_OLD;\n",
        new="\t(void)bound;\n",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="the next number takes no account of the floor",
        file=SLOTS,
        old="uint32_t newest = slots->floor;",
        new="uint32_t newest = 0;",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a policy is taken that the floor would keep from flying",
        file=SLOTS,
        old=" &&\n\t       (!slots->has_floor || serial_number_newer(sequence, slots->floor));",
        new=";",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="the slot that flies next is written after a revert",
        file=SLOTS,
        old="\tif (slots->reverted)\n\t\treturn policy_slots_give_up(slots, NF_REFUSAL_ORDER);\n",
        new="",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a policy that waits for the restart is reverted to",
        file=SLOTS,
        old=" || slots->update.ended)\n\t\treturn NF_REFUSAL_ORDER;",
        new=")\n\t\treturn NF_REFUSAL_ORDER;",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a revert is refused when it is repeated",
        file=SLOTS,
        old="\tif (slots->reverted)\n\t\treturn NF_REFUSAL_NONE;\n",
        new="\tif (slots->reverted)\n\t\treturn NF_REFUSAL_ORDER;\n",
        tests=(OF_UPDATE, OF_COMMANDS),
    ),
    Mutant(
        name="a policy for another image is no floor",
        file=SLOTS,
        old="if (header.magic != NF_POLICY_BLOB_MAGIC)\n\t\t\tcontinue;",
        new="if (policy_slots_check(slots, slot) != NF_OK)\n\t\t\tcontinue;",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a damaged policy's header is told",
        file=SLOTS,
        old="\tcase NF_ERR_BLOB_CRC:\n",
        new="",
        tests=(OF_UPDATE,),
    ),
    Mutant(
        name="a kept policy is left behind",
        file=COMMANDS,
        old="\tif (keep) {\n",
        new="\tif (!keep) {\n",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="what is no image is told as one",
        file=COMMANDS,
        old="msp_put_u8(q->reply, fits ? command_image_flags(&marks) : 0);",
        new="msp_put_u8(q->reply, command_image_flags(&marks));",
        tests=(OF_COMMANDS,),
    ),
    Mutant(
        name="a digest's padding has one block too few",
        file=SHA256,
        old="count < BLOCK_BYTES - LENGTH_BYTES ?",
        new="count <= BLOCK_BYTES - LENGTH_BYTES ?",
        tests=(OF_SHA256,),
    ),
)
