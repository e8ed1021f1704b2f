from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import agents
from agents.learning import training
from agents.learning.callbacks import read_curve
from agents.learning.policy import load_policy
from agents.learning.rollout import Episodes, play
from agents.learning.sweep import Line, TrainingRun, keep, plan_sweep, slug, strongest, summarise, sweep, write_table
from agents.learning.training import Recipe, train
from cp_env.envs.reward import make_reward
from cp_env.evaluation import Conditions, Rollout, Run
from cp_env.world.scene_cache import SceneBank
from tests.agents.conftest import FRAMES

SMALL = Recipe(
    frames=12,
    worlds=2,
    every=1,
    max_frames=FRAMES,
    n_scenes=2,
    n_holdout=2,
    n_steps=FRAMES,
    batch_size=6,
    n_epochs=2,
)


class Killed(Exception):
    pass


@pytest.fixture(autouse=True)
def toy(bank: SceneBank, monkeypatch: pytest.MonkeyPatch) -> None:
    """Segments of six frames on the toy crossings."""
    monkeypatch.setattr(training, "open_bank", lambda *_: bank)


def conditions(bank: SceneBank) -> Conditions:
    return Conditions(scenes=bank.source, names=bank.source.names(), frames=FRAMES)


def files(folder: Path) -> dict[str, bytes]:
    names = ("policy.safetensors", "curve.json", "recipe.json")
    return {name: (folder / name).read_bytes() for name in names}


@pytest.mark.parametrize("options", [{}, {"joint": True, "knowledge": "white-box", "recurrent": True}], ids=str)
def test_a_killed_run_goes_on_as_if_nothing_had_happened(tmp_path: Path, options: dict[str, object]) -> None:
    if "recurrent" in options:
        pytest.importorskip("sb3_contrib")
    recipe = replace(SMALL, **options)
    curve = train(recipe, tmp_path / "whole")
    assert [evaluation["frames"] for evaluation in curve] == [0, 6, 12]

    def kill(frames: int) -> None:
        if frames == 8:
            raise Killed

    with pytest.raises(Killed):
        train(recipe, tmp_path / "killed", report_progress=kill)
    assert len(read_curve(tmp_path / "killed")) == 2
    seen: list[int] = []
    assert train(recipe, tmp_path / "killed", report_progress=seen.append) == curve
    assert seen == [8, 10, 12]  # the first segment is not played again
    assert files(tmp_path / "killed") == files(tmp_path / "whole")
    train(recipe, tmp_path / "killed", report_progress=kill)  # finished: nothing is left to do


def test_more_frames_go_on_and_another_recipe_is_refused(tmp_path: Path) -> None:
    train(replace(SMALL, frames=6), tmp_path / "grown")
    assert train(SMALL, tmp_path / "grown") == train(SMALL, tmp_path / "whole")
    with pytest.raises(ValueError, match="another seed, gamma; choose another folder"):
        train(replace(SMALL, seed=1, gamma=0.5), tmp_path / "grown")


def test_a_run_begins_where_a_policy_stands(bank: SceneBank, tmp_path: Path) -> None:
    train(SMALL, tmp_path / "first")
    policy = load_policy(tmp_path / "first" / "policy.safetensors")
    again = play(policy, conditions(bank), bank, defender="prbi")
    assert again.damage.mean() == pytest.approx(policy.notes["holdout_damage"])
    assert policy.notes["holdout_damage"] == max(evaluation["damage"] for evaluation in read_curve(tmp_path / "first"))
    assert (policy.defender, policy.joint, policy.options) == ("prbi", False, SMALL.options)
    frozen = replace(SMALL, begin=str(tmp_path / "first" / "policy.safetensors"), learning_rate=0.0, frames=6)
    train(frozen, tmp_path / "second")
    same = load_policy(tmp_path / "second" / "policy.safetensors")
    assert all((mine == theirs).all() for mine, theirs in zip(same.weights, policy.weights, strict=True))


def test_the_policy_to_keep_is_chosen_by_what_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reward `critical` asks for critical recall lost: here the policy in the middle, which does least damage."""
    recipe = replace(SMALL, action="critical", reward="critical")
    found = iter([(0.3, 0.1), (0.1, 0.4), (0.2, 0.2)])

    def invented(*_: object, **__: object) -> Episodes:
        damage, critical = next(found)
        ones = np.ones(2)
        return Episodes(damage * ones, ones, ones, ones, ones, critical * ones)

    monkeypatch.setattr(training, "play", invented)
    curve = train(recipe, tmp_path / "critical")
    notes = load_policy(tmp_path / "critical" / "policy.safetensors").notes
    assert [evaluation["critical"] for evaluation in curve] == [0.1, 0.4, 0.2]
    assert (notes["holdout_critical"], notes["holdout_damage"], notes["timesteps"]) == (0.4, 0.1, 12)
    found = iter([(0.3, 0.1), (0.1, 0.4), (0.2, 0.2)])
    train(replace(recipe, reward="damage"), tmp_path / "damage")
    notes = load_policy(tmp_path / "damage" / "policy.safetensors").notes
    assert (notes["holdout_damage"], notes["timesteps"]) == (0.3, 0) and "holdout_critical" not in notes


def test_lost_critical_recall_is_the_reward_of_the_episode(bank: SceneBank) -> None:
    """Per frame, as the environment pays it out."""
    attack, seen = agents.make("nearest_removal:steps=2"), conditions(bank)
    lost = play(attack, seen, bank, defender="none").critical
    rollout = Rollout(Run("none", "attack", 2, 0, seen.names), seen, bank, agents.make("nearest_removal:steps=2"))
    paid = np.mean([make_reward("critical")(rollout.step()) for _ in range(FRAMES)], axis=0)
    np.testing.assert_allclose(lost, paid, rtol=1e-6)


def test_bad_recipes_are_refused() -> None:
    with pytest.raises(ValueError, match="unknown defender"):
        Recipe(defender="nobody")
    with pytest.raises(ValueError, match="every must be at least 1, not 0"):
        Recipe(every=0)


def plan(root: Path) -> list[TrainingRun]:
    configurations = ["shared", "joint:joint=True,knowledge=white-box,frames=12"]
    base = replace(SMALL, frames=6)
    return plan_sweep(base, defenders=["prbi", "robosac"], configurations=configurations, seeds=[0], root=root)


def test_a_sweep_killed_and_resumed_gives_the_same_table(tmp_path: Path) -> None:
    whole, killed = plan(tmp_path / "whole"), plan(tmp_path / "killed")
    assert list(sweep(whole, 1)) == [6, 18, 24, 36]
    assert next(sweep(killed, 1)) == 6  # one run, then nobody asks for more
    train(replace(killed[1].recipe, frames=6), killed[1].folder)  # the next was killed half-way
    list(sweep(killed, 1))
    tables = [write_table(summarise(runs), runs[0].root, {"seeds": [0]}) for runs in (whole, killed)]
    assert tables[0] == tables[1] and tables[0].count("(kept)") == 2
    assert (tmp_path / "whole" / "sweep.json").read_bytes() == (tmp_path / "killed" / "sweep.json").read_bytes()
    lines = json.loads((tmp_path / "whole" / "sweep.json").read_text())["lines"]
    assert [line["configuration"] for line in lines] == ["shared", "joint", "shared", "joint"]
    kept = keep(whole, tmp_path / "strongest")
    assert sorted(path.name for path in kept) == ["prbi.safetensors", "robosac.safetensors"]
    for defender, run in strongest(whole).items():
        mine = [other.best["damage"] for other in whole if other.recipe.defender == defender]
        assert run.best["damage"] == max(mine)
        policy = load_policy(tmp_path / "strongest" / f"{slug(defender)}.safetensors")
        assert policy.notes["holdout_damage"] == max(mine) and policy.joint == run.recipe.joint


def test_a_line_of_the_table_has_intervals_that_stay_in_their_range() -> None:
    """Student's would be 0.950 [0.315, 1.585]; for none of two it is Clopper and Pearson's."""
    line = Line("prbi", "shared", (0, 1), (0.9, 1.0), (0.0, 0.0), True)
    assert line.row() == "| prbi | shared (kept) | 2 | 0.950 [0.144, 0.999] | 1.000 | 0.00 [0.00, 0.84] |"


@pytest.mark.parametrize(
    ("configurations", "match"),
    [([], "at least one"), (["a", "a:gamma=0.5"], "distinct"), (["a:speed=3"], "speed"), (["a:seed=3"], "seed")],
)
def test_bad_sweeps_are_refused(configurations: list[str], match: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=match):
        plan_sweep(SMALL, defenders=["prbi"], configurations=configurations, seeds=[0], root=tmp_path)


def test_every_attack_meets_the_same_episodes(bank: SceneBank) -> None:
    benign = play(agents.make("none"), conditions(bank), bank, defender="none")
    assert benign.damage.tolist() == [0.0, 0.0] and benign.frames.tolist() == [FRAMES] * 2
    assert benign.excluded.tolist() == [0.0, 0.0]
    random = agents.make("random")
    twice = [play(random, conditions(bank), bank, defender="prbi", batch=batch) for batch in (2, 2, 1)]
    assert twice[0].damage.sum() > 0
    for other in twice[1:]:  # whoever its neighbours are, and whatever was played before
        np.testing.assert_allclose(other.damage, twice[0].damage, rtol=1e-5)
