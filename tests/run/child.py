"""`python -m tests.run.child CORES SECONDS WORD...`: the real command with a tiny environment, on so many devices.

SECONDS is how long processes wait for each other.
"""

from __future__ import annotations

import sys


def main() -> int:
    import loco_mjx.env
    from loco_mjx.cli.main import main as command
    from loco_mjx.run import machine, multihost
    from tests.run.tiny import TinyEnv

    cores, seconds, *words = sys.argv[1:]
    loco_mjx.env.LocoEnv = lambda config: TinyEnv()
    machine.cores = lambda: int(cores)
    multihost.CONNECT_SECONDS = float(seconds)
    return command(words)


if __name__ == "__main__":
    sys.exit(main())
