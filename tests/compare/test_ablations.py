"""Every key of an ablation, from the words of a command to the environment, the networks and the action."""

import dataclasses
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.cli import train
from loco_mjx.compare import paper
from loco_mjx.compare.cells import PROGRAM, Plan
from loco_mjx.config import flatten, to_dict
from loco_mjx.depth.encoding import encode
from loco_mjx.env import LocoEnv
from loco_mjx.env.action import joint_scale, to_offsets
from loco_mjx.networks.policies import make_networks
from loco_mjx.run.results import variant_of
from loco_mjx.run.variant import parse_variant

PLAIN = "loco-transformer"


def config_of(text):
    """What `loco-mjx train` makes of the words with which a sweep would start it."""
    (cell,) = Plan(Path("sweep"), total_steps=8192).cells(["thin"], [parse_variant(text)], [0])
    return train.configuration(train.read(cell.train_command()[len(PROGRAM) + 1 :]))


@cache
def observed(config):
    """Shapes of what a newly reset environment shows."""
    env = LocoEnv(config)
    obs = jax.eval_shape(env.reset, jax.random.PRNGKey(0)).obs
    assert {name: x.shape for name, x in obs.items()} == env.observation_size
    return obs


@cache
def shapes_of(text):
    """Of a policy: the shapes of what it sees and says, and the number of parameters of its parts."""
    config = config_of(text)
    obs = observed(config.env)
    networks = make_networks(config.policy, config.network, config.env.action.size)

    def act(obs):
        params = networks.init(jax.random.PRNGKey(0), obs)
        return networks.apply(params, obs), params["params"]

    outputs, params = jax.eval_shape(act, obs)
    sizes = {name: sum(x.size for x in jax.tree.leaves(tree)) for name, tree in params.items()}
    return {
        "state": obs["state"].shape,
        "depth": obs["pixels/depth"].shape,
        "action": outputs.mean.shape,
        "attention": None if outputs.attention is None else outputs.attention.shape,
        "layers": len(params.get("policy_transformer", {})),
    }, sizes


# Of a layer of width C: attention 4 C² + 4 C, an MLP of width 256, two normalisations.
def layer(c):
    return (c * 3 * c + 3 * c) + (c * c + c) + (c * 256 + 256) + (256 * c + c) + 4 * c


# What differs from the policy unchanged: shapes, and numbers of parameters by part.
ABLATIONS = {
    "tokens_per_side=1": ({"attention": (1,)}, {"visual_tokens": 4 * 4 * 64 * 128 + 128}),
    "tokens_per_side=2": ({"attention": (4,)}, {"visual_tokens": 2 * 2 * 64 * 128 + 128}),
    "tokens_per_side=4": ({"attention": (16,)}, {"visual_tokens": 64 * 128 + 128}),
    "layers=0": ({"attention": None, "layers": 0}, {"policy_transformer": 0, "value_transformer": 0}),
    "layers=1": ({"layers": 1}, {"policy_transformer": layer(128), "value_transformer": layer(128)}),
    "layers=2": ({"layers": 2}, {"policy_transformer": 2 * layer(128)}),
    "layers=3": ({"layers": 3}, {"policy_transformer": 3 * layer(128), "value_transformer": 3 * layer(128)}),
    "token_dim=64": (
        {},
        {
            "state_token": 256 * 64 + 64,
            "visual_tokens": 64 * 64 + 64,
            "policy_transformer": 2 * layer(64),
            "value_transformer": 2 * layer(64),
        },
    ),
    "env.action.diagonal=True": ({"action": (6,)}, {}),
    "env.observation.depth.frames=1": ({"depth": (64, 64, 1)}, {"depth_encoder": -8 * 8 * 3 * 32}),
    "env.observation.depth.frames=2": ({"depth": (64, 64, 2)}, {"depth_encoder": -8 * 8 * 2 * 32}),
    "env.observation.state_frames=1": ({"state": (31,)}, {"state_encoder": -62 * 256}),
    "env.observation.displacement=False": ({"state": (84,)}, {"state_encoder": -9 * 256}),
    "env.observation.depth.noise=True": ({}, {}),
}


@pytest.mark.parametrize("change", ABLATIONS)
def test_an_ablation_changes_what_it_names_and_nothing_else(change):
    plain_shapes, plain_sizes = shapes_of(PLAIN)
    shapes, sizes = shapes_of(f"{PLAIN}+{change}")
    other_shapes, other_sizes = ABLATIONS[change]
    assert shapes == plain_shapes | other_shapes
    for name, size in other_sizes.items():
        # A part whose input changed is given by the difference.
        assert sizes.get(name, 0) == (plain_sizes[name] + size if size < 0 else size), name
    # Heads follow the width of the tokens and of the action; all other parts are as they were.
    if "token_dim" not in change and "diagonal" not in change and "layers=0" not in change:
        assert {n: s for n, s in sizes.items() if n not in other_sizes} == {
            n: s for n, s in plain_sizes.items() if n not in other_sizes
        }


def test_the_policy_unchanged_is_the_papers():
    shapes, _ = shapes_of(PLAIN)
    assert shapes == {"state": (93,), "depth": (64, 64, 4), "action": (12,), "attention": (16,), "layers": 2}


@pytest.mark.parametrize("change", ABLATIONS)
def test_a_sweep_and_the_papers_table_know_an_ablation_by_its_configuration(change):
    variant = parse_variant(f"{PLAIN}+{change}")
    flat = flatten(to_dict(config_of(variant.label)))
    same_as_plain = change in ("tokens_per_side=4", "layers=2")
    assert variant.matches(flat)
    assert parse_variant(PLAIN).matches(flat) == same_as_plain
    assert variant_of(flat) == (parse_variant(PLAIN) if same_as_plain else variant)
    in_table = [row.label for row in paper.ABLATION.rows if row.variant.matches(flat)]
    names = {"tokens_per_side=1": "N=1", "tokens_per_side=2": "N=2", "layers=1": "L=1", "layers=3": "L=3"}
    label = "N=4, L=2" if same_as_plain else names.get(change)
    assert in_table == ([f"LocoTransformer ({label})"] if label else [])


def test_diagonal_actions_move_diagonal_legs_alike():
    env = LocoEnv(config_of(f"{PLAIN}+env.action.diagonal=True").env)
    assert env.action_size == 6
    command = to_offsets(jp.arange(1.0, 7.0) / 10, env.config) / joint_scale(env.config.action)
    right, left = [0.1, 0.2, 0.3], [0.4, 0.5, 0.6]
    np.testing.assert_allclose(command, [*right, *left, *left, *right], rtol=1e-5)  # FR, FL, RR, RL


def test_depth_noise_blinds_pixels_and_can_be_on_or_off_by_itself():
    """Of the first frame, with the environment's own key: 3 to 30 pixels read the far clip, or none differ."""

    def seen(*changes):
        config = config_of("+".join([PLAIN, *changes])).env
        env = LocoEnv(dataclasses.replace(config, task="wide"))  # its walls leave little of the image at the far clip
        return np.asarray(jax.jit(env.reset)(jax.random.PRNGKey(0)).obs["pixels/depth"])

    clean, noisy = seen(), seen("env.observation.depth.noise=True")
    far = float(encode(jp.array(10.0)))
    changed = clean[..., 0] != noisy[..., 0]
    assert 0 < changed.sum() <= 30 and (noisy[..., 0][changed] == far).all()
    np.testing.assert_array_equal(clean, seen("env.randomization.enabled=True", "env.observation.depth.noise=False"))
