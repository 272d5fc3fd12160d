"""The workers of a Dask cluster as an executor, after a check that they exist and compute the same."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache, partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from dynident._version import __version__, package_version
from dynident.runtime.errors import InputError, install_command, join_names
from dynident.runtime.jobs.workers import assign_process
from dynident.runtime.kernel import kernel

PACKAGE_FOLDER = Path(__file__).parents[2]
PACKAGES = ("numpy", "scipy", "sympy", "clarabel", "distributed")
MAX_PLACES = 3  # places that are named
ANSWER_SECONDS = 10.0  # s in which a scheduler, and its workers, answer
NOISY_LOGGERS = ("distributed", "tornado")  # what logs to the terminal
GRAPH_SIZE_SETTING = "distributed.admin.large-graph-warning-threshold"


@cache
def software() -> dict[str, str]:
    """Return the versions of what this process computes with, by name.

    The kernel counts without its level, since all levels give the same bits. Raises ConfigError, as ``kernel``.
    """
    return {
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "dynident": __version__,
        "the code of dynident": code_digest(),
        "the kernel of dynident": "compiled" if kernel().level else "NumPy and LAPACK",
        **{name: package_version(name) for name in PACKAGES},
    }


def software_differences(
    own_software: Mapping[str, str], software_by_place: Mapping[str, Mapping[str, str]]
) -> list[str]:
    """Return what differs between this process and others, given by place: ``numpy is 2.4.6 here, 2.4.5 on ...``."""
    lines = []
    for name, version in own_software.items():
        places_by_version: dict[str, list[str]] = {}
        for place, versions in software_by_place.items():
            if (other_version := versions.get(name, version)) != version:
                places_by_version.setdefault(other_version, []).append(place)
        if places_by_version:
            descriptions = (
                f"{other_version} on {join_names(places, MAX_PLACES)}"
                for other_version, places in places_by_version.items()
            )
            lines.append(f"{name} is {version} here, {', '.join(descriptions)}")
    return lines


@cache
def code_version() -> str:
    """Return the version of the code: that of the package, a digest of its sources, and "kernel" or "numpy".

    All levels of the kernel give the same numbers, NumPy others by rounding.
    """
    return f"{package_version('dynident')}+{code_digest()}.{'kernel' if kernel().level else 'numpy'}"


def code_digest() -> str:
    """Return a digest of the Python files of the package; those of C have theirs in the kernel's."""
    digest = sha256()
    for path in sorted(
        PACKAGE_FOLDER.rglob("*.py"), key=lambda source_file: source_file.relative_to(PACKAGE_FOLDER).parts
    ):
        # line ends differ between systems, the code does not
        content = path.read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{path.relative_to(PACKAGE_FOLDER).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()[:12]


@contextmanager
def cluster_workers(address: str, preload: Iterable[str] = ()) -> Iterator[Executor]:
    """Give the workers of the Dask scheduler at ``address`` (``tcp://HOST:8786``) as an executor.

    Each thread of a worker has a process for its jobs, as in ``local_workers``, which has imported ``preload``.
    Raises InputError where the extra ``cluster`` is not installed, no scheduler answers there, it has no worker, or one
    of them has other software than this process; a job of a worker that comes later is refused in that case. What
    Dask logs of it meanwhile is dropped.
    """
    try:
        import dask
        import distributed
        from distributed.versions import VersionMismatchWarning
    except ImportError as error:
        install = install_command("distributed")
        raise InputError(f"work on a cluster needs Dask's package distributed; install it by: {install}") from error
    with _silence_dask(), dask.config.set({GRAPH_SIZE_SETTING: "1 TiB"}):
        _require_scheduler(address)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", VersionMismatchWarning)  # an error, where it matters
                client = distributed.Client(address, timeout=ANSWER_SECONDS, set_as_default=False)
        except (OSError, ImportError) as error:
            raise InputError(_no_answer_text(address, error)) from error
        try:
            _require_workers(client, address)
            yield _Cluster(client, address, tuple(preload))
        finally:
            client.close(timeout=ANSWER_SECONDS)


class _Cluster(Executor):
    """Dask's own executor, with clear errors where the scheduler has gone, and with all workers compared."""

    def __init__(self, client: Any, address: str, preload: tuple[str, ...]) -> None:
        self._client, self._address, self._preload = client, address, preload
        self._executor = client.get_executor(pure=False)

    @property
    def _max_workers(self) -> int:  # the name that the executors of the standard library have for it
        return int(sum(self._client.nthreads().values())) or 1

    def submit(self, function: Callable[..., Any], /, *arguments: Any, **options: Any) -> Future[Any]:
        """Let a worker call ``function``."""
        call = partial(function, *arguments, **options)
        inner = self._executor.submit(_on_worker, software(), self._preload, call)
        outer: Future[Any] = Future()
        # cancelling the outer future drops the job on the cluster
        outer.add_done_callback(lambda future: future.cancelled() and inner.cancel())
        inner.add_done_callback(partial(self._forward_result, outer))
        return outer

    def _forward_result(self, outer: Future[Any], inner: Future[Any]) -> None:
        if not outer.set_running_or_notify_cancel():
            return
        if inner.cancelled():
            outer.set_exception(InputError(f"the Dask scheduler at {self._address} has gone, or has dropped jobs."))
        elif isinstance(error := inner.exception(), ImportError | AttributeError):  # of loading, not of a job
            outer.set_exception(InputError(f"a worker of {self._address} cannot load dynident: {error}"))
        elif error is not None:
            outer.set_exception(error)
        else:
            outer.set_result(inner.result())

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for what is submitted, or give it up."""
        self._executor.shutdown(wait=wait and not cancel_futures)


def _on_worker(expected: Mapping[str, str], preload: tuple[str, ...], call: Callable[[], Any]) -> Any:
    """Call a function on a worker with the same software as the caller; its jobs get a process of their own."""
    if mismatches := software_differences(expected, {socket.gethostname(): software()}):
        raise InputError(_mismatch_text(mismatches))
    assign_process(preload)
    return call()


@contextmanager
def _silence_dask() -> Iterator[None]:
    """Keep what Dask logs from the terminal: what matters is raised."""
    loggers = [logger for logger in logging.root.manager.loggerDict.values() if isinstance(logger, logging.Logger)]
    levels = {
        logger: logger.level for logger in loggers if logger.level and logger.name.partition(".")[0] in NOISY_LOGGERS
    }
    for logger in levels:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in levels.items():
            logger.setLevel(level)


def _require_scheduler(address: str) -> None:
    """Check that a Dask scheduler listens there; InputError.

    Dask's client would wait for ever for a process that accepts the connection and says nothing.
    """
    try:
        with ThreadPoolExecutor(1) as thread:  # there may be a loop in this one, as in a notebook
            identity = thread.submit(asyncio.run, _identity(address)).result()
    except (OSError, EOFError) as error:
        raise InputError(_no_answer_text(address, error)) from error
    except TypeError as error:  # Dask's, of a protocol that is not set up
        raise InputError(
            f"{address!r} cannot be used: {error}; for tls, the certificates are named in Dask's configuration, at "
            "distributed.comm.tls."
        ) from error
    except ValueError as error:  # Dask's, of an address that it cannot read
        raise InputError(f"{address!r} is no address of a Dask scheduler: {error}; give tcp://HOST:PORT.") from error
    if identity.get("type") != "Scheduler":
        its = f"; its scheduler is {identity['scheduler']}" if "scheduler" in identity else ""
        raise InputError(f"at {address} is no Dask scheduler but a {identity.get('type')}{its}.")


async def _identity(address: str) -> Mapping[str, Any]:
    from distributed.core import rpc
    from distributed.security import Security

    async def ask() -> Mapping[str, Any]:
        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=ANSWER_SECONDS, connection_args=arguments) as scheduler:
            return await scheduler.identity()  # type: ignore[no-any-return]

    return await asyncio.wait_for(ask(), ANSWER_SECONDS)


def _no_answer_text(address: str, error: BaseException) -> str:
    detail = f" ({error})" if str(error) else ""
    return (
        f"no Dask scheduler answers at {address} within {ANSWER_SECONDS:g} s{detail}; is it running (`dask "
        "scheduler`), is its port open, and is this not that of its dashboard?"
    )


def _require_workers(client: Any, address: str) -> None:
    """Require that there are workers, and that they have the software of this process."""
    try:
        client.wait_for_workers(1, timeout=ANSWER_SECONDS)
        reports = client.sync(_ask_workers, client)
    except TimeoutError as error:
        if client.nthreads():
            raise InputError(f"not all workers of {address} answer within {ANSWER_SECONDS:g} s.") from error
        raise InputError(f"the Dask scheduler at {address} has no worker; start some: dask worker {address}") from error
    failed = {place: report for place, report in reports.items() if isinstance(report, BaseException)}
    if failed:
        why = next(iter(failed.values()))
        places = join_names(failed, MAX_PLACES)
        raise InputError(f"workers cannot load this dynident ({why}): {places}. Install the same everywhere.")
    scheduler = client.get_versions()["scheduler"]["packages"]
    version = {"Python": ".".join(scheduler["python"].split(".")[:2]), "distributed": scheduler["distributed"]}
    if differing := software_differences(software(), {**reports, "the scheduler": version}):
        raise InputError(_mismatch_text(differing))


async def _ask_workers(client: Any) -> Mapping[str, Any]:
    return await asyncio.wait_for(client.run(software, on_error="return"), ANSWER_SECONDS)


def _mismatch_text(mismatches: list[str]) -> str:
    return (
        f"the workers of the cluster would not compute the same: {'; '.join(mismatches)}. Install the same everywhere."
    )
