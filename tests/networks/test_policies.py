"""The policies: sizes, what they read, what they share."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jp
import numpy as np
import pytest

from loco_mjx.config import NetworkConfig
from loco_mjx.errors import UnknownNameError
from loco_mjx.networks.outputs import DEPTH, PRIVILEGED, STATE
from loco_mjx.networks.policies import make_networks
from loco_mjx.networks.registry import POLICIES
from tests.refusals import refusal

SMALL = NetworkConfig(token_dim=16, mlp_dim=32, layers=1, hidden=(32, 24), state_only_hidden=(32, 32, 24, 24))


def _obs(key, *leading, state=93):
    state_key, depth_key, privileged_key = jax.random.split(key, 3)
    return {
        STATE: jax.random.normal(state_key, (*leading, state)),
        PRIVILEGED: jax.random.normal(privileged_key, (*leading, 7)),
        DEPTH: jax.random.normal(depth_key, (*leading, 64, 64, 4)),
    }


def _count(tree):
    return sum(x.size for x in jax.tree.leaves(tree))


def _shapes(policy, config=None, actions=12, state=93):
    networks = make_networks(policy, config or NetworkConfig(), actions)
    obs = {STATE: jp.zeros((1, state)), DEPTH: jp.zeros((1, 64, 64, 4))}
    return jax.eval_shape(networks.init, jax.random.PRNGKey(0), obs)["params"]


# Parameter counts by hand: inputs × outputs + outputs of each layer.
CONVS = (8 * 8 * 4 * 32 + 32) + (4 * 4 * 32 * 64 + 64) + (3 * 3 * 64 * 64 + 64)
LAYER = (128 * 384 + 384) + (128 * 128 + 128) + (128 * 256 + 256) + (256 * 128 + 128) + 2 * 2 * 128
HIDDEN = 256 * 256 + 256


def test_parameters_of_the_papers_policy():
    params = _shapes("loco-transformer", actions=6, state=84)
    encoders = CONVS + (64 * 128 + 128) + (84 * 256 + 256) + HIDDEN + (256 * 128 + 128)
    policy = encoders + 2 * LAYER + 2 * HIDDEN + (256 * 6 + 6) + 6
    value = 2 * LAYER + 2 * HIDDEN + (256 + 1)
    assert _count(params) == policy + value
    # The official policy network, 84-D state and 6-D action, has 605 thousand.
    assert round(policy / 1000) == 605
    of_policy = {name: part for name, part in params.items() if not name.startswith("value")}
    assert _count(of_policy) == policy


def test_parameters_of_the_other_policies():
    visual = CONVS + (1024 * 256 + 256)
    body = (93 * 256 + 256) + HIDDEN
    concat = visual + body + 2 * (512 * 256 + 256 + HIDDEN) + (256 * 12 + 12) + 12 + (256 + 1)
    assert _count(_shapes("state-depth-concat")) == concat
    depth_only = CONVS + (64 * 128 + 128) + 2 * (2 * LAYER + (128 * 256 + 256) + HIDDEN) + (256 * 12 + 12) + 12 + 257
    assert _count(_shapes("depth-only")) == depth_only
    # Two shared layers, two of its own for each of policy and value.
    state_only = body + 2 * (2 * HIDDEN) + (256 * 12 + 12) + 12 + 257
    assert _count(_shapes("state-only")) == state_only


@pytest.mark.parametrize("side", [1, 2, 4])
@pytest.mark.parametrize("layers", [0, 1, 2, 3])
def test_tokens_and_layers(side, layers):
    config = NetworkConfig(tokens_per_side=side, layers=layers)
    networks = make_networks("loco-transformer", config, 12)
    obs = {STATE: jp.zeros((2, 3, 93)), DEPTH: jp.zeros((2, 3, 64, 64, 4))}
    outputs, params = jax.eval_shape(
        lambda obs: (lambda params: (networks.apply(params, obs), params))(networks.init(jax.random.PRNGKey(0), obs)),
        obs,
    )
    assert outputs.mean.shape == outputs.log_std.shape == (2, 3, 12)
    assert outputs.value.shape == (2, 3)
    assert (outputs.attention is None) == (layers == 0)
    if layers:
        assert outputs.attention.shape == (2, 3, side * side)
    assert _count(params["params"]["policy_transformer"] if layers else {}) == layers * LAYER
    kernel = params["params"]["visual_tokens"]["projection"]["kernel"].shape
    assert kernel == (4 // side, 4 // side, 64, 128)


@pytest.fixture(scope="module")
def outputs_and_gradients():
    """For each policy: networks, outputs for two observations and for the second alone, gradients of mean and value."""
    found, draw = {}, np.random.default_rng(0)
    key = jax.random.PRNGKey(3)
    obs = _obs(key, 2)
    for policy in POLICIES:
        networks = make_networks(policy, SMALL, 12)
        # Not as initialised: the mean's last layer starts near zero, and here everything should show.
        shapes = jax.eval_shape(networks.init, key, obs)
        params = jax.tree.map(lambda x: 0.1 * draw.standard_normal(x.shape, np.float32), shapes)

        def run(params, obs, networks=networks):
            outputs, pull = jax.vjp(networks.apply, params, obs)
            zeros = jax.tree.map(jp.zeros_like, outputs)
            of_mean = pull(zeros.replace(mean=outputs.mean))
            of_value = pull(zeros.replace(value=outputs.value))
            return outputs, networks.apply(params, jax.tree.map(lambda x: x[1], obs)), of_mean, of_value

        found[policy] = (networks, *jax.jit(run)(params, obs))
    return found


def _size(tree):
    return max(float(jp.abs(x).max()) for x in jax.tree.leaves(tree))


@pytest.mark.parametrize("policy", POLICIES)
def test_reads_what_it_declares(outputs_and_gradients, policy):
    networks, _, _, (_, of_mean), (_, of_value) = outputs_and_gradients[policy]
    read = {STATE: networks.uses_state, DEPTH: networks.uses_depth, PRIVILEGED: networks.uses_privileged}
    for name, used in read.items():
        assert (_size(of_mean[name]) > 0) == used
        assert (_size(of_value[name]) > 0) == used


@pytest.mark.parametrize("policy", POLICIES)
def test_shares_encoders_only(outputs_and_gradients, policy):
    _, _, _, (of_mean, _), (of_value, _) = outputs_and_gradients[policy]
    for part in of_mean["params"]:
        mean_size, value_size = _size(of_mean["params"][part]), _size(of_value["params"][part])
        assert (mean_size > 0) == (not part.startswith("value"))
        assert (value_size > 0) == (not part.startswith("policy"))


@pytest.mark.parametrize("policy", POLICIES)
def test_one_observation_is_a_row_of_a_batch(outputs_and_gradients, policy):
    _, outputs, alone, _, _ = outputs_and_gradients[policy]
    assert alone.mean.shape == (12,)
    jax.tree.map(lambda one, many: np.testing.assert_allclose(one, many[1], atol=1e-4), alone, outputs)


def test_attention_is_the_state_tokens(outputs_and_gradients):
    _, outputs, _, _, _ = outputs_and_gradients["loco-transformer"]
    total = outputs.attention.sum(-1)  # what is missing to 1 goes to the state token itself
    assert float(outputs.attention.min()) >= 0 and float(total.max()) < 1 and float(total.min()) > 0.1
    assert all(
        outputs_and_gradients[policy][1].attention is None for policy in POLICIES if policy != "loco-transformer"
    )


@pytest.mark.parametrize("policy", ["loco-transformer", "state-depth-concat"])
def test_a_privileged_critic_takes_the_values_place(key, policy):
    config = dataclasses.replace(SMALL, critic="privileged")
    networks, teacher = make_networks(policy, config, 12), make_networks("privileged", SMALL, 12)
    obs = _obs(key, 5)
    both = jax.jit(lambda: (networks.init(key, obs)["params"], teacher.init(key, obs)["params"]))()
    # The critic is shaped as the privileged policy's value, and nothing else serves the value.
    given = {name: both[1][name] for name in ("state_encoder", "value_head")}
    assert jax.tree.map(jp.shape, both[0]["critic"]) == jax.tree.map(jp.shape, given)
    assert not any(name.startswith("value") for name in both[0])
    params = {"params": both[0] | {"critic": given}}
    apply = jax.jit(networks.apply)
    outputs = apply(params, obs)
    np.testing.assert_allclose(outputs.value, jax.jit(teacher.apply)({"params": both[1]}, obs).value, rtol=1e-5)
    # Out of the simulator the action is the same.
    alone = apply(params, {name: obs[name] for name in (STATE, DEPTH)})
    np.testing.assert_array_equal(alone.mean, outputs.mean)
    assert float(jp.abs(alone.value).max()) == 0


def test_a_policy_on_depth_alone_acts_on_depth_alone_whatever_its_critic_read(key):
    networks, obs = make_networks("depth-only", dataclasses.replace(SMALL, critic="privileged"), 12), _obs(key, 2)
    params = jax.eval_shape(networks.init, key, obs)
    outputs = jax.eval_shape(networks.apply, params, {DEPTH: obs[DEPTH]})
    assert outputs.mean.shape == (2, 12) and outputs.value.shape == (2,)


@pytest.mark.parametrize("policy", ["loco-transformer", "state-only"])
def test_first_policy_is_the_initial_gaussian_whatever_it_sees(key, policy):
    config = dataclasses.replace(SMALL, initial_std=0.5)
    networks = make_networks(policy, config, 12)
    obs = _obs(key, 8)
    outputs = jax.jit(lambda: networks.apply(networks.init(key, obs), obs))()
    np.testing.assert_allclose(jp.exp(outputs.log_std), 0.5, rtol=1e-6)
    assert 0 < float(jp.abs(outputs.mean).max()) < 0.1
    assert float(outputs.value.std()) > 0.01  # the value's last layer is not small


def test_mistakes_are_named():
    with refusal("policy loco-transfomer loco-transformer", UnknownNameError):
        make_networks("loco-transfomer", SMALL, 12)
    with refusal("network.tokens_per_side 3 1 2 4"):
        make_networks("depth-only", dataclasses.replace(SMALL, tokens_per_side=3), 12)
    with refusal("network.layers -1 0"):
        make_networks("depth-only", dataclasses.replace(SMALL, layers=-1), 12)
