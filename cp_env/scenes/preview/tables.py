"""The figures of a preview as tables for the screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np
from rich.table import Table

from cp_env.scenes.preview.box_fit import share_inside
from cp_env.scenes.preview.film import SEEN_AT, Figures

STANDS = 0.3  # m/s; what is slower stands


def tables(figures: Figures, rows: int) -> Iterator[Table]:
    """The scene, its agents, the `rows` vehicles that come nearest to the ego, and `rows` boxes that returns miss."""
    yield _scene(figures)
    yield _agents(figures)
    yield _vehicles(figures, rows)
    if any(one.missed.any() for sweeps in figures.fits for one in sweeps):
        yield _misses(figures, rows)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=True)
    return table


def _scene(figures: Figures) -> Table:
    scene = figures.scene
    there = ~np.isnan(figures.seen)
    table = _table(f"{scene.name}: {len(figures.frames)} of {scene.n_frames} frames used", "", "")
    names, values = table.columns
    names.min_width, values.justify, values.no_wrap = len("redundancy"), "left", False  # narrow windows break lines
    unit = "no road-side unit" if scene.rsu is None else f"and a road-side unit {scene.rsu[2]:.1f} m up"
    table.add_row("agents", f"{scene.n_connected} connected vehicles {unit}")
    low, high = figures.present.min(), figures.present.max()
    table.add_row("vehicles", f"{there.sum()} in all, {low} to {high} in a frame")
    kinds = Counter(name for name, here in zip(figures.classes, there, strict=True) if here)
    named = ", ".join(f"{number} {name}" for name, number in kinds.most_common())
    table.add_row("classes", named if figures.told else f"{named} (guessed from sizes)")
    table.add_row("time", f"{scene.n_frames * scene.dt:.1f} s at {1 / scene.dt:.3g} frames a second")
    table.add_row("speeds", _speeds(figures))
    table.add_row(
        "points", f"{figures.points.sum(axis=1).mean():,.0f} in a frame, {len(scene.obstacles)} walls or buildings"
    )
    never = int((figures.seen[there] == 0).sum())
    table.add_row("seen", f"a vehicle counts as seen with {SEEN_AT} returns from it; {never} never are")
    by = [f"{share:.0%} {n} or more" for n, share in enumerate(figures.redundancy[:4], start=1)]
    table.add_row("redundancy", f"share of the vehicles in a frame that sensors see: {', '.join(by)}")
    good, met = share_inside([one for sweeps in figures.fits for one in sweeps])
    table.add_row("returns", f"most lie in their box for {good} of {met} vehicles met" if met else "no vehicle is met")
    return table


def _speeds(figures: Figures) -> str:
    speed = figures.speed[np.isfinite(figures.speed)]
    if not len(speed):
        return "unknown: no vehicle is there in two frames"
    own = np.nanmedian(figures.speed[:, figures.scene.connected[0]])
    middle, fast, most = np.quantile(speed, [0.5, 0.95, 1.0])
    return (
        f"median {middle:.1f} m/s, 95 % below {fast:.1f}, fastest {most:.1f}; {(speed < STANDS).mean():.0%} stand; "
        f"the ego's median {own:.1f}"
    )


def _misses(figures: Figures, rows: int) -> Table:
    """Where returns miss their boxes, the worst first. A few are walls or trees beside a box."""
    found = []
    for t, sweeps in zip(figures.frames.tolist(), figures.fits, strict=True):
        for agent, one in enumerate(sweeps):
            for row, inside, returns in zip(*(part[one.missed].tolist() for part in (
                one.rows, one.inside, one.returns)), strict=True):  # fmt: skip
                found.append((returns - inside, t, agent, row, inside, returns))
    found.sort(reverse=True)
    table = _table(
        f"boxes that returns miss ({min(rows, len(found))} of {len(found)})",
        *("row", "class", "frame", "agent", "returns", "in the box"),
    )
    for _, t, agent, row, inside, returns in found[:rows]:
        name = "RSU" if agent == figures.scene.n_connected else str(agent)
        table.add_row(str(row), figures.classes[row], str(t), name, str(returns), str(inside))
    return table


def _agents(figures: Figures) -> Table:
    table = _table("agents", "agent", "points", "fewest", "most", "range m", "vehicles seen")
    sees = (figures.hits >= SEEN_AT).sum(axis=2)
    for k in range(figures.points.shape[1]):
        points = figures.points[:, k]
        name = "RSU" if k == figures.scene.n_connected else f"{k}{' ego' if k == 0 else ''}"
        numbers = (points.mean(), points.min(), points.max(), figures.reach[:, k].mean(), sees[:, k].mean())
        table.add_row(name, *(f"{number:,.{digits}f}" for number, digits in zip(numbers, (0, 0, 0, 1, 1), strict=True)))
    return table


def _vehicles(figures: Figures, rows: int) -> Table:
    scene, nearest = figures.scene, figures.nearest
    order = [row for row in np.argsort(nearest) if np.isfinite(nearest[row])]
    title = f"vehicles: how often each is seen, while it is there ({min(rows, len(order))} of {len(order)})"
    table = _table(title, "row", "class", "length m", "m/s", "nearest m", "frames", "by ego", "by any")
    speed = np.ma.median(np.ma.masked_invalid(figures.speed), axis=0).filled(np.nan)
    for row in order[:rows]:
        there = int(np.isfinite(scene.pose[figures.frames, row, 0]).sum())
        agent = np.flatnonzero(scene.connected == row)
        name = f"{row}" + (f" (agent {agent[0]})" if len(agent) else "")
        share = [f"{value:.0%}" for value in (figures.seen_by_ego[row], figures.seen[row])]
        pace = "–" if np.isnan(speed[row]) else f"{speed[row]:.1f}"
        table.add_row(
            name, figures.classes[row], f"{scene.size[row, 0]:.1f}", pace, f"{nearest[row]:.1f}", str(there), *share
        )
    return table
