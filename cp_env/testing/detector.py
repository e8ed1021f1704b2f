"""Conformance rules for detectors: one for each promise of `cp_env.detector.protocol.DetectorLike`.

    from cp_env.testing import check_detector
    check_detector(my_detector)

A detector is checked through its methods alone, on a crossing of five vehicles, recorded with the package's LiDAR.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import SharesMaps, UsesEgoSweep, with_ego_context
from cp_env.geometry.planar import grid_origin
from cp_env.lidar.sensor import scan
from cp_env.testing.rollout import Violation, require
from cp_env.types import Detections, Scene, Sweep

EXTENT = 32.0
"""Half the side of what views are compared on, m."""

N = 4
EGOS = 2
METHODS = ("encode", "warp", "coverage", "perceive", "detect")


def crossing() -> Scene:
    """Cars that stand and drive at a corner, `N` of them connected."""
    states = np.array(
        [(-8, -2, 0.0), (14, 2, np.pi), (2, -15, np.pi / 2), (-2, 19, -np.pi / 2), (9, -6, 0.0), (-19, 6, np.pi)]
    )
    return Scene(
        name="crossing",
        kind="intersection",
        dt=0.2,
        pose=states[None] + np.array([0.37, -0.21, 0.0]),
        size=np.tile([4.5, 1.8, 1.5], (len(states), 1)),
        connected=np.arange(N),
        rsu=None,
        obstacles=np.array([[22.0, 18.0, 0.0, 20.0, 14.0, 8.0]]),
    )


@dataclass(eq=False)
class Trial:
    """A detector and what it is tried on: two worlds, the same crossing with one vehicle and another as the ego."""

    detector: Any
    tolerance: float

    @cached_property
    def sweeps(self) -> list[Sweep]:
        (sweeps,) = scan([(crossing(), 0)])
        return sweeps

    @cached_property
    def maps(self) -> Tensor:
        return self.detector.encode(self.sweeps)

    @cached_property
    def places(self) -> np.ndarray:
        """Of the sensors, [N, 2]; m."""
        return np.stack([sweep.origin[:2] for sweep in self.sweeps])

    @cached_property
    def order(self) -> np.ndarray:
        """`order[e, i]`: which sweep is map i of world e, the ego's first."""
        return np.stack([np.roll(np.arange(N), -e) for e in range(EGOS)])

    @cached_property
    def poses(self) -> Tensor:
        """ego_T_sender of each world's maps."""
        origins = grid_origin(self.places)[self.order]
        shift = np.pad(origins - origins[:, :1], ((0, 0), (0, 0), (0, 1)))
        return torch.from_numpy(shift.astype(np.float32)).to(self.detector.device)

    @cached_property
    def received(self) -> Tensor:
        return self.detector.warp(self.maps[torch.from_numpy(self.order)], self.poses)

    @cached_property
    def ego_detector(self) -> Any:
        """The detector bound to the ego context of both egos."""
        uses_sweep = isinstance(self.detector, UsesEgoSweep)
        return with_ego_context(self.detector, self.detector.ego_context(self.sweeps[:EGOS]) if uses_sweep else None)

    def perceive(self, world: list[int], groups: list[list[int]], received: Tensor | None = None) -> Dense:
        """The decoder's output for groups, each a list of members."""
        device = self.detector.device
        members = torch.tensor([[i in group for i in range(N)] for group in groups], device=device)
        coverage = self.detector.coverage(self.poses)
        received = self.received if received is None else received
        return self.ego_detector.perceive(received, coverage, torch.tensor(world, device=device), members)

    @cached_property
    def dense(self) -> Dense:
        """Everyone, the ego alone, another alone, all but the ego, in both worlds by turns."""
        with torch.no_grad():
            return self.perceive(*self.rows)

    @property
    def rows(self) -> tuple[list[int], list[list[int]]]:
        return [0, 1, 0, 1, 0], [[0, 1, 2, 3], [0], [2], [1, 2, 3], [0, 3]]

    @cached_property
    def found(self) -> list[Detections]:
        own = (self.places - grid_origin(self.places))[self.rows[0]]
        return self.detector.detect(self.dense, own)

    def is_close(self, a: Tensor, b: Tensor) -> bool:
        """Equal up to rounding."""
        return a.shape == b.shape and bool(torch.allclose(a, b, rtol=self.tolerance, atol=self.tolerance))


DetectorRule = Callable[[Trial], None]


@contextmanager
def moved(*parameters: nn.Parameter) -> Iterator[None]:
    """Other weights for a while: each larger by 1."""
    before = [parameter.detach().clone() for parameter in parameters]
    with torch.no_grad():
        for parameter in parameters:
            parameter.add_(1)
    try:
        yield
    finally:
        with torch.no_grad():
            for parameter, value in zip(parameters, before, strict=True):
                parameter.copy_(value)


def has_the_methods(trial: Trial) -> None:
    """It has the protocol's methods, C, H = W, an extent of 32 m (views are compared there), a threshold, a device."""
    detector = trial.detector
    missing = [name for name in METHODS if not callable(getattr(detector, name, None))]
    require(not missing, f"methods are missing: {', '.join(missing)}")
    for name, least in (("channels", 1), ("size", 2)):
        value = getattr(detector, name, None)
        require(
            isinstance(value, int) and value >= least, f"{name} must be a whole number of at least {least}: {value!r}"
        )
    extent, threshold = getattr(detector, "extent", None), getattr(detector, "threshold", None)
    require(extent == EXTENT, f"extent must be {EXTENT}, not {extent!r}")
    require(isinstance(threshold, float) and 0 < threshold < 1, f"threshold must lie in (0, 1), not {threshold!r}")
    require(isinstance(getattr(detector, "device", None), torch.device), "device must be a torch.device")


def digest_is_stable(trial: Trial) -> None:
    """`digest` is a string that is fit for a file name and stays the same, whatever is encoded and perceived."""
    digest = trial.detector.digest
    require(isinstance(digest, str) and digest.isalnum(), f"digest must be letters and digits, not {digest!r}")
    trial.perceive(*trial.rows)
    require(trial.detector.digest == digest, "digest changed though nobody changed the detector")


def digest_tells_weights_apart(trial: Trial) -> None:
    """Other weights have another digest: the cache would serve the old ones' features."""
    if not isinstance(trial.detector, nn.Module):
        return
    digest = trial.detector.digest
    for name, parameter in trial.detector.named_parameters():
        with moved(parameter):
            changed = trial.detector.digest != digest
        require(changed, f"digest is the same with another {name}")


def maps_digest_tells_encoders_apart(trial: Trial) -> None:
    """A `maps_digest`, if there is one, is fit for a file name; weights that it ignores change no map: it keys them."""
    detector = trial.detector
    if not isinstance(detector, SharesMaps):
        return
    digest = detector.maps_digest
    require(isinstance(digest, str) and digest.isalnum(), f"maps_digest must be letters and digits, not {digest!r}")
    ignored = {}
    for name, parameter in detector.named_parameters() if isinstance(detector, nn.Module) else ():
        with moved(parameter):
            if detector.maps_digest == digest:
                ignored[name] = parameter
    order = torch.from_numpy(trial.order)
    with moved(*ignored.values()):
        maps = trial.detector.encode(trial.sweeps)
        received = trial.detector.warp(maps[order], trial.poses)
    same = torch.equal(maps, trial.maps) and torch.equal(received, trial.received)
    require(same, f"maps_digest is the same with other weights, maps are not: it ignores {', '.join(ignored)}")


def maps_are_shared_maps(trial: Trial) -> None:
    """`encode` gives one finite map [C, H, W] a sweep, fit for half precision, on the detector's device."""
    detector, maps = trial.detector, trial.maps
    shape = (N, detector.channels, detector.size, detector.size)
    require(tuple(maps.shape) == shape, f"encode gave {tuple(maps.shape)} for {N} sweeps, not {shape}")
    require(maps.device == detector.device, f"maps are on {maps.device}, the detector is on {detector.device}")
    require(bool(torch.isfinite(maps).all()), "maps hold NaN or infinity")
    limit = float(np.finfo(np.float16).max)
    require(float(maps.abs().max()) < limit, f"maps exceed {limit}: they are kept in half precision")
    require(bool((maps[0] != maps[1]).any()), "two vehicles' maps are the same: does encode use the sweep?")


def encoding_is_deterministic(trial: Trial) -> None:
    """The same sweep gives the same map, bit for bit."""
    require(torch.equal(trial.detector.encode(trial.sweeps), trial.maps), "encode gave another map for the same sweeps")


def encoding_is_a_loop(trial: Trial) -> None:
    """A sweep's map does not depend on the other sweeps of its batch, nor on their order."""
    for row, sweep in enumerate(trial.sweeps):
        alone = trial.detector.encode([sweep])[0]
        require(trial.is_close(alone, trial.maps[row]), f"sweep {row} is encoded otherwise alone than with the others")


def warp_moves_whole_cells(trial: Trial) -> None:
    """A pose that shifts by a cell moves the map by a cell, zeros following; none leaves it alone, bit for bit."""
    cell = 2 * EXTENT / trial.detector.size
    maps = trial.maps[:1]
    still = trial.detector.warp(maps, maps.new_zeros(1, 3))
    require(torch.equal(still, maps), "a sender that stands where the ego does is warped")
    for axis, dim in ((0, -1), (1, -2)):
        pose = maps.new_zeros(1, 3)
        pose[0, axis] = 2 * cell
        wanted = torch.roll(maps, 2, dim)
        wanted.narrow(dim, 0, 2).zero_()
        moved = trial.detector.warp(maps, pose)
        name = ("x, columns", "y, rows")[axis]
        require(torch.equal(moved, wanted), f"2 cells along {name} up, the map is not what it was, two cells up")


def warp_is_linear(trial: Trial) -> None:
    """warp(2 a - 3 b) = 2 warp(a) - 3 warp(b), for any pose: only δ is warped in every frame."""
    a, b = trial.maps[:1], trial.maps[1:2]
    for pose in ([0.0, 0.0, 0.0], [6.0, -4.0, 0.0], [3.3, -7.7, 0.6]):
        at = a.new_tensor([pose])
        whole, parts = trial.detector.warp(2 * a - 3 * b, at), [trial.detector.warp(one, at) for one in (a, b)]
        require(trial.is_close(whole, 2 * parts[0] - 3 * parts[1]), f"warp is not linear at pose {pose}")


def coverage_says_where_maps_reach(trial: Trial) -> None:
    """`coverage` is [.., H, W] of zeros and ones: 1 for the ego itself, 0 for a sender out of reach."""
    size = trial.detector.size
    poses = trial.maps.new_tensor([[0.0, 0, 0], [2 * EXTENT, 0, 0], [EXTENT, 0, 0]])
    covered = trial.detector.coverage(poses)
    require(tuple(covered.shape) == (3, size, size), f"coverage of 3 poses has shape {tuple(covered.shape)}")
    require(bool(((covered == 0) | (covered == 1)).all()), "coverage holds other numbers than 0 and 1")
    require(bool((covered[0] == 1).all()), "the ego does not cover its own map")
    require(not bool(covered[1].any()), "a sender two maps away covers some of the ego's")
    require(bool((covered[2, :, size // 2 :] == 1).all()), "a sender half a map east does not cover the east half")


def views_are_finite(trial: Trial) -> None:
    """`perceive` gives `Dense` for every group, without the ego and of one too: finite, square maps of one size."""
    dense, rows = trial.dense, len(trial.rows[0])
    require(isinstance(dense, Dense), f"perceive gave a {type(dense).__name__}, not a Dense")
    height, width = dense.logits.shape[-2:]
    require(tuple(dense.logits.shape) == (rows, height, height) and height == width, "logits must be [B, h, h]")
    require(tuple(dense.boxes.shape) == (rows, 6, height, width), "boxes must be [B, 6, h, w], as large as the logits")
    require(
        bool(torch.isfinite(dense.logits).all() & torch.isfinite(dense.boxes).all()), "a view holds NaN or infinity"
    )


def perceiving_is_deterministic(trial: Trial) -> None:
    """The same maps give the same view, bit for bit."""
    with torch.no_grad():
        again = trial.perceive(*trial.rows)
    require(torch.equal(again.logits, trial.dense.logits), "perceive gave another view of the same maps")


def perceiving_is_a_loop(trial: Trial) -> None:
    """A view does not depend on the other views of its batch, nor on their worlds."""
    for row, (world, group) in enumerate(zip(*trial.rows, strict=True)):
        with torch.no_grad():
            alone = trial.perceive([world], [group])
        same = trial.is_close(alone.logits[0], trial.dense.logits[row]) and trial.is_close(
            alone.boxes[0], trial.dense.boxes[row]
        )
        require(same, f"group {group} of world {world} is perceived otherwise alone than with the others")


def outsiders_do_not_matter(trial: Trial) -> None:
    """A vehicle's map changes no view of a group without it, and changes the view of a group with it."""
    perturbed = trial.received.clone()
    perturbed[:, 1] = perturbed[:, 1] + 1
    with torch.no_grad():
        before, after = (
            trial.perceive([0, 0], [[0, 2], [0, 1, 2]], maps).logits for maps in (trial.received, perturbed)
        )
    require(torch.equal(before[0], after[0]), "a vehicle outside the group changed its view")
    require(bool((before[1] != after[1]).any()), "a member's map changed and the view did not")


def order_does_not_matter(trial: Trial) -> None:
    """The numbers of the others do not matter: only vehicle 0, the ego, is special."""
    turned = [0, 3, 1, 2]
    shuffled = Trial(trial.detector, trial.tolerance)
    shuffled.order = trial.order[:, turned]
    with torch.no_grad():
        a, b = trial.perceive([0], [[0, 1, 2]]), shuffled.perceive([0], [[0, 2, 3]])
    require(trial.is_close(a.logits, b.logits), "the same maps in another order are perceived otherwise")


def empty_groups_are_refused(trial: Trial) -> None:
    """A group of nobody is a ValueError."""
    try:
        trial.perceive([0, 0], [[0], []])
    except ValueError:
        return
    require(False, "a group of nobody was perceived")


def gradients_flow(trial: Trial) -> None:
    """Logits and boxes have a finite gradient in every member's map, before the warp, and none in an outsider's."""
    maps = trial.maps.detach().clone().requires_grad_()
    received = trial.detector.warp(maps[torch.from_numpy(trial.order)], trial.poses)
    for what in ("logits", "boxes"):
        dense = trial.perceive([0], [[0, 1, 3]], received)
        (gradient,) = torch.autograd.grad(getattr(dense, what).square().sum(), maps, retain_graph=True)
        require(bool(torch.isfinite(gradient).all()), f"the gradient of {what} is not finite")
        moved = gradient.flatten(1).any(1).tolist()
        require(moved[0] and moved[1] and moved[3], f"{what} have no gradient in a member's map")
        require(not moved[2], f"{what} have a gradient in the map of a vehicle outside the group")


def weights_are_frozen(trial: Trial) -> None:
    """A module is in evaluation mode, its weights ask for no gradient and stay what they are, and so do its buffers."""
    module = trial.detector
    if not isinstance(module, nn.Module):
        return
    require(not any(part.training for part in module.modules()), "it is in training mode: call freeze()")
    asking = [name for name, parameter in module.named_parameters() if parameter.requires_grad]
    require(not asking, f"parameters ask for a gradient: {', '.join(asking)}: call freeze()")
    before = {name: tensor.clone() for name, tensor in module.state_dict().items()}
    trial.detector.encode(trial.sweeps)
    changed = [name for name, tensor in module.state_dict().items() if not torch.equal(tensor, before[name])]
    require(not changed, f"encoding changed {', '.join(changed)}")


def detections_are_well_formed(trial: Trial) -> None:
    """One `Detections` a view: finite boxes [L, 5] of positive size inside the map, scores in (0, 1], best first."""
    rows = len(trial.rows[0])
    require(len(trial.found) == rows, f"detect gave {len(trial.found)} answers for {rows} views")
    for found in trial.found:
        require(isinstance(found, Detections), f"detect gave a {type(found).__name__}, not Detections")
        boxes, scores = np.asarray(found.boxes), np.asarray(found.scores)
        require(boxes.shape == (len(scores), 5) and scores.ndim == 1, f"{boxes.shape} boxes and {scores.shape} scores")
        require(bool(np.isfinite(boxes).all() and np.isfinite(scores).all()), "a box or score is not finite")
        require(bool((boxes[:, 2:4] > 0).all()), "a box has no area")
        require(bool((np.abs(boxes[:, :2]) <= EXTENT).all()), "a box lies outside the map")
        require(bool(((scores > 0) & (scores <= 1)).all()), "a score lies outside (0, 1]")
        require(bool((np.diff(scores) <= 0).all()), "boxes are not in order, best first")


def the_ego_is_not_reported(trial: Trial) -> None:
    """No box's centre is within half a metre of the ego, wherever in its grid frame it stands."""
    places = [(0.0, 0.0)]
    for found in trial.found:
        places += [(float(x), float(y)) for x, y in np.asarray(found.boxes)[:2, :2]]
    with torch.no_grad():
        dense = trial.perceive([0], [[0, 1, 2, 3]])
    for place in places:
        (found,) = trial.detector.detect(dense, np.array([place]))
        near = np.linalg.norm(np.asarray(found.boxes)[:, :2] - place, axis=1) < 0.5
        require(not near.any(), f"the ego, at {place} in its grid frame, is among the detections")


RULES: tuple[DetectorRule, ...] = (
    has_the_methods,
    weights_are_frozen,
    maps_are_shared_maps,
    encoding_is_deterministic,
    encoding_is_a_loop,
    warp_moves_whole_cells,
    warp_is_linear,
    coverage_says_where_maps_reach,
    views_are_finite,
    perceiving_is_deterministic,
    perceiving_is_a_loop,
    outsiders_do_not_matter,
    order_does_not_matter,
    empty_groups_are_refused,
    gradients_flow,
    detections_are_well_formed,
    the_ego_is_not_reported,
    digest_is_stable,
    digest_tells_weights_apart,
    maps_digest_tells_encoders_apart,
)


class DetectorRuleBroken(AssertionError):
    """A detector does not keep a rule; `rule` is its name."""

    def __init__(self, rule: DetectorRule, what: str) -> None:
        self.rule = rule.__name__
        super().__init__(f"{self.rule}: {what}\n  the rule: {rule.__doc__}")


def check_detector(detector: Any, *, tolerance: float = 1e-4, skip: Collection[str] = ()) -> tuple[str, ...]:
    """Check a detector against every rule.

    Args:
        detector: what should be a `DetectorLike`, frozen; on any device.
        tolerance: relative and absolute, where a batch may round otherwise than its rows do.
        skip: names of rules that do not apply.

    Returns:
        The names of the rules that were checked, all of them kept.

    Raises:
        DetectorRuleBroken: an `AssertionError` that names the first rule broken and says what happened.
        ValueError: an unknown name in `skip`.
    """
    known = {rule.__name__ for rule in RULES}
    if unknown := set(skip) - known:
        raise ValueError(f"no rules called {sorted(unknown)}; the rules are {sorted(known)}")
    rules = [rule for rule in RULES if rule.__name__ not in skip]
    trial = Trial(detector, tolerance)
    for rule in rules:
        try:
            rule(trial)
        except Violation as violation:
            raise DetectorRuleBroken(rule, str(violation)) from None
        except Exception as error:
            raise DetectorRuleBroken(rule, f"the detector raised {type(error).__name__}: {error}") from error
    return tuple(rule.__name__ for rule in rules)
