"""The package `neuroflight`: `neuroflight.sim` is the folder sim/ beside this file, and so are the others.

`import neuroflight` also registers the environment `neuroflight/Attitude-v0` with Gymnasium.

An installation imports this whenever Python starts (setup.py), as Gymnasium has no plugins since its version
1.0: so `gymnasium.make` knows the name without an import. Every start of Python pays for it, so it imports
little, and waits for Gymnasium.
"""

from __future__ import annotations

import os
import sys

__path__ = [os.path.dirname(__file__)]  # noqa: PTH120 - pathlib takes milliseconds at every start

TYPE_CHECKING = False  # type checkers take it for typing's, whose import takes milliseconds
if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Any

ENVIRONMENT_ID = "neuroflight/Attitude-v0"
GYMNASIUM = "gymnasium"


def register() -> None:
    """Tell Gymnasium where the environment is; nothing of it is imported before it is made."""
    import gymnasium

    if ENVIRONMENT_ID not in gymnasium.registry:
        gymnasium.register(
            ENVIRONMENT_ID,
            entry_point="neuroflight.training.envs.gym_env:AttitudeEnv",
            vector_entry_point="neuroflight.training.envs.gym_vector:AttitudeVectorEnv",
        )


class AfterGymnasium:
    """An entry of `sys.meta_path` that registers once Gymnasium was imported, and goes."""

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        """Return the module's own spec, with the registration behind its execution."""
        if name != GYMNASIUM:
            return None
        from importlib.util import find_spec

        sys.meta_path.remove(self)  # type: ignore[arg-type]
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            loader: Any = spec.loader
            execute = loader.exec_module

            def execute_and_register(module: ModuleType) -> None:
                execute(module)
                register()

            loader.exec_module = execute_and_register
        return spec


if GYMNASIUM in sys.modules:
    register()
else:
    sys.meta_path.insert(0, AfterGymnasium())  # type: ignore[arg-type]
