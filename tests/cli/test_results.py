"""evaluate and bench: what they print, and what they refuse."""

import json
import re
import shutil

import pytest

from loco_mjx.bench import training
from loco_mjx.cli import bench as bench_cli
from loco_mjx.cli.main import main
from loco_mjx.env import LocoEnv
from loco_mjx.networks.registry import POLICIES
from loco_mjx.ppo.trainer import Trainer
from loco_mjx.run import checkpoint, directory, run_log
from tests.refusals import clear, says
from tests.run.tiny import TinyEnv, tiny_config, tiny_trainer


@pytest.fixture
def trained(tmp_path, monkeypatch):
    """A run of the tiny environment, evaluated in it."""
    config, trainer = tiny_config(), tiny_trainer(tiny_config())
    with directory.claim(tmp_path / "run"):
        directory.record_start(tmp_path / "run", config, {})
    state, _ = trainer.iterate(trainer.init(), trainer.make_pool(0))
    checkpoint.save(tmp_path / "run", 32, state, run_log.policy_of(state), config)
    import loco_mjx.evaluation.report
    import loco_mjx.run.policy

    monkeypatch.setattr(loco_mjx.evaluation.report, "LocoEnv", lambda config: TinyEnv())
    monkeypatch.setattr(loco_mjx.run.policy, "observation_shapes", lambda config: TinyEnv().observation_size)
    monkeypatch.setattr(type(config.env.action), "size", 1)
    return tmp_path / "run"


def only_object(text):
    assert len(text.splitlines()) == 1
    return json.loads(text)


def test_evaluate_prints_one_json_object_and_keeps_it(trained, capsys):
    assert main(["evaluate", str(trained), "--episodes", "3", "--json"]) == 0
    result = only_object(capsys.readouterr().out)
    assert (result["policy"], result["task"], result["samples"]) == ("state-only", "thin", 32)
    assert result["metrics"]["length"] == {"mean": 10.0, "std": 0.0}
    assert len(result["episodes"]["distance"]) == 3
    (kept,) = (trained / "evaluation").iterdir()
    assert json.loads(kept.read_text()) == result
    assert kept.name == "thin-32-seed0.json"


def test_step_picks_the_checkpoint(trained, capsys, tmp_path):
    (newest,) = (trained / "checkpoints").iterdir()
    shutil.copytree(newest, newest.with_name("000000000064"))  # no checkpoint of its own: what is newest
    assert main(["evaluate", str(trained), "--episodes", "1", "--step", "32", "--json"]) == 0
    assert only_object(capsys.readouterr().out)["samples"] == 32
    for verb in ("evaluate", "export", "play"):
        for step, said in (("48", "48 32 64"), ("best", f"{trained} evaluated --step"), ("64", "32 000000000064")):
            more = ["--video", str(tmp_path / "film.mp4")] if verb == "play" else []
            assert main([verb, str(trained), "--step", step, *more]) == 2
            err = capsys.readouterr().err
            assert says(err, said) and len(err.splitlines()) == 1, err


def test_evaluate_over_seeds_gives_mean_and_deviation_of_the_seeds_means(trained, capsys, tmp_path):
    folder = tmp_path / "method"
    shutil.copytree(trained, folder / "seed3")
    shutil.copytree(trained, folder / "seed4")
    for path in (folder / "seed4").rglob("*.json"):
        text = path.read_text().replace('"seed": 3', '"seed": 4')
        path.write_text(re.sub(r',\s*"checksum": \d+', "", text))  # as manifests of before there was one
    assert main(["evaluate", str(folder), "--episodes", "3", "--json"]) == 0
    result = only_object(capsys.readouterr().out)
    assert result["seeds_trained"] == [3, 4] and result["num_episodes"] == 3
    own = [json.loads((folder / f"seed{i}/evaluation/thin-32-seed0.json").read_text()) for i in (3, 4)]
    means = [one["metrics"]["distance"]["mean"] for one in own]
    assert result["metrics"]["distance"] == {"mean": sum(means) / 2, "std": 0.0, "seeds": means}
    assert json.loads((folder / "evaluation" / "thin-32-seed0.json").read_text()) == result
    assert main(["evaluate", str(folder), "--episodes", "3"]) == 0
    assert says(capsys.readouterr().out, "2 seeds")
    # Each one's best may stand at another number of samples; what is newest has to be at the same.
    longer = folder / "seed4" / "checkpoints"
    for manifest in folder.rglob("manifest.json"):
        step = 64 if longer in manifest.parents else 32
        text = manifest.read_text().replace('"step": 32', f'"step": {step}').replace('"score": null', '"score": 1.0')
        manifest.write_text(re.sub(r',\s*"checksum": \d+', "", text))
    (longer / "000000000032").rename(longer / "000000000064")
    assert main(["evaluate", str(folder), "--episodes", "3", "--step", "best", "--json"]) == 0
    assert only_object(capsys.readouterr().out)["samples_of_seeds"] == [32, 64]
    assert main(["evaluate", str(folder), "--episodes", "3"]) == 2
    assert says(capsys.readouterr().err, "32 64 finish")
    config = folder / "seed4" / "config.json"
    config.write_text(config.read_text().replace('"clip": 0.2', '"clip": 0.3'))
    assert main(["evaluate", str(folder)]) == 2
    assert says(capsys.readouterr().err, "ppo.clip 0.2 0.3")


def test_evaluate_prints_a_table(trained, capsys):
    assert main(["evaluate", str(trained), "--episodes", "2", "--stochastic"]) == 0
    page = capsys.readouterr().out
    assert says(page, "distance 2 stochastic")


def test_evaluate_refuses_what_is_no_run(tmp_path, capsys, trained):
    (trained / "checkpoints" / "000000000032" / "manifest.json").unlink()
    cases = {
        "nowhere": (["evaluate", str(tmp_path / "nowhere")], f"run {tmp_path}/nowhere"),
        "unknown": (["evaluate", str(trained), "--task", "wid"], "wid wide"),
        "damaged": (["evaluate", str(trained)], "manifest.json checkpoints"),
        "missing": (["evaluate"], "directory"),
    }
    for args, words in cases.values():
        assert main(args) == 2
        out, err = capsys.readouterr()
        assert out == "" and clear(err) and says(err.lower(), words), err


def test_bench_prints_one_json_object_whatever_else_is_printed(capsys, monkeypatch):
    def noisy(options):
        print("a library's chatter")
        return {"bench": options.part, "task": "thin", "per_second": 12.0, "num_envs": 4}

    monkeypatch.setattr(bench_cli, "measure", noisy)
    assert main(["bench", "depth", "--json", "--num-envs", "4"]) == 0
    result = only_object(capsys.readouterr().out)
    assert result["per_second"] == 12.0
    assert result["devices"] >= 1 and "jax" in result["versions"]


def test_bench_refuses_what_it_does_not_know(capsys):
    for args in (["bench", "nets"], ["bench", "env", "--task", "thinn"], ["bench", "env", "--num-envs", "0"]):
        assert main(args) == 2
        out, err = capsys.readouterr()
        assert out == "" and clear(err), err


def test_bench_of_environment_and_training(monkeypatch):
    monkeypatch.setattr(training, "LocoEnv", lambda config: TinyEnv())
    config = tiny_config()
    stepping = training.bench_env(config, seconds=0.0)
    learning = training.bench_train(config, seconds=0.0)
    assert stepping["per_second"] > 0 and stepping["compile_seconds"] > 0
    assert learning["compilations"] == 1
    parts = learning["collect_seconds"] + learning["learn_seconds"]
    assert parts == pytest.approx(learning["iteration_seconds"])
    assert learning["per_second"] == pytest.approx(32 / learning["iteration_seconds"])
    assert 0 < learning["startup_seconds"] < 24 * 3600


@pytest.mark.parametrize("policy", POLICIES)
def test_bench_trains_every_policy_on_what_it_observes(policy):
    config = training.bench_config("thin", policy, None)
    Trainer(config, LocoEnv(config.env))  # refuses a policy without its observations
    assert config.env.observation.depth.enabled == POLICIES[policy].uses_depth


@pytest.mark.parametrize("content", ["{", "[]", "{}", '{"task": "thin", "metrics": [1]}', '"thin"'])
def test_export_of_a_run_whose_newest_evaluation_is_damaged_is_one_line(content, trained, tmp_path, capsys):
    (trained / "evaluation").mkdir()
    (trained / "evaluation" / "thin-32-seed0.json").write_text(content)
    assert main(["export", str(trained), "--out", str(tmp_path / "policy")]) == 2
    err = capsys.readouterr().err
    assert "thin-32-seed0.json" in err and len(err.splitlines()) == 1
    assert not (tmp_path / "policy").exists()


@pytest.mark.parametrize("config", [None, [], "thin"])
def test_a_checkpoint_whose_manifest_has_no_configuration_is_one_line(config, trained, capsys):
    (path,) = trained.rglob("manifest.json")
    manifest = {key: value for key, value in json.loads(path.read_text()).items() if key != "config"}
    path.write_text(json.dumps(manifest if config is None else manifest | {"config": config}))
    assert main(["evaluate", str(trained), "--episodes", "3"]) == 2
    err = capsys.readouterr().err
    assert says(err, f"{trained}/checkpoints") and len(err.splitlines()) == 1
