import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from coop_envs.viewer.metrics import Metric, known_metrics
from coop_envs.viewer.report import render, write_report

pytestmark = pytest.mark.render
RECORDED = [
    *(
        "success",
        "coverage",
        "mapped_m2",
        "information_bits",
        "volume_bits",
        "survey_bits",
        "h_v",
        "points_measured",
        "point_error_m",
        "point_error_95_m",
        "energy_j",
        "action_energy_j",
        "bits_per_joule",
        "bits_per_action_joule",
        "hazards_found",
    ),
    *("pickets_lost", "observer_survived", "position_drift_m", "heading_drift_deg", "drift_percent_of_path", "nees"),
    *("simulated_s", "wall_s"),
]


def episode(seed: int, success: bool = True) -> dict[str, Any]:
    grow = [0.0, 0.5, 1.0]
    series = dict.fromkeys(("time_s", "coverage", "energy_j", "action_energy_j", "information_bits"), grow)
    return dict.fromkeys(RECORDED, 0.25) | {"seed": seed, "success": success, "series": series}


def arguments() -> dict[str, Any]:
    interval = {"iqm": 0.25, "low": 0.125, "high": 0.5, "n": 3}
    return {
        "title": "Two policies <in> the arena",
        "command": 'coop evaluate --policy goal_grid "a & b"',
        "environment": {"machine": "2 cores", "versions": {"numpy": "2.4.6"}, "seeds": [0, 1, 2]},
        "results": {
            "goal_grid": [episode(0), episode(1), episode(2, success=False)],
            "a & b": [episode(0), {"seed": 1, "success": False, "error": "ActionError: not <finite>"}],
        },
        "aggregates": {policy: dict.fromkeys(RECORDED, interval) for policy in ("goal_grid", "a & b")},
        "pictures": {"goal_grid": [("seed 0", [np.zeros((40, 60, 3), np.uint8), np.zeros((30, 30, 3), np.uint8)])]},
        "comparisons": [
            {"a": "goal_grid", "b": "a & b", "metric": "coverage", "value": 0.2, "low": 0.1, "high": 0.3, "n": 6},
            {"a": "goal_grid", "b": "a & b", "metric": "energy_j", "value": 7.0, "low": -1.0, "high": None, "n": 2},
        ],
    }


def changed(**entries: Any) -> dict[str, Any]:
    return {**arguments(), **entries}


@pytest.fixture(scope="module")
def html() -> str:
    return render(**arguments())


class Page(HTMLParser):
    """Collects text and checks that every tag is closed."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text = ""
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in {"meta", "img"}:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def test_every_recorded_metric_is_defined() -> None:
    assert sorted(metric.name for metric in known_metrics()) == sorted(RECORDED)
    assert all(metric.meaning for metric in known_metrics())


def test_the_report_tells_all_and_is_well_formed(html: str) -> None:
    page = Page(html)
    assert page.open == []
    for expected in (
        "Two policies <in> the arena",
        'coop evaluate --policy goal_grid "a & b"',
        "goal_grid: 3 episodes, 1 failed",
        "a & b: 2 episodes, 1 failed",
        "1 of them broke off",
        "ActionError: not <finite>",
        "2 cores",
        "2.4.6",
        "0, 1, 2",
        *(metric.label for metric in known_metrics()),
        *(metric.meaning for metric in known_metrics()),
    ):
        assert expected in page.text


def test_the_report_needs_nothing_else(html: str) -> None:
    assert not re.search(r"https?:|//|@import|url\(", re.sub(r"data:image/png;base64,[\w+/=]+", "", html))
    page = Page(html)
    assert not {"script", "link", "iframe"} & {tag for tag, _ in page.tags}
    images = [attributes["src"] or "" for tag, attributes in page.tags if tag == "img"]
    assert len(images) == 5 + 3 + 2
    assert all(source.startswith("data:image/png;base64,iVBOR") for source in images)


def test_values_are_shown_in_their_units(html: str) -> None:
    text = " ".join(Page(html).text.split())
    assert "Coverage % ↑ 25.0 12.5 to 50.0" in text
    assert "Position drift cm ↓ 25.0 12.5 to 50.0" in text


def test_differences_between_policies_are_told_and_clear_ones_stand_out(html: str) -> None:
    text = " ".join(Page(html).text.split())
    assert "goal_grid − a & b" in text
    assert "Coverage % ↑ 20.0 10.0 to 30.0" in text
    assert "Energy J ↓ 7 -1 to –" in text
    assert '<span class="value">20.0</span>' in html
    assert '<span class="unclear">7</span>' in html
    assert Metric("name", "Label").interval({"low": 1.0, "high": 1.0, "n": 1}) == "1 episode"
    assert not Metric.is_clear({"low": 1.0, "high": 1.0, "n": 5})
    assert "against each other" not in render(**changed(comparisons=(), results={}, aggregates={}, pictures={}))


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (True, "yes"),
        (3, "3"),
        (1234.5, "1,234.50"),
        (float("nan"), "–"),
        (None, "–"),
        (float("inf"), "–"),
        (-0.001, "0.00"),
    ],
)
def test_values_read_well(value: object, expected: str) -> None:
    assert Metric("name", "Label").text(value) == expected


def test_unknown_metrics_and_nothing_at_all_are_reported() -> None:
    given = arguments()
    given["aggregates"]["goal_grid"]["t90_s"] = {"iqm": 12.0, "low": 11.0, "high": 13.0, "n": 3}
    assert "t90_s" in render(**given)
    nothing = render(title="Nothing", command="", environment={}, results={}, aggregates={}, pictures={})
    assert Page(nothing).open == []


def test_many_pairs_of_policies_fill_several_tables() -> None:
    names = ["a", "b", "c", "d"]
    pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
    entries = [{"a": a, "b": b, "metric": "coverage", "value": 0.0, "low": -1, "high": 1, "n": 5} for a, b in pairs]
    text = Page(render(**changed(comparisons=entries, results={}, aggregates={}, pictures={}))).text
    assert text.count("Difference per episode") == 2
    assert all(f"{a} − {b}" in text for a, b in pairs)


def test_a_failed_report_leaves_the_old_one(tmp_path: Path) -> None:
    path = write_report(tmp_path / "report.html", **arguments())
    before = path.read_text(encoding="utf-8")
    broken: dict[str, Any] = arguments() | {"results": {"goal_grid": [{"series": {"time_s": [0.0]}}]}}
    with pytest.raises(KeyError):
        write_report(path, **broken)
    assert path.read_text(encoding="utf-8") == before
    assert list(tmp_path.iterdir()) == [path]
