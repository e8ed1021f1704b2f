"""A spinning multi-beam LiDAR, ray-cast against everything in a scene; all sensors of all given frames at once.

Everything that reflects is a vertical prism standing on the ground (a box, or two stacked boxes for a car), so a ray
is traced in two steps: where its azimuth's vertical plane enters and leaves a footprint (in 2D, once for all beams),
then what each beam meets between the two: the side, the top, or nothing. The nearest thing wins, the ground included.

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

from cp_env.types import Scene, Sweep

DIGEST = "lidar-1"  # changes whenever a sweep would; part of the cache key of every source that casts its own
ROOF = 0.2  # m; a vehicle's sensor stands this high above its roof
CAR_HEIGHT = 1.75  # m; vehicles below it have a bonnet and a boot, the others are full boxes
BODY_HEIGHT, CABIN_LENGTH, CABIN_WIDTH, CABIN_BACK = 0.58, 0.55, 0.88, 0.05  # of a car's height, length, width, length


GROUND, NOTHING = 1 << 30, (1 << 30) + 1  # owners of rays that meet no vehicle and no obstacle


@dataclass(frozen=True)
class LidarSpec:
    """What a sensor can do.

    elevations: degrees above the horizon, one a beam.
    azimuths: rays of a beam in one revolution; ray 0 looks along the heading, they turn counter-clockwise.
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
        ValueError: a frame is outside its scene, or a connected vehicle is absent in it.
    """
    sweeps: list[list[Sweep]] = [[] for _ in jobs]
    for spec, mounts in ((vehicle_spec, _vehicle_mounts(jobs)), (rsu_spec, _rsu_mounts(jobs) if rsu else [])):
        if mounts:
            for mount, sweep in zip(mounts, _sweep(jobs, mounts, spec, torch.device(device)), strict=True):
                sweeps[mount.job].append(sweep)
    return sweeps


@dataclass(frozen=True)
class Mount:
    """One sensor where it stands."""

    job: int  # which of the given (scene, frame) it is in
    agent: int  # connected vehicles count from 0, the road-side unit comes last
    x: float  # world frame; m
    y: float
    z: float
    yaw: float = 0.0  # rad
    vehicle: int = -1  # the scene's row of the vehicle it rides on, -1 for none

    @property
    def origin(self) -> Float[np.ndarray, " 3"]:
        return np.array([self.x, self.y, self.z])


def _vehicle_mounts(jobs: Sequence[tuple[Scene, int]]) -> list[Mount]:
    mounts = []
    for job, (scene, frame) in enumerate(jobs):
        if not 0 <= frame < scene.n_frames:
            raise ValueError(f"frame must be in 0..{scene.n_frames - 1} for scene {scene.name!r}: got {frame}")
        for agent, row in enumerate(scene.connected.tolist()):
            x, y, yaw = scene.pose[frame, row].tolist()
            if math.isnan(x):
                raise ValueError(
                    f"connected vehicles must be in every frame: {row} of {scene.name!r} is not in {frame}"
                )
            mounts.append(Mount(job, agent, x, y, float(scene.size[row, 2]) + ROOF, yaw, row))
    return mounts


def _rsu_mounts(jobs: Sequence[tuple[Scene, int]]) -> list[Mount]:
    return [
        Mount(job, scene.n_connected, *scene.rsu.tolist())
        for job, (scene, _) in enumerate(jobs)
        if scene.rsu is not None
    ]


def prisms(scene: Scene, frame: int) -> tuple[Float[np.ndarray, "B 6"], Int[np.ndarray, " B"]]:
    """All that reflects in one frame, as (x, y, yaw, length, width, height), and whose it is.

    Owners are vehicle rows, and M for an obstacle. A car is its body up to `BODY_HEIGHT` of its height and a shorter, narrower cabin up to the roof.
    """
    row = np.flatnonzero(~np.isnan(scene.pose[frame, :, 0]))
    whole = np.concatenate([scene.pose[frame, row], scene.size[row]], axis=1)
    car = whole[:, 5] < CAR_HEIGHT
    cabin = whole[car]
    whole[car, 5] *= BODY_HEIGHT
    back = CABIN_BACK * cabin[:, 3]
    cabin[:, 0] -= back * np.cos(cabin[:, 2])
    cabin[:, 1] -= back * np.sin(cabin[:, 2])
    cabin[:, 3] *= CABIN_LENGTH
    cabin[:, 4] *= CABIN_WIDTH
    n_vehicles = len(scene.size)
    owner = np.concatenate([row, row[car], np.full(len(scene.obstacles), n_vehicles)])
    return np.concatenate([whole, cabin, scene.obstacles]), owner


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Every (sensor, prism) that could meet, seen from the sensor, in sensor order."""

    sensor: Int[np.ndarray, " K"]
    owner: Int[np.ndarray, " K"]
    centre: Float[np.ndarray, "K 2"]  # of the prism, from the sensor; m
    half: Float[np.ndarray, "K 2"]  # half length, half width; m
    axis: Float[np.ndarray, "K 2"]  # cos and sin of the prism's yaw
    top: Float[np.ndarray, " K"]  # height of its top above the ground; m


def _pairs(jobs: Sequence[tuple[Scene, int]], mounts: Sequence[Mount], max_range: float) -> _Pairs:
    """A prism that contains the sensor (its own vehicle, or bad data) is left out."""
    job, found = -1, []
    for sensor, mount in enumerate(mounts):
        if mount.job != job:
            job = mount.job
            boxes, owner = prisms(*jobs[job])
            axis = np.stack([np.cos(boxes[:, 2]), np.sin(boxes[:, 2])], axis=1)
            half, top = 0.5 * boxes[:, 3:5], boxes[:, 5]
        centre = boxes[:, :2] - (mount.x, mount.y)
        along, across = _into_frame(centre, axis)
        inside = (np.abs(along) <= half[:, 0]) & (np.abs(across) <= half[:, 1]) & (mount.z <= top)
        reach = np.sqrt((centre**2).sum(1)) - np.sqrt((half**2).sum(1))
        keep = (reach < max_range) & (owner != mount.vehicle) & ~inside
        found.append((np.full(int(keep.sum()), sensor), owner[keep], centre[keep], half[keep], axis[keep], top[keep]))
    return _Pairs(*(np.concatenate(part) for part in zip(*found, strict=True)))


def _into_frame(
    point: Float[np.ndarray, "K 2"], axis: Float[np.ndarray, "K 2"]
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """The two coordinates of each point along and across an axis given by its cos and sin."""
    return (
        axis[:, 0] * point[:, 0] + axis[:, 1] * point[:, 1],
        axis[:, 0] * point[:, 1] - axis[:, 1] * point[:, 0],
    )


def _fan_of(pairs: _Pairs, yaw: Float[np.ndarray, " S"], azimuths: int) -> tuple[np.ndarray, np.ndarray]:
    """The first ray index (may be negative) and the number of rays that could meet each prism's footprint.

    Generous by a hair on both sides: the exact test follows.
    """
    corner = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])[None] * pairs.half[:, None]
    c, s = pairs.axis[:, None, 0], pairs.axis[:, None, 1]
    x = pairs.centre[:, None, 0] + c * corner[..., 0] - s * corner[..., 1]
    y = pairs.centre[:, None, 1] + s * corner[..., 0] + c * corner[..., 1]
    bearing = np.arctan2(pairs.centre[:, 1], pairs.centre[:, 0])
    spread = np.remainder(np.arctan2(y, x) - bearing[:, None] + np.pi, 2 * np.pi) - np.pi
    start = bearing - yaw[pairs.sensor]
    step = 2 * np.pi / azimuths
    first = np.ceil((start + spread.min(1)) / step - 1e-6).astype(np.int64)
    last = np.floor((start + spread.max(1)) / step + 1e-6).astype(np.int64)
    along, across = _into_frame(pairs.centre, pairs.axis)
    over = (np.abs(along) <= pairs.half[:, 0]) & (np.abs(across) <= pairs.half[:, 1])  # the sensor hangs above it
    return np.where(over, 0, first), np.where(over, azimuths, np.minimum(last - first + 1, azimuths))


def _directions(mounts: Sequence[Mount], azimuths: int) -> Float[np.ndarray, "S Az 2"]:
    """Unit vectors of the rays in the plane, parallel to the world's axes. Ray 0 looks along the sensor's heading."""
    turn = np.exp(2j * np.pi * np.arange(azimuths) / azimuths)
    rays = np.array([complex(math.cos(m.yaw), math.sin(m.yaw)) for m in mounts])[:, None] * turn
    return np.stack([rays.real, rays.imag], axis=-1)


def _cross(
    pairs: _Pairs, mounts: Sequence[Mount], directions: Tensor, azimuths: int
) -> tuple[Int[Tensor, " R"], Int[Tensor, " R"], Float[Tensor, " R"], Float[Tensor, " R"]]:
    """Where rays cross footprints: the pair, the ray's column (sensor * azimuths + azimuth), and the horizontal
    distances (m) at which it enters and leaves."""
    device = directions.device
    yaw = np.array([m.yaw for m in mounts])
    first, count = _fan_of(pairs, yaw, azimuths)
    pair = np.repeat(np.arange(len(count)), count)
    azimuth = np.remainder(np.arange(len(pair)) - np.repeat(np.cumsum(count) - count - first, count), azimuths)
    which = torch.from_numpy(pair).to(device)
    column = torch.from_numpy(pairs.sensor[pair] * azimuths + azimuth).to(device)
    along, across = _into_frame(-pairs.centre, pairs.axis)
    origin = torch.from_numpy(np.stack([along, across], axis=1)).to(device)[which]
    axis = torch.from_numpy(pairs.axis).to(device)[which]
    half = torch.from_numpy(pairs.half).to(device)[which]
    ray = directions.reshape(-1, 2)[column]
    heading = torch.stack(
        [axis[:, 0] * ray[:, 0] + axis[:, 1] * ray[:, 1], axis[:, 0] * ray[:, 1] - axis[:, 1] * ray[:, 0]], dim=1
    )
    inverse = 1.0 / torch.where(heading.abs() < 1e-12, 1e-12, heading)
    one, other = (-half - origin) * inverse, (half - origin) * inverse
    enter = torch.minimum(one, other).amax(1).clamp_min(0.0)
    leave = torch.maximum(one, other).amin(1)
    hit = (enter < leave).nonzero()[:, 0]
    return which[hit], column[hit], enter[hit], leave[hit]


def trace(
    jobs: Sequence[tuple[Scene, int]], mounts: Sequence[Mount], spec: LidarSpec, device: torch.device | str = "cpu"
) -> tuple[Float[Tensor, "S Az Be"], Int[Tensor, "S Az Be"]]:
    """What every ray meets first, without noise: its horizontal distance (m, infinite if beyond range) and its owner.

    Owners are vehicle rows, M for an obstacle of a scene of M vehicles, and `GROUND` or `NOTHING`.
    """
    directions = torch.from_numpy(_directions(mounts, spec.azimuths)).to(device)
    pairs = _pairs(jobs, mounts, spec.max_range)
    which, column, enter, leave = _cross(pairs, mounts, directions, spec.azimuths)
    slope, slant = _beams(spec, directions.device)
    height = torch.tensor([m.z for m in mounts], dtype=torch.float32, device=device)
    ground = torch.where(slope < 0, -height[:, None] / slope, math.inf)  # [S, Be]
    nearest = _pack(ground, torch.full_like(ground, GROUND, dtype=torch.int64))
    nearest = nearest[:, None].repeat(1, spec.azimuths, 1)
    above = torch.from_numpy(pairs.top).to(device).float()[which] - height[column // spec.azimuths]
    distance = _meet(enter.float()[:, None], leave.float()[:, None], above[:, None], slope).view(-1)
    met = (distance < math.inf).nonzero()[:, 0]
    crossing, beam = met // len(slope), met % len(slope)
    owner = torch.from_numpy(pairs.owner).to(device)[which]
    ray = column[crossing] * len(slope) + beam
    nearest.view(-1).scatter_reduce_(0, ray, _pack(distance[met], owner[crossing]), "amin")
    distance = (nearest >> 32).int().view(torch.float32)
    in_range = distance * slant <= spec.max_range
    return torch.where(in_range, distance, math.inf), torch.where(in_range, nearest & 0xFFFFFFFF, NOTHING)


def _beams(spec: LidarSpec, device: torch.device) -> tuple[Float[Tensor, " Be"], Float[Tensor, " Be"]]:
    """Of each beam, metres up and metres along the ray for each horizontal metre."""
    angle = [math.radians(e) for e in spec.elevations]
    slope = torch.tensor([math.tan(a) for a in angle], dtype=torch.float32, device=device)
    return slope, torch.tensor([1 / math.cos(a) for a in angle], dtype=torch.float32, device=device)


def _meet(
    enter: Float[Tensor, "R 1"], leave: Float[Tensor, "R 1"], above: Float[Tensor, "R 1"], slope: Float[Tensor, " Be"]
) -> Float[Tensor, "R Be"]:
    """The horizontal distance at which each beam meets a prism whose top is `above` m over the sensor; else infinite.

    A beam reaches the height of the top at distance above / slope. One that descends is over the top before that and
    strikes whatever lies beyond; one that climbs is over it afterwards.
    """
    at_top = above / slope
    distance = torch.where(slope < 0, torch.maximum(enter, at_top), enter)
    meets = torch.where(slope < 0, distance <= leave, enter <= at_top)
    return torch.where(meets, distance, math.inf)


def _pack(distance: Tensor, owner: Tensor) -> Int[Tensor, " *n"]:
    """One integer that sorts by distance, then owner: the bits of positive floats sort as the floats do."""
    return (distance.contiguous().view(torch.int32).to(torch.int64) << 32) | owner


def _sweep(
    jobs: Sequence[tuple[Scene, int]], mounts: Sequence[Mount], spec: LidarSpec, device: torch.device
) -> Iterator[Sweep]:
    """The mounts' sweeps, in their order: what is met, with noise along the ray, less what drops out."""
    distance, owner = trace(jobs, mounts, spec, device)
    slope, slant = _beams(spec, device)
    seeds = torch.tensor([_seed(jobs[m.job], m.agent) for m in mounts], device=device)
    jitter, lot = _noise(seeds, distance[0].numel())
    far = distance * (slant / spec.max_range)
    kept = lot.view(far.shape) >= spec.dropout + spec.far_dropout * far * far  # infinitely far is never kept
    index = kept.view(-1).nonzero()[:, 0]
    along = distance + jitter.view(far.shape) * (spec.range_noise / slant)
    directions = torch.from_numpy(_directions(mounts, spec.azimuths)).to(device).float()
    height = torch.tensor([m.z for m in mounts], dtype=torch.float32, device=device)
    x, y, z = along * directions[..., :1], along * directions[..., 1:], height[:, None, None] + along * slope
    points = torch.stack([x.view(-1)[index], y.view(-1)[index], z.view(-1)[index]], dim=1).cpu()
    sizes = kept.sum((1, 2)).tolist()
    owners = owner.view(-1)[index].cpu().split(sizes)
    for mount, own_points, own_owner in zip(mounts, points.split(sizes), owners, strict=True):
        n_vehicles = len(jobs[mount.job][0].size)
        hits = torch.bincount(own_owner[own_owner < n_vehicles], minlength=n_vehicles)
        yield Sweep(own_points.numpy(), mount.origin, hits.numpy())


def _seed(job: tuple[Scene, int], agent: int) -> int:
    """63 bits for the noise of one sensor in one frame of one scene."""
    scene, frame = job
    return crc32(f"{frame}/{agent}".encode()) << 31 ^ crc32(scene.name.encode())


def _noise(seeds: Int[Tensor, " S"], rays: int) -> tuple[Float[Tensor, "S R"], Float[Tensor, "S R"]]:
    """For every ray: a draw of mean 0 and deviation 1 (three uniforms, summed) and one uniform in [0, 1).

    Four 16-bit draws from a hash of (seed, ray), mixed as in splitmix64 but for shifts that keep the sign. Integer
    arithmetic only: the same on any device.
    """
    z = seeds[:, None] + torch.arange(1, rays + 1, device=seeds.device) * -0x61C8864680B583EB
    z = (z ^ (z >> 30)) * -0x40A7B892E31B1A47
    z = (z ^ (z >> 27)) * -0x6B2FB644ECCEEE15
    z = z ^ (z >> 31)
    total = (z & 0xFFFF) + ((z >> 16) & 0xFFFF) + ((z >> 32) & 0xFFFF)
    return total.float() * (2 / 65536) - 3.0, ((z >> 48) & 0xFFFF).float() * (1 / 65536)
