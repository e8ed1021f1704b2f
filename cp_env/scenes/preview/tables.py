"""The figures of a preview as tables for the screen."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from rich.table import Table

from cp_env.scenes.preview.film import SEEN_AT, Figures


def tables(figures: Figures, rows: int) -> Iterator[Table]:
    """The scene, its agents, and the `rows` vehicles that come nearest to the ego."""
    yield _scene(figures)
    yield _agents(figures)
    yield _vehicles(figures, rows)


def _table(title: str, *columns: str) -> Table:
    table = Table(title=title, box=None, pad_edge=False, title_justify="left")
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=True)
    return table


def _scene(figures: Figures) -> Table:
    scene = figures.scene
    there = ~np.isnan(figures.seen)
    table = _table(f"{scene.name}: {len(figures.frames)} of {scene.n_frames} frames used", "", "")
    table.columns[1].justify = "left"
    unit = "no road-side unit" if scene.rsu is None else f"and a road-side unit {scene.rsu[2]:.1f} m up"
    table.add_row("agents", f"{scene.n_connected} connected vehicles {unit}")
    low, high = figures.present.min(), figures.present.max()
    table.add_row("vehicles", f"{there.sum()} in all, {low} to {high} in a frame")
    table.add_row("time", f"{scene.n_frames * scene.dt:.1f} s at {1 / scene.dt:.3g} frames a second")
    table.add_row(
        "points", f"{figures.points.sum(axis=1).mean():,.0f} in a frame, {len(scene.obstacles)} walls or buildings"
    )
    never = int((figures.seen[there] == 0).sum())
    table.add_row("seen", f"a vehicle counts as seen with {SEEN_AT} returns from it; {never} never are")
    return table


def _agents(figures: Figures) -> Table:
    table = _table("agents", "agent", "points", "fewest", "most", "range m", "sees")
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
    table = _table(title, "row", "length m", "nearest m", "frames", "by ego", "by any")
    for row in order[:rows]:
        there = int(np.isfinite(scene.pose[figures.frames, row, 0]).sum())
        agent = np.flatnonzero(scene.connected == row)
        name = f"{row}" + (f" (agent {agent[0]})" if len(agent) else "")
        share = [f"{value:.0%}" for value in (figures.seen_by_ego[row], figures.seen[row])]
        table.add_row(name, f"{scene.size[row, 0]:.1f}", f"{nearest[row]:.1f}", str(there), *share)
    return table
