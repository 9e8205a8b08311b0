"""Mistakes in storage/card/: the SD card, the files on it, the logs in them."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

CARD, FILES, LOG = "storage/card/sd_card.c", "storage/card/card_files.c", "storage/card/card_log.c"
OF_FILES, OF_LOG = "storage/card/test_card_files.py", "storage/card/test_card_log.py"
OF_CUTS = "storage/card/test_power_cuts.py"

CARD_MUTANTS = (
    Mutant(
        name="a block that was read is believed without its checksum",
        file=CARD,
        old="if (sd_crc16(card->data, count) != ",
        new="if (count == 0u && sd_crc16(card->data, count) != ",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a block that the card refused is not sent again",
        file=CARD,
        old="if ((*answer & ACCEPTED_MASK) != ACCEPTED) {",
        new="if ((*answer & RESPONSE_MASK) != RESPONSE) {",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a card that is busy with a refused block is told to stop",
        file=CARD,
        old="if (card->writing && card->trouble) {",
        new="if (card->writing && card->trouble && card->job == JOB_NONE) {",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a pulled card is not missed at rest",
        file=CARD,
        old="!card->writing && sd_passed(card) >= PRESENCE_MS)",
        new="!card->writing && sd_passed(card) >= PRESENCE_MS && card->blocks == 0u)",
        tests=(OF_CUTS,),
    ),
    Mutant(
        name="a busy card is given up after a quarter of a second",
        file=CARD,
        old="#define BUSY_MS 1000u",
        new="#define BUSY_MS 250u",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a file in pieces is taken for one",
        file=FILES,
        old="if (word != files->cluster + 1u) {",
        new="if (word < 2u) {",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="the directory is taken for a file",
        file=FILES,
        old="if (files->root[i] >= first && files->root[i] <= last)",
        new="if (files->root[i] > first && files->root[i] < last)",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="a file system may be larger than its card",
        file=FILES,
        old="before >= sectors ||\n\t    sectors > blocks - files->partition)",
        new="before >= sectors || blocks == 0u)",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="a log overwrites the last one",
        file=FILES,
        old="state = files_blank(block) ? CARD_FILE_BLANK : CARD_FILE_WRITTEN;",
        new="state = CARD_FILE_BLANK;\n\t(void)block;",
        tests=(OF_LOG, OF_CUTS),
    ),
    Mutant(
        name="erasing begins with the first sector",
        file=LOG,
        old="const bool first = log->rest_erased || rest == 0u;",
        new="const bool first = !log->rest_erased || rest == 0u;",
        tests=(OF_CUTS, OF_LOG),
    ),
    Mutant(
        name="a log's end stays in the ring",
        file=LOG,
        old="\t\tlog->taken += rest;\n",
        new="",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="the ring takes more than it holds",
        file=LOG,
        old="const uint32_t limit = room < left ? room : left,",
        new="const uint32_t limit = room < left ? left : room,",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a block that was read is believed after it was written",
        file=CARD,
        old="if (card->held == block)",
        new="if (card->held == block + 1u)",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a card of 2 TiB has no blocks",
        file=CARD,
        old="size < C_SIZE_MAX ? (size + 1u) << 10 : SD_NO_BLOCK;",
        new="(size + 1u) << 10;",
        tests=(OF_LOG,),
    ),
    Mutant(
        name="a file system is believed whose size is told in 16 bits",
        file=FILES,
        old="files_u16(block + SECTORS_16) != 0u || ",
        new="",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="a file system of a later version is believed",
        file=FILES,
        old="files_u16(block + VERSION) != 0u ||",
        new="",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="the first table is believed where another is in use",
        file=FILES,
        old="(block[FLAGS] & NOT_MIRRORED) != 0u || ",
        new="",
        tests=(OF_FILES,),
    ),
    Mutant(
        name="clusters of no block are divided by",
        file=FILES,
        old="cluster_sectors == 0u ||\n",
        new="\n",
        tests=(OF_FILES,),
    ),
)
