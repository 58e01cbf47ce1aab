"""Which teacher to imitate: ``python -m experiments.teachers``.

Privileged policies by PPO that pay differently for collisions, and whose exploration narrows or does not; every run
resumes. Results go to ``experiments/results/cpu/teachers/``.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from experiments.committed import RESULTS, chosen, keep, rows
from loco_mjx.compare.markup import markdown
from loco_mjx.evaluation.display import NOTHING

KEPT = RESULTS / "teachers"
TEXT = """## Teachers, on a CPU

`python -m experiments.teachers`: the policy `privileged` by PPO, one seed, {episodes} deterministic episodes at the end
of training. "Cost" is what a control step in contact with an obstacle costs, beside the paper's reward; "std" how wide
the teacher explores at its end, from 1 at its start: where it narrows, its learning rate falls to 0.
"""


@dataclass(frozen=True)
class Teacher:
    """One teacher.

    Attributes:
        task: to train on.
        cost: of a control step in contact.
        std: of its exploration at the end; None: as PPO leaves it.
        samples: to train on.
    """

    task: str
    cost: float
    std: float | None = None
    samples: int = 1_507_328

    @property
    def name(self) -> str:
        """Name of its directories."""
        narrow = [] if self.std is None else [f"std{self.std:g}"]
        return "-".join([self.task, f"cost{self.cost:g}", *narrow, f"{self.samples / 1e6:.1f}M"])

    @property
    def words(self) -> list[str]:
        """Of the command that trains it."""
        words = ["--task", self.task, "--policy", "privileged", "--seed", "0", "--total-steps", str(self.samples)]
        words += ["--evaluations", "3", "--evaluation-episodes", str(EPISODES)]
        words += ["--env.reward.collision", str(self.cost)]
        words += ["--eval-tasks", ELSEWHERE] if self.task == "thin" else []
        narrow = ["--ppo.final-std", str(self.std), "--ppo.learning-rate-decay", "True"]
        return words + (narrow if self.std is not None else [])


EPISODES, ELSEWHERE = 64, "wide"
TEACHERS = (Teacher("thin", 0.5), Teacher("thin", 1.0), Teacher("thin", 1.0, 0.3))
TEACHERS += tuple(Teacher("mountain", 0.0, 0.3, samples) for samples in (1_507_328, 2_400_256))


def section() -> str:
    """Of docs/results.md; nothing where there are no results."""
    found = [teacher for teacher in TEACHERS if (KEPT / teacher.name).is_dir()]
    if not found:
        return ""
    head = ["task", "cost", "std", "samples", "distance", "collisions", "falls", "progress"]
    head += [f"{name} on `{ELSEWHERE}`" for name in ("distance", "collisions", "falls")]
    return TEXT.format(episodes=EPISODES) + "\n" + markdown(head, [_line(teacher) for teacher in found])


def _line(teacher: Teacher) -> list[str]:
    last = rows(KEPT / teacher.name / "metrics.csv")[-1]

    def figures(prefix: str) -> list[str]:
        if f"{prefix}/distance" not in last:
            return [NOTHING] * 3
        falls = 1.0 - last[f"{prefix}/survived"]
        return [f"{last[f'{prefix}/distance']:.2f}", f"{last[f'{prefix}/collisions']:.0f}", f"{falls:.0%}"]

    progress = f"{last['eval/progress']:.2f}" if teacher.task == "mountain" else NOTHING
    std, samples = f"{last['policy/std']:.2f}", f"{last['step']:,.0f}"
    return [teacher.task, f"{teacher.cost:g}", std, samples, *figures("eval"), progress, *figures(f"eval/{ELSEWHERE}")]


def main() -> None:
    """Trains the teachers that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", default=[teacher.name for teacher in TEACHERS], help="teachers")
    parser.add_argument("--runs", type=Path, default=Path("runs/teachers"), help="where the run directories are")
    options = parser.parse_args()
    for teacher in chosen(options.names, TEACHERS):
        directory = options.runs / teacher.name
        command = [sys.executable, "-m", "loco_mjx.cli.main", "train", *teacher.words, "--out", str(directory)]
        subprocess.run(command, check=True)
        keep(directory, KEPT / teacher.name)


if __name__ == "__main__":
    main()
