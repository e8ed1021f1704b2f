"""E worlds stepped together: transmit, perceive, verify, output. One environment is E = 1."""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

import defenders
from cp_env.detector.model.decoder import Dense
from cp_env.detector.protocol import DetectorLike, fusion_of, with_ego_context
from cp_env.detector.registry import open_detector
from cp_env.metrics.device_similarity import matching_on
from cp_env.scenes import open_source
from cp_env.settings import WORLD_DEFAULTS, Options, Settings
from cp_env.types import SceneSource, View
from cp_env.world import absence
from cp_env.world.absence import Absences
from cp_env.world.episode import Episode, ego_heading, ego_place, empty_maps, make_views, stack_ego_context, stack_maps
from cp_env.world.reset import EpisodePlan, ResetOptions, Seed, options_of, plan_episode
from cp_env.world.scene_cache import SceneBank
from cp_env.world.situation import Clock, Outcome, SimulatedOutcome, Situation, clean_output
from cp_env.world.streams import PUBLIC_KEY, Stream
from cp_env.world.transmission import transmit, unperturbed_after
from cp_env.world.verification import DefenderError, Frame, Judgement, Pair, judge
from defenders.protocol import Defender, Informed, Verdict

Receive = Callable[[], Float[Tensor, "E N C H W"]]


def open_bank(
    fusion: str,
    *,
    scenes: str | SceneSource,
    detector: str | DetectorLike,
    checkpoint: str | Path | None,
    device: str,
    precision: str,
) -> SceneBank:
    """The bank of the named scenes under the named detector; see `open_source` and `open_detector`."""
    model = open_detector(detector, fusion=fusion, checkpoint=checkpoint, device=device, precision=precision)
    return SceneBank(open_source(scenes), model)


@dataclass(eq=False)
class _State:
    """One world between frames."""

    stream: Stream
    defender: Defender
    rng: np.random.Generator | None = None  # the defender's
    scene: str = ""
    start: int = 0
    frame: int = 0  # since the episode began
    attackers: tuple[int, ...] = ()
    absent: Absences = field(default_factory=dict)
    output: View | None = None
    reference: View | None = None  # the earlier output that the defender compared with
    verdict: Verdict | None = None
    error: str | None = None
    informed: bool = False  # whether the defender was shown the attackers of this episode

    def with_rng(self, rng: np.random.Generator) -> Defender:
        """A copy of the defender with another generator; views, which never change, are shared."""
        twin: Defender = copy.deepcopy(self.defender, {id(self.rng): rng})
        return twin


class World:
    """E worlds: scene, attackers, channel, the ego's detector and one defender each.

    Every world has one stream of episodes, hashed at every reset for the scene, the draw of attackers and the defender.
    So a world's trajectory does not depend on its neighbours, and no side can work out another's random numbers.

    Args:
        num_envs: E, worlds stepped together.
        defender: a name, an object (copied for every world) or a function that makes one.
        bank: encoded scenes with their source and detector, instead of the options `scenes`, `detector`, `checkpoint`,
            `device` and `precision`.
        settings: the options of `cp_env.parallel_env`, checked; the defaults if it is left out.
        clock: measures what a step takes, in seconds.
        key: of the random streams (see `cp_env.world.streams`); a benchmark that hides its episodes sets its own.
        options: options of `cp_env.parallel_env` that differ from `settings`.

    Raises:
        ValueError: an option out of range or an unknown name.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        defender: str | Defender | Callable[[], Defender] = "prbi",
        bank: SceneBank | None = None,
        settings: Settings | None = None,
        clock: Clock = time.perf_counter,
        key: str = PUBLIC_KEY,
        **options: Unpack[Options],
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs must be at least 1, not {num_envs}")
        place: dict[str, Any] = {name: value for name, value in options.items() if name in WORLD_DEFAULTS}
        rest: dict[str, Any] = {name: value for name, value in options.items() if name not in WORLD_DEFAULTS}
        self.settings = Settings.of(rest) if settings is None else replace(settings, **rest)
        if bank is None:
            bank = open_bank(self.settings.fusion, **{**WORLD_DEFAULTS, **place})
            bank.check(self.settings.n_vehicles, self.settings.rsu)
        self.num_envs, self.bank, self.detector = num_envs, bank, bank.detector
        self.device = self.detector.device
        self._compare, self._jaccard = matching_on(self.device)
        prototype = defenders.make(defender)
        self._worlds = [_State(Stream.of(np.random.SeedSequence()), copy.deepcopy(prototype)) for _ in range(num_envs)]
        for state in self._worlds:
            state.defender.configure(fusion=fusion_of(self.detector, self.settings.fusion))
        self._everyone = frozenset(range(self.settings.n_maps))
        self._situation: Situation | None = None
        self._places: tuple[tuple[Episode, int], ...] | None = None  # of the current frame
        self._maps: Float[Tensor, "E N C H W"] | None = None  # room for the maps of the current frame
        self._clock, self._key = clock, key

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_situation": None, "_places": None, "_maps": None}  # rebuilt from the bank

    # -- episodes ------------------------------------------------------------------------------------------------

    def reset(
        self,
        seeds: Sequence[Seed] | None = None,
        worlds: Sequence[int] | None = None,
        options: ResetOptions = None,
    ) -> None:
        """Begin a new episode in `worlds`. Everything is checked first: a refused reset changes nothing.

        Args:
            seeds: one a world; None goes on with that world's own stream.
            worlds: numbers of the worlds; all by default.
            options: one dict for all of `worlds` or one for each. "scene" (a name) and "start" (first frame of the
                scene) fix what else is drawn. "absent" maps vehicles to the frames of the episode in which they send
                nothing, as {3: range(10, 20)}.

        Raises:
            ValueError: an unknown option, or one that the scene does not allow.
            DefenderError: a defender fails in its reset.
        """
        chosen = list(range(self.num_envs) if worlds is None else worlds)
        plans = []
        for e, seed, own in zip(chosen, seeds or [None] * len(chosen), options_of(options, len(chosen)), strict=True):
            stream = self._worlds[e].stream if seed is None else Stream.of(seed)
            plans.append(plan_episode(self.bank, self.settings, stream, own, self._key))
        self._situation, self._places = None, None
        for e, plan in zip(chosen, plans, strict=True):
            self._begin(self._worlds[e], plan)

    def _begin(self, state: _State, plan: EpisodePlan) -> None:
        state.stream, state.rng = plan.stream, plan.rng
        state.scene, state.start, state.attackers, state.absent = plan.scene, plan.start, plan.attackers, plan.absent
        state.frame, state.output, state.verdict, state.error = 0, None, None, None
        state.informed = isinstance(state.defender, Informed)
        if isinstance(state.defender, Informed):
            state.defender.reveal_attackers(frozenset(plan.attackers))
        try:
            state.defender.reset(self.settings.n_maps, plan.rng)
        except Exception as error:  # a plug-in's failure ends its own episode, with its name
            raise DefenderError(f"defender {type(state.defender).__name__} failed in reset: {error}") from error

    def _episode(self, state: _State) -> Episode:
        if not state.scene:
            raise RuntimeError("call reset() before anything else")
        return self.bank.episode(state.scene, self.settings.n_vehicles, self.settings.rsu)

    @property
    def attackers(self) -> Int[np.ndarray, "E k"]:
        """Numbers of the malicious vehicles, ascending."""
        return np.array([state.attackers for state in self._worlds], dtype=np.int64).reshape(self.num_envs, -1)

    @property
    def informed(self) -> tuple[bool, ...]:
        """Whether each world showed its defender the attackers of this episode."""
        return tuple(state.informed for state in self._worlds)

    @property
    def excluded(self) -> Bool[np.ndarray, "E N"]:
        """Vehicles that the last verdict left out of the fusion."""
        excluded = np.zeros((self.num_envs, self.settings.n_maps), dtype=bool)
        for row, state in zip(excluded, self._worlds, strict=True):
            if state.verdict is not None:
                row[sorted(self._everyone - state.verdict.collaborators)] = True
        return excluded

    def _present(self) -> list[frozenset[int]]:
        """The vehicles that send a map in each world."""
        return [absence.present(s.absent, self.settings.n_maps, s.frame) for s in self._worlds]

    def _expected(self) -> Bool[np.ndarray, "E N"]:
        """Expected collaborators: all present, less those that a converged verdict excludes."""
        converged = [s.verdict is not None and s.verdict.converged for s in self._worlds]
        return self._rows(self._present()) & ~(self.excluded & np.array(converged)[:, None])

    def _rows(self, groups: Sequence[frozenset[int]]) -> Bool[np.ndarray, "B N"]:
        """Groups as rows of a mask."""
        rows = np.zeros((len(groups), self.settings.n_maps), dtype=bool)
        numbers = [len(group) for group in groups]
        rows[np.repeat(np.arange(len(groups)), numbers), list(chain.from_iterable(groups))] = True
        return rows

    @property
    def defenders(self) -> tuple[Defender, ...]:
        return tuple(state.defender for state in self._worlds)

    @property
    def places(self) -> tuple[tuple[Episode, int], ...]:
        """The episode and the scene's frame that each world is in."""
        if self._places is None:
            self._places = tuple((self._episode(s), self._now(s)) for s in self._worlds)
        return self._places

    def _now(self, state: _State) -> int:
        return state.start + state.frame

    # -- frames --------------------------------------------------------------------------------------------------

    def features(self) -> Float[Tensor, "E N C H W"]:
        """Every vehicle's encoded map of the current frame, in its own grid frame."""
        return stack_maps(self.places, "features")

    def situation(self) -> Situation:
        """The current frame before anyone acts, for an attack: copies, so nothing done to them changes the world."""
        own = self.current()
        receive = cache(partial(stack_maps, self.places, "received"))
        return own.handed_out(receive, self._clean_output(receive, own.coverage.clone(), own.present.clone()))

    def current(self) -> Situation:
        """The current frame before anyone acts, computed once a frame: the world's own, not to be handed out."""
        if self._situation is None:
            places = self.places
            receive = cache(partial(self._receive, places))
            coverage = torch.stack([ep.coverage[t] for ep, t in places]).to(self.device)
            present = torch.from_numpy(self._rows(self._present())).to(self.device)
            self._situation = Situation(
                features=self.features,
                receive=receive,
                coverage=coverage,
                ego_T_sender=torch.stack([ep.ego_T_sender[t] for ep, t in places]).to(self.device),
                perceive_clean=self._clean_output(receive, coverage, present),
                attackers=torch.from_numpy(self.attackers).to(self.device),
                fused=torch.from_numpy(self._expected()).to(self.device),
                present=present,
                active=torch.tensor([s.frame >= self.settings.grace_frames for s in self._worlds], device=self.device),
                frame=np.array([s.frame for s in self._worlds]),
                budget=self.settings.budget,
                norm=self.settings.norm,
                detector=self.detector,
                place=np.stack([ego_place(ep.scene, t) for ep, t in places]),
                heading=np.array([ego_heading(ep.scene, t) for ep, t in places]),
                output=tuple(s.output for s in self._worlds),
                verdict=tuple(s.verdict for s in self._worlds),
                simulate=self._simulate,
                ego_context=stack_ego_context(places, self.device),
            )
        return self._situation

    def _clean_output(
        self, receive: Receive, coverage: Float[Tensor, "E N H W"], present: Bool[Tensor, "E N"]
    ) -> Callable[[], Dense]:
        """Gives the decoder's output of this frame without an attack, computed once."""
        places = self.places
        detector = with_ego_context(self.detector, stack_ego_context(places, self.device))
        return cache(partial(clean_output, places, detector, receive, coverage, present))

    def _receive(self, places: Sequence[tuple[Episode, int]]) -> Float[Tensor, "E N C H W"]:
        """The maps of the current frame in the ego frame, where those of the frame before were."""
        if self._maps is None:
            self._maps = empty_maps(places)
        return stack_maps(places, "received", self._maps)

    def step(self, delta: Float[Tensor, "E k C H W"]) -> Outcome:
        """Play one frame: transmit F_i + δ_i, fuse and decode (Eq. 1), let the defenders judge.

        Raises ValueError if δ has the wrong shape or is not finite. A larger δ than the budget allows is projected.
        """
        situation = self.current()
        situation.receive()  # what a frame's first visit encodes is no time of the defence
        start = self._clock()
        truth = tuple(episode.truth[t] for episode, t in self.places)
        traffic = tuple((episode.scene, t, self.detector.extent) for episode, t in self.places)
        try:
            played = self._play(situation, delta, self.defenders)
        finally:
            self._situation = None  # the perturbations were added to its maps
        self._advance(played)
        seconds = self._clock() - start
        return Outcome(**vars(played), truth=truth, seconds=seconds, traffic=traffic)

    def _simulate(self, delta: Float[Tensor, "E k C H W"], rngs: Sequence[np.random.Generator]) -> SimulatedOutcome:
        """See `Situation.simulate`."""
        if len(rngs) != self.num_envs:
            raise ValueError(f"one generator a world is needed: {self.num_envs} worlds, {len(rngs)} generators")
        situation, defenders = self.current(), [s.with_rng(r) for s, r in zip(self._worlds, rngs, strict=True)]
        with unperturbed_after(situation):
            played = self._play(situation, delta, defenders)
        return replace(played, clean=tuple(view.twin() for view in played.clean))  # the bank's views stay its own

    def _play(
        self, situation: Situation, delta: Float[Tensor, "E k C H W"], defenders: Sequence[Defender]
    ) -> SimulatedOutcome:
        with torch.inference_mode():
            clean = self._clean(situation)  # before anything is added to the maps
            norms = transmit(situation, delta, self.settings)
            perceive = self._perceiver(situation)
            seen = perceive(list(enumerate(self._present())))
            states = zip(self._worlds, seen, strict=True)
            frames = [Frame(s.frame, self.settings.n_maps, view, s.output, s.reference) for s, view in states]
            return self._outcome(frames, judge(frames, defenders, perceive, self._compare), norms, clean)

    def _perceiver(self, situation: Situation) -> Callable[[list[Pair]], list[View]]:
        """The one masked forward that answers any list of (world, group), of the maps as they are when it is asked."""

        places = [ego_place(episode.scene, t) for episode, t in self.places]

        def perceive(pairs: list[Pair]) -> list[View]:
            world = torch.tensor([e for e, _ in pairs], device=self.device)
            groups = torch.from_numpy(self._rows([group for _, group in pairs]))
            dense = situation.ego_detector().perceive(
                situation.received, situation.coverage, world, groups.to(self.device)
            )
            frames = [self._worlds[e].frame for e, _ in pairs]
            return make_views(self.detector, dense, [g for _, g in pairs], frames, [places[e] for e, _ in pairs])

        return perceive

    def _clean(self, situation: Situation) -> tuple[View, ...]:
        """The unattacked views of all present; the bank holds those of frames with everyone."""
        views = [episode.clean_views[t] for episode, t in self.places]
        few = [pair for pair in enumerate(self._present()) if pair[1] < self._everyone]
        seen = self._perceiver(situation)(few) if few else []
        for (e, _), view in zip(few, seen, strict=True):
            views[e] = view
        return tuple(views)

    def _outcome(
        self, frames: list[Frame], judgements: list[Judgement], norms: np.ndarray, clean: tuple[View, ...]
    ) -> SimulatedOutcome:
        places = self.places
        last = [
            1.0 if s.output is None else f.similarity(f.seen, s.output)
            for f, s in zip(frames, self._worlds, strict=True)
        ]
        kept = self._jaccard([j.output.seen.boxes for j in judgements], [c.seen.boxes for c in clean])
        over = [
            s.frame + 1 >= self.settings.max_frames or t + 1 >= episode.scene.n_frames or j.error is not None
            for s, (episode, t), j in zip(self._worlds, places, judgements, strict=True)
        ]
        return SimulatedOutcome(
            frame=np.array([s.frame for s in self._worlds]),
            seen=tuple(f.seen for f in frames),
            clean=clean,
            judgements=tuple(judgements),
            similarity=np.array(last, dtype=np.float32),
            damage=(1.0 - kept).astype(np.float32),
            perturbation_norm=norms,
            attackers=self.attackers,
            truncated=np.array(over),
        )

    def _advance(self, outcome: SimulatedOutcome) -> None:
        """Move every world to its next frame; a world at its end stays on its last frame until it is reset."""
        self._places = None
        for state, judgement, over in zip(self._worlds, outcome.judgements, outcome.truncated, strict=True):
            state.output, state.verdict, state.error = judgement.output, judgement.verdict, judgement.error
            state.reference = judgement.reference
            if not over:
                state.frame += 1
