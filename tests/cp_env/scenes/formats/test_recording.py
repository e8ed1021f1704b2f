"""The file format: what goes in comes out, to the centimetre and the milliradian."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.formats import recording
from cp_env.scenes.formats.recording import wrap
from cp_env.types import Scene


def drawn(seed: int, *, n_frames: int, n_moving: int, n_parked: int, rsu: bool) -> Scene:
    """Vehicles that wander, turn right round, come and go; the first two never leave. Rows are mixed."""
    rng = np.random.default_rng(seed)
    n = n_moving + n_parked
    pose = rng.uniform(-120, 120, (1, n, 3)) + rng.normal(0, 1, (n_frames, n, 3)).cumsum(axis=0)
    pose[:, n_moving:] = pose[:1, n_moving:]
    pose[..., 2] = wrap(pose[..., 2])
    for row in range(2, n_moving):
        begin, end = sorted(rng.integers(0, n_frames + 1, 2))
        pose[:begin, row] = pose[end:, row] = np.nan
        pose[rng.integers(n_frames), row] = 1.0  # never absent throughout
    order = rng.permutation(n)
    return Scene(
        name="drawn",
        kind="urban",
        dt=0.2,
        pose=pose[:, order],
        size=rng.uniform(1, 12, (n, 3))[order],
        connected=np.argsort(order)[[1, 0]],
        rsu=np.array([3.0, -4.0, 6.0]) if rsu else None,
        obstacles=np.column_stack([rng.uniform(-99, 99, (4, 2)), rng.uniform(-3, 3, 4), rng.uniform(0.1, 20, (4, 3))]),
    )


@given(
    seed=st.integers(0, 10_000),
    n_frames=st.integers(2, 20),
    n_moving=st.integers(2, 6),
    n_parked=st.integers(0, 4),
    rsu=st.booleans(),
)
def test_round_trip(
    tmp_path_factory: pytest.TempPathFactory, seed: int, n_frames: int, n_moving: int, n_parked: int, rsu: bool
) -> None:
    scene = drawn(seed, n_frames=n_frames, n_moving=n_moving, n_parked=n_parked, rsu=rsu)
    path = tmp_path_factory.mktemp("round") / "drawn.npz"
    recording.write(path, scene)
    back = recording.read(path, "drawn")
    assert (back.name, back.kind, back.dt, back.n_frames) == ("drawn", "urban", 0.2, n_frames)
    order = [int(np.abs(scene.size - size).sum(axis=1).argmin()) for size in back.size]  # sizes tell vehicles apart
    assert sorted(order) == list(range(len(scene.size)))
    assert np.isclose(back.size, scene.size[order], atol=0.0051).all()
    difference = back.pose - scene.pose[:, order]
    assert (np.isnan(back.pose) == np.isnan(scene.pose[:, order])).all()
    assert np.nanmax(np.abs(difference[..., :2])) < 0.0051
    assert np.nanmax(np.abs(wrap(difference[..., 2]))) < 0.00051
    assert [order[row] for row in back.connected] == scene.connected.tolist()
    assert np.isclose(back.obstacles, scene.obstacles, atol=0.0051).all()
    assert (back.rsu is None) == (scene.rsu is None)
    if back.rsu is not None:
        assert np.isclose(back.rsu, scene.rsu).all()


def test_same_scene_same_bytes(tmp_path: Path) -> None:
    scene = drawn(3, n_frames=9, n_moving=4, n_parked=2, rsu=True)
    recording.write(tmp_path / "a.npz", scene)
    recording.write(tmp_path / "b.npz", scene)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_other_versions_pickles_and_lacking_arrays_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.npz"
    for arrays in (
        {"version": np.array(recording.VERSION + 1)},
        {"version": np.array(recording.VERSION)},
        {"version": np.array([object()], dtype=object)},
    ):
        np.savez(path, **arrays)  # type: ignore[arg-type]
        with pytest.raises(ValueError, match=r"scene\.npz"):
            recording.read(path, "scene")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(ValueError, match=r"array\.npy"):
        recording.read(tmp_path / "array.npy", "array")


def test_wrap_by_hand() -> None:
    assert np.allclose(wrap(np.array([0.0, 3 * np.pi / 2, -3 * np.pi / 2, np.pi])), [0, -np.pi / 2, np.pi / 2, -np.pi])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"steps": np.zeros((6_000_000, 0, 3), np.int16), "first": np.zeros((0, 3), np.int32)},
            "at most 10000000 in all",
        ),
        ({"parked": np.zeros((2_000_000, 3), np.int32)}, "at most 10000000 in all"),
        ({"connected": np.array([0, 99], np.int16)}, "distinct rows of 6"),
        ({"connected": np.array([0, 0], np.int16)}, "distinct rows of 6"),
        ({"connected": np.array([-1, 0], np.int16)}, "distinct rows of 6"),
        ({"dt": np.array(np.nan)}, "dt must be"),
        ({"dt": np.array([0.2])}, "dt is of type"),
        ({"size": np.zeros((5, 3), np.int16)}, "size has shape"),
        ({"first": np.zeros((4, 3))}, "first is of type float64"),
        ({"rsu": np.zeros(2, np.int32)}, "rsu has shape"),
        ({"present": np.zeros((1, 4), np.uint8)}, "present has shape"),
        ({"strange": np.zeros(1)}, "'strange' is missing, or is none"),
    ],
)
def test_arrays_that_do_not_fit_each_other(tmp_path: Path, change: dict[str, np.ndarray], message: str) -> None:
    path = tmp_path / "a.npz"
    recording.write(path, drawn(0, n_frames=9, n_moving=4, n_parked=2, rsu=True))
    with np.load(path) as file:
        arrays = dict(file)
    np.savez_compressed(path, **{**arrays, **change})
    with pytest.raises(ValueError, match=rf"a\.npz is broken \(.*{message}"):
        recording.read(path, "a")
