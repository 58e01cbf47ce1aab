import dataclasses
import errno
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import preset
from loco_mjx.errors import RunError, unwritable
from loco_mjx.run import checkpoint
from tests.refusals import refusal, says

CONFIG = preset("fast")


def tree(value):
    return {"a": jp.full((3, 4), value, jp.float32), "empty": jp.zeros((0, 3)), "nested/x": {"n": jp.int32(value)}}


def save(directory, *steps):
    for step in steps:
        checkpoint.save(directory, step, tree(step), {"params": tree(step)}, CONFIG)


def restore(directory, config=CONFIG):
    said = []
    found = checkpoint.restore(directory, tree(0), config, said.append)
    return found, said


def largest_file(folder: Path) -> Path:
    return max((path for path in folder.rglob("*") if path.is_file()), key=lambda path: path.stat().st_size)


def test_what_is_saved_comes_back_with_types_and_shapes(tmp_path):
    save(tmp_path, 7)
    (state, step), said = restore(tmp_path)
    assert step == 7 and said == []
    np.testing.assert_array_equal(state["a"], np.full((3, 4), 7, np.float32))
    assert state["empty"].shape == (0, 3)
    assert state["nested/x"]["n"].dtype == jp.int32 and int(state["nested/x"]["n"]) == 7


def test_nothing_saved_is_nothing_restored(tmp_path):
    assert restore(tmp_path) == (None, [])


def test_the_last_two_are_kept(tmp_path):
    save(tmp_path, 1, 2, 3)
    assert checkpoint.steps(tmp_path) == [3, 2]
    assert sorted(entry.name for entry in (tmp_path / "checkpoints").iterdir()) == ["000000000002", "000000000003"]


def test_the_best_by_evaluation_is_kept_too_and_one_every_so_often(tmp_path):
    size = CONFIG.ppo.samples_per_iteration
    scores, every = {1: 1.0, 2: 5.0, 5: 2.0, 8: 4.0}, 3 * size + 5  # passed in iterations 4 and 7
    for i in range(1, 9):
        policy = {"params": jp.float32(i)}
        checkpoint.save(tmp_path, i * size, policy, policy, CONFIG, score=scores.get(i), keep_every=every)
    assert [step // size for step in checkpoint.steps(tmp_path)] == [8, 7, 4, 2]
    assert checkpoint.choose(tmp_path, "best") == 2 * size and checkpoint.choose(tmp_path, 4 * size) == 4 * size
    with refusal(f"{tmp_path} {size} {2 * size} {4 * size}"):
        checkpoint.choose(tmp_path, size)
    found = checkpoint.restore(tmp_path, policy, CONFIG, print, checkpoint.POLICY, 4 * size)
    assert found is not None and float(found[0]["params"]) == 4.0
    # The next one's evaluation is better: the best until then is no longer.
    checkpoint.save(tmp_path, 9 * size, policy, policy, CONFIG, score=6.0, keep_every=every)
    assert [step // size for step in checkpoint.steps(tmp_path)] == [9, 8, 7, 4]


def test_without_an_evaluation_there_is_no_best(tmp_path):
    save(tmp_path, 1)
    with refusal(f"{tmp_path} evaluated --step"):
        checkpoint.choose(tmp_path, "best")


@pytest.mark.parametrize("harm", ["truncate", "delete", "flip", "manifest"])
def test_a_damaged_checkpoint_is_named_and_the_one_before_it_used(tmp_path, harm):
    save(tmp_path, 1, 2)
    newest = checkpoint.path_of(tmp_path, 2)
    victim = newest / "manifest.json" if harm == "manifest" else largest_file(newest / "state")
    content = victim.read_bytes()
    if harm == "delete":
        victim.unlink()
    elif harm == "flip":
        victim.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    else:
        victim.write_bytes(content[: len(content) // 2])
    (state, step), said = restore(tmp_path)
    assert step == 1 and float(state["a"][0, 0]) == 1.0
    assert len(said) == 1 and says(said[0], f"{victim.name} {newest.name} 1")  # and from where it goes on


def test_a_checkpoint_under_another_steps_name_is_not_resumed_from(tmp_path):
    save(tmp_path, 1, 2)
    checkpoint.path_of(tmp_path, 2).rename(checkpoint.path_of(tmp_path, 3))
    (_, step), said = restore(tmp_path)
    assert step == 1 and says(said[0], "000000000003 2")
    assert checkpoint.newest(tmp_path) == 1


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"step": 2', '"step": "2"'),
        ('"step": 2', '"step": 3'),
        ('"clip": 0.2', '"clip": 0.3'),
        ('"files": {', '"file": {'),
    ],
)
def test_a_manifest_that_was_edited_is_not_believed(tmp_path, old, new):
    save(tmp_path, 1, 2)
    manifest = checkpoint.path_of(tmp_path, 2) / "manifest.json"
    assert old in manifest.read_text()
    manifest.write_text(manifest.read_text().replace(old, new))
    (_, step), said = restore(tmp_path)
    assert step == 1 and "manifest.json" in said[0]


def test_a_checkpoint_of_before_manifests_had_a_checksum_is_restored(tmp_path):
    save(tmp_path, 1)
    manifest = checkpoint.path_of(tmp_path, 1) / "manifest.json"
    content = json.loads(manifest.read_text())
    del content["checksum"]
    manifest.write_text(json.dumps(content))
    assert restore(tmp_path)[0][1] == 1


def test_names_that_are_no_steps_are_no_checkpoints(tmp_path):
    save(tmp_path, 1)
    for name in ("2", "00000000000²", "000000000002.bak", "0000000000003"):
        (tmp_path / "checkpoints" / name).mkdir()
    assert checkpoint.steps(tmp_path) == [1]


@pytest.mark.parametrize("harm", ["loop", "file"])
def test_checkpoints_that_cannot_be_read_are_not_none(tmp_path, harm):
    place = tmp_path / "checkpoints"
    place.symlink_to(place) if harm == "loop" else place.write_text("")
    with refusal(f"{place}"):
        checkpoint.steps(tmp_path)


def test_what_lies_behind_a_link_is_not_touched(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "precious").write_text("data")
    (tmp_path / "checkpoints").mkdir()
    for name in (".partial-000000000001", "000000000001", ".old-000000000000"):
        (tmp_path / "checkpoints" / name).symlink_to(tmp_path / "elsewhere")
    save(tmp_path, 1)
    assert restore(tmp_path)[0][1] == 1
    assert (tmp_path / "elsewhere" / "precious").read_text() == "data"
    assert [entry.name for entry in (tmp_path / "checkpoints").iterdir()] == ["000000000001"]


def test_curves_come_back_unless_they_are_damaged(tmp_path):
    checkpoint.save(tmp_path, 1, tree(1), tree(1), CONFIG, "step\r\n1\r\n")
    assert checkpoint.curves(tmp_path, 1) == "step\r\n1\r\n"
    (checkpoint.path_of(tmp_path, 1) / "curves.csv").write_text("step\r\n2\r\n")
    assert checkpoint.curves(tmp_path, 1) is None and checkpoint.curves(tmp_path, 2) is None
    assert checkpoint.newest(tmp_path) == 1  # a run goes on without them


def test_one_clear_line_where_no_whole_checkpoint_is_left(tmp_path):
    save(tmp_path, 1)
    lost = largest_file(checkpoint.path_of(tmp_path, 1) / "state")
    lost.unlink()
    with refusal(f"{lost.name} delete {tmp_path}/checkpoints"):
        restore(tmp_path)


def test_damage_to_the_state_does_not_keep_the_policy_from_being_read(tmp_path):
    save(tmp_path, 1)
    largest_file(checkpoint.path_of(tmp_path, 1) / "state").unlink()
    policy, step = checkpoint.restore(tmp_path, {"params": tree(0)}, CONFIG, print, checkpoint.POLICY)
    assert step == 1 and float(policy["params"]["a"][0, 0]) == 1.0


def test_a_checkpoint_of_another_configuration_is_refused(tmp_path):
    save(tmp_path, 1)
    other = dataclasses.replace(CONFIG, network=dataclasses.replace(CONFIG.network, layers=1))
    with refusal("000000000001 network.layers 2 1"):
        restore(tmp_path, other)


def test_more_samples_are_the_same_configuration(tmp_path):
    save(tmp_path, 1)
    longer = dataclasses.replace(CONFIG, ppo=dataclasses.replace(CONFIG.ppo, total_steps=99))
    assert restore(tmp_path, longer)[0][1] == 1


def test_arrays_of_another_shape_are_another_version(tmp_path):
    save(tmp_path, 1)
    with refusal("000000000001 version"):
        checkpoint.restore(tmp_path, tree(0) | {"a": jp.zeros((5, 5))}, CONFIG, print)


class Killed(BaseException):
    pass


@pytest.mark.parametrize("moment", ["write_trees", "write_json", "sync", "kept"])
def test_a_kill_at_any_stage_of_a_save_leaves_a_good_one(tmp_path, monkeypatch, moment):
    save(tmp_path, 1, 2)

    def die(*_):
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, moment, die)
        with pytest.raises(Killed):
            save(tmp_path, 3)
    (state, step), said = restore(tmp_path)
    assert step == (2 if moment in ("write_trees", "write_json") else 3) and said == []
    assert float(state["a"][0, 0]) == step
    save(tmp_path, 4)  # and what was left behind is in nobody's way
    assert checkpoint.steps(tmp_path)[0] == 4
    assert len(list((tmp_path / "checkpoints").iterdir())) == 2


def test_what_is_said_of_a_full_disk_is_said_once(tmp_path, monkeypatch):
    """Wherever in a save it fills up: as the run's failure, which a mistake in the command is not."""
    save(tmp_path, 1)

    def full(*_):
        raise unwritable("the manifest", OSError(errno.ENOSPC, "No space left on device"), "make room")

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "write_json", full)
        with pytest.raises(RunError) as caught:
            save(tmp_path, 2)
    assert str(caught.value).count("cannot write") == 1
    assert [path.name for path in (tmp_path / "checkpoints").iterdir()] == ["000000000001"]


CHILD = """
import sys
from pathlib import Path
import jax.numpy as jp
from loco_mjx.run import checkpoint
from loco_mjx.config import preset

directory, config = Path(sys.argv[1]), preset("fast")
def tree(step):
    return {"a": jp.full((512, 512), step, jp.float32), "b": [jp.full((64, i), step) for i in range(1, 20)]}
found = checkpoint.restore(directory, tree(0), config, print)
step = found[1] if found else 0
while True:
    step += 1
    checkpoint.save(directory, step, tree(step), {"a": jp.full(4, step)}, config)
    print(step, flush=True)
"""


def test_kill_9_while_saving_leaves_a_loadable_run(tmp_path):
    root, last = Path(__file__).parents[2], 0
    rng = np.random.default_rng(0)
    template = {"a": jp.zeros((512, 512)), "b": [jp.zeros((64, i)) for i in range(1, 20)]}
    for _ in range(4):
        child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path)], cwd=root, stdout=subprocess.PIPE)
        assert child.stdout.readline().strip().isdigit()  # it saves without a pause from now on
        time.sleep(rng.uniform(0.0, 0.3))
        os.kill(child.pid, signal.SIGKILL)
        child.communicate()
        state, step = checkpoint.restore(tmp_path, template, CONFIG, print)
        assert step > last
        assert all(np.all(np.asarray(leaf) == step) for leaf in [state["a"], *state["b"]])
        last = step
