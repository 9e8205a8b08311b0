"""A training configuration from a recipe or a file, and overrides of single keys.

A file is TOML or JSON with the fields of `TrainingConfig` as keys and a table for each of output, task,
reward, world, world.randomization and algorithm; what it leaves out is the default. The training.json of a
run is such a file: it repeats that run.
"""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from neuroflight.toolchain.contract import MOTOR_COUNT_MAX
from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.toolchain.strict_toml import parse_toml, shown
from neuroflight.training.config.config_table import NAME, ConfigReader
from neuroflight.training.config.training_config import TrainingConfig
from neuroflight.training.plugins import check_recorded

FOLDER = Path(__file__).parents[1] / "recipes"
FILE_BYTES_MAX = 1 << 20
SUFFIXES = (".toml", ".json")
KEY = re.compile(r"\w+(\.\w+)*", re.ASCII)
RECORD_KEYS = (
    "aircraft",
    "motors",
    "observation_scale",
    "filters",
    "model",
    "plugins",
)  # in training.json only


def recipes() -> tuple[str, ...]:
    """List the configurations that come with the project by name."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.toml")))


def load_config(source: str | Path | None, overrides: Sequence[str] = ()) -> TrainingConfig:
    """Load a recipe's or a file's configuration, with overrides "key.path=value" applied to it.

    source: None is `TrainingConfig()`. A value is TOML; bare words need no quotes. Another name for a task,
    reward or algorithm replaces its whole table. Raises TrainingError, one line, for a file that is
    missing, too large or malformed, and for any key, type or value that is invalid.
    """
    where, document = _read(source)
    record = {key: document.pop(key) for key in RECORD_KEYS if key in document and where.endswith(".json")}
    if "plugins" in record:
        check_recorded(record["plugins"], where)
    given = copy.deepcopy(document)
    origins: dict[str, str] = {}
    for override in sorted(overrides, key=_order):
        _override(given, override, origins)
    reader = ConfigReader(where, origins)
    config = reader.table(TrainingConfig, given)
    if record:
        # Against the file alone: an override may change the observation.
        _check_record(reader, record, reader.table(TrainingConfig, document))
    return config


def _order(override: str) -> tuple[int, bool]:
    """Return the sort key: whole tables before their keys, a name first, then the user's order."""
    key = override.partition("=")[0].strip()
    return key.count("."), not key.endswith(f".{NAME}")


def _read(source: str | Path | None) -> tuple[str, dict[str, Any]]:
    """Return the name of the source in messages, and its keys."""
    if source is None:
        return "configuration", {}
    if str(source) in recipes():
        path, where = FOLDER / f"{source}.toml", f"recipe {source}"
    else:
        path, where = Path(source), f"config {source}"
    if not path.is_file():
        raise TrainingError(
            f"{where}: no such file; give the path of a .toml or .json file or one of the recipes: "
            f"{', '.join(recipes())}"
        )
    if path.suffix not in SUFFIXES:
        raise TrainingError(f"{where}: expected a name that ends in {' or '.join(SUFFIXES)}")
    data = read_limited(path, where, FILE_BYTES_MAX, TrainingError)
    return where, _json(data, where) if path.suffix == ".json" else parse_toml(data, where, TrainingError)


def _json(data: bytes, where: str) -> dict[str, Any]:
    """Return the keys and values of a JSON file; of a training.json, those of its configuration."""
    try:
        document = json.loads(data, object_pairs_hook=_once)
    except (ValueError, RecursionError) as error:
        raise TrainingError(f"{where}: not JSON: {_line(error)}") from error
    if isinstance(document, dict) and isinstance(document.get("config"), dict):
        document = document["config"]
    if not isinstance(document, dict):
        raise TrainingError(f"{where}: got {shown(document)}, expected keys and values")
    return document


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build a JSON object. Raises ValueError for a repeated key, as TOML does."""
    values = dict(pairs)
    if len(values) != len(pairs):
        [(key, _)] = Counter(key for key, _ in pairs).most_common(1)
        raise ValueError(f"{shown(key)} stands twice")
    return values


def _line(error: Exception) -> str:
    return " ".join(str(error).split()) or "nested too deep"


def _override(document: dict[str, Any], text: str, origins: dict[str, str]) -> None:
    """Apply one "key.path=value" to `document`, and note in `origins` which override gave which key."""
    key, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not KEY.fullmatch(key):
        raise TrainingError(f"override {shown(text)}: expected KEY=VALUE, such as world.throttle_max=0.8")
    parsed = _value(value, text)
    *parents, last = key.split(".")
    if not parents and isinstance(parsed, str) and _default_name(last) is not None:
        parents, last = [last], NAME
    table, path = document, ""
    for part in parents:
        path = f"{path}.{part}" if path else part
        if part not in table:
            table[part] = {}
            origins[path] = text
        elif isinstance(table[part], str):  # the name alone
            table[part] = {NAME: table[part]}
        if not isinstance(table[part], dict):
            raise TrainingError(f"override {shown(text)}: {path} is no table")
        table = table[part]
    if last == NAME and len(parents) == 1 and parsed != table.get(NAME, _default_name(parents[0])):
        table.clear()
    table[last] = parsed
    origins[key] = text


def _default_name(key: str) -> object:
    return getattr(getattr(TrainingConfig(), key, None), NAME, None)


def _value(text: str, override: str) -> object:
    try:
        parsed = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError) as error:
        if text and text.isprintable() and text[0] not in "\"'[{" and not text[0].isdigit():
            return text
        raise TrainingError(f"override {shown(override)}: the value is not TOML: {_line(error)}") from error
    if set(parsed) != {"value"}:
        raise TrainingError(f"override {shown(override)}: expected one value")
    return parsed["value"]


def _check_record(reader: ConfigReader, record: dict[str, Any], config: TrainingConfig) -> None:
    """Reject the record of a run that this program would not repeat.

    The command chooses the aircraft; its name, hash and model in a record only say what was flown then.
    """
    chain = config.gyro_filters.chain
    filters = record.get("filters", chain)
    if filters != chain:
        raise reader.error(
            "filters",
            f"got {shown(filters)}, expected {shown(chain)}: gyro_filter is {config.gyro_filter}",
        )
    motors = record.get("motors", 1)
    if not isinstance(motors, int) or isinstance(motors, bool) or not 1 <= motors <= MOTOR_COUNT_MAX:
        raise reader.error("motors", f"got {shown(motors)}, expected 1 to {MOTOR_COUNT_MAX}")
    scale = record.get("observation_scale")
    if scale is not None and "motors" in record and scale != config.observation_scale(motors):
        raise reader.error(
            "observation_scale",
            "that run scaled its observations otherwise than this program does, so it cannot be repeated; "
            "remove the key to train with today's scales",
        )
