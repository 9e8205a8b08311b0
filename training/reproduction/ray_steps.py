"""Steps on the workers of a Ray session: this machine's cores, or a cluster's that sees the same folder."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from neuroflight.training.reproduction.experiments import ReproduceError
from neuroflight.training.reproduction.steps import POLL_S, Execute, execute_here
from neuroflight.training.sweeps.ray_workers import check_ray, ray_session


@contextmanager
def on_ray(address: str, jobs: int) -> Iterator[Execute]:
    """Yield a function that runs a command on a Ray worker; address: see `ray_session`.

    Raises TrainingError without Ray.
    """
    check_ray()
    with ray_session(address, jobs):
        import ray

        work = ray.remote(num_cpus=1, max_retries=0)(_work)

        def execute(words: Sequence[str], folder: Path, stop: Callable[[], bool]) -> str:
            task = work.remote(list(words), str(folder))
            while True:
                ready, _ = ray.wait([task], timeout=POLL_S)
                if ready:
                    text, reason = ray.get(task)
                    if reason:
                        raise ReproduceError(reason)
                    return str(text)
                if stop():
                    ray.cancel(task, force=False)
                    raise ReproduceError(f"{' '.join(words)}: stopped")

        yield execute


def _work(words: list[str], folder: str) -> tuple[str, str]:
    """Return what the command printed, and why it failed, as a text: the driver may not know our errors."""
    try:
        return execute_here(words, Path(folder), lambda: False), ""
    except ReproduceError as error:
        return "", str(error)
