"""Users' modules: rewards and tasks of files that a user names on the command line.

Such a file is his own code, and he names it himself, so it is run as a program is. No name is ever read from
a checkpoint, a policy or a recipe and imported; these hold a file's name and SHA-256, to ask for it.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import wraps
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from neuroflight.toolchain.errors import NeuroflightError, TrainingError
from neuroflight.toolchain.files import read_limited
from neuroflight.training.tasks.registry import TASKS
from neuroflight.training.tasks.reward import REWARDS, Reward, Rewards, Transition
from neuroflight.training.tasks.task import FULL_STICK_DEG_S, LENGTH_MAX_S, Setpoints, Task

FILE_BYTES_MAX = 1 << 20
NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,31}")
PLAIN = (bool, int, float, str)  # what a field of a configuration holds, or a tuple of these
FULL_STICK_RAD_S = np.float32(np.deg2rad(FULL_STICK_DEG_S)) * np.float32(1.0 + 1e-6)  # rounding of float32
REGISTRIES: dict[str, dict[str, type[Any]]] = {"reward": REWARDS, "task": TASKS}

Kind = TypeVar("Kind", bound=type)


@dataclass(frozen=True)
class Plugin:
    """A user's file."""

    path: Path  # absolute
    sha256: str

    def document(self) -> dict[str, str]:
        """Return what a record holds of it."""
        return {"file": self.path.name, "sha256": self.sha256}


def register(kind: Kind) -> Kind:
    """Make a frozen dataclass usable by its `name`: a reward if it can be called, a task if it has episodes.

    What its methods return is checked from then on. Raises TrainingError on a class that is neither, or
    whose name is taken.
    """
    given: Any = kind  # a class, whose attributes are set here
    what = _kind(given)
    registry, where = REGISTRIES[what], f"{what} {given.name}"
    taken = registry.get(given.name)
    if taken is not None and not _replaces(given, taken):
        raise TrainingError(f"{where}: the name is taken by {_owner(taken)}; choose another name")
    for field in fields(given):
        if field.init and not _plain(field.default):
            raise TrainingError(
                f"{where}: {field.name} needs a default that is a number, text, true, false or a "
                f"tuple of these"
            )
    if hasattr(given, "__post_init__"):
        given.__post_init__ = _blamed(given.__post_init__)
    example = given()  # its own checks hold for its defaults
    if what == "reward":
        given.__call__ = _checked_reward(given.__call__)
    else:
        given.episodes = _checked_episodes(given.episodes)
        _check_duration(example)
    given.users = True
    registry[given.name] = given
    return kind


def load_plugins(paths: Sequence[Path]) -> tuple[Plugin, ...]:
    """Run the files, each once a process; what they register is known by name from then on.

    Raises TrainingError, one line, on a file that cannot be imported or registers nothing.
    """
    return tuple(map(load_plugin, paths))


def load_plugin(path: Path) -> Plugin:
    """Run one file, see `load_plugins`."""
    plugin: Plugin = load_file(path).__neuroflight_plugin__
    if not any(getattr(kind, "plugin", None) == plugin for kind in _registered()):
        raise TrainingError(
            f"{path}: registers nothing; put neuroflight.training.plugins.register above its reward or task"
        )
    return plugin


def load_file(path: Path) -> ModuleType:
    """Import a user's file, once a process; modules beside it can be imported by it.

    Raises TrainingError: what the file raised, and in which of its lines.
    """
    source, plugin = _read(path)
    name = f"neuroflight_plugin_{hashlib.sha256(bytes(plugin.path)).hexdigest()[:8]}_{plugin.sha256[:8]}"
    if name in sys.modules:
        return sys.modules[name]
    specification = importlib.util.spec_from_loader(name, loader=None, origin=str(plugin.path))
    assert specification is not None
    module = importlib.util.module_from_spec(specification)
    module.__file__ = str(plugin.path)
    module.__neuroflight_plugin__ = plugin  # type: ignore[attr-defined]
    sys.modules[name] = module
    if (folder := str(plugin.path.parent)) not in sys.path:
        sys.path.append(folder)  # appended, so that it hides no installed package
    before = _registered()
    try:
        with blaming(str(path)):
            exec(compile(source, str(plugin.path), "exec"), vars(module))
    except BaseException as error:
        del sys.modules[name]
        if isinstance(error, NeuroflightError) and not str(error).startswith(str(path)):
            raise TrainingError(f"{path}: {error}") from error
        raise
    for kind in _registered() - before:
        kind.plugin = plugin
        setattr(kind, "__reduce__", _reduced)  # noqa: B010 - mypy refuses the assignment
    return module


def users_class(name: str, methods: Sequence[str]) -> tuple[type[Any], str, Plugin]:
    """Return the class that a user names as FILE.py:CLASS, its name in messages, and its file.

    methods: that it must have. Raises TrainingError, one line, on anything wrong.
    """
    file, _, class_name = name.partition(".py:")
    path = Path(file if file.endswith(".py") else f"{file}.py")
    module = load_file(path)
    own = {
        each: kind
        for each, kind in vars(module).items()
        if isinstance(kind, type) and kind.__module__ == module.__name__
    }
    if class_name not in own:
        known = ", ".join(own) or "it has none"
        raise TrainingError(f"{name}: expected {path}:CLASS, a class of that file: {known}")
    kind, where = own[class_name], f"{path}:{class_name}"
    for method in methods:
        if not callable(getattr(kind, method, None)):
            raise TrainingError(
                f"{where}: has no {method}(), expected {' and '.join(f'{m}()' for m in methods)}"
            )
    return kind, where, module.__neuroflight_plugin__


def users_own(kind: type[Any]) -> bool:
    """Return True if a reward or task is a user's."""
    return bool(getattr(kind, "users", False))


def plugins_of(*parts: object) -> list[dict[str, str]]:
    """Return what a record holds of the files that these rewards and tasks are of; empty: all are ours."""
    found = (getattr(type(part), "plugin", None) for part in parts)
    return [plugin.document() for plugin in dict.fromkeys(found) if plugin is not None]


def check_recorded(recorded: object, where: str) -> None:
    """Raise TrainingError unless the files of a record, see `plugins_of`, are those loaded here."""
    if not isinstance(recorded, list) or not all(isinstance(item, Mapping) for item in recorded):
        raise TrainingError(f"{where}: plugins: got {recorded!r:.60}, expected a list of files")
    loaded = {plugin.sha256: plugin for kind in _registered() if (plugin := getattr(kind, "plugin", None))}
    for item in recorded:
        if item.get("sha256") in loaded:
            continue
        file, digest = str(item.get("file"))[:60], str(item.get("sha256"))
        same = [plugin for plugin in loaded.values() if plugin.path.name == file]
        got = f"that of --plugin {file} is {same[0].sha256[:12]}…" if same else "which is not loaded"
        raise TrainingError(
            f"{where} was trained with the plug-in {file}, SHA-256 {digest[:12]}…, {got}; give the same "
            f"file with --plugin"
        )


@contextmanager
def blaming(where: str) -> Iterator[None]:
    """Make any exception of a user's code in the block a TrainingError that names it and its line."""
    try:
        yield
    except (NeuroflightError, KeyboardInterrupt):
        raise
    except (Exception, SystemExit) as error:
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if _is_users(frame.filename)]
        file, line = (own[-1].filename, own[-1].lineno) if own else (None, None)
        if isinstance(error, SyntaxError):
            file, line = error.filename, error.lineno
        named = "" if file is None or where.endswith(Path(file).name) else f"{Path(file).name}, "
        place = f"{named}line {line}: " if file else ""
        told = " ".join(str(error.msg if isinstance(error, SyntaxError) else error).split())
        if isinstance(error, ModuleNotFoundError) and _is_room(error.name or ""):
            told += f"; it is imported as neuroflight.{error.name}"
        raise TrainingError(f"{where}: {place}{type(error).__name__}{f': {told}' if told else ''}") from error


def _is_room(name: str) -> bool:
    return name.isidentifier() and importlib.util.find_spec(f"neuroflight.{name}") is not None


def real_array(where: str, value: object, shape: tuple[int, ...], meaning: str) -> NDArray[np.float32]:
    """Return what a user's code returned, as float32. Raises TrainingError on anything but finite numbers.

    meaning: of the axes, in the message.
    """
    try:
        array = np.asarray(value)
    except ValueError:
        array = np.asarray(None)
    if array.dtype.kind not in "fiub":
        raise TrainingError(
            f"{where}: returned {type(value).__name__} of {array.dtype}, expected numbers of shape {shape}"
        )
    if array.shape != shape:
        raise TrainingError(f"{where}: returned shape {array.shape}, expected {shape}: {meaning}")
    with np.errstate(over="ignore"):
        numbers: NDArray[np.float32] = array.astype(np.float32, copy=False)
    if not np.isfinite(numbers).all():
        worst = numbers[~np.isfinite(numbers)][0]
        raise TrainingError(f"{where}: returned {worst}, expected finite numbers")
    return numbers


def _kind(kind: type[Any]) -> str:
    """Return of which registry a class is. Raises TrainingError."""
    if not isinstance(kind, type) or not is_dataclass(kind) or not kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        raise TrainingError(
            f"@register {getattr(kind, '__name__', kind)}: expected a class under @dataclass(frozen=True)"
        )
    name = getattr(kind, "name", None)
    if (
        not isinstance(name, str)
        or not NAME.fullmatch(name)
        or "name" in {each.name for each in fields(kind)}
    ):
        raise TrainingError(
            f"@register {kind.__name__}: name {name!r}, expected name: ClassVar[str] of at most 32 "
            f"small letters, digits and dashes"
        )
    if "__call__" in dir(kind):
        return "reward"
    if hasattr(kind, "episodes"):
        return "task"
    raise TrainingError(
        f"@register {kind.__name__}: neither a reward, which has __call__(self, step), nor a task, which has "
        f"episodes(self, count, rng, rate_hz) and duration_s"
    )


def _replaces(kind: type[Any], taken: type[Any]) -> bool:
    """Return True if a class is a newer version of a registered one: of the same file, or typed anew."""
    mine, its = (getattr(sys.modules.get(each.__module__), "__file__", None) for each in (kind, taken))
    return users_own(taken) and mine == its


def _owner(taken: type[Any]) -> str:
    plugin: Plugin | None = getattr(taken, "plugin", None)
    return "this program's own" if plugin is None else f"{plugin.path}"


def _plain(value: object) -> bool:
    return isinstance(value, PLAIN) or (isinstance(value, tuple) and all(map(_plain, value)))


def _registered() -> set[type[Any]]:
    return {kind for registry in REGISTRIES.values() for kind in registry.values()}


def _read(path: Path) -> tuple[bytes, Plugin]:
    if path.suffix != ".py" or not path.is_file():
        raise TrainingError(f"{path}: no such file; expected a Python file, such as my_reward.py")
    source = read_limited(path, str(path), FILE_BYTES_MAX, TrainingError)
    return source, Plugin(path.resolve(), hashlib.sha256(source).hexdigest())


def _is_users(file: str) -> bool:
    """Return True if a file is a user's: of none of ours and no installed package."""
    path = Path(file)
    return (
        path.suffix == ".py"
        and not path.is_relative_to(Path(__file__).parents[1])
        and "site-packages" not in file
    )


def _blamed(method: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(method)
    def guarded(self: Any, *arguments: Any) -> Any:  # noqa: ANN401 - of any class
        with blaming(type(self).name):
            return method(self, *arguments)

    return guarded


def _checked_reward(call: Callable[..., Any]) -> Callable[[Reward, Transition], Rewards]:
    @wraps(call)
    def checked(self: Reward, step: Transition) -> Rewards:
        where = f"reward {self.name}"
        with blaming(where):
            found = call(self, replace(step, **{name: _view(array) for name, array in vars(step).items()}))
        return real_array(where, found, (len(step.action),), "one number for each aircraft")

    return checked


def _view(array: NDArray[Any]) -> NDArray[Any]:
    """Return a view that cannot be written: what a reward changes in place would change the flight."""
    view = array.view()
    view.flags.writeable = False
    return view


def _checked_episodes(episodes: Callable[..., Any]) -> Callable[..., Setpoints]:
    @wraps(episodes)
    def checked(self: Task, count: int, rng: np.random.Generator, rate_hz: int) -> Setpoints:
        where = f"task {self.name}"
        with blaming(where):
            found = episodes(self, count, rng, rate_hz)
        shape = (count, round(self.duration_s * rate_hz), 3)
        setpoints = real_array(where, found, shape, "episodes, control steps of duration_s, axes")
        if (most := np.abs(setpoints).max(initial=0.0)) > FULL_STICK_RAD_S:
            raise TrainingError(
                f"{where}: commands {most:.4g} rad/s, expected at most {FULL_STICK_RAD_S:.4g}, which are "
                f"{FULL_STICK_DEG_S:g} deg/s"
            )
        return setpoints

    return checked


def _check_duration(task: Any) -> None:  # noqa: ANN401 - of any class
    where = f"task {task.name}"
    with blaming(where):
        seconds = float(task.duration_s)
    if not 0.0 < seconds <= LENGTH_MAX_S:
        raise TrainingError(f"{where}: duration_s {seconds:g}, expected above 0 to {LENGTH_MAX_S:g}")


def _reduced(self: Any) -> tuple[Callable[..., Any], tuple[Any, ...]]:  # noqa: ANN401 - of any class
    """Pickle a user's object by its file, which another process runs first."""
    values = {field.name: getattr(self, field.name) for field in fields(self) if field.init}
    return _restored, (type(self).plugin, _kind(type(self)), type(self).name, values)


def _restored(plugin: Plugin, registry: str, name: str, values: dict[str, Any]) -> Any:  # noqa: ANN401
    if load_plugin(plugin.path) != plugin:
        raise TrainingError(f"{plugin.path} was changed while it was used; start again")
    return REGISTRIES[registry][name](**values)
