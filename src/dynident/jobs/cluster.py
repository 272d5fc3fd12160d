"""The workers of a Dask cluster as an executor, after a look at whether they are there and compute the same."""

from __future__ import annotations

import asyncio
import logging
import socket
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from typing import Any

from dynident.errors import InputError, install_command, listed
from dynident.jobs.software import FEW, differences, software
from dynident.jobs.workers import own_process

__all__ = ["cluster_workers"]

ANSWER = 10.0  # s in which a scheduler, and its workers, answer
TALKING = ("distributed", "tornado")  # what logs to the terminal
LARGEST = "distributed.admin.large-graph-warning-threshold"


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
    with _quiet(), dask.config.set({LARGEST: "1 TiB"}):
        _require_scheduler(address)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", VersionMismatchWarning)  # an error, where it matters
                client = distributed.Client(address, timeout=ANSWER, set_as_default=False)
        except (OSError, ImportError) as error:
            raise InputError(_unanswered(address, error)) from error
        try:
            _require_workers(client, address)
            yield _Cluster(client, address, tuple(preload))
        finally:
            client.close(timeout=ANSWER)


class _Cluster(Executor):
    """Dask's own executor, which says so where the scheduler has gone, and whose workers are all compared."""

    def __init__(self, client: Any, address: str, preload: tuple[str, ...]) -> None:
        self._client, self._address, self._preload = client, address, preload
        self._executor = client.get_executor(pure=False)

    @property
    def _max_workers(self) -> int:  # the name that the executors of the standard library have for it
        return int(sum(self._client.nthreads().values())) or 1

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """Let a worker call ``function``."""
        call = partial(function, *given, **named)
        inner = self._executor.submit(_on_worker, software(), self._preload, call)
        outer: Future[Any] = Future()
        outer.add_done_callback(lambda one: one.cancelled() and inner.cancel())
        inner.add_done_callback(partial(self._ended, outer))
        return outer

    def _ended(self, outer: Future[Any], inner: Future[Any]) -> None:
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
    """Call a function on a worker, which has the software of who asks, and its jobs in a process of their own."""
    if found := differences(expected, {socket.gethostname(): software()}):
        raise InputError(_different(found))
    own_process(preload)
    return call()


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep what Dask logs from the terminal: what matters is raised."""
    loggers = [one for one in logging.root.manager.loggerDict.values() if isinstance(one, logging.Logger)]
    before = {one: one.level for one in loggers if one.level and one.name.partition(".")[0] in TALKING}
    for one in before:
        one.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for one, level in before.items():
            one.setLevel(level)


def _require_scheduler(address: str) -> None:
    """Ask who listens there: Dask's client would wait for ever for one that accepts and says nothing."""
    try:
        with ThreadPoolExecutor(1) as thread:  # there may be a loop in this one, as in a notebook
            found = thread.submit(asyncio.run, _identity(address)).result()
    except (OSError, EOFError) as error:
        raise InputError(_unanswered(address, error)) from error
    except TypeError as error:  # Dask's, of a protocol that is not set up
        raise InputError(
            f"{address!r} cannot be used: {error}; for tls, the certificates are named in Dask's configuration, at "
            "distributed.comm.tls."
        ) from error
    except ValueError as error:  # Dask's, of an address that it cannot read
        raise InputError(f"{address!r} is no address of a Dask scheduler: {error}; give tcp://HOST:PORT.") from error
    if found.get("type") != "Scheduler":
        its = f"; its scheduler is {found['scheduler']}" if "scheduler" in found else ""
        raise InputError(f"at {address} is no Dask scheduler but a {found.get('type')}{its}.")


async def _identity(address: str) -> Mapping[str, Any]:
    from distributed.core import rpc
    from distributed.security import Security

    async def ask() -> Mapping[str, Any]:
        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=ANSWER, connection_args=arguments) as there:
            return await there.identity()  # type: ignore[no-any-return]

    return await asyncio.wait_for(ask(), ANSWER)


def _unanswered(address: str, error: BaseException) -> str:
    why = f" ({error})" if str(error) else ""
    return (
        f"no Dask scheduler answers at {address} within {ANSWER:g} s{why}; is it running (`dask scheduler`), is its "
        "port open, and is this not that of its dashboard?"
    )


def _require_workers(client: Any, address: str) -> None:
    """Require that there are workers, and that they have the software of this process."""
    try:
        client.wait_for_workers(1, timeout=ANSWER)
        found = client.sync(_asked, client)
    except TimeoutError as error:
        if client.nthreads():
            raise InputError(f"not all workers of {address} answer within {ANSWER:g} s.") from error
        raise InputError(f"the Dask scheduler at {address} has no worker; start some: dask worker {address}") from error
    failed = {place: one for place, one in found.items() if isinstance(one, BaseException)}
    if failed:
        why = next(iter(failed.values()))
        places = listed(failed, FEW)
        raise InputError(f"workers cannot load this dynident ({why}): {places}. Install the same everywhere.")
    scheduler = client.get_versions()["scheduler"]["packages"]
    version = {"Python": ".".join(scheduler["python"].split(".")[:2]), "distributed": scheduler["distributed"]}
    if differing := differences(software(), {**found, "the scheduler": version}):
        raise InputError(_different(differing))


async def _asked(client: Any) -> Mapping[str, Any]:
    return await asyncio.wait_for(client.run(software, on_error="return"), ANSWER)


def _different(found: list[str]) -> str:
    return f"the workers of the cluster would not compute the same: {'; '.join(found)}. Install the same everywhere."
