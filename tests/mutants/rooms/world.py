"""Mistakes in the world: its step, its resets, its situations, its random streams and its absences."""

from __future__ import annotations

from tests.mutants.mutant import Mutant

TESTS = "tests/cp_env/world/"
ABSENCE = (f"{TESTS}test_absence.py",)
RESET = (f"{TESTS}test_reset.py",)
STREAMS = (f"{TESTS}test_streams.py",)
SITUATION = (f"{TESTS}test_situation.py",)
HANDED = (f"{TESTS}test_handed_out.py",)
WORLD = (f"{TESTS}test_world.py",)
GRACE = (f"{TESTS}test_world.py::test_no_perturbation_exceeds_the_budget_and_none_passes_in_grace",)
ABSENCE_EDGES = (f"{TESTS}test_absence_edges.py",)
HANDED_EDGES = (f"{TESTS}test_handed_out_edges.py",)
RESET_EDGES = (f"{TESTS}test_reset_edges.py",)
STREAMS_EDGES = (f"{TESTS}test_streams_edges.py",)
WORLD_EDGES = (f"{TESTS}test_world_edges.py",)

MUTANTS = (
    Mutant("an-ego-that-is-absent", "cp_env/world/absence.py", "range(1, n_maps)]", "range(n_maps)]", ABSENCE),
    Mutant(
        "absence-of-one-vehicle-too-many",
        "cp_env/world/absence.py",
        "range(1, n_maps)]",
        "range(1, n_maps + 1)]",
        ABSENCE,
    ),
    Mutant(
        "absent-a-frame-late",
        "cp_env/world/absence.py",
        "frame not in absent.get(i, ())",
        "frame - 1 not in absent.get(i, ())",
        ABSENCE,
    ),
    Mutant(
        "absences-in-frames-of-the-scene",
        "cp_env/world/world.py",
        "absence.present(s.absent, self.settings.n_maps, s.frame)",
        "absence.present(s.absent, self.settings.n_maps, self._now(s))",
        ABSENCE_EDGES,
    ),
    Mutant(
        "the-last-start-is-never-drawn",
        "cp_env/world/reset.py",
        "max(n_frames - settings.max_frames, 0) + 1",
        "max(n_frames - settings.max_frames, 1)",
        RESET_EDGES,
    ),
    Mutant(
        "a-start-behind-the-scene",
        "cp_env/world/reset.py",
        "not 0 <= start < n_frames",
        "not 0 <= start <= n_frames",
        RESET_EDGES,
    ),
    Mutant("attackers-drawn-twice", "cp_env/world/reset.py", "replace=False", "replace=True", RESET_EDGES),
    Mutant(
        "the-roadside-unit-attacks",
        "cp_env/world/reset.py",
        "attacker_rng.choice(settings.n_suspects,",
        "attacker_rng.choice(settings.n_maps,",
        RESET_EDGES,
    ),
    Mutant(
        "the-ego-never-attacks",
        "cp_env/world/reset.py",
        "attacker_rng.choice(settings.n_suspects, settings.k, replace=False)",
        "(1 + attacker_rng.choice(settings.n_suspects - 1, settings.k, replace=False))",
        RESET_EDGES,
    ),
    Mutant("the-stream-stands-still", "cp_env/world/reset.py", "stream=stream.next()", "stream=stream", RESET),
    Mutant(
        "a-named-scene-moves-the-start",
        "cp_env/world/reset.py",
        "drawn = names[scene_rng.integers(len(names))]",
        'drawn = names[0] if "scene" in options else names[scene_rng.integers(len(names))]',
        RESET_EDGES,
    ),
    Mutant(
        "one-generator-for-all-roles",
        "cp_env/world/streams.py",
        '"episode", self.episode, role)',
        '"episode", self.episode)',
        STREAMS,
    ),
    Mutant(
        "the-public-key-for-all",
        "cp_env/world/streams.py",
        "keyed_generator(key, *self.entropy",
        "keyed_generator(PUBLIC_KEY, *self.entropy",
        STREAMS,
    ),
    Mutant(
        "words-that-run-together",
        "cp_env/world/streams.py",
        r'"\x1f".join(f"{type(word).__name__[0]}{word}" for word in words)',
        '"".join(str(word) for word in words)',
        STREAMS,
    ),
    Mutant(
        "a-spawned-seed-like-a-longer-one",
        "cp_env/world/streams.py",
        "(*_words(seed.entropy), -1, *seed.spawn_key)",
        "(*_words(seed.entropy), *seed.spawn_key)",
        STREAMS_EDGES,
    ),
    Mutant(
        "situations-share-tensors",
        "cp_env/world/situation.py",
        "copies[one.name] = value.clone()",
        "copies[one.name] = value",
        HANDED,
    ),
    Mutant(
        "situations-share-the-maps",
        "cp_env/world/world.py",
        'receive = cache(partial(stack_maps, self.places, "received"))',
        "receive = own.receive",
        SITUATION,
    ),
    Mutant(
        "outcomes-that-can-be-written",
        "cp_env/world/situation.py",
        "object.__setattr__(self, one.name, frozen(value))",
        "object.__setattr__(self, one.name, value)",
        HANDED,
    ),
    Mutant(
        "clean-output-of-the-absent",
        "cp_env/world/situation.py",
        "torch.nonzero(~present.all(1))",
        "torch.nonzero(~present.any(1))",
        ABSENCE_EDGES,
    ),
    Mutant(
        "a-grace-frame-too-many",
        "cp_env/world/world.py",
        "s.frame >= self.settings.grace_frames",
        "s.frame > self.settings.grace_frames",
        GRACE,
    ),
    Mutant(
        "expected-only-what-was-fused",
        "cp_env/world/world.py",
        "~(self.excluded & np.array(converged)[:, None])",
        "~self.excluded",
        WORLD_EDGES,
    ),
    Mutant(
        "a-frame-too-many",
        "cp_env/world/world.py",
        "s.frame + 1 >= self.settings.max_frames",
        "s.frame >= self.settings.max_frames",
        WORLD_EDGES,
    ),
    Mutant(
        "past-the-end-of-the-scene",
        "cp_env/world/world.py",
        "t + 1 >= episode.scene.n_frames",
        "t >= episode.scene.n_frames",
        WORLD_EDGES,
    ),
    Mutant(
        "the-first-frame-is-abnormal",
        "cp_env/world/world.py",
        "1.0 if s.output is None",
        "0.0 if s.output is None",
        WORLD_EDGES,
    ),
    Mutant("damage-upside-down", "cp_env/world/world.py", "damage=(1.0 - kept)", "damage=kept", WORLD),
    Mutant(
        "damage-of-the-undefended",
        "cp_env/world/world.py",
        "[j.output.seen.boxes for j in judgements]",
        "[f.seen.seen.boxes for f in frames]",
        WORLD,
    ),
    Mutant(
        "a-simulation-with-the-real-rng",
        "cp_env/world/world.py",
        "{id(self.rng): rng}",
        "{}",
        SITUATION,
    ),
    Mutant(
        "a-simulation-that-leaves-its-perturbation",
        "cp_env/world/world.py",
        "with unperturbed_after(situation):",
        "if situation is not None:",
        SITUATION,
    ),
    Mutant(
        "a-failed-step-that-leaves-its-perturbation",
        "cp_env/world/world.py",
        "self._situation = None  # the perturbations",
        "pass  # the perturbations",
        SITUATION,
    ),
    Mutant(
        "a-simulation-of-the-real-defenders",
        "cp_env/world/world.py",
        "[s.with_rng(r) for s, r in zip(self._worlds, rngs, strict=True)]",
        "self.defenders",
        SITUATION,
    ),
    Mutant(
        "the-last-episodes-verdict",
        "cp_env/world/world.py",
        "state.frame, state.output, state.verdict, state.error = 0, None, None, None",
        "state.frame, state.output, state.error = 0, None, None",
        WORLD_EDGES,
    ),
    Mutant(
        "time-goes-on-after-the-end",
        "cp_env/world/world.py",
        "            if not over:",
        "            if True:",
        WORLD_EDGES,
    ),
)
