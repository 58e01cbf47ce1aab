import dataclasses
import json

import pytest

from loco_mjx.config import Config, DistillConfig, PPOConfig, to_dict
from loco_mjx.run import directory, provenance
from tests.refusals import refusal
from tests.run.tiny import tiny_config


def start(path, config, **facts):
    with directory.claim(path):
        directory.record_start(path, config, facts)


def test_a_new_run_records_its_whole_configuration(tmp_path):
    config, path = tiny_config(), tmp_path / "a" / "b"
    assert directory.find(path) is None
    start(path, config, commit="abc")
    assert directory.find(path) == config
    assert json.loads((path / "config.json").read_text()) == json.loads(json.dumps(to_dict(config)))
    assert json.loads((path / "info.json").read_text()) == {"commit": "abc", "resumed": []}


def test_resumptions_are_noted_beside_the_first_start(tmp_path):
    for commit in "abc":
        start(tmp_path, tiny_config(), commit=commit)
    info = json.loads((tmp_path / "info.json").read_text())
    assert info == {"commit": "a", "resumed": [{"commit": "b"}, {"commit": "c"}]}


def test_a_directory_with_anything_else_in_it_is_refused(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with refusal(f"{tmp_path} thesis.tex run"):
        directory.find(tmp_path)


def test_what_a_kill_before_the_configuration_leaves_is_not_foreign(tmp_path):
    with directory.claim(tmp_path):
        (tmp_path / "info.json").write_text("{}")
        (tmp_path / "config.json.partial").write_text("{")
    assert directory.find(tmp_path) is None


def test_a_file_is_no_directory(tmp_path):
    (tmp_path / "file").write_text("")
    with refusal(f"{tmp_path}/file file directory"):
        directory.find(tmp_path / "file")


def test_the_first_difference_is_named_with_both_values(tmp_path):
    config = tiny_config()
    reward = dataclasses.replace(config.env.reward, alive=0.25)
    other = dataclasses.replace(config, env=dataclasses.replace(config.env, reward=reward))
    with refusal("env.reward.alive 0.1 0.25 --out"):
        directory.reconcile(tmp_path, config, other)


@pytest.mark.parametrize(
    ("changing", "said"), [({"learning_rate_decay": True}, "decays"), ({"final_std": 0.3}, "narrows")]
)
def test_a_run_may_be_extended_unless_something_changes_over_its_length(tmp_path, changing, said):
    directory.reconcile(tmp_path, tiny_config(6), tiny_config(7))
    with refusal(f"ppo.total_steps 192 224 {said}"):
        directory.reconcile(tmp_path, tiny_config(6, **changing), tiny_config(7, **changing))


def test_where_a_policy_stops_imitating_is_a_share_of_its_length(tmp_path):
    """Longer, a run whose imitation is over would imitate again."""
    before, after = (Config(method="distill", ppo=PPOConfig(total_steps=total)) for total in (81_920, 163_840))
    directory.reconcile(tmp_path, before, after)
    half = DistillConfig(imitation=0.5)
    with refusal("ppo.total_steps 81920 163840 imitation ends"):
        directory.reconcile(tmp_path, *(dataclasses.replace(one, distill=half) for one in (before, after)))


@pytest.mark.parametrize("content", ["", '{"policy": "state-', "[]", '{"policy": "state-only", "x": 1}', '{"env": 3}'])
def test_a_damaged_configuration_is_one_clear_line(tmp_path, content):
    (tmp_path / "config.json").write_text(content)
    with refusal(f"{tmp_path}/config.json") as error:
        directory.find(tmp_path)
    assert "\n" not in str(error.value)


def test_one_process_at_a_time(tmp_path):
    with directory.claim(tmp_path), refusal(f"another process {tmp_path}"), directory.claim(tmp_path):
        pass
    with directory.claim(tmp_path):  # and it is let go of
        pass


@pytest.mark.parametrize("place", ["/proc/run", "/dev/null/run"])
def test_without_write_access_the_path_is_named(place):
    with refusal(place), directory.claim(directory.Path(place)):
        pass


@pytest.mark.parametrize("name", ["lock", "config.json.partial"])
def test_what_lies_behind_a_link_is_not_touched(tmp_path, name):
    (tmp_path / "precious").write_text("data")
    (tmp_path / name).symlink_to("precious")
    if name == "lock":
        with refusal(f"{tmp_path}/lock link"), directory.claim(tmp_path):
            pass
    else:
        directory.write_json(tmp_path / "config.json", {"new": 1})
        assert json.loads((tmp_path / "config.json").read_text()) == {"new": 1}
    assert (tmp_path / "precious").read_text() == "data"


def test_json_is_replaced_in_one_go(tmp_path, monkeypatch):
    path = tmp_path / "x.json"
    directory.write_json(path, {"old": 1})
    with pytest.raises(TypeError):
        directory.write_json(path, {"new": object()})
    assert json.loads(path.read_text()) == {"old": 1}


def test_json_that_is_nested_too_deeply_is_refused(tmp_path):
    (tmp_path / "config.json").write_text("[" * 100_000)
    with refusal(f"{tmp_path}/config.json JSON"):
        directory.find(tmp_path)


def test_about_names_versions_devices_and_commit():
    found = provenance.describe(["loco-mjx", "train"])
    assert set(found["versions"]) >= {"python", "jax", "mujoco", "mujoco-mjx", "flax", "optax", "loco-mjx"}
    assert "not installed" not in found["versions"].values()
    assert found["devices"]["count"] >= 1
    assert set(found["git"]) == {"commit", "dirty"}
    assert found["command"] == ["loco-mjx", "train"]
