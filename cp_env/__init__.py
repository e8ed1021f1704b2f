"""A gym for lying vehicles: collaborative LiDAR perception under attack.

    env = cp_env.parallel_env(defender="prbi")            PettingZoo ParallelEnv, one agent per lying vehicle
    env = cp_env.env(defender="prbi")                     the same as a PettingZoo AECEnv
    envs = cp_env.vector_env(8, defender="prbi")          gymnasium VectorEnv, one joint adversary per world
    env = gymnasium.make("cp_env/CollaborativePerception-v0")
    env = pettingzoo.make("parallel", "cp_env/CollaborativePerception-v0")

Importing this package registers the ids and loads neither torch nor the world: the doors below do, when first opened.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cp_env.registration import ENV_ID, register_ids

if TYPE_CHECKING:
    from pettingzoo import AECEnv

    from cp_env.detector.protocol import DetectorLike
    from cp_env.envs.parallel import CollaborativePerceptionEnv
    from cp_env.envs.vector import JointAdversaryVectorEnv
    from cp_env.types import SceneSource
    from defenders.protocol import Defender

__version__ = "0.1.0"
__all__ = ["ENV_ID", "__version__", "env", "parallel_env", "vector_env"]


def parallel_env(
    defender: str | Defender | Callable[[], Defender] = "prbi",
    *,
    n_vehicles: int = 5,
    n_attackers: int = 2,
    attackers: Sequence[int] | None = None,
    fusion: str = "mean",
    scenes: str | SceneSource = "town",
    action: str = "guided",
    observation: str = "features",
    knowledge: str = "black-box",
    reward: str | Callable[..., Any] = "damage",
    budget: float = 0.3,
    norm: str = "linf",
    rsu: bool = False,
    slots: str = "adversaries",
    grace_frames: int = 1,
    max_frames: int = 100,
    detector: str | DetectorLike = "cp_env",
    checkpoint: str | Path | None = None,
    device: str = "cpu",
    render_mode: str | None = None,
) -> CollaborativePerceptionEnv:
    """Vehicles share feature maps, some lie, the ego's `defender` decides whom to fuse. The agents are the liars.

    Args:
        defender: who decides, by name (`defenders.names()` lists them) as an object (copied for
            every world) or as a function that makes one.
        n_vehicles: n, maps that are shared, the ego's included; no more than the scenes have connected vehicles.
        n_attackers: k, how many of them lie, 0 < k < n; drawn anew at each reset. The ego may be one of them.
        attackers: fixes who lies (distinct numbers, 0 is the ego) and with it k; nothing is drawn then.
        fusion: how maps are fused: of our own detector, it names the shipped weights.
        scenes: "town" (the training split), "town/train", "town/calibration", "town/test", a kind of
            `cp_env.scenes.SOURCES` with its path and options ("v2x-sim:/data/V2X-Sim-2.0?split=test"), or any
            `SceneSource`.
        action: how a Box in [-1, 1] becomes a perturbation. "full": the raw map (C, H, W), times the budget; "basis": a
            few coefficients on fixed directions; "guided": at most 16 numbers that steer the detector's gradient;
            "quiet": the same, held back so that the ego's view resembles its last output. Numbers outside the box are
            clipped to it; NaN and infinity are refused.
        observation: "features": a Dict of the slot's own encoded map `features` (C, H, W) and a `context` vector;
            "compact": one vector of at most about 100 numbers.
        knowledge: how much of the defender the context shows: "black-box", "gray-box" or "white-box".
        reward: one number a frame, shared by the team. "damage": 1 − Jaccard of what the ego saw and what it would have
            seen unattacked; "ap_drop": AP@0.5 lost; "stealth": damage while nobody is suspected; or a function of the
            frame's `Outcome`.
        budget: Δ >= 0, largest norm of a perturbation, in units of the feature map, before the warp (Eq. 1).
        norm: which norm that is, "linf" or "l2", over a vehicle's whole map.
        rsu: whether the scene's road-side unit shares its map too, as the last number. It lies only if
            `attackers` names it.
        slots: "adversaries": agents `adversary_0` … `adversary_{k-1}`, each driving whichever liar was drawn for it;
            "vehicles": agents `vehicle_0` …, where the honest are flagged and their actions do nothing.
        grace_frames: frames at the start of an episode in which perturbations do nothing: the defender needs an honest
            first look.
        max_frames: frames an episode lasts (5 a second); its end is a truncation.
        detector: whose eyes the victim has: "cp_env", our own; "coperception", the public code's, from a checkpoint of
            yours; or any object of `cp_env.detector.protocol.DetectorLike`.
        checkpoint: the file that coperception saved, for `detector="coperception"`; `fusion` says which model it is of.
        device: where the detector runs, as torch spells it.
        render_mode: "rgb_array" (`render()` returns a picture), "human" (a window follows the episode), or None.

    Returns:
        A PettingZoo `ParallelEnv` with a constant set of agents.

    Raises:
        ValueError: an unknown name (the message lists the known ones), or a number outside its range.
    """
    from cp_env.envs.parallel import CollaborativePerceptionEnv

    return CollaborativePerceptionEnv(
        defender,
        n_vehicles=n_vehicles,
        n_attackers=n_attackers,
        attackers=None if attackers is None else tuple(attackers),
        fusion=fusion,
        scenes=scenes,
        action=action,
        observation=observation,
        knowledge=knowledge,
        reward=reward,
        budget=budget,
        norm=norm,
        rsu=rsu,
        slots=slots,
        grace_frames=grace_frames,
        max_frames=max_frames,
        detector=detector,
        checkpoint=checkpoint,
        device=device,
        render_mode=render_mode,
    )


def env(defender: str | Defender | Callable[[], Defender] = "prbi", **knobs: Any) -> AECEnv[str, Any, Any]:
    """The same environment, one agent after the other (PettingZoo `AECEnv`); knobs as in `parallel_env`."""
    from pettingzoo.utils.conversions import parallel_to_aec

    return parallel_to_aec(parallel_env(defender, **knobs))


def vector_env(
    num_envs: int, defender: str | Defender | Callable[[], Defender] = "prbi", **knobs: Any
) -> JointAdversaryVectorEnv:
    """`num_envs` worlds stepped together (gymnasium `VectorEnv`), each with one adversary who drives all its liars.

    Knobs as in `parallel_env`, but for `slots`, which has no meaning here, and `observation`, which is "compact" unless
    said otherwise; `autoreset_mode` as in `JointAdversaryVectorEnv`.
    """
    from cp_env.envs.vector import JointAdversaryVectorEnv

    return JointAdversaryVectorEnv(num_envs, defender, **knobs)


register_ids()
