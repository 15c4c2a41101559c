"""The results document: what is summarised, what is compared, what JSON can hold."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from train.results import CRASHED, add_row, comparisons, new_document, plain, summarise, summary, to_json, write


def row(episode: int, **metrics: object) -> dict:
    return {"policy": "p", "episode": episode, "seed": episode, "world_index": episode, "error": None, **metrics}


def test_numbers_get_means_and_answers_get_rates():
    found = summary([row(k, coverage=k / 10, success=k > 4, series={"time_s": [0.0]}) for k in range(8)])
    assert set(found) == {"coverage", "success"}
    assert found["coverage"]["kind"] == "iqm"
    assert found["coverage"]["value"] == pytest.approx(0.35)
    assert (found["success"]["kind"], found["success"]["value"]) == ("rate", 3 / 8)


def test_what_is_unknown_is_left_out_and_counted():
    found = summary([row(0, energy_j=10.0), row(1, energy_j=None), row(2, energy_j=20.0)])
    assert (found["energy_j"]["value"], found["energy_j"]["n"]) == (15.0, 2)


def test_what_was_never_reached_is_not_left_out():
    reached = summary([row(k, t90_s=float(k)) for k in range(7)] + [row(7, t90_s=None)])
    never = summary([row(0, t90_s=5.0), row(1, t90_s=None), row(2, t90_s=None)])
    assert reached["t90_s"]["value"] == pytest.approx(3.5)
    assert (reached["t90_s"]["n"], never["t90_s"]["n"]) == (8, 3)
    assert plain(never["t90_s"]["value"]) is None


def test_policies_are_compared_on_the_episodes_that_both_have():
    a = [row(k, success=True, pickets_lost=4, mapped_m2=2.0) for k in range(3)]
    b = [row(k, success=False, pickets_lost=3, mapped_m2=1.0) for k in range(2)]
    found = {entry["metric"]: entry for entry in comparisons(a, b)}
    assert found["success"]["value"] == 1.0
    assert found["pickets_lost"]["value"] == 1.0
    assert found["pickets_lost_per_mapped_m2"]["value"] == pytest.approx(4 / 2 - 3 / 1)
    assert {entry["n"] for entry in found.values()} == {2}


def test_information_is_compared_per_joule_of_all_episodes_together():
    a = [row(0, information_bits=100.0, action_energy_j=10.0), row(1, information_bits=0.0, action_energy_j=40.0)]
    b = [row(0, information_bits=50.0, action_energy_j=10.0), row(1, information_bits=50.0, action_energy_j=10.0)]
    found = {entry["metric"]: entry for entry in comparisons(a, b)}
    assert found["bits_per_action_joule"]["value"] == pytest.approx(100 / 50 - 100 / 20)
    assert "bits_per_joule" not in found


def test_a_crash_lowers_the_rate_but_invents_no_energy():
    found = summary([row(0, success=True, energy_j=5.0, coverage=1.0), row(1, **CRASHED)])
    assert found["success"]["value"] == 0.5
    assert found["coverage"]["value"] == 0.5
    assert found["energy_j"]["n"] == 1


def test_document_is_valid_json_whatever_it_holds(tmp_path):
    document = new_document("coop evaluate", {"out": tmp_path, "seed": 0}, ["p"])
    add_row(document, row(1, nees=math.nan, coverage=np.float32(0.5), success=np.bool_(True)))
    add_row(document, row(0, nees=1.0, coverage=0.25, success=False))
    summarise(document, "complete")
    path = tmp_path / "results.json"
    write(document, path)
    read = json.loads(path.read_text())
    assert path.read_text() == to_json(document)
    assert [entry["episode"] for entry in read["policies"]["p"]["episodes"]] == [0, 1]
    assert read["policies"]["p"]["episodes"][1]["nees"] is None
    assert read["options"]["out"] == str(tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == ["results.json"]
