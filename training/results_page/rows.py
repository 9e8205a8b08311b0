"""Rows of the page of results from stored figures."""

from __future__ import annotations

import hashlib
from collections import ChainMap
from collections.abc import Sequence
from pathlib import Path

from neuroflight.training.results_page.dissertation import ControllerRow, Known
from neuroflight.training.results_page.stored_results import Stored

SUMS = ("iae", "ise", "itae", "itse")
RESPONSES = (  # of a row: figure, factor of the printed value
    ("success", 100.0),
    ("success_bare", 100.0),
    ("failure", 1.0),
    ("rise_ms", 1.0),
    ("peak", 1.0),
    ("error", 1.0),
    ("stability", 1.0),
    ("in_band_500", 100.0),
    ("in_band_750", 100.0),
    ("in_band_500_bare", 100.0),
    ("in_band_750_bare", 100.0),
)
ALL_AXES = ("in_band_500", "in_band_500_bare", "in_band_750", "in_band_750_bare")
STEADY = ("steady", "steady_bare")
DIFFERENCES = ("mae", "mse", "output", "change", "smoothness", *STEADY)
# Where a file names several controllers.
ENTRIES = (("comparison",), ("robustness", "controllers"), ("manoeuvres", "contenders"), ("transparency",))
ROOT = Path(__file__).resolve().parents[2]
SHIPPED = "training/policies/"


def compared_rows(stored: Stored) -> list[ControllerRow]:
    """Return the rows of `compare --json`: one for each controller and throttle."""
    rows: list[ControllerRow] = []
    for entry in stored.entries("comparison"):
        first = rows[-1].against or rows[-1].label if rows and entry.has("difference") else ""
        rows.append(evaluated_row(Stored(entry.name, ChainMap(entry.document, stored.document)), first))
    return rows


def evaluated_row(stored: Stored, against: str = "") -> ControllerRow:
    """Return the row of `evaluate --json`, or of one controller of a comparison whose first is `against`."""
    conditions = []
    if not stored.get("noise"):
        conditions.append("no noise")
    if "--delay" in stored.text("command"):
        conditions.append(f"delay {1e3 * stored.number('delay_s'):g} ms")
    if stored.text("mount") != "centre":
        conditions.append(f"mount {stored.text('mount')}")
    if stored.number("throttle"):
        conditions.append(f"throttle {stored.number('throttle'):g}")
    return ControllerRow(
        label=", ".join([controller_label(stored), *conditions]),
        episodes=int(stored.number("episodes")),
        tracking={name: stored.axes(name) for name in ("mae", "mse", *SUMS)},
        mae_margin=stored.axes("margin_95", "mae"),
        output=stored.number("output"),
        change=stored.number("change"),
        smoothness=stored.optional("smoothness"),
        response=_response(stored, "response"),
        in_band=_all_axes(stored, "response"),
        against=against,
        difference={
            name: stored.interval("difference", name)
            for name in DIFFERENCES
            if stored.has("difference", name)
        },
    )


def flown_rows(stored: Stored) -> list[ControllerRow]:
    """Return the rows of `fly --json`: the firmware's and the PID's."""
    if stored.text("scenario") != "pulses":
        raise stored.error(
            "scenario", stored.text("scenario"), "pulses, the only flight the page has a table for"
        )
    on = stored.text("on")
    firmware = "Betaflight, default PID (SITL)" if on == "betaflight" else f"policy in the firmware ({on})"
    flights = stored.get("flights")
    if not isinstance(flights, dict):
        raise stored.error("flights", flights, "an object")
    return [
        ControllerRow(
            label=firmware if name == "firmware" else f"{name}, same gyro rate and commands as the row above",
            episodes=int(stored.number("episodes")),
            tracking={key: stored.axes("flights", name, "tracking", key) for key in ("mae", "mse", *SUMS)},
            output=stored.number("flights", name, "effort", "output"),
            change=stored.number("flights", name, "effort", "change"),
            smoothness=stored.optional("flights", name, "smoothness"),
            response=_response(stored, "flights", name, "response"),
            in_band=_all_axes(stored, "flights", name, "response"),
        )
        for name in flights
    ]


def controller_label(stored: Stored) -> str:
    """Return a controller's label: Betaflight, a PID's name or a policy's folder, and the idle unless 0."""
    name = stored.text("controller")
    if stored.has("betaflight"):
        own = stored.text("betaflight_settings") if stored.has("betaflight_settings") else None
        label = "Betaflight 4.6, its defaults" if own is None else f"Betaflight 4.6, `{own}`"
    else:
        sha256 = stored.text("policy_sha256") if stored.has("policy_sha256") else None
        label = f"PID `{stored.text('pid')}`" if stored.has("pid") else _policy_label(name, sha256)
    idle = stored.optional("idle")
    return f"{label}, idle {idle:g}" if idle else label


def digests(stored: Stored) -> Sequence[str]:
    """Return the hashes of the aircraft and the policies of a file."""
    of_training = {"config": ("config", "aircraft"), "sweep": ("aircraft",)}
    for kind, path in of_training.items():
        if stored.has(kind):
            name, sha256 = (stored.text(*path, key) for key in ("name", "sha256"))
            return [f"{name} `{sha256[:12]}`"]
    found = [f"{stored.text('aircraft')} `{stored.text('aircraft_sha256')[:12]}`"]
    if stored.has("image_sha256"):
        found.append(f"image `{stored.text('image_sha256')[:12]}`")
    for entry in (stored, *(each for path in ENTRIES if stored.has(*path) for each in stored.entries(*path))):
        if entry.has("policy_sha256"):
            found.append(f"policy `{entry.text('policy_sha256')[:12]}`")
    return list(dict.fromkeys(found))


def _policy_label(name: str, sha256: str | None) -> str:
    path = Path(name)
    if name.startswith(SHIPPED):
        file = ROOT / name
        now = hashlib.sha256(file.read_bytes()).hexdigest() if file.is_file() else None
        which = "shipped policy" if sha256 in (None, now) else "policy shipped before"
        return f"{which} ({path.parent.name})"
    of_run = path.name == "policy.onnx" and path.parent.name
    return f"policy `{path.parent.name if of_run else name}`"


def _response(stored: Stored, *path: str) -> dict[str, Known]:
    if stored.get(*path) is None:
        return {}
    found: dict[str, Known] = {}
    for name, factor in RESPONSES:
        values, counts = stored.axes(*path, name, "value"), stored.axes(*path, name, "count")
        roll, pitch, yaw = (factor * v if count else None for v, count in zip(values, counts, strict=True))
        found[name] = (roll, pitch, yaw)
    return found


def _all_axes(stored: Stored, *path: str) -> dict[str, float]:
    """Return the share of the time, and of the commands, [%] in which all axes are in the band."""
    if stored.get(*path) is None:
        return {}
    found = {name: 100 * stored.number(*path, f"all_{name}", "value") for name in ALL_AXES}
    steady = {name: 100 * stored.number(*path, name, "value") for name in STEADY if stored.has(*path, name)}
    return found | steady
