"""The teams of a training."""

from __future__ import annotations

from train.training_settings import TrainingSettings
from train.training_teams import make_teams


def test_trainings_with_other_seeds_share_no_series():
    seeds: set[int] = set()
    for seed in (0, 1, 8):
        settings = TrainingSettings(team="inchworm", teams=8, num_worlds=1, seed=seed)
        teams = make_teams(settings, settings.load_scenario(), 1)
        seeds |= {int(one) for one in teams.teams.get_state()["series"]["seed"]}
        teams.close()
    assert len(seeds) == 3 * 8
