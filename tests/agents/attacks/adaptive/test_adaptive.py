"""Attackers that know the defence keep their own promises: on random situations, and on real scenes under PRBI."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
import torch

import agents
from agents.attacks.adaptive import eot, framing
from agents.attacks.adaptive.blind_area import seen_by_ego, unseen
from agents.attacks.adaptive.ramp import Ramp
from agents.attacks.objectives.scene_target import Picture, both, crossings, remembered
from agents.attacks.timed import Timed
from cp_env.detector import load_detector
from cp_env.geometry.planar import grid_origin
from cp_env.scenes import open_source
from cp_env.scenes.clip import Clip
from cp_env.world.counterfactual import alike, foresee
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome
from cp_env.world.verification import Judgement
from cp_env.world.world import World
from defenders.protocol import Defender, Frame, Inspection, Verdict
from tests.helpers import situations

MODEL = situations.detector()
FRAMES = 5
SCENES = ("calibration-urban-00", "calibration-intersection-00")


@pytest.fixture(scope="module")
def street() -> SceneBank:
    return SceneBank(Clip(open_source("town/calibration"), frames=FRAMES), load_detector(), progress=False)


def play(
    street: SceneBank, attack: Any, defender: Any = "prbi", seed: int = 1, frames: int = FRAMES, **knobs: Any
) -> list[Outcome]:
    """Both scenes in lock-step, two liars of five, none of them the ego."""
    own = {key: knobs.pop(key) for key in ("grace_frames", "attackers") if key in knobs}
    world = World(2, defender=defender, bank=street, **({"attackers": (1, 2), "max_frames": FRAMES} | own))
    for e, scene in enumerate(SCENES):
        world.reset([seed + e], [e], options={"scene": scene, "start": 0})
    attacker = agents.make(attack, **({"steps": 5} | knobs)) if isinstance(attack, str) else attack
    attacker.reset(2, [np.random.default_rng(seed + e) for e in range(2)])
    return [world.step(attacker.act(world.situation())) for _ in range(frames)]


def damage(outcomes: Sequence[Outcome]) -> float:
    return float(np.mean([outcome.damage for outcome in outcomes]))


def act(name: str, situation: Any, seed: int = 0, **knobs: Any) -> torch.Tensor:
    attacker = agents.make(name, **knobs)
    attacker.reset(len(situation.active), np.random.default_rng(seed))
    return attacker.act(situation)


# -- the defender in the loop ------------------------------------------------------------------------------------------


def test_in_loop_never_shows_anything_below_the_threshold_and_does_more_damage_for_it(street: SceneBank) -> None:
    outcomes = play(street, "in_loop", threshold=0.35, margin=0.05)
    assert min(o.similarity.min() for o in outcomes[1:]) >= 0.35
    assert not any(o.verifications.any() for o in outcomes), "PRBI has no reason to look"
    assert damage(outcomes) > 1.5 * damage(play(street, "pgd"))


def test_a_stricter_threshold_buys_likeness_for_damage(street: SceneBank) -> None:
    loose, strict = (play(street, "in_loop", "none", frames=2, threshold=t)[1] for t in (0.2, 0.75))
    assert loose.damage.mean() > strict.damage.mean() + 0.1
    assert strict.similarity.min() >= 0.7 > loose.similarity.mean()


def test_in_loop_against_the_egos_own_view(street: SceneBank) -> None:
    outcomes = play(street, "in_loop", "robosac", frames=3, reference="ego", threshold=0.3)
    fused = [len(verdict.collaborators) for outcome in outcomes for verdict in outcome.verdicts]
    assert np.mean(np.array(fused) == 5) >= 0.9, "everyone's view passes, liars and all"


# -- pictures, ramps, poison -------------------------------------------------------------------------------------------


def test_foresight_is_what_the_world_then_computes(street: SceneBank) -> None:
    world = World(2, defender="none", bank=street, attackers=(0, 3), grace_frames=0, max_frames=FRAMES)
    world.reset([3, 4])
    everyone = [(e, frozenset(range(5))) for e in range(2)]
    for _ in range(2):
        situation = world.situation()
        delta = act("pgd", situation, steps=2)
        views = foresee(situation, delta, everyone)
        likeness = alike(views, situation.output)
        outcome = world.step(delta)
        np.testing.assert_allclose(likeness, outcome.similarity, atol=1e-6)
        for view, seen in zip(views, outcome.seen, strict=True):
            np.testing.assert_allclose(view.score_map, seen.score_map, atol=1e-5)


def test_ghosts_stand_still_in_the_world_while_the_ego_drives() -> None:
    situation = situations.situation(MODEL, place=np.array([[0.0, 0.0], [37.3, -12.9]]))
    here, there = crossings(12.0)(situation)
    for boxes, place in ((here, situation.place[0]), (there, situation.place[1])):
        assert len(boxes) > 9 and (np.abs(boxes[:, :2]) <= MODEL.extent).all()
        crossing = (boxes[:, :2] + grid_origin(place)) / 12.0
        np.testing.assert_allclose(crossing, crossing.round(), atol=1e-4)
    assert both(crossings(12.0), crossings(12.0))(situation)[0].shape == here.shape
    with pytest.raises(ValueError, match="spacing=3"):
        crossings(3.0)


def test_a_picture_is_best_when_it_is_what_is_seen() -> None:
    """Of all views, the one that shows the picture's cars and nothing else has the highest score."""
    situation = situations.situation(MODEL, n_worlds=1)
    views = situations.views(situation)
    score = Picture(crossings(12.0))(views)
    drawn = Picture(crossings(12.0))._drawn(views)
    shown = situations.dense(drawn)
    best = score(shown)
    for worse in (situations.dense(drawn, logit=-1.0), situations.dense(drawn, elsewhere=2.0), situation.clean):
        assert (score(worse) < best - 1).all()


def test_in_the_first_frame_the_honest_view_is_what_is_remembered(street: SceneBank) -> None:
    world = World(1, defender="none", bank=street, max_frames=FRAMES)
    world.reset([3])
    clean = world.places[0][0].clean_views[world.places[0][1]]
    np.testing.assert_allclose(remembered(world.situation())[0], clean.seen.boxes, atol=0.05)
    outcome = world.step(act("none", world.situation()))
    place = world.situation().place[0]
    motion = outcome.output[0].origin - grid_origin(place)
    expected = outcome.output[0].seen.boxes[:, :2] + motion
    np.testing.assert_allclose(remembered(world.situation())[0][:, :2], expected, atol=1e-4)


def test_a_ramp_grows_by_its_rate_and_no_faster(street: SceneBank) -> None:
    share = Ramp(rate=0.15, first=0.1, onset=2, ceiling=0.6)(np.arange(10))
    np.testing.assert_allclose(share, [0, 0, 0.1, 0.25, 0.4, 0.55, 0.6, 0.6, 0.6, 0.6], atol=1e-6)
    norms = np.array([o.perturbation_norm for o in play(street, "ramp", rate=0.15, first=0.1)])
    assert (np.diff(norms, axis=0) <= 0.15 * 0.3 + 1e-6).all() and (norms[-1] > norms[2]).all()
    with pytest.raises(ValueError, match="rate=0"):
        Ramp(rate=0.0)


def test_poison_lies_in_the_first_frame_and_is_normal_ever_after(street: SceneBank) -> None:
    outcomes = play(street, "poison", grace_frames=0)
    assert outcomes[0].damage.min() > 0.5
    assert min(o.similarity.min() for o in outcomes[1:]) >= 0.35
    assert damage(outcomes) > 0.8 and not any(o.verifications.any() for o in outcomes)


# -- coalitions --------------------------------------------------------------------------------------------------------


def test_the_silent_ones_send_nothing_until_the_verdict_has_converged(street: SceneBank) -> None:
    outcomes = play(street, "sacrifice")
    settled = np.array([[v.converged and 2 not in v.collaborators for v in o.verdicts] for o in outcomes])
    spoke = np.array([o.perturbation_norm[:, 0] > 0 for o in outcomes])
    assert settled.any() and spoke.any(), "the test needs a verdict that converges"
    assert np.array_equal(spoke[1:], settled[:-1]) and not spoke[0].any()


def test_framing_convicts_its_victim_more_often_than_pgd_an_innocent(street: SceneBank) -> None:
    framed: list[bool] = []
    for seed in (1, 2):
        attacker = framing.Framing(draws=1, steps=5)
        verdicts = play(street, attacker, seed=seed)[-1].verdicts
        framed += [victim in v.suspects for victim, v in zip(attacker.victims, verdicts, strict=True)]
    assert np.mean(framed) >= 0.75
    by_pgd = [len(v.suspects - {1, 2}) / 3 for seed in (1, 2) for v in play(street, "pgd", seed=seed)[-1].verdicts]
    assert np.mean(framed) > np.mean(by_pgd) + 0.2


def test_a_look_speaks_against_whom_it_would_convict() -> None:
    def judged(*groups: set[int], suspects: tuple[int, ...] = ()) -> Judgement:
        view = situations.rehearse(torch.zeros(1), [np.random.default_rng(0)]).judgements[0].output
        return Judgement(Verdict(range(5), suspects), view, tuple(frozenset(g) for g in groups), len(groups))

    liars = frozenset({1, 2})
    held = framing.held_against
    assert held(3, judged({1, 3}, {0, 2, 4}), frozenset({1}), liars) == 2  # it fails, and 2 is cleared
    assert held(3, judged({1, 4}, {0, 2, 3}), frozenset({1}), liars) == -2  # the victim is cleared
    assert held(3, judged({3}, suspects=(3,)), frozenset({1}), liars) == 0  # alone and accused all the same
    assert held(3, judged(suspects=(1,)), frozenset({1}), liars) == -0.5
    assert framing.subsets(2) == [(0,), (1,), (0, 1)]


def test_the_victim_is_innocent_and_stays_the_same() -> None:
    situation = situations.situation(MODEL, attackers=torch.tensor([[1, 2], [0, 3]]))
    attacker = framing.Framing(victim=1)
    attacker.reset(2, np.random.default_rng(0))
    assert [attacker._candidates(situation, e) for e in range(2)] == [[3], [1]]
    attacker = framing.Framing()
    attacker.reset(2, np.random.default_rng(0))
    assert [attacker._candidates(situation, e) for e in range(2)] == [[0, 3], [1, 2]]
    attacker.victims = [3, 0]
    assert [attacker._candidates(situation, e) for e in range(2)] == [[3], [1, 2]], "0 lies in this episode"


# -- groups, places, times ---------------------------------------------------------------------------------------------


def test_the_groups_of_each_defence() -> None:
    assert [sorted(g) for g in eot.teams(4, 2)] == [[0, 1], [0, 2], [0, 3]]
    assert {frozenset({0, 1}), frozenset({0, 2, 3})} <= set(eot.halves(4))
    assert len(eot.halves(5)) == 6 and all(0 in g and len(g) == 3 for g in eot.halves(5))
    assert len(eot.splits(5, 2)) == 20 and frozenset({0, 1, 2}) in eot.splits(5, 2)
    groups, weights = eot.crowd(
        situations.situation(MODEL), [[frozenset({0})] * 3 + [frozenset({1, 2})], [frozenset({3})]]
    )
    assert weights[:, :2].tolist() == [[0.75, 0.25], [1.0, 0.0]] and not weights[:, 2:].any()
    assert groups[0, :2].int().tolist() == [[1, 0, 0, 0], [0, 1, 1, 0]]
    with pytest.raises(ValueError, match="no teams of size 9"):
        act("eot", situations.situation(MODEL), groups="teams", size=9)


def test_expectation_over_teams_beats_everyone_on_the_worst_team() -> None:
    situation = situations.situation(MODEL, n_worlds=4)
    audience = eot.drawn_from("teams", 2)
    plain, expected = (
        situations.value(situation, act(name, situation, **knobs), audience=audience).mean()
        for name, knobs in (("bim", {}), ("eot", {"groups": "teams", "size": 2, "random_start": False}))
    )
    assert expected > plain


def test_blind_liars_touch_only_what_the_ego_has_not_seen() -> None:
    situation = situations.situation(MODEL)
    seen, free = seen_by_ego(situation), unseen(situation)
    assert not seen[:, :, :6].any() and seen[:, :, 9:].any()
    delta = act("blind", situation, audience="everyone")
    touched = delta.abs().amax(2) > 0
    assert free.any() and not free.all() and touched.any()
    assert not (touched & ~free).any()
    pose = torch.take_along_dim(situation.ego_T_sender, situation.attackers[..., None], 1)
    arrived = MODEL.warp(delta, pose).abs().amax(2) > 1e-6
    assert not (arrived & seen[:, None]).any()


def test_any_attacker_on_a_timetable() -> None:
    frames = [situations.situation(MODEL, frame=np.array([t, t])) for t in range(8)]

    def spoke(**timetable: Any) -> np.ndarray:
        attacker = agents.make("noise", **timetable)
        assert isinstance(attacker, Timed)
        attacker.reset(2, np.random.default_rng(0))
        return np.array([attacker.act(frame).flatten(1).any(1).tolist() for frame in frames])

    assert spoke(every=3)[:, 0].tolist() == [True, False, False] * 2 + [True, False]
    assert spoke(start=5)[:, 1].tolist() == [False] * 5 + [True] * 3
    half = spoke(duty=0.5)
    assert 0 < half.mean() < 1 and not np.array_equal(half[:, 0], half[:, 1]) and np.array_equal(half, spoke(duty=0.5))
    with pytest.raises(ValueError, match="duty"):
        agents.make("pgd", duty=0.0)


class Watchful(Defender):
    """Would notice an attacker who changes it."""

    def reset(self, n_vehicles: int, rng: np.random.Generator) -> None:
        self.n, self.frames = n_vehicles, 0

    def inspect(self, frame: Frame) -> Inspection:
        yield from ()
        self.frames += 1
        assert self.frames == frame.index + 1, "somebody judged with this very object in between"
        return Verdict(range(self.n))


@pytest.mark.parametrize("attack", ["eot", "framing"])
def test_rehearsing_never_touches_the_defender(street: SceneBank, attack: str) -> None:
    assert not any(error for o in play(street, attack, Watchful(), steps=1) for error in o.errors)


@pytest.mark.parametrize(
    ("attack", "knobs", "message"),
    [
        ("in_loop", {"reference": "truth"}, "output, ego"),
        ("in_loop", {"threshold": 0.9, "margin": 0.2}, r"\[0, 1\]"),
        ("in_loop", {"groups": "pairs"}, "teams, halves, splits"),
        ("eot", {"groups": "pairs"}, "teams, halves, splits"),
        ("eot", {"draws": 0}, "draws"),
        ("framing", {"victim": -1}, "victim"),
        ("poison", {"colour": 1}, "poison"),
        ("ramp", {"first": 2.0}, "first=2"),
    ],
)
def test_bad_knobs_are_refused(attack: str, knobs: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        agents.make(attack, **knobs)


def test_the_loop_pauses_while_no_view_has_a_liar_in_it(street: SceneBank) -> None:
    outcomes = play(street, "in_loop", "oracle", frames=3, rungs=2)
    assert not any(outcome.perturbation_norm.any() for outcome in outcomes)
    assert all(not outcome.judgements[e].verdict.collaborators & {1, 2} for outcome in outcomes for e in range(2))
