"""Cooperative exploration by teams of cheap, losable robots, as a multi-agent environment.

`coop_envs.exploration_v0` holds the environment; importing this package only makes its names known to Gymnasium and
PettingZoo, whose ``make`` then imports the rest.
"""

from coop_envs.registration import register_environments

__version__ = "0.1.0"

register_environments()
