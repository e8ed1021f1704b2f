"""What every attack costs each defender on traffic not trained on: scripted attacks, and the policies that ship.

    python examples/play_attacker.py                                   # every defender a policy ships for
    python examples/play_attacker.py --defenders prbi --policies runs/prbi-*/policy.safetensors
    python examples/play_attacker.py --defenders prbi --gif-frames 100

The program `cp-play` on one page. Each attack's episodes are kept in a file under --out; started again, it goes on with
those that are missing.
"""

from __future__ import annotations

import torch
import tyro
from rich.console import Console

from agents.commands.play import Args, conditions_of, film, play_all, write


def main(args: Args) -> None:
    torch.set_num_threads(1)
    conditions = conditions_of(args)  # scenes, frames, vehicles and fusion, the same for all
    played = play_all(args, conditions)  # what `args.out` holds already is not played again
    Console().print(write(played, args), markup=False, highlight=False, soft_wrap=True)
    if args.gif_frames:
        Console().print(f"wrote {film(args, conditions)}")


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
