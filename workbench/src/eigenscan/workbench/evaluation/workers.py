"""Runs of the pipeline, one after another or in several processes; the answers are the same.

The reference stays with the caller: a worker gets models and a stretch of the log, no more.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from types import TracebackType
from typing import TypeVar

import numba
import psutil
from eigenscan.schemas.envelope import Envelope
from eigenscan.workbench.evaluation.chosen import PipelineSettings
from eigenscan.workbench.evaluation.pipeline import Answer, Packed, Pipeline, Run, pack, unpack
from eigenscan.workbench.pool import Pool

R = TypeVar("R")


class Worker:
    """One warm pipeline."""

    def __init__(self, models: Packed, warm_up: Packed, settings: PipelineSettings) -> None:
        """Handles `warm_up` once, so that all code is compiled before the measurement."""
        numba.set_num_threads(1)
        self._pipeline = Pipeline(list(unpack(models)), settings)
        self._pipeline.warm_up(unpack(warm_up))

    def run(self, received: Packed) -> Run:
        """One cold run over a stretch of the log."""
        return self._pipeline.run(unpack(received))

    def answer(self, scan: Packed) -> Answer:
        """The answer to one raw scan."""
        return self._pipeline.answer(next(unpack(scan)))


_here: list[Worker] = []
"""The worker of a process that has one."""


def _begin(models: Packed, warm_up: Packed, settings: PipelineSettings) -> None:
    _here.append(Worker(models, warm_up, settings))


def _call(work: Callable[[Worker, Packed], R], packed: Packed) -> R:
    return work(_here[0], packed)


def _peak_mb(_: Worker, __: Packed) -> float:
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _weigh(models: Packed, warm_up: Packed, settings: PipelineSettings) -> float:
    first = Worker(models, warm_up, settings)  # brings the code, which is no part of the model
    before = psutil.Process().memory_info().rss
    second = Worker(models, warm_up, settings)
    added = psutil.Process().memory_info().rss - before
    del first, second
    return added / 1e6


def model_mb(models: Sequence[Envelope], warm_up: Sequence[Envelope], settings: PipelineSettings) -> float:
    """Resident memory of the models, MB, measured in a new process."""
    with Pool(1) as pool:
        return pool.submit(_weigh, pack(models), pack(warm_up), settings).result()


class Workers:
    """A worker in this process (`jobs` = 1), or one in each of `jobs` processes. Use it with `with`."""

    def __init__(
        self,
        jobs: int,
        models: Sequence[Envelope],
        warm_up: Sequence[Envelope],
        settings: PipelineSettings | None = None,
    ) -> None:
        beginning = (pack(models), pack(warm_up), settings or PipelineSettings())
        self._pool: Pool | None = None
        self._asked = 1 if jobs == 1 else 8 * jobs  # so many that each process is asked, most likely
        if jobs > 1:
            self._pool = Pool(jobs, _begin, beginning)
            self._pool.submit(int)  # begins one while the caller still prepares
        else:
            self._own = Worker(*beginning)

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool:
            self._pool.__exit__(kind, error, trace)

    @property
    def peak_mb(self) -> float:
        """Largest resident set of a worker's process so far, MB."""
        return max(self._each(_peak_mb, [()] * self._asked))

    def runs(self, stretches: Iterable[Sequence[Envelope]]) -> Iterator[Run]:
        """One cold run for each stretch of the log, in order."""
        return self._each(Worker.run, (pack(stretch) for stretch in stretches))

    def answers(self, scans: Iterable[Envelope]) -> Iterator[Answer]:
        """One answer for each raw scan, in order."""
        return self._each(Worker.answer, (pack([scan]) for scan in scans))

    def _each(self, work: Callable[[Worker, Packed], R], packed: Iterable[Packed]) -> Iterator[R]:
        if self._pool:
            return self._pool.map(partial(_call, work), packed)
        return (work(self._own, one) for one in packed)
