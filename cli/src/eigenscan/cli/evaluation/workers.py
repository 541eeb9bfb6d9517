"""Runs of the pipeline, one after another or in several processes; the answers are the same.

The reference stays with the caller: a worker gets models and a stretch of the log, no more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from typing import TypeVar

import numba
import psutil
from eigenscan.cli.evaluation.pipeline import Answer, Packed, Pipeline, Run, pack, unpack
from eigenscan.schemas.envelope import Envelope

R = TypeVar("R")


class Worker:
    """One warm pipeline. `model_mb`: what loading its models added to the resident set, MB."""

    def __init__(self, models: Packed, warm_up: Packed) -> None:
        """Hears `warm_up` once: what is compiled late is compiled before the clock counts."""
        numba.set_num_threads(1)
        envelopes = list(unpack(models))
        before = psutil.Process().memory_info().rss
        self._pipeline = Pipeline(envelopes)
        self._pipeline.warm_up(unpack(warm_up))
        self.model_mb = (psutil.Process().memory_info().rss - before) / 1e6

    def run(self, heard: Packed) -> Run:
        """One cold run over a stretch of the log."""
        return self._pipeline.run(unpack(heard))

    def answer(self, scan: Packed) -> Answer:
        """The answer to one raw scan."""
        return self._pipeline.answer(next(unpack(scan)))


_here: list[Worker] = []
"""The worker of a process that has one."""


def _begin(models: Packed, warm_up: Packed) -> None:
    _here.append(Worker(models, warm_up))


def _call(work: Callable[[Worker, Packed], R], packed: Packed) -> R:
    return work(_here[0], packed)


def _model_mb(worker: Worker, _: Packed) -> float:
    return worker.model_mb


class Workers:
    """A worker in this process (`jobs` = 1), or one in each of `jobs` processes. Use it with `with`."""

    def __init__(self, jobs: int, models: Sequence[Envelope], warm_up: Sequence[Envelope]) -> None:
        beginning = (pack(models), pack(warm_up))
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1:
            self._pool = ProcessPoolExecutor(jobs, get_context("spawn"), _begin, beginning)
        else:
            self._own = Worker(*beginning)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool:
            self._pool.shutdown(cancel_futures=True)

    @property
    def model_mb(self) -> float:
        """What a loaded model adds to the resident set, MB."""
        return next(self._each(_model_mb, [()]))

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
