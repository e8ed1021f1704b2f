"""Laws of the batched world: its slow twin, its neighbours, its seeds, its victim, its memory."""

from __future__ import annotations

import hashlib
import pickle

import numpy as np
import pytest
import torch

from cp_env.detector import Detector
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Query, Verdict
from examples.bring_your_own_detector import Toy
from tests.reference.one_world import boxes_of, ego_view


class Curious(Defender):
    """Verifies every pair with vehicle 0 and two singles, fuses the group most similar to everyone."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.rng = n_vehicles, rng

    def inspect(self, frame: Frame) -> Inspection:
        groups = [{0, i} for i in range(1, self.n)] + [{int(i)} for i in self.rng.choice(self.n, 2, replace=False)]
        views = yield Query(groups)
        best = max(range(len(groups)), key=lambda i: frame.similarity(views[i], frame.seen))
        return Verdict(groups[best], set(range(self.n)) - groups[best])


def make(bank: SceneBank, num_envs: int = 1, **options: object) -> World:
    return World(num_envs, **{"defender": Curious(), "bank": bank, "max_frames": 6, **options})


def perturbations(world: World, frame: int, worlds: list[int] | None = None) -> torch.Tensor:
    """Random perturbations that depend on the world's own number and the frame only."""
    shape = (world.settings.k, world.detector.channels, world.detector.size, world.detector.size)
    numbers = range(world.num_envs) if worlds is None else worlds
    return torch.stack([torch.randn(shape, generator=torch.Generator().manual_seed(100 * e + frame)) for e in numbers])


def figures(outcome: Outcome, e: int) -> list[object]:
    return [
        sorted(outcome.verdicts[e].collaborators),
        outcome.attackers[e].tolist(),
        outcome.damage[e].item(),
        outcome.similarity[e].item(),
        outcome.verifications[e].item(),
        boxes_of(outcome.output[e]).round(3).tolist(),
    ]


def play(world: World, seeds: list[int], worlds: list[int] | None = None) -> list[list[list[object]]]:
    """`[world][frame]` of one episode."""
    world.reset(seeds)
    outcomes = [world.step(perturbations(world, t, worlds)) for t in range(6)]
    return [[figures(o, e) for o in outcomes] for e in range(world.num_envs)]


def test_step_agrees_with_the_formula_written_out(bank: SceneBank) -> None:
    world = make(bank, attackers=(0, 3), grace_frames=0)
    world.reset([5])
    name = world.places[0][0].scene.name
    for t in range(3):
        delta = perturbations(world, t)
        outcome = world.step(delta)
        sent = dict(zip((0, 3), delta[0], strict=True))
        for view in (outcome.seen[0], outcome.output[0]):
            twin = ego_view(bank.detector, bank.source, name, t, view.group, sent, budget=0.3)
            np.testing.assert_allclose(view.score_map, twin.score_map, atol=1e-3)  # half precision on the way
        unattacked = ego_view(bank.detector, bank.source, name, t, outcome.clean[0].group, {}, budget=0.3)
        np.testing.assert_allclose(outcome.clean[0].score_map, unattacked.score_map, atol=3e-3)


def test_a_world_in_a_batch_lives_as_it_would_alone(bank: SceneBank) -> None:
    together = play(make(bank, 3), [7, 8, 9])
    for e, seed in enumerate([7, 8, 9]):
        assert play(make(bank), [seed], [e]) == [together[e]]


def test_resetting_one_world_does_not_disturb_another(bank: SceneBank) -> None:
    world = make(bank, 2)
    expected = play(world, [1, 2])[1]
    world.reset([1, 2])
    outcomes = []
    for t in range(6):
        if t == 3:
            world.reset([5], [0])
        outcomes.append(figures(world.step(perturbations(world, t)), 1))
    assert outcomes == expected


def test_same_seed_same_life_and_other_seeds_other_lives(bank: SceneBank) -> None:
    assert play(make(bank), [0]) == play(make(bank), [0])
    drawn = {play(make(bank), [s])[0][0][1].__repr__() for s in range(12)}
    assert len(drawn) > 3, "attackers must be drawn anew"


def test_reset_without_a_seed_goes_on_with_the_stream(bank: SceneBank) -> None:
    streams = []
    for _ in range(2):
        world = make(bank)
        world.reset([3])
        drawn = [world.attackers.tolist()]
        for _ in range(8):
            world.reset()
            drawn.append(world.attackers.tolist())
        streams.append(drawn)
    assert streams[0] == streams[1]
    assert len({str(d) for d in streams[0]}) > 3


def test_the_ego_is_among_the_attackers_as_often_as_anyone(bank: SceneBank) -> None:
    world = make(bank)
    world.reset([0])
    counts = np.zeros(5)
    for _ in range(400):
        world.reset()
        counts[world.attackers[0]] += 1
    assert (np.abs(counts / 400 - 0.4) < 4 * np.sqrt(0.4 * 0.6 / 400)).all(), counts


@pytest.mark.parametrize("norm", ["linf", "l2"])
def test_no_perturbation_exceeds_the_budget_and_none_passes_in_grace(bank: SceneBank, norm: str) -> None:
    world = make(bank, norm=norm, budget=0.2, grace_frames=2, defender="none")
    world.reset([0])
    for t in range(4):
        outcome = world.step(100 * perturbations(world, t))
        if t < 2:
            assert not outcome.perturbation_norm.any()
            assert outcome.damage[0] == pytest.approx(0.0, abs=0.1)  # the clean view went through half precision
        else:
            np.testing.assert_allclose(outcome.perturbation_norm, 0.2, rtol=1e-4)


def test_perturbations_do_damage_and_the_oracle_undoes_it(bank: SceneBank) -> None:
    total = {}
    for defender in ("none", "oracle"):
        world = make(bank, defender=defender, budget=3.0, grace_frames=0)
        world.reset([4])
        total[defender] = sum(float(world.step(3 * perturbations(world, t).sign()).damage[0]) for t in range(4))
    assert total["none"] > total["oracle"] + 0.5


def test_the_victim_is_frozen(bank: SceneBank) -> None:
    def fingerprint(detector: Detector) -> str:
        sha = hashlib.sha256()
        for tensor in (*detector.parameters(), *detector.buffers()):
            sha.update(tensor.numpy().tobytes())
        return sha.hexdigest()

    before = fingerprint(bank.detector)
    play(make(bank, 2), [0, 1])
    assert fingerprint(bank.detector) == before
    assert not bank.detector.training
    assert not any(p.requires_grad for p in bank.detector.parameters())


def test_pickling_between_frames_changes_nothing(bank: SceneBank) -> None:
    world = make(bank, 2, defender="prbi", grace_frames=0)
    world.reset([1, 2])
    world.step(perturbations(world, 0))
    twin = pickle.loads(pickle.dumps(world))
    for t in range(1, 6):
        a, b = world.step(perturbations(world, t)), twin.step(perturbations(world, t))
        assert [figures(a, e) for e in range(2)] == [figures(b, e) for e in range(2)]


def test_a_failing_defender_ends_its_episode_only(bank: SceneBank) -> None:
    class Fragile(Curious):
        def inspect(self, frame: Frame) -> Inspection:
            if frame.index == 1 and self.rng.random() < 0.5:
                raise RuntimeError("broken")
            return (yield from super().inspect(frame))

    world = make(bank, 6, defender=Fragile())
    world.reset(list(range(6)))
    world.step(perturbations(world, 0))
    outcome = world.step(perturbations(world, 1))
    failed = np.array([error is not None for error in outcome.errors])
    assert failed.any()
    assert not failed.all()
    assert np.array_equal(outcome.truncated, failed)
    message = next(error for error in outcome.errors if error)
    assert "Fragile" in message
    assert "broken" in message


@pytest.mark.parametrize(
    ("delta", "message"),
    [
        (torch.zeros(1, 2, 3, 4, 4), r"shape \[E, k, C, H, W\] = \(1, 2, 128, 32, 32\)"),
        (torch.full((1, 2, 128, 32, 32), float("nan")), r"finite"),
    ],
)
def test_bad_perturbations_are_refused(bank: SceneBank, delta: torch.Tensor, message: str) -> None:
    world = make(bank)
    world.reset([0])
    with pytest.raises(ValueError, match=message):
        world.step(delta)


def test_options_fix_the_place_and_bad_ones_are_refused(bank: SceneBank) -> None:
    world = make(bank, max_frames=2)
    world.reset([0], options={"scene": "toy-1", "start": 3})
    assert (world.places[0][0].scene.name, world.places[0][1]) == ("toy-1", 3)
    with pytest.raises(ValueError, match="start must be a frame"):
        world.reset([0], options={"start": 99})


def test_the_time_limit_truncates_exactly(bank: SceneBank) -> None:
    world = make(bank, max_frames=4, defender="none")
    world.reset([0])
    ends = [bool(world.step(perturbations(world, t)).truncated[0]) for t in range(4)]
    assert ends == [False, False, False, True]


def test_stepping_before_reset_is_a_clear_error(bank: SceneBank) -> None:
    with pytest.raises(RuntimeError, match=r"reset\(\)"):
        make(bank).situation()


def test_defenders_are_told_how_the_ego_fuses(bank: SceneBank) -> None:
    """By the detector, or by the settings where it does not say; before the first reset, every world's own."""

    class Listener(Curious):
        configured: tuple[str, ...] = ()

        def configure(self, *, fusion: str) -> None:
            self.configured += (fusion,)

    class Mute(SceneBank):
        """A bank whose detector has no fusion of that name."""

        def __init__(self) -> None:
            self.__dict__.update(bank.__dict__)
            self.detector = Toy().freeze()

    prototype = Listener()
    for own, fusion, expected in ((bank, "max", "mean"), (Mute(), "max", "max")):
        world = make(own, 2, defender=prototype, fusion=fusion)
        assert [defender.configured for defender in world.defenders] == [(expected,)] * 2  # type: ignore[attr-defined]
    assert prototype.configured == ()
