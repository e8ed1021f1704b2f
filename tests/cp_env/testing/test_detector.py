"""Every rule for detectors can fail: for each there are mutants of a lawful detector that break it before any other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from cp_env.detector import Dense, load_detector
from cp_env.detector.coperception import CoperceptionDetector
from cp_env.detector.coperception.checkpoint import Weights
from cp_env.detector.model.base import BaseDetector
from cp_env.detector.protocol import DetectorLike
from cp_env.testing import DetectorRuleBroken, check_detector
from cp_env.testing.detector import RULES
from cp_env.types import Detections, Sweep
from examples.bring_your_own_detector import Toy
from tests.reference import coperception as twin

ALL = tuple(rule.__name__ for rule in RULES)
MUTANTS: list[tuple[str, type[Toy]]] = []


def breaks(rule: Callable[..., None] | str) -> Callable[[type[Toy]], type[Toy]]:
    """Enter a mutant into the list, with the rule it breaks."""

    def enter(mutant: type[Toy]) -> type[Toy]:
        MUTANTS.append((str(rule), mutant))
        return mutant

    return enter


def frozen(kind: type[Toy]) -> BaseDetector:
    return kind().freeze()


@breaks("has_the_methods")
class OtherGround(Toy):
    extent = 51.2


@breaks("has_the_methods")
class NoThreshold(Toy):
    threshold = 7.0


@breaks("has_the_methods")
class Voiceless(Toy):
    detect = None  # type: ignore[assignment]


@breaks("weights_are_frozen")
class StillTraining(Toy):
    def freeze(self) -> BaseDetector:
        return self.requires_grad_(False).train()


@breaks("weights_are_frozen")
class Trainable(Toy):
    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))

    def freeze(self) -> BaseDetector:
        return self.eval()


@breaks("weights_are_frozen")
class Learns(Toy):
    """A running mean that runs on."""

    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        maps = super().encode(sweeps)
        self.evidence += 0.01 * maps.mean()
        return maps


@breaks("maps_are_shared_maps")
class OneMapShort(Toy):
    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        return super().encode(sweeps)[:-1]


@breaks("maps_are_shared_maps")
class Overflows(Toy):
    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        return super().encode(sweeps) * 1e6


@breaks("maps_are_shared_maps")
class Blind(Toy):
    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        return super().encode([sweeps[0]] * len(sweeps))


@breaks("encoding_is_deterministic")
class Noisy(Toy):
    def __init__(self) -> None:
        super().__init__()
        self.generator = torch.Generator().manual_seed(0)

    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        maps = super().encode(sweeps)
        return maps + 1e-6 * torch.rand(maps.shape, generator=self.generator)


@breaks("encoding_is_a_loop")
class NormalisedByTheBatch(Toy):
    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        maps = super().encode(sweeps)
        return maps / maps.mean(0, keepdim=True).clamp(min=0.1)


@breaks("warp_moves_whole_cells")
class Mirrored(Toy):
    """East taken for west."""

    def warp(self, maps: Tensor, ego_T_sender: Tensor) -> Tensor:
        return super().warp(maps, ego_T_sender * ego_T_sender.new_tensor([-1, 1, 1]))


@breaks("warp_moves_whole_cells")
class Transposed(Toy):
    """Rows taken for columns."""

    def warp(self, maps: Tensor, ego_T_sender: Tensor) -> Tensor:
        return super().warp(maps, ego_T_sender[..., [1, 0, 2]])


@breaks("warp_moves_whole_cells")
class Blurred(Toy):
    def warp(self, maps: Tensor, ego_T_sender: Tensor) -> Tensor:
        return super().warp(maps, ego_T_sender + 1e-2)


@breaks("warp_is_linear")
class Rectified(Toy):
    """Invisible on maps that are nowhere negative."""

    def warp(self, maps: Tensor, ego_T_sender: Tensor) -> Tensor:
        return super().warp(maps, ego_T_sender).relu()


@breaks("coverage_says_where_maps_reach")
class EverywhereAtOnce(Toy):
    def coverage(self, ego_T_sender: Tensor) -> Tensor:
        return torch.ones_like(super().coverage(ego_T_sender))


@breaks("coverage_says_where_maps_reach")
class FromTheOtherSide(Toy):
    def coverage(self, ego_T_sender: Tensor) -> Tensor:
        return super().coverage(-ego_T_sender)


class Seeing(Toy):
    """A hook on what is perceived."""

    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return self.change(super().perceive(received, coverage, world, groups), received, world, groups)

    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        raise NotImplementedError


@breaks("views_are_finite")
class DividesByTheNumberOfOthers(Seeing):
    """Undefined for a group of one."""

    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return replace(dense, logits=dense.logits / (groups.sum(1) - 1)[:, None, None])


@breaks("views_are_finite")
class HalfAView(Seeing):
    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return Dense(dense.logits[:, :32], dense.boxes[:, :, :32])


@breaks("perceiving_is_deterministic")
class Drops(Seeing):
    """Dropout that was left on."""

    def __init__(self) -> None:
        super().__init__()
        self.calls = itertools.count(1)

    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return replace(dense, logits=dense.logits + 1e-6 * next(self.calls))


@breaks("perceiving_is_a_loop")
class ComparesViews(Seeing):
    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return replace(dense, logits=dense.logits - dense.logits.mean(0))


@breaks("perceiving_is_a_loop")
class SeesTheFirstWorldOnly(Toy):
    """Right as long as there is only one."""

    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return super().perceive(received, coverage, world[:1].expand_as(world), groups)


@breaks("outsiders_do_not_matter")
class HearsEveryone(Seeing):
    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return replace(dense, logits=dense.logits + 1e-3 * received[world].mean((1, 2, 3, 4))[:, None, None])


@breaks("outsiders_do_not_matter")
class HearsNobody(Toy):
    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return super().perceive(received[:, :1].expand_as(received), coverage[:, :1].expand_as(coverage), world, groups)


@breaks("order_does_not_matter")
class PrefersTheFirst(Toy):
    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        weight = torch.tensor([1.0, 0.9, 0.8, 0.7])[:, None, None, None]
        return super().perceive(received * weight, coverage, world, groups)


@breaks("empty_groups_are_refused")
class TakesNobody(Toy):
    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return super().perceive(received, coverage, world, groups | ~groups.any(1, keepdim=True))


@breaks("gradients_flow")
class Detached(Toy):
    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return super().perceive(received.detach(), coverage, world, groups)


@breaks("gradients_flow")
class TrustsTheEgo(Toy):
    """The ego's own map as if it could not be perturbed."""

    def perceive(self, received: Tensor, coverage: Tensor, world: Tensor, groups: Tensor) -> Dense:
        ego, others = received[:, :1].detach(), received[:, 1:]
        return super().perceive(torch.cat([ego, others], dim=1), coverage, world, groups)


@breaks("gradients_flow")
class InfinitelySteep(Seeing):
    """The square root of what may be nothing."""

    def change(self, dense: Dense, received: Tensor, world: Tensor, groups: Tensor) -> Dense:
        return replace(dense, logits=dense.logits + (dense.logits - dense.logits.detach()).abs().sqrt())


class Finding(Toy):
    """A hook on what is detected."""

    def detect(self, dense: Dense, own: np.ndarray | None = None) -> list[Detections]:
        return [self.change(found) for found in super().detect(dense, own)]

    def change(self, found: Detections) -> Detections:
        raise NotImplementedError


@breaks("detections_are_well_formed")
class WorstFirst(Finding):
    def change(self, found: Detections) -> Detections:
        return Detections(found.boxes[::-1], found.scores[::-1])


@breaks("detections_are_well_formed")
class Logits(Finding):
    def change(self, found: Detections) -> Detections:
        return Detections(found.boxes, 10 * found.scores)


@breaks("detections_are_well_formed")
class InsideOut(Finding):
    def change(self, found: Detections) -> Detections:
        return Detections(found.boxes * np.array([1, 1, -1, 1, 1], np.float32), found.scores)


@breaks("detections_are_well_formed")
class OneViewOnly(Toy):
    def detect(self, dense: Dense, own: np.ndarray | None = None) -> list[Detections]:
        return super().detect(dense, own)[:1]


@breaks("the_ego_is_not_reported")
class SeesItself(Toy):
    def detect(self, dense: Dense, own: np.ndarray | None = None) -> list[Detections]:
        return super().detect(dense, None if own is None else np.full_like(own, 1e3))


@breaks("the_ego_is_not_reported")
class StandsAtTheOrigin(Toy):
    """Wrong by up to a metre: a grid frame's origin is a lattice point, not the ego."""

    def detect(self, dense: Dense, own: np.ndarray | None = None) -> list[Detections]:
        return super().detect(dense)


@breaks("digest_is_stable")
class CountsItsDigests(Toy):
    def __init__(self) -> None:
        super().__init__()
        self.calls = itertools.count()

    @property
    def digest(self) -> str:
        return f"toy{next(self.calls)}"


@breaks("digest_is_stable")
class HasAPath(Toy):
    @property
    def digest(self) -> str:
        return "weights/epoch 100"


@breaks("digest_tells_weights_apart")
class NamedNotHashed(Toy):
    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))

    @property
    def digest(self) -> str:
        return "toy1"


@breaks("maps_digest_tells_encoders_apart")
class ClaimsEveryonesMaps(Toy):
    def __init__(self) -> None:
        super().__init__()
        self.scale = torch.nn.Parameter(torch.ones(1))

    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        return self.scale * super().encode(sweeps)

    @property
    def maps_digest(self) -> str:
        return "toys"


@pytest.mark.parametrize(("rule", "mutant"), MUTANTS, ids=[mutant.__name__ for _, mutant in MUTANTS])
def test_a_mutant_breaks_its_rule(rule: str, mutant: type[Toy]) -> None:
    with pytest.raises(DetectorRuleBroken) as caught:
        check_detector(frozen(mutant))
    assert caught.value.rule == rule, str(caught.value)
    assert "the rule: " in str(caught.value)


def test_every_rule_has_a_mutant() -> None:
    assert {rule for rule, _ in MUTANTS} == set(ALL)


@pytest.mark.parametrize("make", [lambda: frozen(Toy), load_detector], ids=["toy", "ours"])
def test_lawful_detectors_keep_every_rule(make: Callable[[], DetectorLike]) -> None:
    detector = make()
    assert isinstance(detector, DetectorLike)
    assert check_detector(detector) == ALL


@pytest.mark.slow
def test_so_does_coperception() -> None:
    """All but one that its ten million weights would make long; `test_coperception` checks its digest."""
    detector = CoperceptionDetector(Weights(twin.random_state("max"), "a checkpoint"), "max", 3, "affine")
    skipped = "digest_tells_weights_apart"
    assert check_detector(detector, skip=[skipped]) == tuple(name for name in ALL if name != skipped)


def test_what_raises_is_named() -> None:
    class Broken(Toy):
        def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
            raise RuntimeError("no such kernel")

    with pytest.raises(DetectorRuleBroken, match="the detector raised RuntimeError: no such kernel"):
        check_detector(frozen(Broken))


def test_rules_can_be_skipped_by_name_only() -> None:
    kept: Any = check_detector(frozen(Toy), skip=["gradients_flow"])
    assert "gradients_flow" not in kept and len(kept) == len(ALL) - 1
    with pytest.raises(ValueError, match=r"no rules called \['gradient_flows'\]; the rules are .*gradients_flow"):
        check_detector(frozen(Toy), skip=["gradient_flows"])
