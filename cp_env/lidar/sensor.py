"""Spinning multi-beam LiDARs in a scene: every connected vehicle's and the road-side unit's, of many frames at once.

Vehicles and obstacles are vertical prisms standing on flat ground (a car is two: body and cabin);
`cp_env.lidar.raycast` finds what each ray meets first, and this module makes a measurement of it: range noise, dropout,
range limit.

A sensor never sees the vehicle that carries it: neither returns from its own roof nor the shadow of it are modelled.
Noise is a hash of (scene name, frame, agent, ray), so a sweep does not depend on the batch it was cast in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from cp_env.lidar.raycast import Mount, Prisms, directions, trace
from cp_env.types import Scene, Sweep

ROOF = 0.2  # m; a vehicle's sensor stands this high above its roof
CAR_HEIGHT = 1.75  # m; vehicles below it have a bonnet and a boot, the others are full boxes
BODY_HEIGHT, CABIN_LENGTH, CABIN_WIDTH, CABIN_BACK = 0.58, 0.55, 0.88, 0.05  # of a car's height, length, width, length
AT_ONCE = 8  # frames traced together; more is no faster on a CPU and takes memory


@dataclass(frozen=True)
class LidarSpec:
    """What a sensor can do.

    elevations: degrees above the horizon, one a beam.
    azimuths: rays of a beam in one revolution; ray 0 points along the heading, the others follow counter-clockwise.
    max_range: m, along the ray.
    range_noise: m, standard deviation along the ray (a sum of three uniform draws: never beyond three deviations).
    dropout: chance that a ray near the sensor returns nothing; rises with the square of the range by `far_dropout`.
    """

    elevations: tuple[float, ...]
    azimuths: int = 512
    max_range: float = 70.0
    range_noise: float = 0.02
    dropout: float = 0.02
    far_dropout: float = 0.10

    def __post_init__(self) -> None:
        if not self.elevations or not all(-90 < e < 90 and e != 0 for e in self.elevations):
            raise ValueError(
                f"elevations must be one or more degrees in (-90, 90), none of them 0: got {self.elevations}"
            )
        if self.azimuths < 1 or self.max_range <= 0:
            raise ValueError(f"azimuths and max_range must be positive: got {self.azimuths} and {self.max_range}")
        if self.range_noise < 0 or self.dropout < 0 or self.far_dropout < 0:
            raise ValueError("range_noise, dropout and far_dropout must not be negative")


def fan(low: float, high: float, beams: int, *, horizon: float = -1.5, gather: float = 1.4) -> tuple[float, ...]:
    """`beams` elevations from `low` to `high` degrees, the denser near `horizon` the more `gather` exceeds 1."""
    span_low, span_high = horizon - low, high - horizon
    share = span_low ** (1 / gather) / (span_low ** (1 / gather) + span_high ** (1 / gather))
    u = np.linspace(-share, 1 - share, beams)
    scaled = np.where(u < 0, -span_low * (np.abs(u) / share) ** gather, span_high * (np.abs(u) / (1 - share)) ** gather)
    return tuple(float(e) for e in np.round(horizon + scaled, 4))


def rings(height: float, first: float, last: float, beams: int) -> tuple[float, ...]:
    """Elevations whose ground circles, seen from `height` m, have radii from `first` to `last` m in equal ratios."""
    return tuple(float(e) for e in np.round(-np.degrees(np.arctan2(height, np.geomspace(last, first, beams))), 4))


VEHICLE = LidarSpec(elevations=fan(-24.0, 9.0, 32))
RSU = LidarSpec(elevations=rings(6.0, 4.0, 60.0, 32))
_SHAPE = (VEHICLE, RSU, ROOF, CAR_HEIGHT, BODY_HEIGHT, CABIN_LENGTH, CABIN_WIDTH, CABIN_BACK)
DIGEST = f"lidar-1-{crc32(repr(_SHAPE).encode()):08x}"  # changes whenever a sweep would: part of every cache key


def scan(
    jobs: Sequence[tuple[Scene, int]],
    *,
    rsu: bool = True,
    vehicle_spec: LidarSpec = VEHICLE,
    rsu_spec: LidarSpec = RSU,
    device: str = "cpu",
) -> list[list[Sweep]]:
    """For every (scene, frame): the sweeps of its connected vehicles in order, then of its road-side unit if any.

    A vehicle's sensor stands `ROOF` m above its roof, the road-side unit's where the scene says. `Sweep.hits[m]` counts
    the returns from the scene's vehicle m. `rsu=False` leaves the road-side units out.

    Raises:
        ValueError: a frame is outside its scene, a connected vehicle is absent in it, or a sensor is not above ground.
    """
    for scene, frame in jobs:
        _check(scene, frame)
    return [
        sweeps
        for start in range(0, len(jobs), AT_ONCE)
        for sweeps in _scan(jobs[start : start + AT_ONCE], rsu, vehicle_spec, rsu_spec, device)
    ]


def _scan(
    jobs: Sequence[tuple[Scene, int]], rsu: bool, vehicle_spec: LidarSpec, rsu_spec: LidarSpec, device: str
) -> list[list[Sweep]]:
    worlds = [prisms(scene, frame) for scene, frame in jobs]
    sweeps: list[list[Sweep]] = [[] for _ in jobs]
    for spec, mounts in ((vehicle_spec, _vehicle_mounts(jobs)), (rsu_spec, _rsu_mounts(jobs) if rsu else [])):
        if not mounts:
            continue
        reach, owner = trace(worlds, mounts, _beams(spec, device)[0], spec.azimuths, spec.max_range)
        for mount, sweep in zip(mounts, _measure(jobs, mounts, spec, reach, owner), strict=True):
            sweeps[mount.world].append(sweep)
    return sweeps


def _check(scene: Scene, frame: int) -> None:
    if not 0 <= frame < scene.n_frames:
        raise ValueError(f"frame must be in 0..{scene.n_frames - 1} for scene {scene.name!r}: got {frame}")
    absent = scene.connected[np.isnan(scene.pose[frame, scene.connected]).any(axis=1)]
    if len(absent):
        raise ValueError(
            f"connected vehicles must be present in every frame: {absent.tolist()} of {scene.name!r} are not in {frame}"
        )
    if scene.rsu is not None and not scene.rsu[2] > 0:
        raise ValueError(f"a road-side unit must be above ground: that of {scene.name!r} is at {scene.rsu.tolist()}")


def _vehicle_mounts(jobs: Sequence[tuple[Scene, int]]) -> list[Mount]:
    return [
        Mount(world, x, y, float(scene.size[row, 2]) + ROOF, yaw, row)
        for world, (scene, frame) in enumerate(jobs)
        for row in scene.connected.tolist()
        for x, y, yaw in [scene.pose[frame, row].tolist()]
    ]


def _rsu_mounts(jobs: Sequence[tuple[Scene, int]]) -> list[Mount]:
    return [Mount(world, *scene.rsu.tolist()) for world, (scene, _) in enumerate(jobs) if scene.rsu is not None]


def prisms(scene: Scene, frame: int) -> Prisms:
    """All that reflects in one frame. Owners are vehicle rows, and M, the number of rows, for an obstacle.

    A car is its body up to `BODY_HEIGHT` of its height and a shorter, narrower cabin up to the roof.
    """
    row = np.flatnonzero(~np.isnan(scene.pose[frame, :, 0]))
    whole = np.concatenate([scene.pose[frame, row], scene.size[row]], axis=1)
    car = whole[:, 5] < CAR_HEIGHT
    cabin = whole[car]
    whole[car, 5] *= BODY_HEIGHT
    back = CABIN_BACK * cabin[:, 3:4]
    cabin[:, :2] -= back * np.stack([np.cos(cabin[:, 2]), np.sin(cabin[:, 2])], axis=1)
    cabin[:, 3:5] *= (CABIN_LENGTH, CABIN_WIDTH)
    owner = np.concatenate([row, row[car], np.full(len(scene.obstacles), len(scene.size))])
    return Prisms(np.concatenate([whole, cabin, scene.obstacles]), owner)


def _beams(spec: LidarSpec, device: torch.device | str) -> tuple[Float[Tensor, " Be"], Float[Tensor, " Be"]]:
    """Of each beam, metres up and metres along the ray for each horizontal metre."""
    angle = [math.radians(e) for e in spec.elevations]
    slope = torch.tensor([math.tan(a) for a in angle], dtype=torch.float32, device=device)
    return slope, torch.tensor([1 / math.cos(a) for a in angle], dtype=torch.float32, device=device)


def _measure(
    jobs: Sequence[tuple[Scene, int]],
    mounts: Sequence[Mount],
    spec: LidarSpec,
    reach: Float[Tensor, "S Az Be"],
    owner: Int[Tensor, "S Az Be"],
) -> Iterator[Sweep]:
    """What the sensors report of what their rays met: with noise along the ray, less what is too far or drops out."""
    slope, slant = _beams(spec, reach.device)
    seeds = torch.tensor([_seed(jobs[mount.world], mount.carrier) for mount in mounts], device=reach.device)
    jitter, lot = _noise(seeds, reach[0].numel())
    far = reach * (slant / spec.max_range)
    kept = (far <= 1) & (lot.view(far.shape) >= spec.dropout + spec.far_dropout * far * far)
    index = kept.view(-1).nonzero()[:, 0]
    along = reach + jitter.view(far.shape) * (spec.range_noise / slant)
    ray = torch.from_numpy(directions(mounts, spec.azimuths)).to(reach.device).float()
    height = torch.tensor([mount.z for mount in mounts], device=reach.device)[:, None, None]
    coordinates = (along * ray[..., :1], along * ray[..., 1:], height + along * slope)
    points = torch.stack([c.view(-1).index_select(0, index) for c in coordinates], dim=1).cpu()
    sizes = kept.sum((1, 2)).tolist()
    owners = owner.view(-1).index_select(0, index).cpu()
    for mount, own_points, own_owners in zip(mounts, points.split(sizes), owners.split(sizes), strict=True):
        n_vehicles = len(jobs[mount.world][0].size)
        hits = torch.bincount(own_owners[own_owners < n_vehicles], minlength=n_vehicles)
        yield Sweep(own_points.numpy(), np.array([mount.x, mount.y, mount.z]), hits.numpy())


def _seed(job: tuple[Scene, int], carrier: int) -> int:
    """63 bits for the noise of one sensor in one frame of one scene."""
    scene, frame = job
    return crc32(f"{frame}/{carrier}".encode()) << 31 ^ crc32(scene.name.encode())


def _noise(seeds: Int[Tensor, " S"], rays: int) -> tuple[Float[Tensor, "S R"], Float[Tensor, "S R"]]:
    """For every ray: a draw of mean 0 and deviation 1 (three uniforms, summed) and one uniform in [0, 1).

    Four 16-bit draws from a splitmix64 hash of (seed, ray). Integer arithmetic only: the same on any device.
    """
    z = seeds[:, None] + torch.arange(1, rays + 1, device=seeds.device) * -0x61C8864680B583EB
    for bits, factor in ((30, -0x40A7B892E31B1A47), (27, -0x6B2FB644ECCEEE15)):
        z = (z ^ _shift(z, bits)) * factor
    z = z ^ _shift(z, 31)
    total = (z & 0xFFFF) + (_shift(z, 16) & 0xFFFF) + (_shift(z, 32) & 0xFFFF)
    return total.float() * (2 / 65536) - 3.0, _shift(z, 48).float() * (1 / 65536)


def _shift(z: Int[Tensor, " *n"], bits: int) -> Int[Tensor, " *n"]:
    """Shift a 64-bit pattern to the right and fill with zeros: torch has no unsigned shift."""
    return (z >> bits) & ((1 << (64 - bits)) - 1)
