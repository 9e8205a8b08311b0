"""Acknowledges what keeps a board from arming until somebody knows of it."""

from __future__ import annotations

from dataclasses import dataclass

from neuroflight.flash.link import records
from neuroflight.flash.link.client import Client
from neuroflight.flash.link.records import Fault
from neuroflight.toolchain.contract import FallbackCause, Msp


@dataclass(frozen=True)
class Acknowledged:
    """The faults and the policy error that were acknowledged."""

    fault: Fault | None  # the newest of those logged
    refused: FallbackCause  # reason that kept the policy from flying; NONE: no reason


def acknowledge(client: Client) -> Acknowledged:
    """Acknowledge all logged faults and the refused policy; returns what they were.

    Raises LinkError while the motors are armed or flash refuses: then all stays as it was.
    """
    fault = records.faults(client.request(Msp.FAULTS)).pending
    refused = records.safety(client.request(Msp.SAFETY)).refused_cause
    client.request(Msp.ACKNOWLEDGE)
    return Acknowledged(fault, refused)
