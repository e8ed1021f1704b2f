"""Tuning of PPO's hyperparameters by Optuna: trials on training scenes, compared on the scenes held back.

A study is a database in a folder, with a training run for each trial and seed beside it. The first trial plays the
values of the recipe, so what is found is at least as good as they are on the scenes held back. Every trial draws from a
random stream of its own, made from the study's seed and the trial's number, and a trial that was stopped goes on from
its checkpoints. So a study that was killed and started again ends as if it had never been stopped.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from agents.learning.hyperparameters import write_hyperparameters
from agents.learning.training import Recipe, train
from cp_env.evaluation.plan.files import check_writable

if TYPE_CHECKING:
    import optuna

N_STEPS = (16, 32, 64)
"""Rollouts that are tried, in frames of each world."""

MINIBATCHES = (1, 2, 4, 8)
"""Into so many minibatches a rollout is cut."""

EPOCHS = (2, 16)
"""The fewest and the most that are tried."""

RANGES = {
    "learning_rate": (1e-4, 1e-2),
    "gamma": (0.6, 0.99),
    "gae_lambda": (0.6, 1.0),
    "ent_coef": (0.0, 0.02),
    "clip_range": (0.1, 0.4),
}
"""The smallest and the largest value that is tried; learning rates evenly by their logarithm."""

STARTUP = 8
"""Trials that are drawn at random, before Optuna's estimator (TPE) has enough to go by."""

NAME = "ppo"
FILE = "hyperparameters.json"


@dataclass(frozen=True)
class Trial:
    """A finished trial: hyperparameters, and what the policies that were trained with them reached."""

    number: int
    hyperparameters: dict[str, Any]
    damage: tuple[float, ...]  # per frame on the scenes held back, of each seed's best policy; empty if training failed
    reason: str = ""  # why training failed

    @property
    def score(self) -> float:
        """Mean detection loss per frame over the seeds."""
        return float(np.mean(self.damage)) if self.damage else float("-inf")


def tune(
    base: Recipe,
    folder: Path,
    *,
    trials: int,
    seeds: Sequence[int],
    seed: int = 0,
    n_steps: Sequence[int] = N_STEPS,
) -> Iterator[Trial]:
    """Play trials until the study in `folder` has so many; yields each of them, the stored ones first.

    A trial trains one policy a seed. Its score is the mean of their highest damage on the scenes held back. After every
    trial the best hyperparameters so far are written to `folder`/hyperparameters.json. One process at a time may work
    in a folder.

    Args:
        base: what all trials share; its own hyperparameters are the first trial.
        folder: of the study.
        trials: how many there are to be in all.
        seeds: of the learners.
        seed: of the search.
        n_steps: rollouts that are tried, in frames of each world. The frames between two evaluations stay the same.

    Raises:
        ImportError: Optuna is not installed; the message names the extra.
        ValueError: no trials or no seeds, hyperparameters of the recipe that the search cannot try, a folder that
            cannot be written or holds a study of something else; or the recipe itself cannot be trained.
    """
    if trials < 1 or not seeds or len(set(seeds)) != len(seeds):
        raise ValueError(f"a study needs a trial and distinct seeds; got {trials} trials and the seeds {list(seeds)}")
    first, library = _first(base, n_steps), _optuna()
    check_writable(folder)
    asked = {"recipe": asdict(base), "seeds": list(seeds), "seed": seed, "n_steps": list(n_steps)}
    with _study(library, folder) as study:
        _claim(study, folder, asked)
        finished = _finished(study)
        yield from finished[:trials]
        while len(finished) < trials:
            number, values = _open(study, first, base, seed, n_steps)
            done = _score(number, values, base, folder, seeds)
            if not done.damage and not finished:
                raise ValueError(f"the recipe's own hyperparameters cannot be trained with: {done.reason}")
            _store(study, done)
            finished.append(done)
            write_best(finished, folder, asked)
            yield done


def write_best(finished: Sequence[Trial], folder: Path, asked: dict[str, Any]) -> Trial:
    """Write the hyperparameters of the best trial, and return it; the earliest of equals."""
    best = max(finished, key=lambda trial: (trial.score, -trial.number))
    about = {
        **asked,
        "trial": best.number,
        "trials": len(finished),
        "damage_held_back": list(best.damage),
        "damage_of_the_recipe": list(finished[0].damage),
    }
    write_hyperparameters(folder / FILE, best.hyperparameters, about)
    return best


def suggest(trial: optuna.trial.BaseTrial, base: Recipe, n_steps: Sequence[int] = N_STEPS) -> dict[str, Any]:
    """Hyperparameters of a trial, by name.

    Args:
        trial: of Optuna; it draws them.
        base: its worlds and attackers say how many steps a rollout holds.
        n_steps: rollouts that are tried.
    """
    frames = int(trial.suggest_categorical("n_steps", list(n_steps)))
    parts = int(trial.suggest_categorical("minibatches", list(MINIBATCHES)))
    drawn: dict[str, Any] = {"n_steps": frames, "batch_size": max(rollout_steps(base, frames) // parts, 2)}
    drawn["n_epochs"] = trial.suggest_int("n_epochs", *EPOCHS)
    for name, (low, high) in RANGES.items():
        drawn[name] = trial.suggest_float(name, low, high, log=name == "learning_rate")
    return drawn


def rollout_steps(recipe: Recipe, n_steps: int) -> int:
    """Steps that SB3 counts in a rollout of so many frames of each world."""
    return n_steps * recipe.worlds * (1 if recipe.joint else recipe.n_attackers)


def trial_recipe(base: Recipe, values: dict[str, Any], seed: int) -> Recipe:
    """The recipe with other hyperparameters and another seed, evaluated after as many frames as before.

    Raises:
        ValueError: rollouts that do not fit into the frames between two evaluations.
    """
    every, rest = divmod(base.every * base.n_steps, values["n_steps"])
    if rest or not every:
        raise ValueError(
            f"a segment of {base.every} rollouts of {base.n_steps} frames does not divide into rollouts of "
            f"{values['n_steps']}; choose another `every`"
        )
    return replace(base, **values, every=every, seed=seed)


def _first(base: Recipe, n_steps: Sequence[int]) -> dict[str, Any]:
    """The recipe's hyperparameters as `suggest` asks for them. ValueError if the search cannot try them."""
    own, steps = dict(base.hyperparameters), rollout_steps(base, base.n_steps)
    for frames in n_steps:
        trial_recipe(base, {"n_steps": frames}, base.seed)
    parts, rest = divmod(steps, own.pop("batch_size"))
    if base.n_steps not in n_steps or rest or parts not in MINIBATCHES:
        raise ValueError(
            f"the search tries rollouts of {', '.join(map(str, n_steps))} frames, cut into "
            f"{', '.join(map(str, MINIBATCHES))} minibatches; the recipe's have {base.n_steps} frames, {steps} steps "
            f"and minibatches of {base.batch_size}; choose another n_steps or batch_size"
        )
    for name, (low, high) in {"n_epochs": EPOCHS, **RANGES}.items():
        if not low <= own[name] <= high:
            raise ValueError(f"the search tries {name} from {low:g} to {high:g}; the recipe has {own[name]:g}")
    return own | {"minibatches": parts}


def _optuna() -> Any:
    """The library, which reports nothing but warnings."""
    try:
        import optuna
    except ImportError as error:
        raise ImportError("hyperparameters are tuned by Optuna, an extra: pip install 'cp-env[agents,tune]'") from error
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


@contextmanager
def _study(library: Any, folder: Path) -> Iterator[optuna.study.Study]:
    """The study in a folder, new or begun; its file is closed in the end."""
    storage = library.storages.RDBStorage(f"sqlite:///{folder / 'study.db'}")
    try:
        yield library.create_study(storage=storage, study_name=NAME, direction="maximize", load_if_exists=True)
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _claim(study: optuna.study.Study, folder: Path, asked: dict[str, Any]) -> None:
    """Note in the study what it is of; ValueError if it is one of something else."""
    theirs = study.user_attrs.get("asked", asked)
    other = [name for name in asked["recipe"] if theirs["recipe"].get(name) != asked["recipe"][name]]
    other += [f"{name} of the study" for name in ("seeds", "seed", "n_steps") if theirs[name] != asked[name]]
    if other:
        raise ValueError(f"{folder} holds a study with another {', '.join(other)}; choose another folder")
    study.set_user_attr("asked", asked)


def _open(
    study: optuna.study.Study, first: dict[str, Any], base: Recipe, seed: int, n_steps: Sequence[int]
) -> tuple[int, dict[str, Any]]:
    """Number and hyperparameters of the trial that was stopped, if there is one, else of a new one."""
    from optuna.samplers import TPESampler
    from optuna.trial import TrialState

    for stopped in study.get_trials(states=(TrialState.RUNNING,)):
        if "values" in stopped.user_attrs:
            return stopped.number, stopped.user_attrs["values"]
        study.tell(stopped.number, state=TrialState.FAIL)  # it was killed before it was known what it would try
    if not any(trial.state is TrialState.WAITING or "values" in trial.user_attrs for trial in study.trials):
        study.enqueue_trial(first)
    stream = np.random.SeedSequence([seed, len(study.trials)])
    study.sampler = TPESampler(seed=int(stream.generate_state(1)[0]), n_startup_trials=STARTUP)
    trial = study.ask()
    values = suggest(trial, base, n_steps)
    trial.set_user_attr("values", values)
    return trial.number, values


def _score(number: int, values: dict[str, Any], base: Recipe, folder: Path, seeds: Sequence[int]) -> Trial:
    """Train with these hyperparameters, one policy a seed, each from its last checkpoint if there is one."""
    damage = []
    for own in seeds:
        try:
            curve = train(trial_recipe(base, values, own), folder / f"trial-{number:03}" / f"seed-{own}")
        except ValueError as error:  # torch refuses a policy whose numbers are not finite
            return Trial(number, values, (), str(error).splitlines()[0][:200])
        damage.append(max(evaluation["damage"] for evaluation in curve))
    return Trial(number, values, tuple(damage))


def _store(study: optuna.study.Study, done: Trial) -> None:
    """Store a finished trial."""
    from optuna.trial import TrialState

    study.set_user_attr(_key(done.number), {"damage": list(done.damage), "reason": done.reason})
    if done.damage:
        study.tell(done.number, done.score)
    else:
        study.tell(done.number, state=TrialState.FAIL)


def _finished(study: optuna.study.Study) -> list[Trial]:
    """Trials whose result is stored, in order."""
    found = []
    for trial in study.trials:
        result = study.user_attrs.get(_key(trial.number))
        if result is not None and trial.state.is_finished():
            values = trial.user_attrs["values"]
            found.append(Trial(trial.number, values, tuple(result["damage"]), result["reason"]))
    return found


def _key(number: int) -> str:
    """The name of a trial's result in the study."""
    return f"result {number}"
