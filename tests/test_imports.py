"""Names from the user's own modules: `--import`, the registries, and what says which module is missing."""

import sys
import textwrap

import pytest

import loco_mjx
from loco_mjx import imports
from loco_mjx.cli import words
from loco_mjx.cli.main import main
from loco_mjx.compare.cells import Plan
from loco_mjx.config import Config, EnvConfig, RewardConfig, to_dict
from loco_mjx.config.reward_terms import REWARDS
from loco_mjx.networks.registry import POLICIES
from loco_mjx.run import checkpoint, directory, needs
from loco_mjx.run.policy import load_policy
from loco_mjx.run.variant import Variant, default_keys, parse_variant
from loco_mjx.scene.tasks import TASKS, get_task
from tests.refusals import refusal, says

MODULE = """
    import flax.linen as nn
    import loco_mjx
    from loco_mjx.networks import heads
    from loco_mjx.scene import layouts

    @loco_mjx.register_task("plaza", summary="as thin")
    def plaza(key):
        return layouts.thin(key)

    loco_mjx.register_reward("upright", lambda step: step.up, weight=0.25)

    @loco_mjx.register_policy("small", uses_depth=False)
    class Small(nn.Module):
        config: object
        actions: int

        @nn.compact
        def __call__(self, obs):
            features = nn.tanh(nn.Dense(8)(obs["state"]))
            return heads(self, (8,), features, lambda: features, obs)
"""
OWN = (TASKS, "plaza"), (POLICIES, "small"), (REWARDS, "upright")


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A .py file in the working directory; what it registers is taken out again, and forgotten."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    path = tmp_path / "own_things.py"
    path.write_text(textwrap.dedent(MODULE))
    default_keys.cache_clear()
    yield path
    forget()
    default_keys.cache_clear()


def forget():
    sys.modules.pop("own_things", None)
    for registry, name in OWN:
        if name in registry:
            registry.unregister(name)


@pytest.mark.parametrize("word", ["own_things", "own_things.py", "./own_things.py"])
def test_a_module_by_name_or_path_brings_its_names_once(word, module):
    imports.load([word, word])
    assert all(name in registry and registry.origin(name) == word for registry, name in OWN)
    assert get_task("plaza").summary == "as thin" and not POLICIES["small"].uses_depth
    config = Config(policy="small", env=EnvConfig(task="plaza"))
    assert config.env.reward.terms == {"upright": 0.25}
    assert needs.with_imports(config).imports == (word,)
    assert needs.with_imports(Config(env=EnvConfig(reward=RewardConfig(terms={})))).imports == ()
    assert imports.absolute(word) == str(module)


def test_a_module_that_a_file_imports_is_brought_by_that_file(module):
    """Wherever a run is looked at later: the file's folder is where Python finds the module."""
    elsewhere = module.parent / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "starts.py").write_text("import own_things")
    module.rename(elsewhere / "own_things.py")
    imports.load(["elsewhere/starts.py"])
    sys.modules.pop("starts")
    assert {registry.origin(name) for registry, name in OWN} == {"elsewhere/starts.py"}
    assert needs.with_imports(Config(policy="small")).imports == ("elsewhere/starts.py",)


def test_a_name_that_is_taken_is_refused(module):
    imports.load(["own_things.py"])
    for register, thing in (
        (loco_mjx.register_task, TASKS["thin"].generate),
        (loco_mjx.register_policy, POLICIES["hrl"].build),
        (loco_mjx.register_reward, REWARDS["alive"].function),
    ):
        taken = {"register_task": "plaza", "register_policy": "small", "register_reward": "upright"}
        with refusal(f"{taken[register.__name__]} already own_things.py"):
            register(taken[register.__name__], thing)
    with refusal("task thin already loco_mjx"):
        loco_mjx.register_task("thin", TASKS["wide"].generate)
    with refusal("task a/b name"):
        loco_mjx.register_task("a/b", TASKS["wide"].generate)


def test_a_notebook_may_register_again(module):
    cell = "import loco_mjx\nloco_mjx.register_reward('upright', lambda step: step.up, weight={})"
    for weight in (1.0, 2.0):
        exec(cell.format(weight), {"__name__": "__main__"})
    assert REWARDS["upright"].weight == 2.0


@pytest.mark.parametrize(
    ("args", "said"),
    [
        (("--import", "no_such_module"), "--import no_such_module .py"),
        (("--import", "no/such.py"), "--import no/such.py file"),
        (("--import", "json.py"), "--import json.py json already"),
        (("--import", "not a name"), "--import 'not a name'"),
        (("--import",), "--import module"),
        (("--import", "--task", "thin"), "--import module"),
    ],
)
def test_what_cannot_be_imported_is_one_line(args, said, module, capsys):
    (module.parent / "json.py").write_text("")
    assert main(["train", *args]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says(line, said)


def test_a_mistake_inside_of_a_module_keeps_its_traceback(module):
    (module.parent / "broken_things.py").write_text("import no_such_module_either")
    with pytest.raises(ModuleNotFoundError, match="no_such_module_either"):
        imports.load(["broken_things"])


def test_the_words_of_a_command():
    args = ["--import", "a", "--task", "thin", "--import=b.py"]
    assert words.imports(args) == ["a", "b.py"] and words.without_imports(args) == ["--task", "thin"]


def test_help_lists_what_a_module_brings_and_its_weight_is_an_option(module, capsys):
    with pytest.raises(SystemExit):
        main(["train", "--import", "own_things", "--help-all"])
    text = capsys.readouterr().out
    assert "plaza" in text and "small" in text and "--env.reward.upright" in text and "--import MODULE" in text
    assert main(["train", "--import", "own_things", "--env.reward.uprigt", "1"]) == 2
    assert "--env.reward.upright" in capsys.readouterr().err


def test_a_sweep_hands_modules_to_its_commands_by_a_path_that_means_the_same_anywhere(module, capsys):
    imports.load(["own_things"])
    plan = Plan(module.parent / "out", total_steps=8192, imports=(imports.absolute("own_things"),))
    (cell,) = plan.cells(["plaza"], [parse_variant("small+env.reward.upright=0.5")], [0])
    assert cell.variant == Variant("small", (("env.reward.upright", "0.5"),))
    assert cell.config.env.reward.terms == {"upright": 0.5} and cell.config.env.task == "plaza"
    for command in (cell.train_command(), cell.evaluate_command("plaza")):
        assert command[-2:] == ["--import", str(module)]
    args = ["--tasks", "plaza", "--policies", "small", "--total-steps", "8192", "--dry-run"]
    assert main(["sweep", "--import", "own_things", *args]) == 0
    assert "plaza" in capsys.readouterr().out
    forget()
    assert main(["sweep", *args]) == 2
    assert says(capsys.readouterr().err, "policy small")


def test_a_run_says_which_module_it_needs(module):
    imports.load(["own_things.py"])
    config = needs.with_imports(Config(policy="small", env=EnvConfig(task="plaza")))
    run = module.parent / "run"
    directory.write_json(run / "config.json", to_dict(config))
    assert directory.load_config(run) == config
    with refusal(f"{run} checkpoint"):
        load_policy(run)
    forget()
    with refusal(f"{run} task plaza --import own_things.py"):
        load_policy(run)


def test_how_a_module_is_named_and_what_weighs_nothing_make_no_other_run(module, tmp_path):
    imports.load(["own_things"])
    plain = Config(env=EnvConfig(reward=RewardConfig(terms={})))
    zero = Config(env=EnvConfig(reward=RewardConfig(terms={"upright": 0.0})), imports=("elsewhere.py",))
    directory.reconcile(tmp_path, plain, zero)
    with refusal("env.reward.upright 0.0 0.25"):
        directory.reconcile(tmp_path, plain, Config())
    with refusal("env.reward.upright 0.25 0.0"):
        directory.reconcile(tmp_path, Config(), plain)
    saved = checkpoint.path_of(tmp_path, 32)
    directory.write_json(saved / checkpoint.MANIFEST, {"step": 32, "config": to_dict(plain), "files": {}})
    checkpoint.check_config(saved, zero)
    with refusal("env.reward.upright 0.0 0.25"):
        checkpoint.check_config(saved, Config())
