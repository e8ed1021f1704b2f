"""PRBI's Fig. 5: the probability 1 - P_benign that a vehicle is malicious, by frame, for n = 5 and k = 1 … 4 attackers.

    python examples/reproduce/prbi_probability.py              # under a perfect verifier
    python examples/reproduce/prbi_probability.py --detector   # on the detector under PGD; goes on where it stopped

PRBI goes on verifying. The lines are the first run, with attackers in red and benign vehicles in blue. Shaded is the
middle 80 % over runs. The table has the frame from which on exactly the attackers are at 100 %, the share of benign
vehicles at 100 % in the fifth frame, and the mean over the benign vehicles in the last. The paper says that all
attackers reach 100 % rapidly, and gives no numbers. Under a perfect verifier they are at 100 % from the first frame on,
because they never pass. The benign vehicles take time to leave it. A P_benign above 1, which Eq. (10) allows, counts
as 1.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch
import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

import agents
from cp_env.detector.registry import open_detector
from cp_env.evaluation.plan.files import write_atomically
from cp_env.metrics.intervals import t_interval
from cp_env.metrics.shares import share_interval
from cp_env.rendering import style
from cp_env.scenes import open_source
from cp_env.settings import Precision
from cp_env.world.scene_cache import SceneBank
from cp_env.world.world import World
from defenders import Prbi
from defenders.simulation.world import SimulatedWorld

N = 5


@dataclass
class Args:
    frames: int = 30  # of attack
    runs: int = 100  # of every k, under the perfect verifier
    ks: tuple[int, ...] = (1, 2, 3, 4)
    seed: int = 0
    threshold: str = "paper"  # of `defenders.Prbi`; it has no effect under a perfect verifier
    detector: bool = False  # play on the detector instead
    scenes: str = "town/test"
    n_scenes: int = 2
    precision: Precision = "float32"  # of the detector's maps, fusion and decoder
    threads: int = 1
    out: Path = Path("out/prbi/probability")


@dataclass(frozen=True)
class Run:
    k: int
    name: str  # of the scene, or the seed
    attackers: list[int]
    belief: list[list[float]]  # [frames of attack, N]


def perfect(args: Args) -> list[Run]:
    return [under_the_truth(args, k, i) for k in args.ks for i in range(args.runs)]


def under_the_truth(args: Args, k: int, run: int) -> Run:
    place, defender_rng = (np.random.default_rng(seed) for seed in np.random.SeedSequence([args.seed, k, run]).spawn(2))
    attackers = sorted(place.permutation(N)[:k].tolist())
    defender, world = Prbi(stopping="never"), SimulatedWorld(N, frozenset(attackers))
    defender.reset(N, defender_rng)
    world.judge(defender, attack=False)
    belief = []
    for _ in range(args.frames):
        world.judge(defender)
        belief.append(defender.belief().tolist())
    return Run(k, str(run), attackers, belief)


def on_the_detector(args: Args) -> list[Run]:
    """A file for each k and scene; those that are there already are read."""
    bank = SceneBank(open_source(args.scenes), open_detector(precision=args.precision), progress=False)
    names = bank.source.names()
    chosen = [names[i * len(names) // args.n_scenes] for i in range(args.n_scenes)]
    jobs = [(k, name) for k in args.ks for name in chosen]
    return [in_a_scene(args, bank, *job) for job in track(jobs, "playing", transient=True)]


def in_a_scene(args: Args, bank: SceneBank, k: int, name: str) -> Run:
    conditions = (args.scenes, name, k, args.seed, args.frames, args.threshold, bank.detector.digest)
    path = args.out / "runs" / f"k{k}-{zlib.crc32(repr(conditions).encode()):08x}.json"
    if path.exists():
        return Run(**json.loads(path.read_text()))
    defender = Prbi(stopping="never", threshold=args.threshold)
    world = World(1, defender=defender, bank=bank, n_vehicles=N, n_attackers=k, max_frames=args.frames + 1)
    seed = np.random.SeedSequence([args.seed, zlib.crc32(name.encode())])
    world.reset([seed], options={"scene": name})
    attack = agents.make("pgd")
    attack.reset(1, [np.random.default_rng(seed)])
    belief = []
    for _ in range(args.frames + 1):
        world.step(attack.act(world.situation()))
        belief.append(world.defenders[0].belief().tolist())
    run = Run(k, name, world.attackers[0].tolist(), belief[1:])
    write_atomically(path, json.dumps(asdict(run)) + "\n")
    return run


def show(runs: list[Run], where: str) -> Table:
    columns = (
        "k",
        "runs",
        "exactly the attackers after",
        "in runs %",
        "benign vehicles at 100 %, frame 5",
        "benign vehicles, last",
    )
    table = Table(*columns, title=f"Fig. 5, {where}")
    for k in dict.fromkeys(run.k for run in runs):
        mine = [run for run in runs if run.k == k]
        exact = [((np.array(run.belief) == 1) == np.isin(range(N), run.attackers)).all(axis=1) for run in mine]
        after = [int(np.flatnonzero(~row).max(initial=-1)) + 2 for row in exact if row[-1]]
        benign = [100 * np.delete(run.belief, run.attackers, axis=1) for run in mine]
        early = share_interval([100 * (belief[4] == 100).mean() for belief in benign], whole=100)
        shown = f"{t_interval(after):.1f}" if after else "–"
        last = share_interval([belief[-1].mean() for belief in benign], whole=100)
        share = f"{100 * len(after) / len(mine):.0f}"
        table.add_row(str(k), str(len(mine)), shown, share, f"{early:.0f}", f"{last:.0f}")
    return table


@style.plot_style()
def draw(runs: list[Run], path: Path, where: str) -> None:
    ks = list(dict.fromkeys(run.k for run in runs))
    figure, axes = plt.subplots(1, len(ks), figsize=(style.PAGE, 2.9), sharey=True, squeeze=False, layout="constrained")
    for axis, k in zip(axes[0], ks, strict=True):
        mine = [run for run in runs if run.k == k]
        frames = range(1, len(mine[0].belief) + 1)
        for kind, colour in (("attackers", style.VERMILLION), ("benign vehicles", style.BLUE)):
            rows = [[i for i in range(N) if (i in run.attackers) == (kind == "attackers")] for run in mine]
            values = np.concatenate(
                [100 * np.array(run.belief)[:, i] for run, i in zip(mine, rows, strict=True)], axis=1
            )
            axis.fill_between(frames, *np.quantile(values, [0.1, 0.9], axis=1), color=colour, alpha=0.2, linewidth=0)
            axis.plot(frames, values[:, : len(rows[0])], color=colour, linewidth=1)
            axis.plot([], [], color=colour, label=kind)
        axis.set(title=f"k = {k}", xlabel="frames of attack", ylim=(-3, 103))
    axes[0, 0].set_ylabel("attack probability, 1 − P_benign, %")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
    figure.suptitle(f"PRBI's belief, n = {N}, {where}")
    style.save_plot(figure, path)
    plt.close(figure)


def main(args: Args) -> None:
    torch.set_num_threads(args.threads)
    where = "detector" if args.detector else "perfect verifier"
    runs = on_the_detector(args) if args.detector else perfect(args)
    Console(width=100).print(show(runs, where))
    args.out.mkdir(parents=True, exist_ok=True)
    path = args.out / ("prbi-probability-detector" if args.detector else "prbi-probability")
    data = {"args": vars(args), "runs": [asdict(run) for run in runs]}
    path.with_suffix(".json").write_text(json.dumps(data, default=str) + "\n")
    draw(runs, path.with_suffix(".png"), where)
    print("written:", path.with_suffix(".json"), path.with_suffix(".png"))


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
