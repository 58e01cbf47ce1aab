"""Acts with a trained policy in an environment, step by step: a run, an exported folder, or a shipped policy.

python examples/act_in_a_loop.py mountain
"""

import sys

import jax

import loco_mjx


def main(path: str = "mountain-blind", task: str | None = None, steps: int = 100, seed: int = 0) -> float:
    """Walks for some control steps of 0.04 s, or until the episode ends.

    Args:
        path: of a run or of an exported policy, or a shipped one's name.
        task: to walk on; None: the one it was trained on.
        steps: at most.
        seed: of the scene.

    Returns:
        The distance covered, m.
    """
    loco_mjx.set_up()
    policy = loco_mjx.load_policy(path)
    env = policy.make_env(task)
    reset, step = jax.jit(env.reset), jax.jit(env.step)
    state, distance = reset(jax.random.PRNGKey(seed)), 0.0
    for _ in range(steps):
        state = step(state, policy.act(state.obs))
        distance += float(state.metrics["distance"])
        if state.done:
            break
    print(f"{path} on {env.task.name}: {distance:.2f} m")
    return distance


if __name__ == "__main__":
    main(*sys.argv[1:3])
