"""f_T: worked by hand where it can be, laws where it cannot."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import cp_env.detector.model.warp as moving
from cp_env.detector import Detector
from cp_env.detector.model.warp import coverage, warp

EXTENT, SIZE = 32.0, 32  # cells of 2 m


def pose(x: float, y: float, yaw: float = 0.0) -> torch.Tensor:
    return torch.tensor([x, y, yaw])


def spot(row: int, col: int, size: int = SIZE) -> torch.Tensor:
    maps = torch.zeros(1, size, size)
    maps[0, row, col] = 1.0
    return maps


def random_map(seed: int, channels: int = 3) -> torch.Tensor:
    return torch.rand(channels, SIZE, SIZE, generator=torch.Generator().manual_seed(seed))


def test_one_cell_east_is_one_column_on() -> None:
    # a sender 2 m east of the ego: what it sees in its column 10 lies in the ego's column 11; north is the next row
    assert torch.allclose(warp(spot(5, 10), pose(2.0, 0.0), EXTENT), spot(5, 11), atol=1e-6)
    assert torch.allclose(warp(spot(5, 10), pose(0.0, 2.0), EXTENT), spot(6, 10), atol=1e-6)
    assert torch.allclose(warp(spot(5, 10), pose(-4.0, 6.0), EXTENT), spot(8, 8), atol=1e-5)


def test_half_a_cell_is_shared() -> None:
    expected = 0.5 * spot(5, 10) + 0.5 * spot(5, 11)
    assert torch.allclose(warp(spot(5, 10), pose(1.0, 0.0), EXTENT), expected, atol=1e-5)
    quarter = sum(0.25 * spot(row, col) for row in (5, 6) for col in (10, 11))
    assert torch.allclose(warp(spot(5, 10), pose(1.0, 1.0), EXTENT), quarter, atol=1e-5)


def test_a_quarter_turn() -> None:
    # the sender faces north (yaw 90°): its ahead (+x, high columns) is the ego's north (high rows)
    # cell (row 15, col 31) has its centre at (x, y) = (31, -1); turned by 90° that is (1, 31): row 31, col 16
    turned = warp(spot(15, 31), pose(0.0, 0.0, math.pi / 2), EXTENT)
    assert torch.allclose(turned, spot(31, 16), atol=1e-4)


def test_what_leaves_the_map_is_gone_and_what_enters_is_zero() -> None:
    shifted = warp(torch.ones(1, SIZE, SIZE), pose(20.0, 0.0), EXTENT)
    assert torch.allclose(shifted[:, :, :10], torch.zeros(1, SIZE, 10))
    assert torch.allclose(shifted[:, :, 10:], torch.ones(1, SIZE, 22), atol=1e-5)
    assert not warp(torch.ones(1, SIZE, SIZE), pose(70.0, 0.0), EXTENT).any()


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-4, 4), st.integers(0, 5))
def test_linear(x: float, y: float, yaw: float, seed: int) -> None:
    a, b, at = random_map(seed), random_map(seed + 10), pose(x, y, yaw)
    both = warp(2 * a - 3 * b, at, EXTENT)
    assert torch.allclose(both, 2 * warp(a, at, EXTENT) - 3 * warp(b, at, EXTENT), atol=1e-4)


@given(st.floats(-70, 70), st.floats(-70, 70), st.floats(-4, 4))
def test_coverage_is_where_the_senders_map_reaches(x: float, y: float, yaw: float) -> None:
    mask = coverage(pose(x, y, yaw), SIZE, EXTENT)
    centre = (torch.arange(SIZE) + 0.5) * 2 - EXTENT
    dx, dy = centre[None, :] - x, centre[:, None] - y
    ahead, left = math.cos(yaw) * dx + math.sin(yaw) * dy, -math.sin(yaw) * dx + math.cos(yaw) * dy
    depth = EXTENT - torch.maximum(ahead.abs(), left.abs())  # m within the border
    assert (mask[depth > 0.01] == 1).all()
    assert (mask[depth < -0.01] == 0).all()
    full = warp(torch.ones(1, SIZE, SIZE), pose(x, y, yaw), EXTENT)[0]
    assert (full[mask == 0] < 1).all()  # nothing whole comes from outside
    assert torch.allclose(full[depth > 1.5], torch.ones(()), atol=1e-4)  # more than half a (turned) cell inside


def test_coverage_of_oneself_is_everything() -> None:
    for yaw in (0.0, math.pi / 2, math.pi, -math.pi / 2):
        assert coverage(pose(0.0, 0.0, yaw), SIZE, EXTENT).all()


def test_leading_axes_are_batch_axes() -> None:
    detector = Detector()
    maps = torch.stack([torch.stack([random_map(e * 4 + n, 2) for n in range(3)]) for e in range(2)])
    poses = torch.tensor([[[0.0, 0, 0], [3, 1, 0], [-7, 2, 0.3]], [[5.0, 5, 0], [0, 0, 1], [60, 0, 0]]])
    together, masks = detector.warp(maps, poses), detector.coverage(poses)
    for e in range(2):
        for n in range(3):
            assert torch.allclose(together[e, n], detector.warp(maps[e, n], poses[e, n]), atol=1e-5)
            assert torch.equal(masks[e, n], detector.coverage(poses[e, n]))


@given(st.integers(-40, 40), st.integers(-40, 40), st.integers(0, 5))
def test_whole_cells_are_copied_as_they_would_be_sampled(columns: int, rows: int, seed: int) -> None:
    maps = random_map(seed)
    copied = warp(maps, pose(2.0 * columns, 2.0 * rows), EXTENT)
    sampled = warp(maps, pose(2.0 * columns, 2.0 * rows, 2 * math.pi), EXTENT)  # a full turn is no shift: it is sampled
    assert torch.allclose(copied, sampled, atol=1e-3)
    assert set(copied.unique().tolist()) <= set(maps.unique().tolist()) | {0.0}, "nothing is blurred"


@pytest.mark.parametrize("at", [(3.0, -5.0), (4.0, -6.0)])
def test_gradient_reaches_the_sender(at: tuple[float, float]) -> None:
    maps = random_map(0).requires_grad_()
    warp(maps, pose(*at), EXTENT).sum().backward()
    assert maps.grad is not None
    assert maps.grad[:, 10:25, 5:25].min() == pytest.approx(1.0, abs=1e-4)  # each inner cell is handed on whole
    assert not maps.grad[:, :2].any()  # and the southern rows left the ego's map


def test_a_pose_too_few_is_refused() -> None:
    with pytest.raises(ValueError, match="a map needs one pose each"):
        warp(torch.zeros(3, 2, SIZE, SIZE), torch.zeros(2, 3), EXTENT)


SHIFTS = [(0, 0), (3, -5), (-31, 2), (32, 0), (0, -40), (100, 100)]


def test_one_fetch_for_all_maps_is_the_copy_of_each() -> None:
    maps = torch.randn(len(SHIFTS), 2, 32, 32)
    assert torch.equal(moving._gathered(maps, SHIFTS), moving._shifted(maps, SHIFTS))


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize("worlds", [[1, 0, 1], [1, 0], [1]], ids=["one twice", "each once", "one left out"])
def test_weighted_perturbations_are_warped_weighted_and_summed_and_so_is_their_gradient(
    precision: torch.dtype, worlds: list[int]
) -> None:
    """Beside the plain formula: fused + Σ_j share_j · warp(δ_j), differentiated by torch itself."""
    generator, n = torch.Generator().manual_seed(0), len(worlds)
    world, delta = torch.tensor(worlds), torch.randn(2, 2, 4, 32, 32, generator=generator).requires_grad_()
    pose = torch.tensor([[[0.0, 0, 0], [4, -6, 0]], [[-30, 8, 0], [62, 0, 0]]])
    share = torch.rand(n, 2, 1, 32, 32, generator=generator)
    fused = torch.randn(n, 4, 32, 32, generator=generator).to(precision)
    weight = torch.randn(n, 4, 32, 32, generator=generator)
    plain = fused + (warp(delta, pose, 32.0)[world] * share).sum(1)
    expected = torch.autograd.grad((plain * weight).sum(), delta)[0]
    moves = moving.weighted_moves(share, world, pose, 32.0)
    assert moves is not None
    added = moving.add_weighted(fused, delta, moves)
    assert added.dtype == precision
    loose = {"atol": 1e-5, "rtol": 1e-5} if precision == torch.float32 else {"atol": 0.05, "rtol": 0.02}
    torch.testing.assert_close(added.float(), plain.detach(), **loose)  # type: ignore[arg-type]
    found = torch.autograd.grad((added.float() * weight).sum(), delta)[0]
    torch.testing.assert_close(found, expected, **loose)  # type: ignore[arg-type]


def test_no_shortcut_for_maps_that_turn() -> None:
    pose = torch.tensor([[[0.0, 0.0, 0.3]]])
    target = torch.zeros(1, 1, 32, 32)
    assert moving.weighted_moves(torch.ones(1, 1, 1, 32, 32), torch.tensor([0]), pose, 32.0) is None
    assert not moving.copy_into(target, [0], [torch.ones(1, 32, 32)], pose[0], 32.0) and not target.any()
    assert not moving.add_into(target, [0], torch.ones(1, 1, 32, 32), pose[0], 32.0) and not target.any()
