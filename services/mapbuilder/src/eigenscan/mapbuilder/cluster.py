"""Shards built by dask's workers: processes of this machine, or a cluster."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from importlib.util import find_spec
from itertools import islice
from typing import TYPE_CHECKING, Any

from eigenscan.eigenspace.region_file import pack_region
from eigenscan.geometry.raycast import RayCaster
from eigenscan.mapbuilder.plan import Plan
from eigenscan.mapbuilder.shards import Shard, build_shard

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_AHEAD = 2
"""Shards queued at a worker, so the waiting memory does not grow with the site."""
_PATIENCE_S = 20
"""Longest wait for a scheduler, s."""


class ClusterError(ValueError):
    """A cluster that cannot be used; the message states which and the fix."""


class Workers(AbstractContextManager["Workers"]):
    """Workers of dask: `count` processes of this machine, or those of the scheduler at `address`.

    Raises ClusterError where dask is not installed, the scheduler does not answer or has no workers.
    """

    def __init__(self, count: int = 0, address: str = "") -> None:
        if find_spec("distributed") is None:
            raise ClusterError("--workers and --scheduler need dask: pip install 'eigenscan[cluster]'")
        self._count, self._address = count, address
        self._local: LocalCluster | None = None
        self._client: Client | None = None

    def __enter__(self) -> Workers:
        from distributed import Client, LocalCluster

        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        if not self._address:
            self._local = LocalCluster(
                n_workers=self._count,
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
                silence_logs=logging.CRITICAL,
            )
        try:
            self._client = Client(self._local or self._address, timeout=_PATIENCE_S)
            self._client.wait_for_workers(1, timeout=_PATIENCE_S)
        except (OSError, ValueError) as error:
            self.__exit__(None, None, None)
            raise ClusterError(
                f"--scheduler {self._address}: no dask scheduler with workers answers: start "
                "`dask scheduler` there and `dask worker ADDRESS` on each computer, or check the address"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        for part in (self._client, self._local):
            if part is not None:
                part.close()

    @property
    def count(self) -> int:
        """Shards that are built at a time."""
        return sum(self.client.nthreads().values())

    @property
    def client(self) -> Client:
        """The connection, between enter and exit."""
        assert self._client is not None
        return self._client

    def build(
        self, caster: RayCaster, plan: Plan, waiting: Sequence[Shard]
    ) -> Iterator[tuple[int, list[bytes]]]:
        """Engine, as in `sharded`. Raises ClusterError if a worker cannot build."""
        from distributed import as_completed

        client = self.client
        there = client.scatter(caster, broadcast=True)
        single = replace(plan, threads=1)
        numbered, under_way = enumerate(waiting), dict[Any, int]()

        def send(number: int, shard: Shard) -> Any:
            future = client.submit(_build, there, single, shard, pure=False, retries=2)
            under_way[future] = number
            return future

        results = as_completed([send(*each) for each in islice(numbered, _AHEAD * self.count)])
        for future in results:
            if future.status != "finished":
                raise ClusterError(f"a worker failed: {future.exception()!r}: it needs eigenscan-mapbuilder")
            yield under_way.pop(future), future.result()
            for each in islice(numbered, 1):
                results.add(send(*each))


def _build(caster: RayCaster, plan: Plan, shard: Shard) -> list[bytes]:
    return list(build_shard(caster, plan, shard, pack_region))
