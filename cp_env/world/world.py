"""E worlds stepped together: transmit, perceive, verify, output. One environment is E = 1."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

import defenders
from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike
from cp_env.detector.registry import open_detector
from cp_env.metrics import similarity
from cp_env.perturbation import channel
from cp_env.scenes import open_source
from cp_env.settings import Settings
from cp_env.types import SceneSource, View
from cp_env.world import absence
from cp_env.world.absence import Absences
from cp_env.world.episode import Episode, ego_place, make_views, stack_kept, stack_maps
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Outcome, Situation
from cp_env.world.verification import DefenderError, Frame, Judgement, Pair, judge
from defenders.protocol import Defender, Verdict

Seed = int | np.random.SeedSequence | None


@dataclass(eq=False)
class _State:
    """One world between frames."""

    seeds: np.random.SeedSequence
    defender: Defender
    coins: np.random.Generator | None = None  # the defender's
    scene: str = ""
    start: int = 0
    frame: int = 0  # since the episode began
    attackers: tuple[int, ...] = ()
    absent: Absences = field(default_factory=dict)
    output: View | None = None
    verdict: Verdict | None = None
    error: str | None = None

    def imagined(self, coins: np.random.Generator) -> Defender:
        """A copy of the defender as it is, but for its coins; the last output, which never changes, is shared."""
        twin: Defender = copy.deepcopy(self.defender, {id(self.coins): coins, id(self.output): self.output})
        return twin


class World:
    """E worlds: scene, liars, channel, the ego's detector and one defender each.

    `defender` is a name, an object (copied for every world) or a factory; `scenes` a name or a `SceneSource`;
    `detector`, `checkpoint` and `device` as in `open_detector`, unless a `bank` brings its detector along. All other
    knobs are those of `cp_env.parallel_env`. Seeds: one `SeedSequence` a world, spawned at every reset for the scene,
    the draw of liars and the defender, so a world's trajectory does not depend on its neighbours.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        scenes: str | SceneSource = "town",
        device: str = "cpu",
        detector: str | DetectorLike = "cp_env",
        checkpoint: str | Path | None = None,
        bank: SceneBank | None = None,
        settings: Settings | None = None,
        **knobs: Any,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        self.settings = replace(settings, **knobs) if settings else Settings(**knobs)
        if bank is None:
            eyes = open_detector(detector, fusion=self.settings.fusion, checkpoint=checkpoint, device=device)
            bank = SceneBank(open_source(scenes), eyes)
        self.num_envs, self.bank, self.detector = num_envs, bank, bank.detector
        self.device = self.detector.device
        prototype = defenders.make(defender)
        self._worlds = [_State(np.random.SeedSequence(), copy.deepcopy(prototype)) for _ in range(num_envs)]
        for state in self._worlds:
            state.defender.configure(fusion=getattr(self.detector, "fusion", self.settings.fusion))
        self._everyone = frozenset(range(self.settings.n_maps))
        self._situation: Situation | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_situation": None}  # rebuilt from the bank

    # -- episodes ------------------------------------------------------------------------------------------------

    def reset(
        self,
        seeds: Sequence[Seed] | None = None,
        worlds: Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> None:
        """Begin a new episode in `worlds` (all by default). A seed of None goes on with that world's own stream.

        `options` may fix the "scene" (a name) and the "start" (first frame of the scene); else both are drawn. "absent"
        maps vehicles to the frames of the episode in which they send nothing, as {3: range(10, 20)}; by default none.
        """
        worlds = range(self.num_envs) if worlds is None else worlds
        for e, seed in zip(worlds, seeds or [None] * len(worlds), strict=True):
            self._begin(self._worlds[e], seed, options or {})
        self._situation = None

    def _begin(self, state: _State, seed: Seed, options: dict[str, Any]) -> None:
        if seed is not None:
            state.seeds = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
        place, draw, mind = (np.random.default_rng(child) for child in state.seeds.spawn(3))
        names = self.bank.source.names()
        state.scene = str(options.get("scene", names[place.integers(len(names))]))
        spare = self._episode(state).scene.n_frames - self.settings.max_frames
        state.start = int(options.get("start", place.integers(max(spare, 0) + 1)))
        if not 0 <= state.start < self._episode(state).scene.n_frames:
            raise ValueError(f"start must be a frame of scene {state.scene!r}, not {state.start}")
        settings = self.settings
        drawn = draw.choice(settings.n_vehicles, settings.k, replace=False) if settings.attackers is None else ()
        state.attackers = tuple(sorted(int(i) for i in (settings.attackers or drawn)))
        state.absent = absence.checked(options.get("absent", {}), settings.n_maps)
        state.frame, state.output, state.verdict, state.error = 0, None, None, None
        tell = getattr(state.defender, "tell", None)  # the oracle alone is told the truth: defenders.baselines
        if tell is not None:
            tell(frozenset(state.attackers))
        state.coins = mind
        try:
            state.defender.reset(settings.n_maps, mind)
        except Exception as error:  # a plug-in's failure ends its own episode, with its name
            raise DefenderError(f"defender {type(state.defender).__name__} failed in reset: {error}") from error

    def _episode(self, state: _State) -> Episode:
        if not state.scene:
            raise RuntimeError("call reset() before anything else")
        return self.bank.episode(state.scene, self.settings.n_vehicles, self.settings.rsu)

    @property
    def attackers(self) -> Int[np.ndarray, "E k"]:
        """Numbers of the lying vehicles, ascending."""
        return np.array([state.attackers for state in self._worlds], dtype=np.int64).reshape(self.num_envs, -1)

    @property
    def excluded(self) -> Bool[np.ndarray, "E N"]:
        """Vehicles that the last verdict left out of the fusion."""
        excluded = np.zeros((self.num_envs, self.settings.n_maps), dtype=bool)
        for row, state in zip(excluded, self._worlds, strict=True):
            if state.verdict is not None:
                row[sorted(self._everyone - state.verdict.collaborators)] = True
        return excluded

    def _present(self) -> list[frozenset[int]]:
        """Whose maps are there in each world."""
        return [absence.present(s.absent, self.settings.n_maps, s.frame) for s in self._worlds]

    def _expected(self) -> Bool[np.ndarray, "E N"]:
        """Whom the ego will look at first: a verdict that has not converged may change, so all present until then."""
        converged = [s.verdict is not None and s.verdict.converged for s in self._worlds]
        return self._rows(self._present()) & ~(self.excluded & np.array(converged)[:, None])

    def _rows(self, groups: Sequence[frozenset[int]]) -> Bool[np.ndarray, "B N"]:
        """Groups as rows of a mask."""
        return np.array([[i in group for i in range(self.settings.n_maps)] for group in groups], dtype=bool)

    @property
    def defenders(self) -> tuple[Defender, ...]:
        return tuple(state.defender for state in self._worlds)

    @property
    def places(self) -> tuple[tuple[Episode, int], ...]:
        """The episode and the scene's frame that each world is in."""
        return tuple((self._episode(s), self._now(s)) for s in self._worlds)

    def _now(self, state: _State) -> int:
        return state.start + state.frame

    # -- frames --------------------------------------------------------------------------------------------------

    def features(self) -> Float[Tensor, "E N C H W"]:
        """Every vehicle's encoded map of the current frame, in its own grid frame."""
        return stack_maps(self.places, "features").to(self.device)

    def situation(self) -> Situation:
        """The current frame before anyone acts; computed once a frame."""
        if self._situation is None:
            places = self.places
            situation = Situation(
                features=self.features,
                received=stack_maps(places, "received").to(self.device),
                coverage=torch.stack([ep.coverage[t] for ep, t in places]).to(self.device),
                ego_T_sender=torch.stack([ep.ego_T_sender[t] for ep, t in places]).to(self.device),
                clean=Dense(
                    torch.stack([ep.clean.logits[t] for ep, t in places]).float().to(self.device),
                    torch.stack([ep.clean.boxes[t] for ep, t in places]).float().to(self.device),
                ),
                attackers=torch.from_numpy(self.attackers).to(self.device),
                fused=torch.from_numpy(self._expected()).to(self.device),
                present=torch.from_numpy(self._rows(self._present())).to(self.device),
                active=torch.tensor([s.frame >= self.settings.grace_frames for s in self._worlds], device=self.device),
                frame=np.array([s.frame for s in self._worlds]),
                budget=self.settings.budget,
                norm=self.settings.norm,
                detector=self.detector,
                place=np.stack([ego_place(ep.scene, t) for ep, t in places]),
                output=tuple(s.output for s in self._worlds),
                verdict=tuple(s.verdict for s in self._worlds),
                rehearse=self._rehearse,
                kept=stack_kept(places, self.device),
            )
            self._situation = self._without_absent(situation)
        return self._situation

    def _without_absent(self, situation: Situation) -> Situation:
        """The clean output is the bank's, with everyone fused; where someone is absent it is perceived anew."""
        few = torch.nonzero(~situation.present.all(1)).flatten()
        if len(few):
            with torch.inference_mode():
                dense = situation.eyes().perceive(situation.received, situation.coverage, few, situation.present[few])
            situation.clean.logits[few], situation.clean.boxes[few] = dense.logits.clone(), dense.boxes.clone()
        return situation

    def step(self, delta: Float[Tensor, "E k C H W"]) -> Outcome:
        """Play one frame: transmit F_i + δ_i, fuse and decode (Eq. 1), let the defenders judge.

        Raises ValueError if δ has the wrong shape or is not finite. A larger δ than the budget allows is projected.
        """
        outcome = self._play(delta, self.defenders)
        self._advance(outcome)
        return outcome

    def _rehearse(self, delta: Float[Tensor, "E k C H W"], coins: Sequence[np.random.Generator]) -> Outcome:
        """See `Situation.rehearse`."""
        return self._play(delta, [s.imagined(own) for s, own in zip(self._worlds, coins, strict=True)])

    def _play(self, delta: Float[Tensor, "E k C H W"], minds: Sequence[Defender]) -> Outcome:
        with torch.inference_mode():
            situation = self.situation()
            attacked, norms = self._transmit(situation, delta)
            perceive = self._perceiver(attacked, situation)
            seen = perceive(list(enumerate(self._present())))
            states = zip(self._worlds, seen, strict=True)
            frames = [Frame(s.frame, self.settings.n_maps, view, s.output) for s, view in states]
            return self._outcome(frames, judge(frames, minds, perceive), norms, self._clean(situation))

    def _transmit(
        self, situation: Situation, delta: Float[Tensor, "E k C H W"]
    ) -> tuple[Float[Tensor, "E N C H W"], Float[np.ndarray, "E k"]]:
        shape = (*situation.attackers.shape, *situation.received.shape[2:])
        if tuple(delta.shape) != shape:
            raise ValueError(f"a perturbation must have shape [E, k, C, H, W] = {shape}, not {tuple(delta.shape)}")
        sent = channel.norm_of(delta.detach().to(self.device), situation.norm)
        if not bool(torch.isfinite(sent).all()):
            raise ValueError("a perturbation must be finite, but it holds NaN or infinity; check the attacker")
        active = situation.active[:, None] & situation.present.gather(1, situation.attackers)
        if not bool((sent * active).any()):
            return situation.received, torch.zeros_like(sent).cpu().numpy()
        delta = channel.project(delta.detach().to(self.device), situation.budget, situation.norm)
        delta = delta * active[..., None, None, None]
        norms = channel.norm_of(delta, situation.norm).cpu().numpy()
        index = situation.attackers[..., None].expand(-1, -1, 3)
        warped = self.detector.warp(delta, situation.ego_T_sender.gather(1, index))
        return channel.inject(situation.received, warped, situation.attackers), norms

    def _perceiver(
        self, attacked: Float[Tensor, "E N C H W"], situation: Situation
    ) -> Callable[[list[Pair]], list[View]]:
        """The one masked forward that answers any list of (world, group)."""

        def perceive(pairs: list[Pair]) -> list[View]:
            world = torch.tensor([e for e, _ in pairs], device=self.device)
            groups = torch.from_numpy(self._rows([group for _, group in pairs]))
            dense = situation.eyes().perceive(attacked, situation.coverage, world, groups.to(self.device))
            states = [self._worlds[e] for e, _ in pairs]
            places = [ego_place(self._episode(s).scene, self._now(s)) for s in states]
            return make_views(self.detector, dense, [g for _, g in pairs], [s.frame for s in states], places)

        return perceive

    def _clean(self, situation: Situation) -> tuple[View, ...]:
        """What the egos would have seen of all present without lies; the bank knows where everyone is."""
        views = [episode.clean_views[t] for episode, t in self.places]
        few = [pair for pair in enumerate(self._present()) if pair[1] < self._everyone]
        seen = self._perceiver(situation.received, situation)(few) if few else []
        for (e, _), view in zip(few, seen, strict=True):
            views[e] = view
        return tuple(views)

    def _outcome(
        self, frames: list[Frame], judgements: list[Judgement], norms: np.ndarray, clean: tuple[View, ...]
    ) -> Outcome:
        places = self.places
        last = [
            1.0 if s.output is None else f.similarity(f.seen, s.output)
            for f, s in zip(frames, self._worlds, strict=True)
        ]
        kept = similarity.jaccard_many([j.output.seen.boxes for j in judgements], [c.seen.boxes for c in clean])
        over = [
            s.frame + 1 >= self.settings.max_frames or t + 1 >= episode.scene.n_frames or j.error is not None
            for s, (episode, t), j in zip(self._worlds, places, judgements, strict=True)
        ]
        return Outcome(
            frame=np.array([s.frame for s in self._worlds]),
            seen=tuple(f.seen for f in frames),
            clean=clean,
            judgements=tuple(judgements),
            truth=tuple(episode.truth[t] for episode, t in places),
            similarity=np.array(last, dtype=np.float32),
            damage=(1.0 - kept).astype(np.float32),
            perturbation_norm=norms,
            attackers=self.attackers,
            truncated=np.array(over),
        )

    def _advance(self, outcome: Outcome) -> None:
        """Move every world to its next frame; a world at its end stays on its last frame until it is reset."""
        for state, judgement, over in zip(self._worlds, outcome.judgements, outcome.truncated, strict=True):
            state.output, state.verdict, state.error = judgement.output, judgement.verdict, judgement.error
            if not over:
                state.frame += 1
        self._situation = None
