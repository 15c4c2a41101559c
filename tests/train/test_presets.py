"""Every preset can be trained with, and is named like its scenario."""

from __future__ import annotations

import pytest

from coop_envs.scenario import scenario_names
from coop_envs.validation import validated
from train.train import preset, preset_names
from train.training_settings import TrainingSettings


@pytest.mark.parametrize("name", preset_names())
def test_preset(name):
    settings = validated(TrainingSettings, preset(name), name)
    assert settings.scenario == name
    assert name in scenario_names()
    assert settings.load_scenario().name == name
    assert validated(TrainingSettings, settings.plain()) == settings
