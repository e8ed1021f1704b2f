"""The folder of encoded scenes: shown, bounded and cleared, and nothing of others' is touched."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from cp_env.paths import cache_directory, cache_limit, size_of
from cp_env.world import cache_folder
from cp_env.world.block_file import DRAFT


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """Three scenes of two keys, used at 100, 300 and 200 s, with 10, 20 and 40 bytes in each of two files."""
    for key, scene, used, size in (("a", "s0", 100, 10), ("a", "s1", 300, 20), ("b", "s0", 200, 40)):
        folder = tmp_path / "encoded" / key / scene
        folder.mkdir(parents=True)
        for number in range(2):
            (folder / f"map-{number}-0.maps").write_bytes(bytes(size))
        os.utime(folder, (used, used))
    cache_folder.write_about(tmp_path / "encoded" / "a", "town/test", "Detector")
    return tmp_path


def names(folder: Path) -> list[str]:
    return [f"{scene.key.name}/{scene.name}" for scene in cache_folder.stored_scenes(folder)]


def test_scenes_are_listed_by_their_last_use(cache: Path) -> None:
    found = cache_folder.stored_scenes(cache / "encoded")
    assert [(s.source, s.detector, s.name, s.bytes, s.used) for s in found] == [
        ("town/test", "Detector", "s0", 20, 100),
        ("?", "?", "s0", 80, 200),
        ("town/test", "Detector", "s1", 40, 300),
    ]
    assert cache_folder.stored_scenes(cache / "none") == []


@pytest.mark.parametrize(
    ("limit", "left", "stay"),
    [(140, 140, ["a/s0", "b/s0", "a/s1"]), (139, 120, ["b/s0", "a/s1"]), (119, 40, ["a/s1"]), (39, 0, []), (0, 0, [])],
)
def test_the_least_recently_used_go_first(cache: Path, limit: int, left: int, stay: list[str]) -> None:
    assert cache_folder.bound(cache / "encoded", limit) == left
    assert names(cache / "encoded") == stay


def test_the_scene_that_is_played_stays(cache: Path) -> None:
    assert cache_folder.bound(cache / "encoded", 0, keep=cache / "encoded" / "a" / "s0") == 20
    assert names(cache / "encoded") == ["a/s0"]


def test_a_broken_note_is_no_obstacle(cache: Path) -> None:
    for text in ("", "[]", '{"source": 1}', "\x00"):
        (cache / "encoded" / "a" / "about.json").write_text(text)
        assert {(s.source, s.detector) for s in cache_folder.stored_scenes(cache / "encoded")} == {("?", "?")}


def test_clearing_deletes_what_the_library_wrote_and_nothing_else(cache: Path) -> None:
    """Encoded scenes, indices, maps of version 0.1; not what a user keeps in the same folder, however named."""
    ours = {"v2x-sim/0123/0.npz": 5, "v2x-sim/0123/index.json": 2, "v2x-sim-det/key.npz": 3}
    old = {f"digest-{16 * 'a'}/scene/{kind}-0.npy": 7 for kind in ("features", "received", "kept")}
    theirs = {
        "notes.txt": 1,
        "encoded/a/s0/notes.txt": 1,
        f"mine-{16 * 'b'}/weights/weights.npy": 1,
        "other/scene/received-0.npy": 1,
        "mine/s0/map-0-0.maps": 1,
    }
    for name, size in (ours | old | theirs).items():
        (cache / name).parent.mkdir(parents=True, exist_ok=True)
        (cache / name).write_bytes(bytes(size))
    (cache / "encoded" / "a" / "s0" / f"{DRAFT}1").write_bytes(b"half")
    about = (cache / "encoded" / "a" / "about.json").stat().st_size
    assert cache_folder.earlier_versions(cache) == [cache / f"digest-{16 * 'a'}"]
    assert cache_folder.size(cache / "v2x-sim") == 7
    assert cache_folder.clear(cache) == 140 + 10 + 21 + 4 + about
    left = {str(path.relative_to(cache)) for path in cache.rglob("*") if path.is_file()}
    assert left == set(theirs)
    assert not (cache / "v2x-sim").exists() and not (cache / "encoded" / "b").exists()
    assert cache_folder.clear(cache / "none") == 0


def test_what_killed_processes_left_is_swept(cache: Path) -> None:
    """Drafts and folders without end that are old; not those that somebody may still be writing."""
    now = time.time()
    ages = {"old": 2 * cache_folder.ABANDONED, "young": 1.0}
    for name, age in ages.items():
        scene = cache / "encoded" / "b" / f"endless-{name}" / "s9"
        scene.mkdir(parents=True)
        (scene / "map-0-0.maps").write_bytes(b"x")
        draft = cache / "encoded" / "a" / "s0" / f"{DRAFT}{name}"
        draft.write_bytes(b"half")
        for path in (draft, scene, scene.parent):
            os.utime(path, (now - age, now - age))
    assert {"b/s9", "b/s0"} <= set(names(cache / "encoded")), "they are listed and bounded like others"
    cache_folder.sweep(cache / "encoded")
    assert {path.name for path in (cache / "encoded").rglob(f"{DRAFT}*")} == {f"{DRAFT}young"}
    assert {path.name for path in (cache / "encoded").rglob("endless-*")} == {"endless-young"}
    assert set(names(cache / "encoded")) == {"a/s0", "a/s1", "b/s0", "b/s9"}


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("0", 0),
        ("1500", 1500),
        ("20GB", 20 * 10**9),
        (" 1.5 mb ", 1_500_000),
        ("3 KB", 3000),
        ("7B", 7),
        ("1TB", 10**12),
    ],
)
def test_sizes(text: str, size: int, monkeypatch: pytest.MonkeyPatch) -> None:
    assert size_of(text) == size
    monkeypatch.setenv("CP_ENV_CACHE_SIZE", text)
    assert cache_limit() == size


@pytest.mark.parametrize("text", ["", "GB", "-1 GB", "1 GiB", "1e3", "1,5 GB", "ten", "5 G", "nan"])
def test_what_is_no_size(text: str) -> None:
    with pytest.raises(ValueError, match='a size is a number with B, KB, MB, GB or TB, as in "20 GB", not'):
        size_of(text)


def test_where_the_cache_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CP_ENV_CACHE", str(tmp_path))
    assert cache_directory() == tmp_path and cache_folder.encoded_folder() == tmp_path / "encoded"
    monkeypatch.delenv("CP_ENV_CACHE")
    assert cache_directory().name == "cp_env"
    monkeypatch.delenv("CP_ENV_CACHE_SIZE", raising=False)
    assert cache_limit() is None
