"""A slow twin of `cp_env.detector.coperception`, straight from the layer sequence of the public coperception code.

Every agent is encoded, fused and decoded, by layer names as they stand in a checkpoint: one function a step, no module,
nothing folded, nothing shared. Maps stay in coperception's own layout. `random_state` makes weights in its format.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np
import shapely
import torch
from torch import Tensor
from torch.nn import functional as F

State = dict[str, Tensor]
ANCHORS = [(w, h, a) for w, h in ((2.0, 4.0), (3.0, 12.0)) for a in (0.0, math.pi / 2, -math.pi / 4)]


def unit(state: State, conv: str, norm: str, x: Tensor, stride: int = 1) -> Tensor:
    """Convolution, normalisation with running statistics, ReLU."""
    x = F.conv2d(x, state[f"{conv}.weight"], state[f"{conv}.bias"], stride, state[f"{conv}.weight"].shape[-1] // 2)
    statistics = (state[f"{norm}.{name}"] for name in ("running_mean", "running_var", "weight", "bias"))
    return F.relu(F.batch_norm(x, *statistics))


def volume(state: State, name: str, x: Tensor) -> Tensor:
    """A 1x1x1 convolution over one moment in time."""
    x = F.conv3d(x.unsqueeze(2), state[f"{name}.conv3d.weight"], state[f"{name}.conv3d.bias"])
    statistics = (state[f"{name}.bn3d.{part}"] for part in ("running_mean", "running_var", "weight", "bias"))
    return F.relu(F.batch_norm(x, *statistics)).squeeze(2)


def encode(state: State, half: str, bev: Tensor) -> list[Tensor]:
    """[A, 13, 256, 256] to the five layers."""
    x = unit(state, f"{half}.conv_pre_1", f"{half}.bn_pre_1", bev)
    layers = [unit(state, f"{half}.conv_pre_2", f"{half}.bn_pre_2", x)]
    for stage in (1, 2, 3, 4):
        x = unit(state, f"{half}.conv{stage}_1", f"{half}.bn{stage}_1", layers[-1], stride=2)
        x = unit(state, f"{half}.conv{stage}_2", f"{half}.bn{stage}_2", x)
        layers.append(volume(state, f"{half}.conv3d_{stage}", x) if stage < 3 else x)
    return layers


def decode(state: State, half: str, layers: list[Tensor]) -> Tensor:
    x = layers[4]
    for stage, skip in zip((5, 6, 7, 8), layers[3::-1], strict=True):
        x = torch.cat([F.interpolate(x, scale_factor=(2, 2)), skip], dim=1)
        x = unit(state, f"{half}.conv{stage}_1", f"{half}.bn{stage}_1", x)
        x = unit(state, f"{half}.conv{stage}_2", f"{half}.bn{stage}_2", x)
    return x


def warped(sent: Tensor, sender_T_target: Tensor) -> Tensor:
    """One map [C, 32, 32] of mirrored rows in the target's frame: one affine resampling."""
    theta = torch.cat([sender_T_target[:2, :2], -sender_T_target[:2, 3:4] * (4 / 128)], dim=1).float()[None]
    return F.grid_sample(sent[None], F.affine_grid(theta, [1, *sent.shape], align_corners=False), align_corners=False)[
        0
    ]


def warped_in_two(sent: Tensor, target_T_sender: Tensor) -> Tensor:
    """One map [C, 32, 32] in the target's frame: turned first, then moved; the rows are not mirrored."""
    turn = torch.cat([target_T_sender[:2, :2], torch.zeros(2, 1).double()], dim=1)
    move = torch.tensor([[1, 0, 4 * target_T_sender[0, 3] / 128], [0, 1, -4 * target_T_sender[1, 3] / 128]])
    for theta in (turn, move):
        grid = F.affine_grid(theta.float()[None], [1, *sent.shape], align_corners=False)
        sent = F.grid_sample(sent[None], grid, align_corners=False)[0]
    return sent


def gru(state: State, x: Tensor) -> Tensor:
    """A convolutional GRU from a hidden state of zeros."""
    hidden = torch.zeros(1, 256, *x.shape[-2:])
    of_input = F.conv2d(x, state["convgru.weight_ih_l0"], state["convgru.bias_ih_l0"], padding=1)
    of_hidden = F.conv2d(hidden, state["convgru.weight_hh_l0"], state["convgru.bias_hh_l0"], padding=1)
    (i_r, i_z, i_n), (h_r, h_z, h_n) = of_input.chunk(3, 1), of_hidden.chunk(3, 1)
    new = torch.tanh(i_n + torch.sigmoid(i_r + h_r) * h_n)
    return new + torch.sigmoid(i_z + h_z) * (hidden - new)


def weight_of(state: State, pair: Tensor) -> Tensor:
    for number in (1, 2, 3):
        name = f"pixel_weighted_fusion.{{}}1_{number}"
        pair = unit(state, name.format("conv"), name.format("bn"), pair)
    last = state["pixel_weighted_fusion.conv1_4.weight"], state["pixel_weighted_fusion.conv1_4.bias"]
    return torch.exp(F.relu(F.conv2d(pair, *last)))


def fuse(state: State, fusion: str, own: Tensor, others: list[Tensor], rounds: int) -> Tensor:
    """The target's own map and those of its neighbours."""
    if fusion == "v2vnet":
        mine, message = own, torch.stack(others).mean(0)
        for _ in range(rounds):
            mine = gru(state, torch.cat([mine, message])[None])[0]
        return mine
    if fusion == "disconet":
        weights = [weight_of(state, torch.cat([own, one])[None])[0] for one in [own, *others]]
        shares = [weight / sum(weights) for weight in weights]
        return sum(share * one for share, one in zip(shares, [own, *others], strict=True))
    stacked = torch.stack([own, *others])
    return {"mean": stacked.mean(0), "max": stacked.max(0).values, "sum": stacked.sum(0)}[fusion]


def forward(
    state: State,
    fusion: str,
    bev: Tensor,
    poses: Tensor,
    *,
    rounds: int = 3,
    mirrored: bool = True,
    egos: int | None = None,
) -> tuple[Tensor, Tensor]:
    """All A agents: class scores [A, 256 · 256 · 6, 2] and codes [A, 256, 256, 6, 6]; of the first `egos`, if given.

    `poses[i, j]` [4, 4] takes points of agent j to agent i. `mirrored`: rows are mirrored while maps are fused, which
    are resampled once; else they are not, and are resampled twice.
    """
    egos = len(bev) if egos is None else egos
    first, last = ("stpn", "stpn") if any(key.startswith("stpn") for key in state) else ("u_encoder", "decoder")
    layers = encode(state, first, bev)
    sent = layers[3].flip(2) if mirrored else layers[3]
    fused = []
    for i in range(egos):
        others = [
            warped(sent[j], poses[j, i]) if mirrored else warped_in_two(sent[j], poses[i, j])
            for j in range(len(bev))
            if j != i
        ]
        fused.append(fuse(state, fusion, sent[i], others, rounds))
    layers = [own[:egos] for own in layers]
    layers[3] = torch.stack(fused).flip(2) if mirrored else torch.stack(fused)
    x = decode(state, last, layers)
    scores = unit(state, "classification.conv1", "classification.bn1", x)
    scores = F.conv2d(scores, state["classification.conv2.weight"], state["classification.conv2.bias"])
    box = "regression.box_prediction"
    codes = unit(state, f"{box}.0", f"{box}.1", x)
    codes = F.conv2d(codes, state[f"{box}.3.weight"], state[f"{box}.3.bias"])
    return (
        scores.permute(0, 2, 3, 1).reshape(egos, -1, 2),
        codes.permute(0, 2, 3, 1).reshape(egos, 256, 256, 6, 6),
    )


def corners(code: np.ndarray, row: int, column: int, anchor: int) -> np.ndarray:
    """One decoded box's corners [4, 2] in coperception's frame."""
    (w, h, angle), (xp, yp, wp, hp, sp, cp) = ANCHORS[anchor], code
    width, length = w / math.exp(wp), h / math.exp(hp)
    x = column * 0.25 - 32 + 0.125 - width * xp
    y = row * 0.25 - 32 + 0.125 - length * yp
    sin = math.sin(angle) * cp + math.cos(angle) * sp
    cos = math.cos(angle) * cp - math.sin(angle) * sp
    around = np.array([[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]]) * [width, length]
    return around @ np.array([[cos, -sin], [sin, cos]]) + [x, y]


def detections(scores: Tensor, codes: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Corners [L, 4, 2] and scores of one agent: softmax, more than 0.7, polygons suppressed beyond IoU 0.01."""
    score = F.softmax(scores, dim=-1)[:, 1].numpy()
    chosen: list[tuple[np.ndarray, float, shapely.Polygon]] = []
    for index in sorted(np.flatnonzero(score > 0.7).tolist(), key=lambda i: -score[i]):
        cell, anchor = divmod(index, 6)
        row, column = divmod(cell, 256)
        outline = corners(codes[row, column, anchor].double().numpy(), row, column, anchor)
        polygon = shapely.Polygon(outline)
        if all(polygon.intersection(p).area / polygon.union(p).area <= 0.01 for _, _, p in chosen):
            chosen.append((outline, float(score[index]), polygon))
    return np.array([c for c, _, _ in chosen]).reshape(-1, 4, 2), np.array([s for _, s, _ in chosen])


def shapes(fusion: str) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Name and shape of every convolution, and of every normalisation (one number), of a whole checkpoint."""
    wide = [
        (1, 32, 64),
        (2, 64, 128),
        (3, 128, 256),
        (4, 256, 512),
        (5, 768, 256),
        (6, 384, 128),
        (7, 192, 64),
        (8, 96, 32),
    ]
    for half in ("stpn",) if fusion == "none" else ("u_encoder", "decoder"):
        yield f"{half}.conv_pre_1", (32, 13, 3, 3)
        yield f"{half}.conv_pre_2", (32, 32, 3, 3)
        for number, into, out in wide:
            yield f"{half}.conv{number}_1", (out, into, 3, 3)
            yield f"{half}.conv{number}_2", (out, out, 3, 3)
        for stage, out in ((1, 64), (2, 128)):
            yield f"{half}.conv3d_{stage}.conv3d", (out, out, 1, 1, 1)
            yield f"{half}.conv3d_{stage}.bn3d", (out,)
        for name in ("com_compresser", "com_decompresser"):
            yield f"{half}.{name}", (256, 256, 1, 1)
        yield f"{half}.bn_compress", (256,)
        yield f"{half}.bn_decompress", (256,)
        for number, out in [("_pre_", 32), *((f"{n}_", out) for n, _, out in wide)]:
            yield f"{half}.bn{number}1", (out,)
            yield f"{half}.bn{number}2", (out,)
    yield "classification.conv1", (32, 32, 3, 3)
    yield "classification.bn1", (32,)
    yield "classification.conv2", (12, 32, 1, 1)
    yield "regression.box_prediction.0", (32, 32, 3, 3)
    yield "regression.box_prediction.1", (32,)
    yield "regression.box_prediction.3", (36, 32, 1, 1)


def judge_shapes() -> Iterator[tuple[str, tuple[int, ...]]]:
    """The same of DiscoNet's own part."""
    for number, (into, out) in enumerate(((512, 128), (128, 32), (32, 8), (8, 1)), start=1):
        yield f"pixel_weighted_fusion.conv1_{number}", (out, into, 1, 1)
        if out > 1:
            yield f"pixel_weighted_fusion.bn1_{number}", (out,)


def _filled(shapes: Iterable[tuple[str, tuple[int, ...]]], generator: torch.Generator) -> State:
    """Random numbers that keep activations at about one."""

    def normal(*shape: int) -> Tensor:
        return torch.randn(shape, generator=generator)

    state: State = {}
    for name, shape in shapes:
        if len(shape) == 1:
            state[f"{name}.weight"], state[f"{name}.bias"] = 1 + 0.1 * normal(*shape), 0.1 * normal(*shape)
            state[f"{name}.running_mean"] = 0.1 * normal(*shape)
            state[f"{name}.running_var"] = 1 + 0.3 * torch.rand(shape, generator=generator)
            state[f"{name}.num_batches_tracked"] = torch.tensor(7)
        else:
            state[f"{name}.weight"] = normal(*shape) * math.sqrt(2 / math.prod(shape[1:]))
            state[f"{name}.bias"] = 0.05 * normal(shape[0])
    return state


def fusion_state(fusion: str, seed: int = 1) -> State:
    """Random weights of what a learned fusion adds to the model; nothing for the others."""
    generator = torch.Generator().manual_seed(seed)
    if fusion == "disconet":
        return _filled(judge_shapes(), generator)
    if fusion != "v2vnet":
        return {}
    of_input, of_hidden, *biases = (
        torch.randn(shape, generator=generator) for shape in ((768, 512, 3, 3), (768, 256, 3, 3), (768,), (768,))
    )
    return {
        "convgru.weight_ih_l0": of_input / math.sqrt(512 * 9),
        "convgru.weight_hh_l0": of_hidden / math.sqrt(256 * 9),
        "convgru.bias_ih_l0": 0.1 * biases[0],
        "convgru.bias_hh_l0": 0.1 * biases[1],
    }


def random_state(fusion: str = "mean", seed: int = 0, *, rarity: float = 3.0) -> State:
    """Random weights with the names and shapes of a checkpoint; vehicles are as rare as `rarity` (log-odds) says.

    `fusion="none"` makes the model that shares nothing (`stpn`).
    """
    state = {} if fusion == "none" else fusion_state(fusion, seed + 1)
    state |= _filled(shapes(fusion), torch.Generator().manual_seed(seed))
    state["classification.conv2.bias"][::2] += rarity
    upright = torch.tensor([0.0, 0.0, 0.0, 0.0, 0.0, 1.0]).repeat(6)
    state["regression.box_prediction.3.weight"] *= 0.2
    state["regression.box_prediction.3.bias"] += upright
    return state


def save(state: State, path: object, **more: object) -> None:
    """A checkpoint as coperception writes it, several GPUs' prefix and all."""
    torch.save({"epoch": 100, "model_state_dict": {f"module.{key}": t for key, t in state.items()}, **more}, path)  # type: ignore[arg-type]
