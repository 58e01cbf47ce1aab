import numpy as np
import pytest

from loco_mjx.cli.main import main
from loco_mjx.compare import curves
from loco_mjx.run.directory import write_json
from loco_mjx.run.results import find_runs
from tests.compare.runs import VERSIONS, write_curve, write_run
from tests.refusals import says

COLUMNS = ["step", "episode/return", "eval/distance"]


def test_mean_and_deviation_over_seeds_by_hand(tmp_path):
    write_curve(write_run(tmp_path, seed=0), COLUMNS, [[10, 1.0, ""], [20, 2.0, 5.0], [30, 6.0, ""]])
    write_curve(write_run(tmp_path, seed=1), COLUMNS, [[10, 3.0, ""], [20, 8.0, 7.0], [30, 6.0, ""]])
    first, second = find_runs(tmp_path)
    found = curves.over_seeds([curves.read_curve(run, "episode/return") for run in (first, second)])
    assert found.steps.tolist() == [10, 20, 30] and found.seeds == 2
    assert found.mean.tolist() == [2.0, 5.0, 6.0] and found.std.tolist() == [1.0, 3.0, 0.0]
    sparse = curves.over_seeds([curves.read_curve(run, "eval/distance") for run in (first, second)])
    assert (sparse.steps.tolist(), sparse.mean.tolist(), sparse.std.tolist()) == ([20], [6.0], [1.0])
    assert curves.over_seeds([curves.read_curve(first, "nothing")]) is None


def test_only_the_common_stretch_counts_and_gaps_are_interpolated():
    whole = (np.array([0, 10, 20, 30, 40]), np.array([0.0, 1.0, 2.0, 3.0, 4.0]))
    part = (np.array([10, 30]), np.array([10.0, 30.0]))
    other = (np.array([0, 20]), np.array([0.0, 20.0]))
    found = curves.over_seeds([whole, part])
    assert (found.steps.tolist(), found.mean.tolist()) == ([10, 30], [5.5, 16.5])
    # In 10..20 `part` has one point, 10, where `other` lies halfway.
    found = curves.over_seeds([part, other])
    assert (found.steps.tolist(), found.mean.tolist(), found.std.tolist()) == ([10], [10.0], [0.0])
    assert curves.over_seeds([(np.array([0, 5]), np.zeros(2)), part]) is None


def test_a_figure_per_task_with_a_line_per_policy(tmp_path, capsys):
    for policy in ("hrl", "loco-transformer"):
        for seed in (0, 1):
            path = write_run(tmp_path, policy=policy, seed=seed)
            write_curve(path, COLUMNS, [[100, seed, 1.0], [200, 2.0, 3.0]])
    write_run(tmp_path, task="wide")
    assert main(["curves", str(tmp_path)]) == 0
    assert says(capsys.readouterr().out, "loco-transformer wide curve")
    png, svg = tmp_path / "curves" / "thin.png", tmp_path / "curves" / "thin.svg"
    assert sorted((tmp_path / "curves").iterdir()) == [png, svg]
    assert png.read_bytes().startswith(b"\x89PNG") and "<svg" in svg.read_text()


def test_other_tasks_that_were_evaluated_on_have_panels_of_their_own(tmp_path):
    columns = [*COLUMNS, "eval/wide/distance", "eval/wide/collisions", "eval/reward/alive"]
    write_curve(write_run(tmp_path, seed=0), columns, [[100, 1.0, 1.0, 0.5, 3.0, 1.0], [200, 2.0, "", "", "", ""]])
    write_curve(write_run(tmp_path, seed=1), COLUMNS, [[100, 1.0, 1.0]])
    shown = curves.panels(find_runs(tmp_path))
    assert shown[:4] == list(curves.PANELS)
    assert [metric for _, _, metric in shown[4:]] == ["eval/wide/distance", "eval/wide/collisions"]
    files, notes = curves.draw(tmp_path, tmp_path / "curves")
    assert not notes
    drawn = files[1].read_text()
    titles = [text for text in drawn.splitlines() if "<!--" in text]  # matplotlib notes what a glyph's path writes
    assert any(says(text, "wide distance") for text in titles) and any(says(text, "wide collisions") for text in titles)


def test_a_line_shows_its_mean_and_the_deviation_around_it():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots()
    two = curves.Curve(np.array([1e6, 2e6]), np.array([1.0, 5.0]), np.array([0.5, 1.0]), 2)
    curves.draw_line(axis, two, "hrl", "C0")
    (line,) = axis.lines
    assert line.get_xdata().tolist() == [1e6, 2e6] and line.get_ydata().tolist() == [1.0, 5.0]
    assert says(line.get_label(), "hrl 2")
    corners = axis.collections[0].get_paths()[0].vertices
    assert (corners[:, 1].min(), corners[:, 1].max()) == (0.5, 6.0)
    plt.close(figure)


def test_nothing_to_draw_is_one_line(tmp_path, capsys):
    cases = [(tmp_path / "nowhere", "directory"), (tmp_path, "runs")]
    for path, words in cases:
        assert main(["curves", str(path)]) == 2
        err = capsys.readouterr().err
        assert len(err.splitlines()) == 1 and says(err, f"{path} {words}")
    write_curve(write_run(tmp_path), COLUMNS, [])
    assert main(["curves", str(tmp_path)]) == 2
    assert says(capsys.readouterr().err, f"{tmp_path} curve")
    write_curve(tmp_path / "thin/loco-transformer/seed0", COLUMNS, [[1, "x", ""]])
    assert main(["curves", str(tmp_path)]) == 2
    assert "metrics.csv" in capsys.readouterr().err
    assert not (tmp_path / "curves").exists()


@pytest.mark.parametrize("seed", [0, 1])
def test_runs_trained_in_two_ways_are_not_one_curve(tmp_path, capsys, seed):
    write_curve(write_run(tmp_path), COLUMNS, [[1, 1.0, ""]])
    other = write_run(tmp_path, "other", seed=seed, mlp_dim=128)
    write_curve(other, COLUMNS, [[1, 1.0, ""]])
    assert main(["curves", str(tmp_path)]) == 2
    assert "network.mlp_dim" in capsys.readouterr().err


def test_runs_of_mixed_versions_are_refused_unless_accepted(tmp_path, capsys):
    for seed in (0, 1):
        path = write_run(tmp_path, seed=seed)
        write_curve(path, COLUMNS, [[1, 1.0, ""]])
        write_json(path / "info.json", {"versions": VERSIONS, "resumed": []})
    assert main(["curves", str(tmp_path)]) == 0
    write_json(path / "info.json", {"versions": VERSIONS, "resumed": [{"versions": VERSIONS | {"jax": "0.8.0"}}]})
    capsys.readouterr()
    assert main(["curves", str(tmp_path)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1 and says(err, "versions jax 0.7.2 0.8.0 --mixed-versions")
    assert main(["curves", str(tmp_path), "--mixed-versions"]) == 0
    (path / "info.json").write_text("[]")
    assert main(["curves", str(tmp_path)]) == 2 and says(capsys.readouterr().err, f"{path}/info.json")
