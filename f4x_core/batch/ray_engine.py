"""An engine that runs tasks on a Ray cluster: Ray schedules and retries, and a node runs a task in a child process."""

from __future__ import annotations

import contextlib
import hashlib
import socket
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from itertools import pairwise
from typing import Any

from ..errors import F4xError
from ..raster import choose_backend
from ..versions import VERSION
from .graph import Task
from .run import LOCK
from .storage import open_store
from .work import ROOT, Outcome, Settings, run_task

RETRIES = 5
"""Maximum restarts of a task whose worker or node dies; it resumes from its saved files."""
PATIENCE = 5.0
"""Seconds until an address that does not answer counts as unreachable."""
PROBE_PATIENCE = 60.0
"""Seconds that a node may take to start Python and report its version."""
FAREWELL = 10.0
"""Seconds that running tasks have after Ctrl-C to save the files from which they resume."""
AHEAD = 2
"""Tasks per core that are submitted to Ray: enough that no node is idle, and few enough to cancel."""


class RayEngine:
    """An `Engine` on the Ray cluster at an address, as a context manager: it disconnects at the end and never stops the cluster."""

    def __init__(self, settings: Settings, address: str, tasks: Sequence[Task] = ()):
        """Connect, and check that every node has this version and reaches the store, and that each task fits on some node.

        Raises:
            F4xError: Ray is not installed or not reachable, or a node does not fit.
        """
        self.settings = settings
        self.ray = connect(address)
        try:
            nodes = [node for node in self.ray.nodes() if node["Alive"]]
            self._require_nodes(nodes, tasks)
            _require_room([node["Resources"] for node in nodes], tasks)
            self.slots = max(1, int(AHEAD * self.ray.cluster_resources().get("CPU", 1)))
            self.remote = self.ray.remote(_work)
        except BaseException:
            self.ray.shutdown()
            raise
        self.running: dict[Any, Task] = {}

    def __enter__(self) -> RayEngine:
        return self

    def __exit__(self, *_: object) -> None:
        self.ray.shutdown()

    def start(self, task: Task) -> None:
        """See `Engine.start`."""
        remote = self.remote.options(
            num_cpus=task.threads, memory=task.memory, max_retries=RETRIES, name=f"{task.row} {task.stage}"
        )
        self.running[remote.remote(task, self.settings)] = task

    def finished(self, timeout: float) -> list[tuple[Task, Outcome]]:
        """See `Engine.finished`."""
        if not self.running:
            return []
        first, _ = self.ray.wait(list(self.running), num_returns=1, timeout=timeout)
        if not first:
            return []
        ended, _ = self.ray.wait(list(self.running), num_returns=len(self.running), timeout=0)
        return [(task, self._outcome(task, answer)) for answer in ended for task in [self.running.pop(answer)]]

    def progress(self) -> dict[tuple[str, str], tuple[str, int, int]]:
        """See `Engine.progress`. Empty, because nodes do not report steps; the logs contain them."""
        return {}

    def stop(self) -> list[tuple[Task, Outcome]]:
        """See `Engine.stop`."""
        for answer in self.running:
            self.ray.cancel(answer, force=False)
        if self.running:
            self.ray.wait(list(self.running), num_returns=len(self.running), timeout=FAREWELL)
        left = [(task, Outcome(task.row, task.stage, task.key, "stopped")) for task in self.running.values()]
        self.running.clear()
        return left

    def _outcome(self, task: Task, answer: Any) -> Outcome:
        try:
            return self.ray.get(answer)
        except self.ray.exceptions.RayError as error:
            lines = str(error).strip().splitlines() or [type(error).__name__]
            reason = f"the cluster gave up on it after {RETRIES} new attempts: {lines[0]}"
            return Outcome(task.row, task.stage, task.key, "failed", error=reason)

    def _require_nodes(self, nodes: Sequence[dict[str, Any]], tasks: Sequence[Task]) -> None:
        """Ask every node for its version, what it would draw with, and whether it sees the lock of this batch."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        probe = self.ray.remote(_make_probe())
        package = __package__.split(".")[0]
        drawn, answers = choose_backend("auto"), {}
        any_auto = any(
            pair == ("--backend", "auto") for task in tasks for words in task.commands for pair in pairwise(words)
        )
        for node in nodes:
            here = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
            remote = probe.options(num_cpus=0, scheduling_strategy=here, max_retries=0)
            answers[node["NodeID"]] = remote.remote(package, self.settings.url, LOCK)
        for node in nodes:
            name = f"node {node['NodeManagerHostname']} ({node['NodeManagerAddress']})"
            try:
                version, draws, sees = self.ray.get(answers[node["NodeID"]], timeout=PROBE_PATIENCE)
            except self.ray.exceptions.GetTimeoutError as error:
                raise F4xError(
                    f"{name} did not answer within {PROBE_PATIENCE:.0f} seconds; it may be busy: give the same command again, and"
                    " restart Ray there if it stays silent."
                ) from error
            except self.ray.exceptions.RayError as error:
                raise F4xError(f"{name} does not answer ({type(error).__name__}); restart Ray there.") from error
            if version != code_version():
                has = f"has Feature4X {version}" if version else "has no Feature4X with `f4x batch`"
                raise F4xError(
                    f"{name} {has}, this machine {code_version()}; install the same on both and restart Ray there."
                )
            if any_auto and draws != drawn:
                raise F4xError(
                    f"{name} would draw with {draws}, this machine with {drawn}, and pictures would differ; compile the kernels on"
                    " both (`python -m f4x_core.native.build`), or choose one backend with --set backend=torch."
                )
            if not sees:
                raise F4xError(
                    f"{name} does not see {self.settings.url}; choose a folder that all machines share, under one path, or a URL."
                )


def connect(address: str) -> Any:
    """Return the module `ray`, connected to the cluster at `address`; F4xError with the reason why not."""
    try:
        ray: Any = import_module("ray")
    except ImportError as error:
        raise F4xError("--ray needs the package ray: pip install 'feature4x-blender[cluster]'.") from error
    host, _, port = address.rpartition("://")[2].rpartition(":")
    if address != "auto":
        if not (host and port.isdigit()):
            raise F4xError(f"--ray {address}: write HOST:PORT, as `ray start --head` prints it, or auto.")
        try:
            socket.create_connection((host, int(port)), PATIENCE).close()
        except (OSError, OverflowError) as error:
            raise F4xError(
                f"--ray {address}: nobody answers there ({error}); start one by `ray start --head` and give the address that it"
                " prints."
            ) from error
    try:
        ray.init(address=address, namespace="feature4x", log_to_driver=False, logging_level="ERROR")
    except Exception as error:  # ConnectionError, RuntimeError of another version, …
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        reason = reason.partition(" Please ")[0].rstrip(".")  # names options that are Ray's own
        raise F4xError(f"--ray {address}: {reason}; start Ray by `ray start --head`, or give its HOST:PORT.") from error
    return ray


@cache
def code_version() -> str:
    """Return the version with a hash of the code: results are bit-equal only where it is the same."""
    state = hashlib.sha256()
    package = ROOT / __package__.split(".")[0]
    for file in sorted(file for suffix in ("py", "cpp", "hpp") for file in package.rglob(f"*.{suffix}")):
        state.update(f"{file.relative_to(package).as_posix()}\n".encode() + file.read_bytes())
    return f"{VERSION} ({state.hexdigest()[:8]})"


def _work(task: Task, settings: Settings) -> Outcome:
    return run_task(task, settings)


def _make_probe() -> Callable[[str, str, str], tuple[str | None, str, bool]]:
    """Return a function that Ray sends as code, because it also runs on nodes without this package or with another version."""

    def probe(package: str, url: str, lock: str) -> tuple[str | None, str, bool]:
        from importlib import import_module

        try:
            engine = import_module(f"{package}.batch.ray_engine")
            version = engine.code_version()
        except ImportError:
            return None, "", False
        return version, import_module(f"{package}.raster").choose_backend("auto"), engine.sees(url, lock)

    return probe


def sees(url: str, name: str) -> bool:
    """Return True if this machine can read a file of a store."""
    with contextlib.suppress(F4xError, OSError):
        return open_store(url).read(name) is not None
    return False


def _require_room(nodes: Sequence[dict[str, float]], tasks: Sequence[Task]) -> None:
    """Raise F4xError for a task that fits on no node: Ray would wait for such a node forever without a message."""
    for threads, memory, row in sorted({(t.threads, t.memory, t.row) for t in tasks}):
        if any(node.get("CPU", 0) >= threads and node.get("memory", 0) >= memory for node in nodes):
            continue
        raise F4xError(
            f"{row}: no node of the cluster has {threads} cores, {memory / 2**30:.0f} GB; change threads of the row, or add"
            " a node."
        )
