"""Every preset can be trained with, and is named like its scenario."""

from __future__ import annotations

import pytest
from rich.console import Console

from coop_envs.scenario import scenario_names
from coop_envs.validation import validated
from train.train import _base, preset, preset_names
from train.training_settings import TrainingSettings


@pytest.mark.parametrize("name", preset_names())
def test_preset(name):
    settings = validated(TrainingSettings, preset(name), name)
    assert settings.scenario == name
    assert name in scenario_names()
    assert settings.load_scenario().name == name
    assert validated(TrainingSettings, settings.plain()) == settings


def test_a_file_that_names_a_world_is_not_laid_over_a_preset(tmp_path):
    path = tmp_path / "settings.yaml"
    for world, presets in (("cave.ply", TrainingSettings().teams), ("null", preset("arena")["teams"])):
        path.write_text(f"world: {world}\n")
        assert _base(["--config", str(path)], Console())[0].teams == presets
