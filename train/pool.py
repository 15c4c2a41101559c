"""Independent jobs over processes: results as they finish, a dead worker costs only the job it held."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import traceback
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

STOP_S = 5.0


@dataclass(frozen=True)
class Outcome:
    """What became of ``jobs[index]``: a value, or the one-line text of the error."""

    index: int
    value: Any = None
    error: str | None = None


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    index: int | None = None


def run_jobs(function: Callable[[Any], Any], jobs: Sequence[Any], workers: int) -> Generator[Outcome, None, None]:
    """Yield the outcome of ``function(job)`` for every job, in the order of finishing.

    Workers are spawned, so ``function`` and the jobs must pickle. They ignore Ctrl-C: the parent gets the interrupt,
    and closing this generator ends them.
    """
    waiting = list(enumerate(jobs))[::-1]
    team: list[_Worker] = []
    try:
        while waiting or team:
            while waiting and len(team) < workers:
                team.append(_start(function))
                _give(team[-1], waiting.pop())
            ready = set(wait([worker.connection for worker in team]))
            for worker in [worker for worker in team if worker.connection in ready]:
                outcome = _receive(worker)
                dead = worker.process.exitcode is not None
                if waiting and not dead:
                    _give(worker, waiting.pop())
                else:
                    team.remove(worker)
                    _stop(worker)
                yield outcome
    finally:
        for worker in team:
            worker.process.terminate()
            _stop(worker)


def _start(function: Callable[[Any], Any]) -> _Worker:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function), daemon=True)
    with _interrupts_held_back():
        process.start()
    theirs.close()
    return _Worker(process, ours)


def _give(worker: _Worker, numbered_job: tuple[int, Any]) -> None:
    worker.index, job = numbered_job
    with suppress(BrokenPipeError):  # a worker dead already shows when its answer is read
        worker.connection.send(job)


def _receive(worker: _Worker) -> Outcome:
    assert worker.index is not None
    try:
        value, error = worker.connection.recv()
    except (EOFError, ConnectionError):
        worker.process.join()
        return Outcome(worker.index, error=f"the process died (exit code {worker.process.exitcode})")
    return Outcome(worker.index, value, error)


def _stop(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.join(STOP_S)
    worker.process.kill()
    worker.process.join()


def _work(connection: Connection, function: Callable[[Any], Any]) -> None:
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # unwinds, so that unfinished files are removed
    while True:
        try:
            job = connection.recv()
        except EOFError:
            return
        try:
            reply = function(job), None
        except Exception as error:  # noqa: BLE001 (whatever it is, it belongs in the results)
            reply = None, _one_line(error)
        connection.send(reply)


def _one_line(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    text = " ".join(f"{type(error).__name__}: {error}".split())
    return f"{text} ({where.filename.rpartition('/')[2]}:{where.lineno})"


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Block SIGINT, which a process started meanwhile inherits; one that arrives is delivered at the end."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
