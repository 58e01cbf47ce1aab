"""An installation without an extra: one line that names it, exit code 2; and the extras hold what the code imports."""

import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

from loco_mjx.cli.main import EXTRAS, VERBS
from tests.deploy import flat
from tests.refusals import says

ARGS = {"evaluate": ["run"], "export": ["run"], "bench": ["depth"], "simcheck": ["policy"], "play": ["run"]}
OTHERWISE = {"table", "curves", "deploy"}  # these look at what they are given first, or need less
ABSENT = """
import sys
from loco_mjx.cli.main import EXTRAS, main
class Absent:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
sys.meta_path.insert(0, Absent)
for words in sys.argv[1:]:
    print(words.split()[0], main(words.split()))
print("help", main(["--help"]) or main(["deploy", "--help"]))
"""


def test_every_verb_names_the_extra_it_lacks(tmp_path):
    flat.write(tmp_path)
    verbs = [verb for verb in VERBS if verb not in OTHERWISE]
    words = [" ".join([verb, *ARGS.get(verb, [])]) for verb in verbs] + [f"deploy {tmp_path}"]
    done = subprocess.run([sys.executable, "-c", ABSENT, *words], capture_output=True, text=True)
    said = done.stderr.splitlines()
    assert [line.split() for line in done.stdout.splitlines()[: len(words)]] == [[w.split()[0], "2"] for w in words]
    assert len(said) == len(words)
    for verb, line in zip(verbs, said, strict=False):
        assert says(line, f"{verb} pip install 'loco-mjx[train]'")
    assert says(said[-1], "deploy pip install 'loco-mjx[deploy]'")
    assert done.returncode == 0 and says(done.stdout, "loco-mjx deploy --robot")  # --help needs no extra


def test_extras_hold_the_packages_they_are_named_for():
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    brought = packages_distributions()
    for module, extra in EXTRAS.items():
        if module == "jaxlib":  # comes with jax
            continue
        names = {name.lower() for name in brought.get(module, [module])}
        wanted = {spec.partition(">")[0].lower() for spec in project["optional-dependencies"][extra]}
        assert names & wanted, f"{module} is not in {extra}"
