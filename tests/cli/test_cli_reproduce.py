import json

import pytest

from jaxest import reproduce


def test_small_figures_as_tables_pictures_and_json(invoke, tmp_path):
    words = ("reproduce", "sato2023", "--part", "fig2", "--part", "fig3", "--small")
    result = invoke(*words, "--json", "-o", "pictures")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["name"] == "sato2023"
    rows = {(row["metric"], row["condition"]): row for row in found["rows"]}
    circular = rows["fig3: circular mean", "kappa 10"]
    assert circular["reference"] == 135.0
    assert abs(circular["value"] - 135) < 5 * circular["spread"]
    assert rows["fig3: naive mean", "kappa 1"]["value"] < 100  # the mistake that the figure warns of
    for name in ("fig2", "fig3"):
        assert (tmp_path / "pictures" / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
    assert "--force" in invoke(*words, "-o", "pictures").stderr
    table = invoke(*words)
    assert "Fig. 3: naive against circular mean" in table.stdout


@pytest.mark.parametrize("draw", [None, lambda path: path.write_bytes(b"")])
def test_pictures_are_spoken_of_where_there_are_any(invoke, monkeypatch, tmp_path, draw):
    monkeypatch.setattr(reproduce, "sections", lambda *_, **__: [reproduce.Section("fig2", "title", [], draw)])
    result = invoke("reproduce", "sato2023", "--part", "fig2", "-o", "pictures")
    assert result.exit_code == 0, result.output
    assert "title" in result.stdout  # also where there are no figures under it
    assert ("no picture of fig2" in result.stderr) == (draw is None)
    assert ("pictures in pictures" in result.stderr) == (tmp_path / "pictures" / "fig2.png").exists() == bool(draw)


def test_what_needs_a_folder_is_left_out_of_all_and_said(invoke, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(reproduce, "sections", lambda paper, names, **_: asked.append(names) or [])
    assert "left out, without the folder that it needs: broad" in invoke("reproduce", "santaera2015").stderr
    assert "left out" not in invoke("reproduce", "santaera2015", "--broad", tmp_path).stderr
    assert [("broad" in names) for names in asked] == [False, True]


def test_parts_are_named(invoke):
    names = invoke("reproduce", "sato2023", "--list").stdout.split()
    assert names[:3] == ["fig1", "fig2", "fig3"]
    found = json.loads(invoke("reproduce", "sato2023", "--list", "--json").stdout)
    assert found["parts"] == names
    assert found["rows"] == []


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("sato2032",), "sato2023"),
        (("kalman1960",), "known: sato2023, sato2024"),
        (("sato2023", "--part", "fig22"), "fig2"),
        (("santaera2015", "--part", "broad"), "--part broad: got no folder, expected --broad FOLDER"),
        (("sato2023", "--runs", "3"), "--runs: sato2023 has no such choice; it takes --seed, --small"),
    ],
)
def test_unknown_papers_and_parts_are_refused(refused, words, part):
    assert part in refused("reproduce", *words)


def test_no_run_of_one_seed_is_one_of_another():
    runs = [reproduce.seed_of(reproduce.Choice(seed), run) for seed in range(4) for run in (0, 1, 100, 50_090)]
    assert len(set(runs)) == len(runs)
    assert reproduce.seed_of(reproduce.Choice()) == 0
