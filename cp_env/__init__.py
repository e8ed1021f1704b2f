"""A gym for adversarial collaborative perception: vehicles share LiDAR feature maps (V2X), some are malicious.

    env = cp_env.parallel_env(defender="prbi")            PettingZoo ParallelEnv, one agent per attacker
    env = cp_env.env(defender="prbi")                     the same as a PettingZoo AECEnv
    envs = cp_env.vector_env(8, defender="prbi")          gymnasium VectorEnv, one joint adversary per world
    env = gymnasium.make("cp_env/CollaborativePerception-v0")
    env = pettingzoo.make("parallel", "cp_env/CollaborativePerception-v0")

Importing this package registers the ids. Torch and the world are loaded by the functions below, when first called.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any

from cp_env.process import watch_in_worker
from cp_env.registration import ENV_ID, register_ids

if TYPE_CHECKING:
    from typing import Unpack

    from pettingzoo import AECEnv

    from cp_env.envs.parallel import CollaborativePerceptionEnv
    from cp_env.envs.vector import JointAdversaryVectorEnv
    from cp_env.settings import Options
    from cp_env.world import Outcome, SceneBank, Situation, World
    from defenders.protocol import Defender

__version__ = "0.2.0"
__all__ = [
    "ENV_ID",
    "Outcome",
    "SceneBank",
    "Situation",
    "World",
    "__version__",
    "env",
    "parallel_env",
    "vector_env",
]

_LAZY = ("Outcome", "SceneBank", "Situation", "World")


def __getattr__(name: str) -> Any:
    """The classes of the world, which load torch, when first asked for."""
    if name in _LAZY:
        return getattr(import_module("cp_env.world"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})


def parallel_env(
    defender: str | Defender | Callable[[], Defender] = "prbi",
    **options: Unpack[Options],
) -> CollaborativePerceptionEnv:
    """A PettingZoo environment of collaborative perception under attack. The agents are the attackers.

    Vehicles share feature maps, and some of them add perturbations to theirs. The ego's `defender` decides which maps
    are fused.

    Args:
        defender: the ego's defence: a name (`defenders.names()` lists them), with options if need be
            ("bayes:max_verifications=8"), "module:Class" of yours, an object (copied for every world) or a function
            that makes one.
        **options: what else is chosen. The defaults stand in `cp_env.settings`.

            * `n_vehicles` (5): n, vehicles that share their maps, the ego included; no more than the scenes have
              connected ones. At least 2, or 1 with `rsu`.
            * `n_attackers` (2): k, number of malicious vehicles, 0 < k < n. They are drawn anew at each reset. The ego
              may be one.
            * `attackers` (None): the malicious vehicles (distinct numbers, 0 is the ego). It fixes k too; nothing is
              drawn then.
            * `fusion` ("mean"): how maps are fused: of our own detector, it names the shipped weights.
            * `scenes` ("town", the training split): "town/train", "town/calibration", "town/test", a kind of
              `cp_env.scenes.SOURCES` with its path and options ("v2x-sim:/data/V2X-Sim-2.0?split=test"), "module:Class"
              of yours, or any `SceneSource`.
            * `action` ("guided"): how a Box in [-1, 1] becomes a perturbation. "full": the raw map (C, H, W), times the
              budget; "basis": a few coefficients on fixed directions; "guided": eight numbers that steer an ascent of
              the detector's gradient; "stealth": the same, held back so that the ego's view resembles its last output;
              "critical": as "stealth", aimed ahead of the ego.
              Numbers outside the box are clipped to it; NaN and infinity are refused.
            * `observation` ("features"): "features": a Dict of the slot's own encoded map `features` (C, H, W) and a
              `context` vector, whose entries `cp_env.envs.observation.context_names` names; "compact": one vector of at
              most about 100 numbers.
            * `knowledge` ("black-box"): how much of the defender the context shows: "black-box", "gray-box" or
              "white-box".
            * `reward` ("damage"): one number a frame, shared by the team. "damage": 1 − Jaccard of what the ego saw and
              what it would have seen unattacked; "ap_drop": AP@0.5 lost; "stealth": damage while nobody is suspected;
              or a function of the frame's `Outcome`.
            * `budget` (0.3): Δ >= 0, largest norm of a perturbation, in units of the feature map, before the warp
              (Eq. 1).
            * `norm` ("linf"): which norm that is, "linf" or "l2", over a vehicle's whole map.
            * `gradient_precision` (None): of the gradients that the actions "guided", "stealth" and "critical" take:
              "bfloat16" for a faster search of the attackers in a rounded copy of the detector, or the detector's own.
            * `rsu` (False): whether the scene's road-side unit shares its map too, as the last number. It is malicious
              only if `attackers` names it.
            * `slots` ("adversaries"): agents `adversary_0` … `adversary_{k-1}`, each of which drives the attacker that
              was drawn for it; "vehicles": agents `vehicle_0` …, where infos mark the malicious and benign actions do
              nothing.
            * `grace_frames` (1): frames at the start of an episode in which perturbations do nothing: the defender
              needs one unattacked view.
            * `max_frames` (100): frames an episode lasts (5 a second); its end is a truncation.
            * `state` ("maps"): what `env.state()` is, for critics: every vehicle's map, or "compact", one vector.
            * `detector` ("cp_env"): the attacked model: our own; "coperception", the public code's, from a checkpoint
              of yours; "module:Class"; or any object of `cp_env.detector.protocol.DetectorLike`.
            * `checkpoint` (None): the file that coperception saved, for `detector="coperception"`; `fusion` says which
              model it is of.
            * `device` ("cpu"): where the detector runs, as torch spells it.
            * `precision` ("float32"): of its maps, fusion and decoder; "bfloat16" is faster, see docs/speed.md.
            * `render_mode` (None): "rgb_array" (`render()` returns a picture) or "human" (a window follows the
              episode).

    Returns:
        A PettingZoo `ParallelEnv` with a constant set of agents.

    Raises:
        ValueError: an unknown name or option (the message names the nearest known one), or a value out of range.
    """
    from cp_env.envs.parallel import CollaborativePerceptionEnv

    return CollaborativePerceptionEnv(defender, **options)


def env(
    defender: str | Defender | Callable[[], Defender] = "prbi", **options: Unpack[Options]
) -> AECEnv[str, Any, Any]:
    """The same environment, one agent after the other (PettingZoo `AECEnv`).

    Args:
        defender: as in `parallel_env`.
        options: as in `parallel_env`.

    Returns:
        A PettingZoo `AECEnv`.

    Raises:
        ValueError: as `parallel_env`.
    """
    from pettingzoo.utils.conversions import parallel_to_aec

    return parallel_to_aec(parallel_env(defender, **options))


def vector_env(
    num_envs: int, defender: str | Defender | Callable[[], Defender] = "prbi", **options: Any
) -> JointAdversaryVectorEnv:
    """`num_envs` worlds stepped together (gymnasium `VectorEnv`), each with one adversary for all its attackers.

    Args:
        num_envs: E, worlds stepped together.
        defender: as in `parallel_env`.
        options: as in `parallel_env`, but for `slots`, which has no meaning here, and `observation`, which is "compact"
            by default; `autoreset_mode` as in `JointAdversaryVectorEnv`.

    Returns:
        A gymnasium `VectorEnv`.

    Raises:
        ValueError: as `parallel_env`, or fewer than one world.
    """
    from cp_env.envs.vector import JointAdversaryVectorEnv

    return JointAdversaryVectorEnv(num_envs, defender, **options)


watch_in_worker()
register_ids()
