"""Trains from Python, sees every iteration's metrics, stops when it walks well enough, and evaluates.

python examples/train_from_python.py
"""

import sys
from collections.abc import Mapping
from typing import Any

import loco_mjx

FAR_ENOUGH = 6.0  # m


def main(out: str = "runs/from-python", **changes: Any) -> dict[str, Any]:
    """Trains a blind policy on `thin` into a directory; a second call goes on where the first one ended.

    Args:
        out: the run's directory.
        **changes: of the configuration, such as total_steps=500_000.
    """
    config = loco_mjx.configure("fast", **{"task": "thin", "policy": "state-only", "total_steps": 500_000} | changes)

    def each_iteration(samples: int, metrics: Mapping[str, float]) -> bool:
        distance = metrics.get("eval/distance", 0.0)  # there after the iterations that are followed by an evaluation
        print(f"{samples:9,} samples  reward per step {metrics['step/reward']:.3f}")
        return distance > FAR_ENOUGH

    outcome = loco_mjx.train(config, out, each_iteration, quiet=True)
    result = loco_mjx.evaluate(out, episodes=8)
    print(f"{outcome.samples:,} samples, distance {result['metrics']['distance']['mean']:.2f} m")
    return result


if __name__ == "__main__":
    main(*sys.argv[1:2])
