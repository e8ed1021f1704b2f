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
from safetensors.torch import save_file
from torch import Tensor

from agents.learning.lstm import Memory
from cp_env.detector.model.tensors import read_tensors
from cp_env.scenes.formats.bounded import parse_json

FOLDER = Path(__file__).parent / "policies"
FORMAT = "cp_env policy 3"

ABOUT = ("defender", "options", "notes", "joint")
_KINDS = {"defender": str, "options": dict, "notes": dict, "joint": bool, "format": str}
MEMORY = ("weight_ih", "weight_hh", "bias_ih", "bias_hh")
MAX_LOG_STD = 20.0


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
        ValueError: unknown name, missing file, broken file, or one of another format; a tensor that is missing, not
            asked for, of the wrong shape or type, or holds a number that is not finite.
    """
    path = Path(name)
    if path.suffix != ".safetensors":
        if str(name) not in policy_names():
            raise ValueError(
                f"unknown policy {str(name)!r}; known: {', '.join(policy_names())}; or give a .safetensors file"
            )
        path = FOLDER / f"{name}.safetensors"
    try:
        notes, tensors = read_tensors(path)
        about = parse_json(notes.get("about", "{}"))
    except FileNotFoundError as error:
        raise ValueError(f"no policy at {path}: the file is missing; train one with cp-train attack") from error
    except (OSError, ValueError) as error:
        raise ValueError(f"cannot read the policy in {path}: {error}; the file is broken") from error
    if not isinstance(about, dict) or about.get("format") != FORMAT:
        raise ValueError(f"{path} is no policy of the format {FORMAT!r}; train one anew")
    if {key: type(value) for key, value in about.items()} != _KINDS:
        raise ValueError(f"{path} is no policy: it must say {', '.join(_KINDS)}, each of its type; train one anew")
    _check_tensors(path, tensors)
    layers = range((len(tensors) - 1 - len(MEMORY) * (f"memory.{MEMORY[0]}" in tensors)) // 2)
    return Policy(
        weights=tuple(tensors[f"{layer}.weight"] for layer in layers),
        biases=tuple(tensors[f"{layer}.bias"] for layer in layers),
        log_std=tensors["log_std"],
        memory=Memory(*(tensors[f"memory.{name}"] for name in MEMORY)) if f"memory.{MEMORY[0]}" in tensors else None,
        **{name: about[name] for name in ABOUT},
    )


def _check_tensors(path: Path, tensors: dict[str, Tensor]) -> None:
    """ValueError unless these are the tensors of a policy: all of them, no other, of shapes that fit, finite."""
    wanted: dict[str, tuple[int, ...]] = {}
    width = None  # numbers that come out of the part before
    if any(key.startswith("memory.") for key in tensors):
        gates, width = _shape(path, tensors, "memory.weight_hh")
        n_inputs = _shape(path, tensors, "memory.weight_ih")[1]
        if gates != 4 * width:
            raise ValueError(
                f"{path} is no policy: memory.weight_hh has shape ({gates}, {width}), not (4h, h); train one anew"
            )
        shapes = (gates, n_inputs), (gates, width), (gates,), (gates,)
        wanted |= {f"memory.{name}": shape for name, shape in zip(MEMORY, shapes, strict=True)}
    for layer in range(max(1, sum(key.partition(".")[2] == "weight" for key in tensors))):
        n_out, n_in = _shape(path, tensors, f"{layer}.weight")
        wanted |= {f"{layer}.weight": (n_out, n_in if width is None else width), f"{layer}.bias": (n_out,)}
        width = n_out
    assert width is not None
    wanted["log_std"] = (width,)
    if wrong := sorted(wanted.keys() ^ tensors.keys()):
        what = "lacks" if wrong[0] in wanted else "holds, beside its own,"
        raise ValueError(f"{path} is no policy: it {what} the tensor {wrong[0][:80]!r}; train one anew")
    for key, shape in wanted.items():
        if tuple(tensors[key].shape) != shape or tensors[key].dtype != torch.float32:
            raise ValueError(
                f"{path} is no policy: {key} is {tuple(tensors[key].shape)} of {tensors[key].dtype}, not {shape} of "
                "torch.float32; train one anew"
            )
        if not bool(torch.isfinite(tensors[key]).all()):
            raise ValueError(f"{path} is no policy: {key} holds numbers that are not finite; train one anew")
    if bool((tensors["log_std"] > MAX_LOG_STD).any()):
        raise ValueError(f"{path} is no policy: log_std must be at most {MAX_LOG_STD}; train one anew")


def _shape(path: Path, tensors: dict[str, Tensor], key: str) -> tuple[int, int]:
    """Rows and columns of a matrix, at least one each."""
    shape = tuple(tensors[key].shape) if key in tensors else ()
    if len(shape) != 2 or 0 in shape:
        has = f"has shape {shape}" if key in tensors else "is missing"
        raise ValueError(f"{path} is no policy: the matrix {key} {has}; train one anew")
    return shape[0], shape[1]
