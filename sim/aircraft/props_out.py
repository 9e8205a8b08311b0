"""The same aircraft with its propellers out: every rotor turns the other way than its file says."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

SUFFIX = ":props-out"  # behind the name or path of an aircraft
NAME_END = "-props-out"  # of the aircraft's name, which policy and image carry
OTHER = {"cw": "ccw", "ccw": "cw"}


def props_out(document: Mapping[str, Any]) -> dict[str, Any]:
    """Return a parsed aircraft file with all spins reversed.

    A PID keeps its gains: its share of each motor in yaw, where the file gives one, changes its sign. What is
    no valid aircraft is left for its reader to refuse.
    """
    turned = copy.deepcopy(dict(document))
    if isinstance(turned.get("name"), str):
        turned["name"] += NAME_END
    for rotor in _tables(turned.get("rotor")):
        if isinstance(spin := rotor.get("spin"), str):
            rotor["spin"] = OTHER.get(spin, spin)
    pids = turned.get("pid")
    for pid in _tables(list(pids.values()) if isinstance(pids, dict) else None):
        mixer = pid.get("mixer")
        if isinstance(mixer, dict) and isinstance(mixer.get("yaw"), list):
            mixer["yaw"] = [-each if isinstance(each, int | float) else each for each in mixer["yaw"]]
    return turned


def _tables(value: object) -> list[dict[str, Any]]:
    return [each for each in value if isinstance(each, dict)] if isinstance(value, list) else []
