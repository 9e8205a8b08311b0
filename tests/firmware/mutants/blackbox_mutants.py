"""Mistakes of the log: its ring, its snapshots."""

from __future__ import annotations

from tests.firmware.mutants.mutant import Mutant

OF_RING = "blackbox/test_ring.py"
OF_FLIGHT = "blackbox/test_log_of_a_flight.py"

BLACKBOX_MUTANTS: tuple[Mutant, ...] = (
    Mutant(
        name="a record is taken of the place behind the oldest",
        file="blackbox/log_ring.c",
        old="&ring->records[taken % LOG_RING_RECORDS]",
        new="&ring->records[(taken + 1u) % LOG_RING_RECORDS]",
        tests=(OF_RING,),
    ),
    Mutant(
        name="a snapshot is taken between samples of one control step",
        file="blackbox/log_snapshot.c",
        old="before == 0 || before != *state->window",
        new="before == 0",
        tests=(OF_RING,),
    ),
    Mutant(
        name="a snapshot keeps the last pointer",
        file="blackbox/log_snapshot.c",
        old="i < state->held_count;",
        new="i + 1u < state->held_count;",
        tests=(OF_RING,),
    ),
    Mutant(
        name="a snapshot is renewed a step late",
        file="blackbox/log_snapshot.c",
        old="snapshot->step >= LOG_SNAPSHOT_STEPS",
        new="snapshot->step > LOG_SNAPSHOT_STEPS",
        tests=(OF_RING,),
    ),
    Mutant(
        name="a log is written as if no motor ever turned",
        file="background_blackbox.c",
        old=".armed = firmware_armed(fw),",
        new=".armed = false,",
        tests=(OF_FLIGHT,),
    ),
    Mutant(
        name="a record tells the next step's first sample as its own",
        file="firmware_log.c",
        old="record->sample = fw->samples - 1u;",
        new="record->sample = fw->samples;",
        tests=(OF_FLIGHT,),
    ),
)
