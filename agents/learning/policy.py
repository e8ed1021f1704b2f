"""Learned attacks on disk: a policy's small network and the options it was trained under, one safetensors file each.

Nothing is unpickled, and Stable-Baselines3 is not needed to play one.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from agents.learning.lstm import Memory

FOLDER = Path(__file__).parent / "policies"
FORMAT = "cp_env policy 3"

ABOUT = ("defender", "options", "notes", "joint")
MEMORY = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")


@dataclass(frozen=True, eq=False)
class Policy:
    """A Gaussian policy: linear layers with tanh between them, the mean of the last, and one deviation a number.

    A shared policy moves each attacker by its own observation. A joint policy reads the observations of all attackers
    of a world end to end, and writes their actions likewise. A recurrent policy puts a memory before the layers; it
    goes on remembering from call to call until `reset`.
    """

    weights: tuple[Float[Tensor, "_ _"], ...]
    biases: tuple[Float[Tensor, " _"], ...]
    log_std: Float[Tensor, " a"]
    defender: str  # it was trained against
    options: dict[str, Any]  # of the environment it was trained in
    notes: dict[str, Any] = field(default_factory=dict)  # how it was trained and what it reached
    joint: bool = False
    memory: Memory | None = None

    @property
    def n_inputs(self) -> int:
        """Numbers the network reads at once."""
        return (self.memory.weight_ih if self.memory else self.weights[0]).shape[1]

    def reset(self) -> None:
        """Begin new episodes in all worlds."""
        if self.memory is not None:
            self.memory.reset()

    def __call__(
        self, observations: Float[np.ndarray, "*n d"], rng: np.random.Generator | None = None
    ) -> Float[np.ndarray, "*n a"]:
        """Actions in [-1, 1]: the mean, or a draw if `rng` is given. Of a joint policy, n ends in a world's attackers.

        Raises:
            ValueError: observations that are not those of the environment it was trained in.
        """
        array = np.asarray(observations, dtype=np.float32)
        shape = (*array.shape[:-2], -1) if self.joint else array.shape
        hidden = torch.from_numpy(array.reshape(shape))
        if hidden.shape[-1] != self.n_inputs:
            raise ValueError(
                f"this policy reads observations of {self.n_inputs} numbers, not {hidden.shape[-1]}; "
                f"make the environment with its own options: {self.options}"
            )
        if self.memory is not None:
            hidden = self.memory(hidden.reshape(-1, self.n_inputs)).reshape(*hidden.shape[:-1], -1)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = torch.nn.functional.linear(torch.tanh(hidden) if layer else hidden, weight, bias)
        action: np.ndarray = hidden.numpy()
        if rng is not None:
            action = action + np.exp(self.log_std.numpy()) * rng.standard_normal(action.shape, dtype=np.float32)
        return np.clip(action, -1.0, 1.0).reshape(*array.shape[:-1], -1)


def policy_names() -> tuple[str, ...]:
    """Names of the learned attacks that ship with the package."""
    return tuple(sorted(path.stem for path in FOLDER.glob("*.safetensors")))


def save_policy(policy: Policy, path: Path) -> None:
    """Write a policy; the file appears whole or not at all."""
    tensors = {"log_std": policy.log_std.contiguous()}
    for layer, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        tensors |= {f"{layer}.weight": weight.contiguous(), f"{layer}.bias": bias.contiguous()}
    if policy.memory is not None:
        tensors |= {f"memory.{name}": getattr(policy.memory, name).contiguous() for name in MEMORY}
    about = {name: getattr(policy, name) for name in ABOUT} | {"format": FORMAT}
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    save_file(tensors, partial, metadata={"about": json.dumps(about)})  # one entry: several come in any order
    partial.replace(path)


def load_policy(name: str | Path) -> Policy:
    """A shipped policy by its name, or one from a file of yours (`….safetensors`).

    Args:
        name: one of `policy_names()`, or a file.

    Returns:
        The policy.

    Raises:
        ValueError: unknown name, missing file, broken file, or one of another format.
    """
    path = Path(name)
    if path.suffix != ".safetensors":
        if str(name) not in policy_names():
            raise ValueError(
                f"unknown policy {str(name)!r}; known: {', '.join(policy_names())}; or give a .safetensors file"
            )
        path = FOLDER / f"{name}.safetensors"
    if not path.is_file():
        raise ValueError(f"no policy at {path}: the file is missing; train one with examples/train_attacker.py")
    try:
        with safe_open(path, framework="pt") as file:
            about = json.loads((file.metadata() or {}).get("about", "{}"))
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (not a dict)
    except (SafetensorError, OSError, json.JSONDecodeError) as error:
        raise ValueError(f"cannot read the policy in {path}: {error}; the file is broken") from error
    if about.pop("format", None) != FORMAT:
        raise ValueError(f"{path} is no policy of the format {FORMAT!r}; train one anew")
    layers = range(sum(key.endswith(".weight") for key in tensors))
    return Policy(
        weights=tuple(tensors[f"{layer}.weight"] for layer in layers),
        biases=tuple(tensors[f"{layer}.bias"] for layer in layers),
        log_std=tensors["log_std"],
        memory=Memory(*(tensors[f"memory.{name}"] for name in MEMORY)) if f"memory.{MEMORY[0]}" in tensors else None,
        **about,
    )
