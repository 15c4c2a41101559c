from __future__ import annotations

import json

import pytest

from coop_envs import cli
from experiments import localization_study
from experiments.comparison import Comparison, terminal_table
from experiments.reproduce import EXPERIMENTS, main


def test_one_figure_leaves_a_picture_and_its_numbers(tmp_path, capsys):
    assert cli.main(["reproduce", "figure-6.1", "--out", str(tmp_path)]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figure-6.1.json", "figure-6.1.png"]
    assert (tmp_path / "figure-6.1.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads((tmp_path / "figure-6.1.json").read_text())
    assert len(document["comparisons"]) == 12
    assert all(abs(row["deviation_percent"]) < 2 for row in document["comparisons"])
    out = capsys.readouterr().out
    assert "thesis" in out and "fov pi/2, t0" in out


def test_json_goes_to_standard_output(tmp_path, capsys):
    assert main(["figure-6.1", "--out", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == "figure-6.1"


def test_an_unknown_name_is_one_line_with_a_hint(tmp_path, capsys):
    assert cli.main(["reproduce", "figure-6.11", "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err.strip()
    assert error.startswith("error: name: got 'figure-6.11'") and "figure-6.1" in error and "\n" not in error
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_refused_first(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert cli.main(["reproduce", "figure-6.1", "--out", str(tmp_path / "file" / "x")]) == 2
    assert "out: got" in capsys.readouterr().err


def test_a_negative_number_of_seeds_is_refused(tmp_path, capsys):
    assert cli.main(["reproduce", "table-5.2", "--seeds", "-1", "--out", str(tmp_path)]) == 2
    assert "seeds: got -1, expected 0 to 1000" in capsys.readouterr().err


@pytest.mark.slow
def test_figures_of_one_drive_share_it(tmp_path, capsys):
    names = ["figure-5.4", "figure-5.5", "figure-5.6"]
    assert main([*names, "--seeds", "1", "--out", str(tmp_path)]) == 0
    documents = [json.loads((tmp_path / f"{name}.json").read_text()) for name in names]
    assert [len(document["comparisons"]) for document in documents] == [4, 4, 2]
    assert all((tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG") for name in names)
    assert len(localization_study._kept) == 1
    assert "thesis's filter, two pickets" in capsys.readouterr().out


def test_help_names_every_figure(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert all(name in text for name in EXPERIMENTS)


def test_a_deviation_needs_something_to_deviate_from():
    assert Comparison("h_v", "d^3", 22.0, 20.0).deviation_percent == pytest.approx(10.0)
    assert Comparison("h_v", "d^3", 22.0).deviation_percent is None


def test_what_the_thesis_says_in_words_is_shown_and_does_not_deviate():
    class Words:
        title, notes = "t", ()
        comparisons = (Comparison("a: h_v", "d^3", 0.4, "below 0.5"), Comparison("b: h_v", "d^3", 12345.6))

    table = terminal_table(Words())
    assert [column.header for column in table.columns] == ["quantity", "ours", "thesis", "unit"]
    assert list(table.columns[1].cells) == ["", "0.4", "", "12346"]
    assert "below 0.5" in list(table.columns[2].cells)
    assert Words.comparisons[0].deviation_percent is None


@pytest.mark.slow
def test_all_figures_at_once(tmp_path):
    assert main(["--out", str(tmp_path)]) == 0
    assert sorted(path.stem for path in tmp_path.glob("*.png")) == sorted(EXPERIMENTS)
