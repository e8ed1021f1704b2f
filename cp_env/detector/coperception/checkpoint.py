"""coperception's checkpoints: a dictionary with `model_state_dict`, read without running any code of theirs.

Keys may begin with `module.` (a model that was trained on several GPUs). Models that share maps hold two halves,
`u_encoder` and `decoder`, each of which carries the whole backbone though it uses half of it; the model that shares
nothing holds one, `stpn`. What a model does not use is tolerated where coperception writes it, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from jaxtyping import Float
from torch import Tensor, nn

from cp_env.detector.coperception.torch_file import StoredTensor, TorchFile

FUSIONS = ("mean", "max", "sum", "v2vnet", "disconet")
LEARNED = {"v2vnet": "convgru", "disconet": "pixel_weighted_fusion"}
HALVES = ("u_encoder", "decoder", "stpn")
KNOWN = (*HALVES, "classification", "regression", *LEARNED.values())


class Weights:
    """The tensors of a checkpoint, handed out by name and shape."""

    def __init__(self, tensors: Mapping[str, Tensor], source: str) -> None:
        self._tensors = {key.removeprefix("module."): tensor for key, tensor in tensors.items()}
        self.source = source

    @property
    def prefixes(self) -> set[str]:
        """The parts of the model that are there."""
        return {key.split(".")[0] for key in self._tensors}

    def __contains__(self, key: str) -> bool:
        return key in self._tensors

    def shape(self, key: str) -> tuple[int, ...]:
        return tuple(self._tensors[key].shape)

    def take(self, key: str, *shape: int) -> Tensor:
        """The tensor `key`, single precision. ValueError if it is missing or has another shape."""
        if key not in self._tensors:
            raise ValueError(
                f"{self.source} does not fit: it holds no {key!r}; its parts are {', '.join(sorted(self.prefixes))}"
            )
        tensor = self._tensors[key]
        if tuple(tensor.shape) != shape:
            raise ValueError(
                f"{self.source} does not fit: {key!r} has shape {tuple(tensor.shape)}, not {shape}; "
                "only coperception's default configuration can be read (13 slices, layer 3, two classes, six anchors)"
            )
        return tensor.detach().float()

    def conv(self, conv: str, norm: str | None, shape: tuple[int, ...]) -> tuple[Tensor, Tensor]:
        """Weight [O, I, k, k] and bias [O] of a convolution with the normalisation behind it folded in.

        `shape` is the weight's in the checkpoint; further axes of length one (of a 1x1x1 convolution) are dropped.
        """
        weight, bias = self.take(f"{conv}.weight", *shape).double(), self.take(f"{conv}.bias", shape[0]).double()
        if norm is not None:
            scale, shift, mean, variance = (
                self.take(f"{norm}.{name}", shape[0]).double()
                for name in ("weight", "bias", "running_mean", "running_var")
            )
            scale = scale / (variance + nn.BatchNorm2d(1).eps).sqrt()
            weight, bias = weight * scale.reshape(-1, *[1] * (weight.dim() - 1)), (bias - mean) * scale + shift
        return weight.float().reshape(*shape[:4]), bias.float()

    def check_parts(self, fusion: str) -> None:
        """ValueError if the checkpoint is of another model than the one that fuses by `fusion`."""
        if unknown := self.prefixes - set(KNOWN):
            raise ValueError(
                f"{self.source} does not fit: it holds {', '.join(sorted(unknown))}, which no model of coperception "
                f"with mean, max, sum, V2VNet or DiscoNet fusion has; known parts are {', '.join(KNOWN)}"
            )
        for name, part in LEARNED.items():
            if (part in self.prefixes) != (fusion == name):
                has = "holds" if part in self.prefixes else "holds no"
                way = f'use fusion="{name}"' if part in self.prefixes else 'use fusion="mean", "max" or "sum"'
                raise ValueError(f'{self.source} does not fit fusion="{fusion}": it {has} {part}.*; {way}')
        if not {"u_encoder", "decoder"} <= self.prefixes and "stpn" not in self.prefixes:
            raise ValueError(
                f"{self.source} does not fit: it needs u_encoder.* and decoder.* (or stpn.*), and holds "
                f"{', '.join(sorted(self.prefixes)) or 'nothing'}"
            )


def read(path: str | Path) -> Weights:
    """The tensors of a checkpoint file.

    Raises:
        ValueError: the file is missing, is none of torch's, exceeds a bound of `torch_file`, holds other objects than
            tensors and plain values, a weight that is no finite number, or no `model_state_dict`.
    """
    path = Path(path)
    try:
        with TorchFile(path) as file:
            content = file.content
            state = content.get("model_state_dict") if isinstance(content, dict) else None
            if isinstance(state, dict) and all(isinstance(value, StoredTensor) for value in state.values()):
                return Weights({str(key): file.tensor(value) for key, value in state.items()}, str(path))
    except FileNotFoundError as error:
        raise ValueError(f"no checkpoint at {path}: the file is missing") from error
    except (OSError, ValueError) as error:
        raise ValueError(
            f"cannot read the checkpoint {path}: {error}\nIf it is whole, it holds objects that are not run here. "
            'Where you trust it, keep the weights alone: torch.save({"model_state_dict": torch.load(path, '
            'weights_only=False)["model_state_dict"]}, new_path)'
        ) from error
    holds = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
    raise ValueError(f"the checkpoint {path} has no 'model_state_dict' of tensors; it holds {holds[:200] or 'nothing'}")


def layer(weight: Float[Tensor, "O I h w"], bias: Float[Tensor, " O"], stride: int = 1) -> nn.Conv2d:
    """A convolution of zero padding with these weights."""
    out, into, size, _ = weight.shape
    made = nn.Conv2d(into, out, size, stride, size // 2)
    made.weight, made.bias = nn.Parameter(weight.contiguous()), nn.Parameter(bias)
    return made
