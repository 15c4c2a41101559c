"""The report of a training tells what a colleague needs, whatever happened to the training."""

from __future__ import annotations

import re
from typing import Any

import pytest

from train.learning_report import held_out_metrics, render
from train.training_progress import add_row, close, new_document
from train.training_settings import TrainingSettings

SETTINGS = TrainingSettings(team="inchworm", overrides=("task.time_limit_s=100",), steps=3000)


def document(rows: int, evaluations: int, status: str = "complete") -> dict[str, Any]:
    made = new_document("coop train --team inchworm <b>", SETTINGS.plain())
    for k in range(rows):
        add_row(made, update(k))
    names = {metric.name: 0.5 * k for k, metric in enumerate(held_out_metrics())}
    made["held_out"] = [{"steps": 1000 * (k + 1), "episodes": 16, **names, "return": -k} for k in range(evaluations)]
    made |= {"steps": 1000 * rows, "wall_s": 12.0, "weights_sha256": "abcdef0123456789" * 4}
    close(made, status)
    return made


def update(k: int) -> dict[str, Any]:
    losses = dict.fromkeys(("policy_loss", "value_loss", "entropy", "approx_kl", "explained_variance"), 0.1 * k)
    return {"steps": 1000 * (k + 1), "return": None if k == 0 else 1.0 * k, "steps_per_s": 5.0, **losses} | {
        "reward_per_s": {"information": 0.1, "energy": 0.0}
    }


def test_it_names_what_was_trained_and_how_to_go_on():
    html = render(document(3, 3))
    assert "coop train --team inchworm &lt;b&gt;" in html
    assert "coop train --resume --out out/train --steps 6000" in html
    assert "coop evaluate --policy out/train" in html
    assert "task.time_limit_s=100" in html
    assert "First" in html
    assert "Best return" in html
    assert html.count("data:image/svg+xml") == len(held_out_metrics()) + 7
    assert not re.search(r'(src|href)="(?!data:)', html)


@pytest.mark.parametrize(("rows", "evaluations"), [(0, 0), (1, 0), (1, 1)])
def test_a_short_training_has_one_too(rows, evaluations):
    html = render(document(rows, evaluations, "interrupted"))
    assert "This training is interrupted" in html
    assert "coop train --resume --out out/train --steps 3000" in html


def test_very_many_updates_are_thinned_and_ends_are_kept():
    made = document(5000, 0)
    steps = [row["steps"] for row in made["training"]]
    assert len(steps) <= 2000
    assert (steps[0], steps[-1]) == (1000, 5_000_000)
    assert steps == sorted(steps)
