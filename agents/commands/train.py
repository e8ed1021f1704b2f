"""Train a detector on your scenes, or an attack against a defender.

    cp-train detector --scenes mine:Folder:folder=data --out runs/mine     # then: cp-env evaluate --calibrate
    cp-train attack --defender prbi --seed 1                             # PPO; the policy that did most damage is kept
    cp-train sweep --defenders prbi robosac --seeds 0 1                  # configurations × seeds, the strongest kept
    cp-train tune --trials 20                                            # PPO's hyperparameters, by Optuna, as a file

Each goes on where a killed run stopped. `cp-train attack --help` and so on list the options. Attacks are trained by
Stable-Baselines3: pip install 'cp-env[agents]'.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module

from agents.commands.common import run_program
from cp_env.progress import say
from defenders.registry import unknown

COMMANDS = {
    "attack": "agents.commands.train_attack",
    "detector": "agents.commands.train_detector",
    "sweep": "agents.commands.train_sweep",
    "tune": "agents.commands.train_tune",
}
"""Modules, imported when they are asked for: a detector is trained without Stable-Baselines3."""


def main(argv: list[str] | None = None) -> None:
    """Run the console script; `argv` are the command line's unless given."""
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] in ("-h", "--help"):
        say(f"usage: cp-train {{{','.join(COMMANDS)}}} [OPTIONS]\n\n{__doc__}", sys.stdout)
        return
    if words[0] not in COMMANDS:
        raise SystemExit(f"cp-train: {unknown('command', words[0], tuple(COMMANDS))}")
    try:
        module = import_module(COMMANDS[words[0]])
    except ImportError as error:
        if (error.name or "").startswith("stable_baselines3"):
            raise SystemExit(
                "cp-train: attacks are trained by Stable-Baselines3, an extra: pip install 'cp-env[agents]'"
            ) from error
        raise SystemExit(f"cp-train: {error}") from error
    program: Callable[..., None] = module.program
    run_program(f"cp-train {words[0]}", module.Args, program, module.__doc__, words[1:])


if __name__ == "__main__":
    main()
