"""Runs of a sweep on the workers of a Ray session: this machine's cores, or a cluster's."""

from __future__ import annotations

import importlib.util
import io
import logging
import os
import shutil
import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from neuroflight.toolchain.errors import TrainingError
from neuroflight.toolchain.workers import THREADS
from neuroflight.training.sweeps.jobs import FAILURES_MAX, Job, SweepCallback, do

if TYPE_CHECKING:
    import ray.tune
    from ray.tune.experiment import Trial as RayTrial

STARTS_MAX = 3  # attempts to start a session
REACH_S = 5.0  # to wait for a connection to a cluster
OBJECT_STORE_BYTES = 128 * 2**20  # of a local session; only configurations are sent
LOCAL = "local"  # in place of an address: a session of this machine
LOOPBACK = "127.0.0.1"
RAY = ".ray"  # Ray's own folder inside the sweep's, while it runs
# Ray reads these on import. Without the first, a session of one machine listens on every interface.
OF_THIS_MACHINE = {
    "RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER": "0",
    "RAY_prestart_worker_first_driver": "0",  # workers that no run will use
    **THREADS,
}
QUIET = {
    "RAY_USAGE_STATS_ENABLED": "0",
    "TUNE_DISABLE_AUTO_CALLBACK_LOGGERS": "1",
    "TUNE_DISABLE_SIGINT_HANDLER": "1",
    "RAY_AIR_NEW_OUTPUT": "0",  # which prints at verbosity 0 too
}


def check_ray() -> None:
    """Raise TrainingError if Ray Tune is not installed."""
    if any(importlib.util.find_spec(name) is None for name in ("ray", "pyarrow", "pandas")):
        raise TrainingError(
            "--address needs Ray Tune, which is not installed; install it with: pip install "
            "'neuroflight[sweep]', or leave --address out to use processes of this machine"
        )


@contextmanager
def ray_session(address: str, cpus: int) -> Iterator[None]:
    """Open a Ray session on `cpus` cores of this machine, not reachable from others, or that at `address`.

    address: LOCAL for this machine, else HOST:PORT, ray://HOST:PORT or auto.

    An existing session is used and not shut down.
    """
    local = address == LOCAL
    os.environ.update({**QUIET, **OF_THIS_MACHINE} if local else QUIET)
    import ray

    if ray.is_initialized():
        yield
        return
    common: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    if not local:
        _check_address(address)
        _start(
            1, f"no Ray cluster at {address}", address=address, runtime_env={"env_vars": THREADS}, **common
        )
    else:
        _start(
            STARTS_MAX,
            "Ray does not start",
            address=LOCAL,
            num_cpus=cpus,
            num_gpus=0,
            include_dashboard=False,
            object_store_memory=OBJECT_STORE_BYTES,
            **common,
        )
    try:
        if local and any(node["NodeManagerAddress"] != LOOPBACK for node in ray.nodes()):  # type: ignore[no-untyped-call]
            raise RuntimeError("ray was imported before its session was prepared: it would listen everywhere")
        yield
    finally:
        ray.shutdown()


def _check_address(address: str) -> None:
    """Raise TrainingError within seconds if nothing answers; Ray would try for minutes."""
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    try:
        with socket.create_connection((host, int(port)), REACH_S):
            return
    except (ValueError, OverflowError) as error:
        raise TrainingError(f"--address {address}, expected HOST:PORT, ray://HOST:PORT or auto") from error
    except OSError as error:
        raise TrainingError(
            f"nothing answers at --address {address} ({error.strerror or error}); begin a cluster there with "
            f"`ray start --head`, or leave --address out to use this machine"
        ) from error


def _start(attempts: int, wrong: str, **options: Any) -> None:  # noqa: ANN401 - of ray.init
    """Start a session, with retries: Ray gives its processes 30 s, too little on a busy machine."""
    import ray

    for left in reversed(range(attempts)):
        try:
            ray.init(**options)
            return
        except Exception as error:  # Ray raises plain ones
            ray.shutdown()
            if not left:
                line = " ".join(str(error).split())
                raise TrainingError(f"{wrong}: {line}") from error


def run_jobs(jobs: Sequence[Job], out: Path, cpus: int, callback: SweepCallback) -> None:
    """Do all runs in the present Ray session, at most `cpus` at a time, one core each."""
    from ray import tune

    trainable = tune.with_resources(tune.with_parameters(_work, jobs=tuple(jobs), out=out), {"cpu": 1})
    logging.getLogger("ray.tune").setLevel(logging.CRITICAL)
    tuner = tune.Tuner(
        trainable,
        param_space={"job": tune.grid_search(list(range(len(jobs))))},
        tune_config=tune.TuneConfig(max_concurrent_trials=cpus),
        run_config=tune.RunConfig(
            name="tune",
            storage_path=str((out / RAY).resolve()),
            verbose=0,
            failure_config=tune.FailureConfig(max_failures=FAILURES_MAX),
            callbacks=[_callback(jobs, callback)],
        ),
    )
    try:
        with redirect_stdout(io.StringIO()):  # Ray reports a worker's death on stdout
            tuner.fit()
    finally:
        shutil.rmtree(out / RAY, ignore_errors=True)


def _work(config: dict[str, Any], jobs: Sequence[Job], out: Path) -> None:
    """Do one run. Errors of ours are reported; any other exception makes Ray try again."""
    from ray import tune

    def report(steps: int, reward: float) -> None:
        tune.report({"steps": steps, "reward": reward})

    tune.report(asdict(do(jobs[config["job"]], out, report)))


def _callback(jobs: Sequence[Job], callback: SweepCallback) -> ray.tune.Callback:
    from ray import tune

    class Driver(tune.Callback):
        """Passes Tune's events on."""

        def __init__(self, numbers: list[int]) -> None:
            self._numbers = numbers

        def __reduce__(self) -> tuple[type[tune.Callback], tuple[()]]:
            return tune.Callback, ()  # pickled by Tune as one that does nothing

        def on_trial_result(
            self, iteration: int, trials: list[RayTrial], trial: RayTrial, result: dict[str, Any], **_: object
        ) -> None:
            number = self._number(trial)
            if "steps" in result:
                callback.progressed(number, result["steps"], result["reward"], result["pid"])
            elif result["finished"]:
                callback.finished(number)
            elif result["reason"]:
                callback.failed(number, result["reason"])

        def on_trial_recover(
            self, iteration: int, trials: list[RayTrial], trial: RayTrial, **_: object
        ) -> None:
            callback.restarted(self._number(trial))

        def on_trial_error(
            self, iteration: int, trials: list[RayTrial], trial: RayTrial, **_: object
        ) -> None:
            reason = f"ended {FAILURES_MAX + 1} times before it was done: {_last_line(trial)}"
            callback.failed(self._number(trial), reason)

        def _number(self, trial: RayTrial) -> int:
            index: int = trial.config["job"]
            return self._numbers[index]

    return Driver([job.trial.number for job in jobs])


def _last_line(trial: RayTrial) -> str:
    """Return the last line of Ray's error for a run."""
    error = trial.get_error()
    text = str(error).strip() if error else ""
    return text.splitlines()[-1] if text else "no reason is known"
