"""Where robots go: ground, hazards, media, and what is true of them."""

from coop_envs.worlds.build import Split, build_world
from coop_envs.worlds.placement import Footprint
from coop_envs.worlds.solid import SolidColumns, solid_columns
from coop_envs.worlds.truth import TruthGrid, safe_path_exists, truth_grid
from coop_envs.worlds.world import Hazard, HazardKind, HeightField, Medium, Mesh, World

__all__ = [
    "Footprint",
    "Hazard",
    "HazardKind",
    "HeightField",
    "Medium",
    "Mesh",
    "SolidColumns",
    "Split",
    "TruthGrid",
    "World",
    "build_world",
    "safe_path_exists",
    "solid_columns",
    "truth_grid",
]
