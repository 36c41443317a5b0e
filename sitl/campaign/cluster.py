"""The workers of a Dask cluster, by the address of its scheduler."""

from __future__ import annotations

import logging
from concurrent.futures import Future
from typing import Self

from distributed import Client, KilledWorker
from distributed.comm.addressing import get_address_host_port

from companion.errors import CompanionError, InputError
from sitl.campaign.mission import Mission, Row
from sitl.campaign.software import software
from sitl.campaign.workers import Fly

CONNECT_S = 10.0
AHEAD = 2
"""Missions for each worker under way, so that none waits for the network between two."""


_LOGGERS = ("distributed", "distributed.client", "tornado.application")
"""Those to which Dask gives levels of their own."""


class ClusterError(CompanionError):
    """The cluster is gone while missions were to be flown."""


class Cluster:
    """Who flies missions elsewhere. A worker that dies is replaced by Dask, which flies its mission again a few times.

    Args:
        address: of the scheduler, as ``tcp://HOST:8786``.

    Raises:
        InputError: no scheduler answers there, or a worker has other software than this process.
    """

    died: tuple[type[BaseException], ...] = (KilledWorker,)

    def __init__(self, address: str) -> None:
        self._address = address
        for name in _LOGGERS:
            logging.getLogger(name).setLevel(logging.CRITICAL)  # what ends the campaign is told in one message
        try:
            get_address_host_port(address)  # the client would fail only when it is taken away
            self._client = Client(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError(
                f"--scheduler {address}: no scheduler answers there ({error}); start one with `dask scheduler`"
            ) from None
        try:
            self._check_software()
            self._executor = self._client.get_executor(pure=False)
        except BaseException:
            self._client.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._client.status == "running":
            self._executor.shutdown(wait=False)
        self._client.close()

    def room(self) -> int:
        """A few missions for each worker that is there now; before the first comes, some wait for it."""
        return AHEAD * max(1, self._count())

    def who(self) -> str:
        """As many as there are now."""
        count = self._count()
        return f"on {count} worker{'s' * (count != 1)}" if count else "no worker has come yet"

    def submit(self, fly: Fly, mission: Mission) -> Future[Row]:
        """Give a mission to the scheduler."""
        future: Future[Row] = self._executor.submit(fly, mission)
        return future

    def check(self) -> None:
        """See whether the scheduler is still there.

        Raises:
            ClusterError: it is not.
        """
        if self._client.status != "running":
            raise self._gone()

    def _count(self) -> int:
        try:
            return len(self._client.nthreads())
        except (OSError, TimeoutError):
            raise self._gone() from None

    def _gone(self) -> ClusterError:
        return ClusterError(
            f"the scheduler {self._address} is gone; start it and its workers, and then this command again: it goes on "
            "with what is missing"
        )

    def _check_software(self) -> None:
        found = self._client.run(software, on_error="return")
        for worker, theirs in found.items():
            if theirs != software():
                raise InputError(
                    f"--scheduler {self._address}: worker {worker} has {theirs!s}, this is {software()}; install the "
                    "same there, with the extras sim and campaigns"
                )
