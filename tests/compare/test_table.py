from loco_mjx.cli.main import main
from loco_mjx.compare import paper, render, tables
from loco_mjx.evaluation import multi_seed
from loco_mjx.run.results import find_runs, over_seeds
from tests.compare.runs import edit, write_evaluation, write_run
from tests.refusals import clear, says


def generalisation(folder, values, policy="loco-transformer", trained_on="thin", on="wide", **more):
    """One run per value of (distance, collisions)."""
    return [
        write_evaluation(
            write_run(folder, policy=policy, task=trained_on, seed=i), on, distance=d, collisions=c, **more
        )
        for i, (d, c) in enumerate(values)
    ]


def line_of(text, table, label):
    """A row of the Markdown, as a list of its cells."""
    section = text.split(f"## Table {table}.")[1].split("## ")[0]
    (line,) = [line for line in section.splitlines() if line.startswith(f"| {label} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def notes(text, kind=""):
    """The notes below the tables, of a kind: what is missing, left out, unfinished."""
    return [line for line in text.splitlines() if line.startswith(f"- {kind}")]


def test_mean_and_deviation_over_seeds_are_the_papers():
    """33.3 ± 47.1 in the paper's table of spheres is that of 0, 0, 100."""
    found = over_seeds([0.0, 0.0, 100.0])
    assert (round(found.mean, 1), round(found.std, 1)) == paper.SPHERE.rows[1].values[3] == (33.3, 47.1)
    assert found.values == (0.0, 0.0, 100.0)


def test_our_figures_stand_beside_the_papers(tmp_path):
    generalisation(tmp_path, [(10.0, 100.0), (14.0, 60.0), (12.0, 80.0)])
    text = render.markdown(tables.fill(tmp_path))
    # std of 10, 14, 12 is sqrt(8/3) = 1.63; of 100, 60, 80 it is 16.33.
    assert line_of(text, 1, "LocoTransformer") == [
        *("LocoTransformer", "12.0 ± 1.6", "14.2 ± 2.8", "80.0 ± 16.3", "82.2 ± 103.8", "16,384", "3", "8"),
    ]
    assert line_of(text, 1, "Depth-Only")[1:] == ["—", "0.1 ± 0.0", "—", "—", "—", "—", "—"]
    missing = notes(text, "missing")
    assert any(says(note, "HRL thin") for note in missing) and not any("LocoTransformer" in note for note in missing)
    assert "Ours" not in text and ": ours" not in text


def test_what_nothing_was_evaluated_of_is_named_and_takes_no_room(tmp_path):
    generalisation(tmp_path, [(10.0, 100.0)])
    text = render.markdown(tables.fill(tmp_path))
    assert [says(note, "Thin Obs. (trained on Wide Obs.)") for note in notes(text, "left")] == [True, True]
    (others,) = [line for line in text.splitlines() if "Environments with spheres" in line]
    assert says(others, "2 3 4 5") and text.count("### Table") == 1
    own = tmp_path / "own"
    write_evaluation(write_run(own), "thin", distance=3.0, collisions=1.0)
    assert "### Table" not in render.markdown(tables.fill(own))
    assert render.latex(tables.fill(own)).count(r"\begin{tabular}") == 2


NEW = {"speed": 0.5, "return": 90.0, "length": 900.0, "survived": 0.75, "collisions_per_metre": 2.0}
NEW |= {"distance_16s": 4.0, "collisions_16s": 7.0}


def rows_below(text, title):
    """The rows of the Markdown table below a heading, without its head, as lists of cells."""
    lines = text.split(f"{title}\n")[1].strip().splitlines()
    table = lines[: next((i for i, line in enumerate(lines) if not line.startswith("|")), len(lines))]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table[2:]]


def test_the_summary_comes_first_with_each_tasks_own_evaluation(tmp_path):
    for seed, distance in enumerate((10.0, 14.0)):
        run = write_run(tmp_path, seed=seed)
        write_evaluation(run, "thin", distance=distance, collisions=1.0)
        write_evaluation(run, "wide", distance=distance / 2, collisions=1.0)
    write_evaluation(write_run(tmp_path, policy="state-only", task="wide"), "wide", distance=2.0, collisions=1.0)
    write_evaluation(write_run(tmp_path, "deep", layers=3), "thin", distance=1.0, collisions=1.0)
    text = render.markdown(tables.fill(tmp_path))
    assert text.index("## Summary: distance (m)") < text.index("### thin\n") < text.index("### Table 1.")
    assert "| policy | thin | wide | thin → wide |" in text
    assert rows_below(text, "## Summary: distance (m)\n") == [
        ["state-only", "—", "2.00", "—"],
        ["loco-transformer", "12.00 ± 2.00", "—", "6.00 ± 1.00"],
        ["loco-transformer+layers=3", "1.00", "—", "—"],
    ]


def test_beside_distance_and_collisions_stand_speed_collisions_per_metre_and_the_first_16_seconds(tmp_path):
    for seed, more in enumerate((0.0, 2.0)):
        metrics = {name: value + more for name, value in NEW.items()}
        write_evaluation(write_run(tmp_path, seed=seed), "thin", distance=10.0, collisions=5.0 + more, **metrics)
    (row,) = rows_below(render.markdown(tables.fill(tmp_path)), "### thin\n")
    assert row[1:5] == ["10.00 ± 0.00", "6.0 ± 1.0", "3.00 ± 1.00", "1.50 ± 1.00"]
    assert row[8:] == ["5.00 ± 1.00", "8.0 ± 1.0", "16,384", "2", "8"]


def test_evaluations_of_before_have_dashes_there(tmp_path):
    write_evaluation(write_run(tmp_path, seed=0), "thin", distance=10.0, collisions=5.0, **NEW)
    write_evaluation(write_run(tmp_path, seed=1), "thin", distance=10.0, collisions=5.0, speed=0.5)
    (row,) = rows_below(render.markdown(tables.fill(tmp_path)), "### thin\n")
    assert row[1:10] == ["10.00 ± 0.00", "5.0 ± 0.0", "—", "0.50 ± 0.00", "—", "—", "—", "—", "—"]


def test_one_seed_has_no_deviation_and_rows_may_stand_on_different_things(tmp_path):
    generalisation(tmp_path, [(10.0, 100.0)])
    generalisation(tmp_path, [(-1.04, 1.0), (1.0, 3.0)], trained_on="wide", on="thin", episodes=32)
    text = render.markdown(tables.fill(tmp_path))
    row = line_of(text, 1, "LocoTransformer")
    assert (row[1], row[3], row[5], row[7]) == ("0.0 ± 1.0", "10.0", "2.0 ± 1.0", "100.0")  # not -0.0
    assert row[-3:] == ["16,384", "1–2", "8–32"]


def test_the_other_tables_take_their_metrics(tmp_path):
    for seed, (distance, reward) in enumerate([(1.0, 0.0), (3.0, 200.0)]):
        run = write_run(tmp_path, policy="hrl", task="wide-sphere", seed=seed)
        metrics = {"distance": distance, "collisions": 5.0, "reward/sphere": reward}
        write_evaluation(run, "wide-sphere", **metrics)
    write_evaluation(write_run(tmp_path, policy="hrl", task="mountain"), "mountain", distance=6.5)
    write_evaluation(write_run(tmp_path, policy="hrl", task="moving"), "moving", distance=2.0, collisions=9.0)
    text = render.markdown(tables.fill(tmp_path))
    assert line_of(text, 2, "HRL")[1:3] == ["2.0 ± 1.0", "11.3 ± 2.9"]
    assert line_of(text, 2, "HRL")[3:5] == ["100.0 ± 100.0", "288.9 ± 154.8"]
    assert line_of(text, 3, "HRL")[1:5] == ["2.0", "7.1 ± 2.6", "9.0", "75.8 ± 11.0"]
    assert line_of(text, 5, "HRL")[1:3] == ["6.5", "6.3 ± 0.3"]


def test_ablations_are_told_apart_by_their_configuration(tmp_path):
    whole = {"distance": 1.0, "collisions": 0.0, "reward/sphere": 0.0}
    variants = (({}, 3.0), ({"layers": 1}, 5.0), ({"tokens_per_side": 2}, 7.0), ({"layers": 0}, 9.0))
    for i, (network, value) in enumerate(variants):
        run = write_run(tmp_path, f"run{i}", task="thin-sphere", **network)
        write_evaluation(run, "thin-sphere", **whole, **{"return": value})
    text = render.markdown(tables.fill(tmp_path))
    ours = {
        label: line_of(text, 4, f"LocoTransformer ({label})")[1] for label in ("N=1", "N=2", "N=4, L=2", "L=1", "L=3")
    }
    assert ours == {"N=1": "—", "N=2": "7.0", "N=4, L=2": "3.0", "L=1": "5.0", "L=3": "—"}
    assert line_of(text, 2, "LocoTransformer")[1] == "1.0" and line_of(text, 2, "LocoTransformer")[-2] == "1"
    assert any(says(note, f"{tmp_path / 'run3'} loco-transformer+layers=0 thin-sphere") for note in notes(text))


def test_half_finished_runs_are_named_and_shorter_ones_left_out_of_the_mean(tmp_path):
    first = write_run(tmp_path, seed=0)
    write_evaluation(first, "wide", distance=10.0, collisions=0.0)
    second = write_run(tmp_path, seed=1)
    write_evaluation(second, "wide", samples=8192, distance=90.0, collisions=0.0)
    third = write_run(tmp_path, seed=2)
    text = render.markdown(tables.fill(tmp_path))
    assert line_of(text, 1, "LocoTransformer")[1] == "10.0" and line_of(text, 1, "LocoTransformer")[-2] == "1"
    assert any(says(note, "LocoTransformer thin seed 1 8,192 16,384") for note in notes(text, "left"))
    assert any(says(note, "LocoTransformer thin seed 2 wide") for note in notes(text, "missing"))
    shorter, none = notes(text, "unfinished")
    assert says(shorter, f"{second} 8,192 16,384") and says(none, f"{third}") and str(first) not in shorter + none


def test_a_teacher_is_part_of_its_pupils_run_and_a_run_of_that_name_is_one(tmp_path):
    run = write_run(tmp_path / "x")
    write_run(run, "teacher", policy="privileged")
    write_run(tmp_path / "begun", "teacher", policy="privileged")  # whose pupil has not begun
    own = write_run(tmp_path, "teacher", policy="state-only")
    assert {found.path for found in find_runs(tmp_path)} == {run, own}
    assert not multi_seed.holds_seeds(tmp_path / "begun") and multi_seed.holds_seeds(tmp_path)
    (run / "teacher" / "config.json").write_text("{")  # nobody reads it
    assert len(find_runs(tmp_path)) == 2


def test_the_newest_deterministic_evaluation_counts(tmp_path):
    run = write_run(tmp_path)
    write_evaluation(run, "wide", samples=8192, episodes=99, distance=1.0, collisions=0.0)
    write_evaluation(run, "wide", episodes=4, distance=2.0, collisions=0.0)
    write_evaluation(run, "wide", episodes=64, name="-b", distance=3.0, collisions=0.0)
    edit(write_evaluation(run, "wide", episodes=99, name="-stochastic", distance=4.0), deterministic=False)
    edit(write_evaluation(run, "wide", episodes=99, name="-randomized", distance=5.0), randomized=True)
    row = line_of(render.markdown(tables.fill(tmp_path)), 1, "LocoTransformer")
    assert row[1] == "3.0" and row[-1] == "64"


def test_latex_has_the_same_figures(tmp_path):
    generalisation(tmp_path, [(10.0, 100.0), (14.0, 60.0), (12.0, 80.0)])
    text = render.latex(tables.fill(tmp_path))
    (line,) = [line for line in text.splitlines() if line.startswith("LocoTransformer & 12")]
    assert r"12.0 $\pm$ 1.6 & 14.2 $\pm$ 2.8" in line and line.endswith(r"& 16,384 & 3 & 8 \\")
    assert text.count(r"\begin{tabular}") == text.count(r"\end{tabular}") == 3  # summary, thin → wide, table 1
    for table in text.split(r"\begin{table}")[1:]:
        columns = table.split(r"\begin{tabular}{")[1].split("}")[0]
        rows = [
            line.replace(r"\&", "") for line in table.splitlines() if line.endswith(r"\\") and "multicol" not in line
        ]
        assert {line.count("&") for line in rows} == {len(columns) - 1}
    assert not set("±↑↓→–—") & set(text.split(r"\begin{table}", 1)[1])


def refused(capsys, *args):
    assert main(["table", *map(str, args)]) == 2
    out, err = capsys.readouterr()
    assert out == "" and clear(err), err
    return err


def test_the_command_writes_both_files(tmp_path, capsys):
    generalisation(tmp_path / "runs", [(10.0, 100.0)])
    assert main(["table", str(tmp_path / "runs"), "--out", str(tmp_path / "new" / "tables")]) == 0
    written = (tmp_path / "new" / "tables" / "tables.md").read_text()
    assert written in capsys.readouterr().out
    assert (tmp_path / "new" / "tables" / "tables.tex").read_text().startswith("%")


def test_directories_with_nothing_to_compare(tmp_path, capsys):
    assert says(refused(capsys, tmp_path / "nowhere"), f"directory {tmp_path / 'nowhere'}")
    assert says(refused(capsys, tmp_path), f"runs {tmp_path}")
    write_run(tmp_path)
    assert says(refused(capsys, tmp_path), f"1 {tmp_path} evaluate")
    assert "directory" in refused(capsys).lower()
    assert not (tmp_path / "tables.md").exists()


def test_damaged_and_foreign_files_are_named(tmp_path, capsys):
    (file,) = generalisation(tmp_path, [(10.0, 100.0)])
    whole = file.read_text()
    file.write_text(whole[:50])
    assert says(refused(capsys, tmp_path), f"{file} JSON")
    file.write_text("[]")
    assert says(refused(capsys, tmp_path), f"{file} evaluation")
    file.write_text(whole.replace('"collisions"', '"bumps"'))
    assert says(refused(capsys, tmp_path), f"{file} 'collisions'")


def test_mixed_versions_are_refused_unless_accepted(tmp_path, capsys):
    generalisation(tmp_path, [(10.0, 100.0)])
    generalisation(tmp_path, [(10.0, 100.0)], policy="hrl", versions={"mujoco": "3.4.0"})
    said = refused(capsys, tmp_path)
    assert says(said, "versions mujoco 3.3.5 3.4.0 --mixed-versions")
    assert main(["table", str(tmp_path), "--mixed-versions"]) == 0
    assert "10.0" in capsys.readouterr().out


def test_runs_trained_in_two_ways_are_not_averaged(tmp_path, capsys):
    generalisation(tmp_path, [(10.0, 100.0)])
    other = write_run(tmp_path, "other", seed=1)
    write_evaluation(other, "wide", distance=1.0, collisions=0.0)
    text = (other / "config.json").read_text()
    (other / "config.json").write_text(text.replace('"clip": 0.2', '"clip": 0.3'))
    said = refused(capsys, tmp_path)
    assert says(said, f"ppo.clip 0.2 0.3 {other}")
    (other / "config.json").write_text(text.replace('"seed": 1', '"seed": 0'))
    assert says(refused(capsys, tmp_path), f"twice seed 0 {other}")
