"""Which part of a large network a scene is taken from: where enough vehicles meet, and what lies round that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import shapely
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

from cp_env.scenes.sumo.build import REACH
from cp_env.scenes.sumo.network import Streets
from cp_env.scenes.sumo.selection import FRAMES, RADIO, SAMPLE, STRIDE, stands
from cp_env.scenes.sumo.traffic import Tracks

AROUND = 270.0  # m: of a large network only what is so near to the place of the scene is used
DRIVEN = 420.0  # m: of a large bare network only what is so near to the place is driven through


def meetings(tracks: Tracks, least: int, *, moving: bool) -> Float[np.ndarray, "K 3"]:
    """Places of vehicles that have at least `least` - 1 others in radio range for the length of a scene.

    The windows of time are those that `selection.candidates` tries.

    Args:
        tracks: vehicles that may be connected.
        least: connected vehicles wanted, the ego among them.
        moving: whether only vehicles count that do not stand for the whole time.

    Returns:
        For every such vehicle and window x, y of the middle between where it is first and last, and how far it goes
        from there; m.
    """
    found = [np.zeros((0, 3))]
    for start in range(0, len(tracks.pose) - FRAMES + 1, STRIDE):
        window = tracks.pose[start : start + FRAMES]
        place = window[::SAMPLE, ~np.isnan(window[..., 0]).any(axis=0), :2]
        if moving:
            place = place[:, ~stands(place)]
        if place.shape[1] < least:
            continue
        pairs = cKDTree(place[0]).query_pairs(RADIO - 1, output_type="ndarray")
        gap = np.linalg.norm(place[:, pairs[:, 0]] - place[:, pairs[:, 1]], axis=-1).max(axis=0)
        company = np.bincount(pairs[gap < RADIO - 1].ravel(), minlength=place.shape[1])
        egos = place[:, company >= least - 1]
        middle = (egos[0] + egos[-1]) / 2
        found.append(np.column_stack([middle, np.linalg.norm(egos - middle, axis=-1).max(axis=0)]))
    return np.concatenate(found)


def focus(network: Streets, tracks: Tracks, spot: Float[np.ndarray, " 3"]) -> tuple[Streets, Int[np.ndarray, " K"]]:
    """What lies round a place of `meetings`: a city is too much to search for a scene.

    Returns:
        The streets there, centred on the place, and the rows of the vehicles that come by.
    """
    centre, reach = spot[:2], max(AROUND, spot[2] + REACH + 20)
    near = np.flatnonzero((np.linalg.norm(tracks.pose[..., :2] - centre, axis=-1) < reach).any(axis=0))
    box = shapely.box(*(centre - reach), *(centre + reach))
    inside = shapely.intersects(box, [shapely.LineString(lane.shape) for lane in network.lanes])
    town = replace(
        network,
        lanes=[lane for lane, kept in zip(network.lanes, inside, strict=True) if kept],
        junctions=network.junctions[(np.abs(network.junctions[:, :2] - centre) < reach).all(axis=1)],
        carriageway=shapely.clip_by_rect(network.carriageway, *box.bounds),
        centre=centre,
        radius=reach - REACH - 10,
    )
    return town, near


def quarter(network: Streets, rng: np.random.Generator) -> Streets:
    """What lies within `DRIVEN` of a street drawn at random: vehicles farther off are never seen by a scene there.

    Where streets are so long that none lies within it, those that pass through are taken whole.
    """
    streets = [lane for lane in network.lanes if lane.cars and not lane.internal]
    length = np.array([np.linalg.norm(np.diff(lane.shape, axis=0), axis=1).sum() for lane in streets])
    drawn = streets[rng.choice(len(streets), p=length / length.sum())]
    centre = drawn.shape.mean(axis=0)
    lanes = [lane for lane in network.lanes if (np.linalg.norm(lane.shape - centre, axis=1) < DRIVEN).all()]
    if drawn not in lanes:
        disc = shapely.Point(centre).buffer(DRIVEN)
        lanes = [lane for lane in network.lanes if disc.intersects(shapely.LineString(lane.shape))]
    edges = {lane.edge for lane in lanes if lane.cars and not lane.internal}
    sources, sinks = ([edge for edge in ends if edge in edges] for ends in (network.sources, network.sinks))
    radius = DRIVEN - AROUND
    return replace(network, lanes=lanes, sources=sources, sinks=sinks, centre=centre, radius=radius)
