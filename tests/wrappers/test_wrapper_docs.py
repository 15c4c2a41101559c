"""The examples of docs/wrappers.md run, and its links lead somewhere."""

from __future__ import annotations

import pytest

import coop_envs.wrappers
from tests.test_documents import ROOT, blocks

PAGE = "docs/wrappers.md"


@pytest.mark.parametrize("number", range(len(blocks(PAGE, "python"))))
def test_examples_run(number: int) -> None:
    exec(blocks(PAGE, "python")[number], {})


def test_every_wrapper_is_told_of() -> None:
    text = (ROOT / PAGE).read_text(encoding="utf-8")
    for name in coop_envs.wrappers.__all__:
        assert f"{name}" in text, name
