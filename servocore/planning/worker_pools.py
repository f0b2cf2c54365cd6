"""Workers for blocks of a sweep: an executor of this machine, or a Dask cluster."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

PATIENCE = 60.0
"""How long a cluster may be without any worker, in s; workers that die are started again within seconds."""

_LOOKS = 12  # polls in that time, few enough for the scheduler
_FEWEST = 16  # workers assumed of an executor, whose number cannot be read


class PoolLost(Exception):
    """The worker process or the cluster has ended; the message gives the reason."""


@dataclass(frozen=True)
class Pool:
    """An executor.

    Attributes
    ----------
    executor : concurrent.futures.Executor
        Which computes.
    """

    executor: Executor

    @property
    def ahead(self) -> int:
        """How many calls are under way at once, so that no worker waits for the next."""
        return 2 * max(os.cpu_count() or 1, _FEWEST) + 2

    def submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Have something computed.

        Raises
        ------
        PoolLost
            If the executor has ended.
        """
        try:
            return self.executor.submit(call, *arguments)
        except RuntimeError as error:  # broken, or shut down
            raise _broken(error) from error

    def completed(self, waiting: Collection[Any]) -> Collection[Any]:
        """Wait for the first of some calls, and return which are complete."""
        return wait(waiting, return_when=FIRST_COMPLETED).done

    def forget(self, waiting: Collection[Any]) -> None:
        """Cancel calls whose results are not needed any more."""
        for future in waiting:
            future.cancel()

    def result(self, future: Any) -> Any:
        """Return the result of a call.

        Raises
        ------
        PoolLost
            If the executor has lost the call.
        """
        try:
            return future.result()
        except BrokenExecutor as error:
            raise _broken(error) from error


@dataclass(frozen=True)
class Cluster:
    """Workers of Dask, whose results are fetched one after the other; see `Pool`.

    Dask's own executor fetches all at once. Where a worker died with results that were not fetched yet, every one of
    these requests has all of them computed again.

    Attributes
    ----------
    client : distributed.Client
        Which knows the workers.
    """

    client: Any

    @property
    def ahead(self) -> int:
        """As many as the workers that are there now can take, and some for those that will join."""
        with self._connected():
            return 2 * int(sum(self.client.ncores().values())) + 8

    def submit(self, call: Callable[..., Any], *arguments: Any) -> Any:
        """Have something computed."""
        with self._connected():
            return self.client.submit(call, *arguments, pure=False)

    def completed(self, waiting: Collection[Any]) -> Collection[Any]:
        """Wait for the first of some calls; `PoolLost` if there is no worker for too long."""
        from distributed import wait as first_of  # noqa: PLC0415 - an extra

        with self._connected():
            first = self._patiently(partial(first_of, list(waiting), return_when="FIRST_COMPLETED"))
            done: Collection[Any] = first.done
            return done

    def forget(self, waiting: Collection[Any]) -> None:
        """Cancel calls whose results are not needed any more."""
        if self.client.status == "running":  # else the cluster has ended
            self.client.cancel(list(waiting))

    def result(self, future: Any) -> Any:
        """Return the result of a call; `PoolLost` if the cluster has lost the call."""
        from distributed.scheduler import KilledWorker  # noqa: PLC0415 - an extra

        try:
            with self._connected():
                return self._patiently(future.result)
        except KilledWorker as error:
            raise _broken(error) from error

    @contextmanager
    def _connected(self) -> Iterator[None]:
        """Raise `PoolLost` where the scheduler has ended: Dask closes the client then, and fails where it is used."""
        try:
            yield
        except PoolLost:
            raise
        except (Exception, CancelledError) as error:
            if self.client.status == "running":
                raise
            raise PoolLost("the cluster's scheduler does not answer") from error

    def _patiently(self, fetch: Callable[..., Any]) -> Any:
        """Wait in intervals; a result of a worker that died before it was fetched is computed again.

        Raises
        ------
        PoolLost
            If there is no worker for too long.
        """
        seen = time.monotonic()
        while True:
            try:
                return fetch(timeout=PATIENCE / _LOOKS)
            except TimeoutError:
                if self.client.ncores():
                    seen = time.monotonic()
                elif time.monotonic() - seen >= PATIENCE:
                    raise PoolLost(f"the cluster had no worker for {PATIENCE:g} s") from None


def _broken(error: Exception) -> PoolLost:
    return PoolLost(f"the executor gave up: {type(error).__name__}: {error}")
