"""Jobs over processes: order, errors, deaths, interruption."""

from __future__ import annotations

import os
import time

import pytest

from train.pool import run_jobs


def square(number: int) -> int:
    if number == 3:
        raise ValueError("three\nis odd")
    if number == 4:
        os._exit(7)
    return number * number


def sleep(seconds: float) -> float:
    time.sleep(seconds)
    return seconds


def test_every_job_has_an_outcome_whatever_happens_to_its_process():
    outcomes = {outcome.index: outcome for outcome in run_jobs(square, [1, 2, 3, 4, 5, 6], workers=2)}
    assert [outcomes[i].value for i in range(6)] == [1, 4, None, None, 25, 36]
    assert outcomes[2].error == f"ValueError: three is odd (test_pool.py:{square.__code__.co_firstlineno + 2})"
    assert outcomes[3].error == "the process died (exit code 7)"


def test_no_jobs_no_outcomes():
    assert list(run_jobs(square, [], workers=2)) == []


def test_results_come_as_they_finish_and_closing_ends_the_rest():
    outcomes = run_jobs(sleep, [60.0, 0.0], workers=2)
    started = time.monotonic()
    assert next(outcomes).value == 0.0
    outcomes.close()
    assert time.monotonic() - started < 20.0


@pytest.mark.parametrize("workers", [1, 5])
def test_the_number_of_workers_does_not_change_the_results(workers):
    outcomes = sorted(run_jobs(square, [1, 2, 5], workers), key=lambda outcome: outcome.index)
    assert [outcome.value for outcome in outcomes] == [1, 4, 25]
