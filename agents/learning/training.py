"""Training of one attack: the recipe, and the run that follows it from wherever it was stopped.

A run is a chain of segments, each some rollouts long. Every segment begins new episodes and draws from streams of its
own, made from the recipe's seed and its place in the chain. So a run that was killed and went on from the checkpoint
before its last segment is, bit for bit, the run that was never killed.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import ConvertCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.vec_env import VecMonitor

import defenders
from agents.learning.callbacks import Evaluation, FrameDamage, Holdout
from agents.learning.hyperparameters import PPO_OPTIONS, check_hyperparameters
from agents.learning.policy import Policy, load_policy
from agents.learning.ppo import adopt, export, load_checkpoint, make_ppo, save_checkpoint
from agents.learning.rollout import Episodes, open_bank, play
from agents.sb3 import AdversaryVecEnv, make_vec_env
from cp_env.detector.registry import precise
from cp_env.evaluation import Conditions
from cp_env.settings import Action, Fusion, Knowledge, Precision, RewardName, Settings
from cp_env.world.scene_cache import SceneBank


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How an attack is trained; with the versions of the libraries it decides every bit of the policy."""

    defender: str = "prbi"
    """the defender to beat: a name of defenders.names(), with options if need be: prbi:threshold=calibrated"""
    joint: bool = False
    """one actor moves all attackers of a world; else they share a policy that moves each by its own observation"""
    recurrent: bool = False
    """an actor with a memory of the frames before (needs the extra `recurrent`)"""
    action: Action = "guided"
    """what its numbers mean: guided, stealth or basis, see docs/actions.md"""
    gradient_precision: Precision | None = None
    """of the gradients that guided, stealth and critical take: bfloat16 is faster; the detector's own by default"""
    knowledge: Knowledge = "black-box"
    """how much of the defender the policy sees: black-box, gray-box or white-box"""
    reward: RewardName = "damage"
    """the reward of the attackers, see docs/rewards.md"""
    seed: int = 0
    """of the learner, the scenes and the attackers"""
    frames: int = 5_000
    """frames of traffic to learn from, all worlds together; whole segments are played"""
    worlds: int = 8
    """worlds stepped together"""
    n_vehicles: int = 5
    rsu: bool = False
    """with the road-side unit's map as the last one; one vehicle is enough then"""
    n_attackers: int = 2
    max_frames: int = 50
    """length of an episode"""
    scenes: str = "town/train"
    n_scenes: int = 12
    """how many of them to learn on: each is encoded once, which takes seconds"""
    holdout: str = "town/calibration"
    """scenes on which the policy to keep is chosen"""
    n_holdout: int = 6
    """how many of them, one episode each"""
    detector: str = "cp_env"
    """the victim: our own, cp_env:weights=FILE, coperception:checkpoint=FILE, or module:Class of yours"""
    fusion: Fusion = "mean"
    """how maps are fused, of a detector that leaves it open"""
    precision: Precision = "float32"
    """of the detector's maps, fusion and decoder: bfloat16 is faster, see docs/speed.md"""
    every: int = 5
    """rollouts in a segment: then the policy is played on the scenes held back, and a checkpoint is written"""
    n_steps: int = PPO_OPTIONS["n_steps"]
    """frames of each world in a rollout, after which PPO learns"""
    batch_size: int = PPO_OPTIONS["batch_size"]
    """steps in a minibatch; a rollout holds n_steps × worlds × attackers of them, or n_steps × worlds with joint"""
    n_epochs: int = PPO_OPTIONS["n_epochs"]
    """how often PPO goes through a rollout"""
    learning_rate: float = PPO_OPTIONS["learning_rate"]
    """Adam's step size"""
    gamma: float = PPO_OPTIONS["gamma"]
    """discount of a frame"""
    gae_lambda: float = PPO_OPTIONS["gae_lambda"]
    """λ of generalised advantage estimation"""
    ent_coef: float = PPO_OPTIONS["ent_coef"]
    """weight of the policy's entropy"""
    clip_range: float = PPO_OPTIONS["clip_range"]
    """how far a probability ratio may move in one update"""
    begin: str | None = None
    """a policy whose actor is learned on: a name of agents.learning.policy.policy_names(), or a .safetensors file"""

    @property
    def victim(self) -> str:
        """The detector's name with the precision in it."""
        return precise(self.detector, self.precision)

    def __post_init__(self) -> None:
        defenders.make(self.defender)
        for name in ("frames", "worlds", "every"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, not {getattr(self, name)}")
        check_hyperparameters(self.hyperparameters)

    @property
    def measure(self) -> str:
        """By what the policy to keep is chosen on the scenes held back: critical recall lost if that is the reward."""
        return "critical" if self.reward == "critical" else "damage"

    @property
    def hyperparameters(self) -> dict[str, Any]:
        """Of PPO, by name: see `agents.learning.hyperparameters`."""
        return {name: getattr(self, name) for name in PPO_OPTIONS}

    @property
    def options(self) -> dict[str, Any]:
        """Of the environment: whatever a recipe shares with its settings, but for what the detector fixes."""
        shared = {f.name for f in fields(Settings)} & {f.name for f in fields(self)} - {"fusion"}
        return {"observation": "compact"} | {
            f.name: getattr(self, f.name) for f in fields(Settings) if f.name in shared
        }

    @property
    def n_segments(self) -> int:
        """Segments that hold at least `frames` frames."""
        return -(-self.frames // self.segment)

    @property
    def segment(self) -> int:
        """Frames of a segment, all worlds together."""
        return self.worlds * self.every * self.n_steps


def train(
    recipe: Recipe,
    folder: Path,
    *,
    tensorboard: bool = False,
    report_progress: Callable[[int], object] = lambda frames: None,
) -> list[Evaluation]:
    """Train by the recipe, from the last checkpoint in `folder` if there is one.

    `folder` then holds `policy.safetensors`: the policy that did most damage on the scenes held back, or, with the
    reward `critical`, the one that cost most critical recall there.

    Args:
        recipe: how to train.
        folder: of the run.
        tensorboard: write TensorBoard curves there.
        report_progress: called with the number of frames learned from so far, every frame.

    Returns:
        The learning curve.

    Raises:
        ValueError: `folder` holds a run of another recipe (one with fewer frames may go on), or a broken one.
    """
    _claim(folder, recipe)
    env = _environment(recipe)
    monitored = VecMonitor(env)
    model = make_ppo(monitored, recipe.seed, recurrent=recipe.recurrent, **recipe.hyperparameters)
    if tensorboard:
        model.set_logger(configure(str(folder), ["tensorboard"]))
    checkpoint = folder / "checkpoint.safetensors"
    if checkpoint.exists():
        load_checkpoint(model, checkpoint)
    elif recipe.begin is not None:
        adopt(model, load_policy(recipe.begin))
    holdout = Holdout(
        _held_back(recipe),
        _exporter(recipe),
        folder,
        every=recipe.every,
        per_frame=env.n_seats,
        measure=recipe.measure,
    )

    def tick(variables: dict[str, Any], _: dict[str, Any]) -> bool:
        report_progress(variables["self"].num_timesteps // env.n_seats)
        return True

    steps = recipe.segment * env.n_seats
    for number in range(model.num_timesteps // steps, recipe.n_segments):
        model.set_env(monitored, force_reset=True)
        model.set_random_seed(int(np.random.SeedSequence([recipe.seed, number]).generate_state(1)[0]))
        model.learn(steps, callback=[FrameDamage(), holdout, ConvertCallback(tick)], reset_num_timesteps=False)
        save_checkpoint(model, checkpoint)
    return holdout.curve


def _claim(folder: Path, recipe: Recipe) -> None:
    """Write the recipe into the folder; ValueError if another one's run is there."""
    folder.mkdir(parents=True, exist_ok=True)
    path, mine = folder / "recipe.json", asdict(recipe)
    if path.exists():
        theirs = json.loads(path.read_text())
        other = [f.name for f in fields(recipe) if f.name != "frames" and theirs.get(f.name, f.default) != mine[f.name]]
        if other:
            raise ValueError(f"{folder} holds a run with another {', '.join(other)}; choose another folder")
    path.write_text(json.dumps(mine, indent=1))


def _environment(recipe: Recipe) -> AdversaryVecEnv:
    return make_vec_env(
        recipe.worlds,
        defenders.make(recipe.defender),
        joint=recipe.joint,
        bank=open_bank(recipe.scenes, recipe.n_scenes, recipe.victim, recipe.fusion),
        fusion=recipe.fusion,
        **recipe.options,
    )


def held_back_scenes(recipe: Recipe) -> tuple[SceneBank, Conditions]:
    """The scenes that a recipe evaluates on and does not learn on, and the conditions under which they are played."""
    bank = open_bank(recipe.holdout, recipe.n_holdout, recipe.victim, recipe.fusion)
    conditions = Conditions(
        scenes=bank.source,
        names=bank.source.names(),
        frames=recipe.max_frames,
        n_vehicles=recipe.n_vehicles,
        rsu=recipe.rsu,
        fusion=recipe.fusion,
    )
    return bank, conditions


def _held_back(recipe: Recipe) -> Callable[[Policy], Episodes]:
    bank, conditions = held_back_scenes(recipe)
    return lambda policy: play(policy, conditions, bank, defender=recipe.defender, k=recipe.n_attackers)


def _exporter(recipe: Recipe) -> Callable[[OnPolicyAlgorithm], Policy]:
    return lambda model: export(model, recipe.defender, recipe.options, joint=recipe.joint, seed=recipe.seed)
