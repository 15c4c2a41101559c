"""The environment by its name in the registries."""

from __future__ import annotations

import gymnasium
import pettingzoo

from coop_envs.registration import NAME, register_environments


def test_pettingzoo_makes_both_interfaces():
    parallel = pettingzoo.make("parallel", NAME, scenario="u_turn")
    observations, _ = parallel.reset(seed=0)
    assert set(observations) == {"observer_0", "picket_0", "picket_1"}
    aec = pettingzoo.make("aec", NAME, scenario="u_turn")
    aec.reset(seed=0)
    assert aec.agents == parallel.agents


def test_gymnasium_makes_the_team_and_many_teams():
    team = gymnasium.make(NAME, scenario="u_turn")
    observation, _ = team.reset(seed=0)
    assert team.observation_space.contains(observation)
    teams = gymnasium.make_vec(NAME, num_envs=2, scenario="u_turn")
    assert teams.num_envs == 2


def test_registering_again_changes_nothing(recwarn):
    before = gymnasium.spec(NAME)
    register_environments()
    assert gymnasium.spec(NAME) is before
    assert not recwarn.list
