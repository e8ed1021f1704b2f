"""Draw the gallery anew: a film of each defence under each main attack, two special ones, and the README's teaser.

    python examples/reproduce/gallery.py                                                # docs/gallery/, docs/gallery.md
    python examples/reproduce/gallery.py --films prbi-pgd removal --page out/page.md --out out/gallery

All films of the grid show one episode: the same scene, start and attackers, by the seed. Nothing was selected. The
critical removal was: its scene is one in which the attack hides the vehicle ahead. The figures under the films are of
these episodes alone and carry no claim; the leaderboard has tables over scenes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import tyro
from PIL import Image, ImageDraw
from rich.console import Console

from agents.arena.entries import make_attack
from cp_env import evaluation
from cp_env.evaluation.plan.files import write_atomically
from cp_env.evaluation.report.video import FPS, record_rollout, write_film
from cp_env.progress import track
from cp_env.rendering.frame import draw_output
from cp_env.rendering.panel import FAINT, GROUND, INK, Panel, draw_counts, draw_ground, draw_legend, draw_panel, font
from cp_env.rendering.picture import Picture, standing_points, telling_frame
from cp_env.rendering.style import save_image
from cp_env.types import Detections

DEFENDERS = ("none", "prbi", "robust_prbi", "robosac", "pasac:score=similarity", "bayes")
ATTACKS = {
    "pgd": "pgd",
    "threshold-aware": "in_loop:steps=6",
    "ramp": "ramp:steps=6",
    "learned": "policy:name=prbi-stealth-action",
}
"""By the name of their films."""
TITLES = {"pgd": "PGD", "threshold-aware": "Threshold-aware", "ramp": "Ramp", "learned": "Learned"}
ABOUT = {
    "pgd": "Projected gradient descent knows of no defence: every frame is attacked at the full budget.",
    "threshold-aware": "It knows that outputs are compared with the frame before, and does the most damage that passes "
    "at 0.35.",
    "ramp": "The share of Δ that it spends grows from frame to frame: every output becomes the next reference.",
    "learned": "A policy that PPO trained against PRBI steers the gradient ascent.",
}
MOST = 150_000
"""Bytes of a film; fewer of its frames are shown where it would be larger."""
BEGIN, END = "<!-- films:begin -->", "<!-- films:end -->"


@dataclass(frozen=True)
class Film:
    """One film: an episode under a defence and an attack."""

    name: str
    defender: str
    attack: str
    scenes: str
    scene: str
    extent: float = 32.0  # m; what is shown round the ego
    start: int | None = None  # first frame of the scene; by the seed if none is given


@dataclass(frozen=True)
class Args:
    """What is drawn, and where it goes."""

    films: tuple[str, ...] = ()  # names of films; all, and the teaser, if none is given
    scenes: str = "town/test"
    scene: str = "test-intersection-00"
    removal_scene: str = "test-suburban-03"
    frames: int = 24  # of an episode; every other one is shown, or fewer
    removal_frames: int = 27  # the same for the critical removal
    n_attackers: int = 2  # of five vehicles
    seed: int = 0
    threads: int = 1
    out: Path = Path("docs/gallery")
    page: Path = Path("docs/gallery.md")  # the block between its marks is replaced
    teaser: Path = Path("docs/teaser.png")


@dataclass(frozen=True)
class Figures:
    """What happened in the episode of a film."""

    loss: float  # detection loss per frame
    verifications: float  # per frame
    suspected: int  # of the attackers, in the last frame
    misclassified: int  # benign vehicles that are suspected there


def films_of(args: Args) -> list[Film]:
    """Every film of the gallery."""
    grid = [
        Film(f"{defender.partition(':')[0]}-{name}", defender, attack, args.scenes, args.scene)
        for name, attack in ATTACKS.items()
        for defender in DEFENDERS
    ]
    return [
        *grid,
        Film("removal", "prbi", "nearest_removal:steps=8", args.scenes, args.removal_scene, extent=20.0, start=0),
        Film("junction", "prbi", "pgd", "junction/test", "test-junction-00"),
    ]


def record(film: Film, args: Args) -> list[Picture]:
    """The episode of a film."""
    frames = args.frames if film.start is None else args.removal_frames
    conditions = evaluation.Conditions(film.scenes, (film.scene,), frames)
    run = evaluation.Run(film.defender, film.attack, args.n_attackers, args.seed, conditions.names)
    rollout = evaluation.Rollout(run, conditions, evaluation.open_bank(conditions), make_attack(film.attack))
    if film.start is not None:  # as examples/reproduce/hidden_leader.py plays it
        options = [{"scene": film.scene, "start": film.start}]
        rollout.world.reset([np.random.SeedSequence(args.seed)], options=options)
    pictures = record_rollout(rollout, run, frames)
    return [replace(picture, horizon=frames, extent=film.extent) for picture in pictures]


def figures_of(pictures: Sequence[Picture]) -> Figures:
    """The figures of an episode."""
    last = pictures[-1]
    return Figures(
        float(np.mean([picture.damage for picture in pictures])),
        float(np.mean([picture.verifications for picture in pictures])),
        len(last.suspects & last.attackers),
        len(last.suspects - last.attackers),
    )


def draw_teaser(benign: Picture, attacked: Picture, path: Path) -> Path:
    """Three panels of one frame: unattacked, attacked, defended. Drawn at two pixels for each one of the page.

    Raises:
        ValueError: the pictures are of different moments.
    """
    if benign.frame != attacked.frame or not np.array_equal(benign.truth, attacked.truth):
        raise ValueError(f"the pictures must show one moment, got frames {benign.frame} and {attacked.frame}")
    scale, gap, side = 2.0, 14, 448
    panels = [Panel(gap + i * (side + gap), 96, side, attacked.extent, 1.5) for i in range(3)]
    canvas = np.full((96 + side + 206, gap + 3 * (side + gap), 3), GROUND, np.uint8)
    draw_ground(canvas, standing_points(attacked), panels)
    image = Image.fromarray(canvas)
    everyone = frozenset(range(len(attacked.places)))
    nobody: frozenset[int] = frozenset()
    attack = f"{len(attacked.attackers)} of {len(everyone)} attack"
    shown: list[tuple[str, str, Detections, frozenset[int], frozenset[int], frozenset[int]]] = [
        ("no attack", "all five fused", benign.output, everyone, nobody, nobody),
        (attack, "all five fused", attacked.seen, everyone, nobody, attacked.attackers),
        (
            attack,
            attacked.defended,
            attacked.output,
            attacked.collaborators,
            attacked.suspects,
            attacked.attackers,
        ),
    ]
    for panel, (title, below, boxes, *marked) in zip(panels, shown, strict=True):
        counts = draw_panel(image, attacked, panel, boxes, *marked)
        pen = ImageDraw.Draw(image)
        pen.text((panel.left, 40), title, INK, font(round(16 * scale)), anchor="ls")
        pen.text((panel.left, 80), below, FAINT, font(round(14 * scale)), anchor="ls")
        draw_counts(pen, panel, *counts)
    draw_legend(ImageDraw.Draw(image), gap, 96 + side + 84, (0, side + gap, 2 * (side + gap)), scale)
    return save_image(image, path)


def block(films: Sequence[Film], figures: dict[str, Figures], args: Args) -> str:
    """The page's generated part: the grid's films by attack, each row with a table of figures."""
    lines, head = list[str](), ("defender", "detection loss/frame", "verifications/frame", "attackers suspected")
    for name, attack in ATTACKS.items():
        row = [film for film in films if film.name.endswith(f"-{name}")]
        lines += [f"## {TITLES[name]}", "", f"`{attack}`. {ABOUT[name]}", ""]
        lines += [f"![{film.defender} against {attack}]({args.out.name}/{film.name}.gif)" for film in row]
        lines += ["", f"| {' | '.join(head)} | benign suspected |", "|---|--:|--:|--:|--:|"]
        for film in row:
            one = figures[film.name]
            cells = (f"{one.loss:.2f}", f"{one.verifications:.2f}", f"{one.suspected} of {args.n_attackers}")
            lines.append(f"| `{film.defender}` | {' | '.join(cells)} | {one.misclassified} |")
        lines.append("")
    return "\n".join(lines)


def main(args: Args) -> None:
    """Play, draw, write."""
    torch.set_num_threads(args.threads)
    films = films_of(args)
    known = [film.name for film in films]
    unknown = [name for name in args.films if name not in known]
    if unknown:
        raise ValueError(f"no film {unknown[0]!r}; known: {', '.join(known)}")
    console, figures = Console(), dict[str, Figures]()
    for film in track([film for film in films if not args.films or film.name in args.films], "films", unit="film"):
        pictures = record(film, args)
        figures[film.name] = figures_of(pictures)
        path = args.out / f"{film.name}.gif"
        for every in (2, 3, 4):
            if write_film(pictures, path, layout=draw_output, every=every, fps=FPS / every).stat().st_size <= MOST:
                break
        console.print(f"{path}: {path.stat().st_size / 1000:.0f} kB, {figures[film.name]}", soft_wrap=True)
    if not args.films:
        by_name = {film.name: film for film in films}
        attacked = record(by_name["prbi-pgd"], args)
        at = telling_frame(attacked)
        benign = record(replace(by_name["prbi-pgd"], defender="none", attack="none"), args)
        console.print("teaser:", draw_teaser(benign[at], attacked[at], args.teaser), soft_wrap=True)
        text = args.page.read_text()
        before, rest = text.split(BEGIN)
        _, after = rest.split(END)
        write_atomically(args.page, f"{before}{BEGIN}\n{block(films, figures, args)}{END}{after}")
        console.print("page:", args.page, soft_wrap=True)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
