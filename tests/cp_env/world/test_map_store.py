"""Maps are made when they are first asked for, always with the same bits, whatever happens to the files."""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from cp_env.types import Scene, Sweep
from cp_env.world import map_store
from cp_env.world.block_file import DRAFT, write_block
from cp_env.world.cache_folder import STALE
from cp_env.world.map_store import BLOCK, MapStore
from cp_env.world.packing import pack_map
from examples.bring_your_own_detector import Toy
from tests.helpers.toy_scenes import ToySource

FRAMES = 2 * BLOCK + 2
AGENTS = (0, 1, 2)


class Counting(ToySource):
    """Counts the frames that are ray-cast."""

    def __init__(self) -> None:
        super().__init__(n_frames=FRAMES)
        self.cast: list[int] = []

    def sweeps(self, scene: Scene, frames: Sequence[int]) -> list[list[Sweep]]:
        self.cast += frames
        return super().sweeps(scene, frames)


class Neighbourly(Toy):
    """Its maps depend on their batch, as the last bits of a convolution may on some device."""

    def encode(self, sweeps: Sequence[Sweep]) -> Tensor:
        maps = super().encode(sweeps)
        return maps + maps.mean(dim=(0, 2, 3))[None, :, None, None]

    def ego_context(self, sweeps: Sequence[Sweep]) -> Tensor:
        return self.encode(sweeps).mean(dim=1)

    def with_ego_context(self, ego_context: Tensor) -> Neighbourly:
        return self


@pytest.fixture
def detector() -> Neighbourly:
    detector = Neighbourly()
    detector.freeze()
    return detector


Fresh = Callable[[], tuple[MapStore, Scene]]


@pytest.fixture
def fresh(detector: Neighbourly, tmp_path: Path) -> Fresh:
    """Makes stores with nothing in memory on one folder."""

    def make() -> tuple[MapStore, Scene]:
        source = Counting()
        return MapStore(source, detector, tmp_path / "encoded", "key", progress=False), source.load("toy-0")

    return make


def read(store: MapStore, scene: Scene, frame: int, agents: Sequence[int] = AGENTS) -> bytes:
    context = store.ego_context(scene, frame)
    return b"".join(one.tobytes() for one in [*store.maps(scene, agents, frame), context])


def cast(store: MapStore) -> list[int]:
    assert isinstance(store.source, Counting)
    return store.source.cast


def files(store: MapStore) -> list[Path]:
    return sorted(path for path in store.root.rglob("*.maps"))


@pytest.fixture
def expected(fresh: Fresh) -> list[bytes]:
    """All frames of a scene; they are on disk now."""
    store, scene = fresh()
    return [read(store, scene, t) for t in range(FRAMES)]


def test_only_blocks_that_are_asked_for_are_encoded(fresh: Fresh) -> None:
    store, scene = fresh()
    store.maps(scene, AGENTS, BLOCK + 1)
    store.maps(scene, AGENTS[:2], 2 * BLOCK - 1)
    assert cast(store) == list(range(BLOCK, 2 * BLOCK))
    store.maps(scene, AGENTS, FRAMES - 1)
    assert cast(store)[BLOCK:] == [2 * BLOCK, 2 * BLOCK + 1], "the last block ends with the scene"


def test_bits_depend_on_nothing_that_was_asked_for_before(fresh: Fresh, expected: list[bytes]) -> None:
    """Another order, fewer vehicles first, one vehicle alone; from memory or from disk."""
    store, scene = fresh()
    again = [read(store, scene, t) for t in range(FRAMES)]
    assert again == expected and not cast(store), "they are read"
    shutil.rmtree(store.root)
    store, scene = fresh()
    store.maps(scene, [2], FRAMES - 1)
    store.maps(scene, [1, 0], BLOCK + 3)
    assert [read(store, scene, t) for t in reversed(range(FRAMES))] == expected[::-1]


def test_what_is_stored_is_the_encoders_answer(detector: Neighbourly, fresh: Fresh) -> None:
    store, scene = fresh()
    sweeps = store.source.sweeps(scene, range(BLOCK))
    direct = detector.encode([of_all[1] for of_all in sweeps])[3]
    np.testing.assert_array_equal(store.maps(scene, [1], 3)[0], direct.half().numpy())
    np.testing.assert_array_equal(store.ego_context(scene, 3), detector.ego_context([s[0] for s in sweeps])[3])


@pytest.mark.parametrize("item", ["map-1", "context"])
@pytest.mark.parametrize("harm", ["flip", "cut", "empty", "another map"])
def test_a_broken_file_is_named_once_and_made_again(fresh: Fresh, expected: list[bytes], item: str, harm: str) -> None:
    store, scene = fresh()
    (path,) = store.root.rglob(f"{item}-{BLOCK}.maps")
    whole = path.read_bytes()
    if harm == "flip":
        path.write_bytes(whole[:200] + bytes([whole[200] ^ 4]) + whole[201:])
    elif harm == "cut":
        path.write_bytes(whole[:-1])
    elif harm == "empty":
        path.write_bytes(b"")
    else:
        write_block(path, [pack_map(np.zeros((1, 2, 2), np.float16))] * BLOCK)
    with pytest.warns(UserWarning, match=f"broken file in the scene cache.*{item}-{BLOCK}.maps") as caught:
        again = [read(store, scene, t) for t in range(FRAMES)]
    assert again == expected and len(caught) == 1 and path.read_bytes() == whole
    store, scene = fresh()
    assert read(store, scene, BLOCK) == expected[BLOCK] and not cast(store)


def test_the_cache_may_be_deleted_while_it_is_played(
    fresh: Fresh, expected: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(map_store, "MEMORY", 0)
    store, scene = fresh()
    for t in range(FRAMES):
        assert read(store, scene, t) == expected[t]
        shutil.rmtree(store.folder)
    assert read(store, scene, 0) == expected[0] and files(store)


@pytest.mark.parametrize("place", ["folder", "file"])
def test_where_nothing_can_be_written_play_goes_on(
    fresh: Fresh, expected: list[bytes], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file lies where the cache's folder should be, or a folder where one of its files should."""
    monkeypatch.setattr(map_store, "MEMORY", 0)
    store, scene = fresh()
    wrong = store.folder if place == "folder" else store.place(scene) / "map-1-0.maps"
    shutil.rmtree(store.folder)
    if place == "folder":
        wrong.write_text("not a folder")
    else:
        wrong.mkdir(parents=True)
    with pytest.warns(UserWarning, match="scene cache") as caught:
        assert [read(store, scene, t) for t in range(FRAMES)] == expected
    told = [str(one.message) for one in caught]
    assert sum("cannot be written" in text and "set CP_ENV_CACHE" in text for text in told) == 1
    assert sum("broken file" in text and str(wrong) in text for text in told) == (place == "file")


def test_memory_is_bounded(fresh: Fresh, expected: list[bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    store, scene = fresh()
    one = store.maps(scene, [0], 0)[0].nbytes
    monkeypatch.setattr(map_store, "MEMORY", 5 * one)
    for _ in range(2):
        assert [read(store, scene, t) for t in range(FRAMES)] == expected
    assert sum(array.nbytes for array in store._memory.values()) == store._held <= 5 * one
    assert len(pickle.dumps(store)) < 10 * one and not pickle.loads(pickle.dumps(store))._memory


def test_drafts_of_killed_encodings_are_removed(fresh: Fresh) -> None:
    store, scene = fresh()
    store.place(scene).mkdir(parents=True)
    old, young = (store.place(scene) / f"{DRAFT}{name}" for name in ("old", "young"))
    for draft in (old, young):
        draft.write_bytes(b"half a block")
    os.utime(old, (time.time() - 2 * STALE,) * 2)
    store.maps(scene, AGENTS, 0)
    assert not old.exists() and young.exists(), "another process may be writing it"


def test_a_bound_on_the_cache(fresh: Fresh, expected: list[bytes], monkeypatch: pytest.MonkeyPatch) -> None:
    """Whole scenes go, the one used last is the last to go, and the one that is played stays."""
    whole = sum(path.stat().st_size for path in files(fresh()[0]))
    monkeypatch.setattr(map_store, "UNSEEN", 0)
    monkeypatch.setenv("CP_ENV_CACHE_SIZE", str(int(1.2 * whole)))
    store, scene = fresh()
    other = store.source.load("toy-1")
    for t in range(FRAMES):
        read(store, other, t)
    assert {path.parent.name for path in files(store)} == {"toy-1"}
    assert [read(store, scene, t) for t in range(FRAMES)] == expected
    monkeypatch.setenv("CP_ENV_CACHE_SIZE", "1 B")
    store, scene = fresh()
    shutil.rmtree(store.folder)
    assert [read(store, scene, t) for t in range(FRAMES)] == expected
    assert {path.parent.name for path in files(store)} == {"toy-0"}


def test_a_bound_that_is_no_size(fresh: Fresh, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CP_ENV_CACHE_SIZE", "plenty")
    with pytest.raises(ValueError, match=r'CP_ENV_CACHE_SIZE: a size is a number with .*"20 GB", not \'plenty\''):
        fresh()


@pytest.mark.parametrize("name", ["..", ".", "a/b", "../../up", "süß 1"])
def test_any_scene_name_has_a_folder_of_its_own(fresh: Fresh, name: str) -> None:
    from tests.helpers.toy_scenes import toy_scene

    store, _ = fresh()
    place = store.place(toy_scene(name=name))
    assert place.parent == store.root and place.name not in ("", ".", "..")


def test_maps_of_another_shape_than_the_detector_says(fresh: Fresh) -> None:
    store, scene = fresh()
    store.detector.channels += 1
    with pytest.raises(ValueError, match=r"encode must give maps of .*mend the detector's `channels` and `size`"):
        store.maps(scene, AGENTS, 0)


def test_it_says_once_where_frames_are_kept(
    detector: Neighbourly, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = MapStore(Counting(), detector, tmp_path, "key", progress=True)
    scene = store.source.load("toy-0")
    for t in range(FRAMES):
        store.maps(scene, AGENTS, t)
    told = capsys.readouterr().err
    assert told.count("encoding frames") == 1 and str(store.root) in told and "cp-env cache" in told


PLAY = """
import hashlib, sys
from pathlib import Path
import torch
torch.set_num_threads(1)
from tests.cp_env.world.test_map_store import AGENTS, FRAMES, Counting, Neighbourly, read
from cp_env.world.map_store import MapStore
detector = Neighbourly()
detector.freeze()
store = MapStore(Counting(), detector, Path(sys.argv[1]), "key", progress=False)
scene = store.source.load("toy-0")
print("ready", flush=True)
sys.stdin.readline()
print(hashlib.sha256(b"".join(read(store, scene, t) for t in range(FRAMES))).hexdigest())
"""


@pytest.mark.slow
def test_two_processes_on_one_cold_cache(fresh: Fresh, expected: list[bytes], tmp_path: Path) -> None:
    """Both begin at once and read what they would read alone; the files are whole, and no draft is left."""
    folder = tmp_path / "cold"
    command, pipe = [sys.executable, "-W", "error::UserWarning", "-c", PLAY, str(folder)], subprocess.PIPE
    both = [subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=Path.cwd()) for _ in range(2)]
    for process in both:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
    for process in both:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    told = [process.communicate(timeout=120)[0].strip() for process in both]
    assert told == [hashlib.sha256(b"".join(expected)).hexdigest()] * 2
    warm, _ = fresh()
    made = {path.name: path.read_bytes() for path in files(warm)}
    assert {path.name: path.read_bytes() for path in folder.rglob("*.maps")} == made
    assert not list(folder.rglob(f"{DRAFT}*"))


def test_what_is_read_may_be_widened_without_a_warning(fresh: Fresh, expected: list[bytes]) -> None:
    """Torch warns of arrays that cannot be written."""
    store, scene = fresh()
    for one in [*store.maps(scene, AGENTS, 0), store.ego_context(scene, 0)]:
        assert torch.from_numpy(one).shape == one.shape
