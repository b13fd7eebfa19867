"""Scenes on a Ray cluster: Ray distributes them; this process submits and gathers them."""

import contextlib
import math
import os
import socket
import uuid
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ...base.errors import GraycastError, WorkerDied
from ...base.version import __version__
from .job import Job, TaskResult, TaskRunner
from .maker import GPU_DEVICES
from .pool import Failed

_AHEAD = 2  # scenes submitted per place: no worker waits, and few finished scenes pile up


class RayPool:
    """A pool of Ray tasks. The scenes' files return to this process, so no shared disk is needed.

    Files that the cell names by path (environment maps) must be readable on every machine.
    """

    def __init__(self, task: Job, *, workers: int, threads: int, address: str | None) -> None:
        self._ray = ray = _import_ray()
        self._limit, self._threads = workers, threads
        self._running: dict[Any, int] = {}
        try:
            if address is not None:
                _knock(address)
            ray.init(address=address, include_dashboard=False, log_to_driver=False)
        except (OSError, RuntimeError, ValueError, ray.exceptions.RayError) as error:
            raise GraycastError(
                f"Ray at {address or 'this machine'} does not answer ({error}): start it with "
                "'ray start --head', or check --address"
            ) from error
        if task.device == "auto":
            device = "cuda" if ray.cluster_resources().get("GPU") else "cpu"
            task = replace(task, device=device)
        self._gpus = 0.0
        if task.device in GPU_DEVICES:
            self._gpus = gpu_share(ray.cluster_resources(), threads)
        remote = ray.remote(num_cpus=threads, num_gpus=self._gpus, max_retries=0)
        self._make = remote(_make_on_node)
        self._task = ray.put(task)
        self._run = uuid.uuid4().hex

    @property
    def free(self) -> int:
        resources = self._ray.cluster_resources()  # machines may join and leave
        places = resources.get("CPU", 0) / self._threads
        if self._gpus:
            places = min(places, resources.get("GPU", 0) / self._gpus)
        room = self._limit or _AHEAD * max(1, math.floor(places))
        return max(0, room - len(self._running))

    def submit(self, scene_id: int) -> None:
        # In a list, Ray passes on the reference itself, so each worker fetches the task only once.
        job = self._make.remote(self._run, [self._task], scene_id, self._threads)
        self._running[job] = scene_id

    def gather(self) -> TaskResult | Failed:
        (job, *_), _ = self._ray.wait(list(self._running), num_returns=1)
        scene_id = self._running.pop(job)
        try:
            return self._ray.get(job)
        except self._ray.exceptions.RayTaskError as error:
            return Failed(scene_id=scene_id, error=error.cause)
        except self._ray.exceptions.RayError as error:
            why = str(error).strip().splitlines()[0]
            return Failed(scene_id=scene_id, error=WorkerDied(f"its Ray worker was lost ({why})"))

    def close(self) -> None:
        with contextlib.suppress(Exception):  # the cluster may be gone already
            for job in self._running:
                self._ray.cancel(job, force=True)
        self._ray.shutdown()


def gpu_share(resources: Mapping[str, float], threads: int) -> float:
    """Return each scene's share of a GPU, so that the GPUs serve all processors.

    A scene needs the GPU for a small part of its time; the drop takes most of the time on a
    processor. Ray counts in steps of 1e-4.
    """
    places = max(1.0, resources.get("CPU", 1.0) / threads)
    return min(1.0, max(1e-4, math.floor(1e4 * resources.get("GPU", 1.0) / places) / 1e4))


def _knock(address: str) -> None:
    """Refuse an address without a server at once, because Ray itself would try for minutes.

    Raises:
        OSError: no server listens there.
        ValueError: the address belongs to Ray's client, whose tasks end with the connection.
    """
    if address.startswith("ray://"):
        raise ValueError("addresses with ray:// are not supported: give HOST:PORT of the head node")
    host, _, port = address.rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host, int(port)), timeout=10).close()


def _import_ray() -> Any:
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        import ray
    except ImportError as error:
        raise GraycastError(
            "engine ray needs Ray: run pip install 'graycast[ray]', or use --engine local"
        ) from error
    return ray


# --- in a worker of Ray ------------------------------------------------------------------------

_maker: tuple[str, TaskRunner] | None = None  # Ray reuses a worker process, which keeps this value.


def _make_on_node(run: str, task: list[Any], scene_id: int, threads: int) -> TaskResult:
    global _maker
    if _maker is None or _maker[0] != run:
        if _maker is not None:
            _maker[1].close()
        _maker = (run, _fetch(task[0]).open(threads=threads))
    return _maker[1].make(scene_id)


def _fetch(reference: Any) -> Job:
    import ray

    task = ray.get(reference)
    if task.graycast != __version__:
        node = ray.util.get_node_ip_address()
        raise GraycastError(
            f"Graycast is {__version__} on {node}, {task.graycast} where the run was started: "
            "install one version on all machines"
        )
    return task
