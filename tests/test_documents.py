"""What README and docs show, run: Python blocks are executed, YAML blocks are loaded."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from coop_envs.agents.catalog import load_camera, load_team
from coop_envs.localization.logs.bag_topics import Topics
from coop_envs.localization.logs.team_file import read_team
from coop_envs.localization.settings import Localization
from coop_envs.scenario import load_scenario
from coop_envs.validation import read_yaml, validated

ROOT = Path(__file__).parents[1]
PAGES = (
    "README.md",
    "docs/worlds.md",
    "docs/robots.md",
    "docs/scanning.md",
    "docs/policies.md",
    "docs/training.md",
    "docs/localizing.md",
)


def blocks(page: str, language: str) -> list[str]:
    return re.findall(
        rf"^```{language}\n(.*?)^```", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )


@pytest.mark.parametrize("page", PAGES)
def test_python_blocks_run(page):
    for program in blocks(page, "python"):
        run = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr


@pytest.mark.parametrize("page", PAGES)
def test_yaml_blocks_load(page, tmp_path):
    for number, text in enumerate(blocks(page, "yaml")):
        path = tmp_path / f"{number}.yaml"
        path.write_text(text, encoding="utf-8")
        entries = read_yaml(text, str(path))
        if "camera_matrix" in entries:
            assert load_camera({"file": path}).name
        elif {"robots", "names", "starts"} & set(entries):
            who = read_team(path)
            assert who.robots and Topics(who.topics)
        elif set(entries) == {"estimation"}:
            assert validated(Localization, entries, "settings")
        else:
            assert (load_team(path) if "members" in entries else load_scenario(path)).name


def test_quick_start_is_short():
    (program,) = blocks("README.md", "python")
    assert len(program.strip().splitlines()) <= 10


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)#:]+)\)", (ROOT / page).read_text(encoding="utf-8")):
        assert (ROOT / page).parent.joinpath(target).exists(), target
