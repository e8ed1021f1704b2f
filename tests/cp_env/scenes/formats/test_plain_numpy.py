"""Plain arrays in numpy's files: what numpy writes is read back, and a file that promises more than it holds is not."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from cp_env.scenes.formats import plain_numpy
from cp_env.scenes.formats.plain_numpy import check_directory, load_npy, load_npz, map_npy, parse_npy

DTYPES = ("?", "i1", "<i2", ">i4", "<i8", "u1", "<u8", "<f2", "<f4", ">f8", "<U7", "S3")
ARRAYS = st.sampled_from(DTYPES).flatmap(
    lambda dtype: hnp.arrays(np.dtype(dtype), hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4))
)


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array, allow_pickle=True)
    return file.getvalue()


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


@given(ARRAYS, st.booleans())
def test_what_numpy_writes_is_read(array: np.ndarray, fortran: bool) -> None:
    array = np.asfortranarray(array) if fortran and array.ndim else array
    for back in (parse_npy(npy(array)), load_npz(npz(a=array, b=np.zeros(2)))["a"]):
        assert back.dtype == array.dtype and back.shape == array.shape
        assert back.tobytes() == array.tobytes() and not back.flags.writeable


def test_by_hand() -> None:
    header = b"{'descr': '<i2', 'fortran_order': True, 'shape': (2, 3), }"
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    data += bytes([1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 6, 0])
    assert parse_npy(data).tolist() == [[1, 3, 5], [2, 4, 6]]


BASE = npy(np.arange(6, dtype="<i2").reshape(2, 3))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "does not begin"),
        (BASE[:-1], "holds 11 bytes"),
        (BASE + b"\0", "holds 13 bytes"),
        (BASE.replace(b"(2, 3), }        ", b"(9999999999, 3), }"), "array of shape .9999999999"),
        (BASE.replace(b"(2, 3), }    ", b"(99999, 3), }"), "holds 12 bytes"),
        (BASE.replace(b"'<i2'", b"'|O8'"), "type .|O8."),
        (BASE.replace(b"'<i2'", b"'<M8'"), "plain numbers, truth values"),
        (BASE.replace(b"'<i2'", b"[('a', '<i2')]"), "header"),
        (npy(np.array([None])), "type .|O."),
        (b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + b"(" * 99, "too long"),
        (npy(np.array([True]))[:-1] + b"\x02", "neither 0 nor 1"),
        (BASE.replace(b"(2, 3), }", b"(-2,-3),}"), "header"),
    ],
)
def test_files_that_are_refused(data: bytes, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_npy(data)


def test_a_small_archive_of_much_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    """2 MB that unpack to 2.3 GB."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as member:
        member.write(npy(np.zeros(0, np.uint8)))
        for _ in range(290):
            member.write(bytes(1 << 20))
    assert path.stat().st_size < 1 << 20
    tracemalloc.start()
    with pytest.raises(ValueError, match=r"unpacks to 304087168 bytes; at most 268435456 are read"):
        load_npz(path)
    assert tracemalloc.get_traced_memory()[1] < 4 << 20
    tracemalloc.stop()


def directory(change: Any) -> bytes:
    """An archive whose directory was changed: what it promises is not what there is."""
    data = bytearray(npz(a=np.zeros(1000)))
    change(data, data.rfind(b"PK\x01\x02"))
    return bytes(data)


def lie_about_size(data: bytearray, at: int) -> None:
    data[at + 24 : at + 28] = (500).to_bytes(4, "little")


def lie_about_room(data: bytearray, at: int) -> None:
    """A stored member of 16 MB in an archive of one kilobyte: to read it would ask for the memory first."""
    data[at + 20 : at + 28] = (1 << 24).to_bytes(4, "little") * 2


def lie_about_begin(data: bytearray, at: int) -> None:
    data[at + 42 : at + 46] = (1 << 24).to_bytes(4, "little")


def other_method(data: bytearray, at: int) -> None:
    data[at + 10] = 14  # LZMA, whose dictionary may take 4 GB


def encrypted(data: bytearray, at: int) -> None:
    data[at + 8] |= 1


def doubled() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("a.npy", npy(np.zeros(2)))
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("a.npy", npy(np.ones(2)))
    return file.getvalue()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (lambda: b"", "its end is missing"),
        (lambda: npz(a=np.zeros(9))[:-30], "its end is missing"),
        (lambda: directory(lie_about_size), "no archive that can be read|holds"),
        (lambda: directory(lie_about_room), "bytes of a smaller archive"),
        (lambda: directory(lie_about_begin), "bytes of a smaller archive"),
        (lambda: directory(other_method), "packed or encrypted"),
        (lambda: directory(encrypted), "packed or encrypted"),
        (doubled, "each of its own name"),
        (lambda: npz(a=np.array([None])), "plain numbers"),
    ],
)
def test_archives_that_are_refused(data: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        load_npz(data())


def test_the_number_of_members_and_their_directory_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    data = npz(**{f"a{i}": np.zeros(1) for i in range(20)})
    monkeypatch.setattr(plain_numpy, "MEMBERS", 3)
    with pytest.raises(ValueError, match=r"directory of \d+ bytes; at most 100"):
        check_directory(data, 100)
    with pytest.raises(ValueError, match="at most 10 are read"):
        load_npz(data, limit=10)
    with zipfile.ZipFile(io.BytesIO(data)) as archive, pytest.raises(ValueError, match="20 members; at most 3"):
        plain_numpy.check_archive(archive, 1 << 20, 3)


def test_a_file_is_read_by_its_path(tmp_path: Path) -> None:
    (tmp_path / "a.npy").write_bytes(BASE)
    assert load_npy(tmp_path / "a.npy").tolist() == [[0, 1, 2], [3, 4, 5]]
    with pytest.raises(ValueError, match="at most 5 are read"):
        load_npy(tmp_path / "a.npy", 5)


@pytest.mark.parametrize("fortran", [False, True])
def test_a_large_array_is_mapped_as_numpy_maps_it(tmp_path: Path, fortran: bool) -> None:
    path, array = tmp_path / "a.npy", np.arange(24, dtype=np.float16).reshape(2, 3, 4)
    np.save(path, np.asfortranarray(array) if fortran else array)
    mapped = map_npy(path)
    assert isinstance(mapped, np.memmap) and not mapped.flags.writeable
    assert np.array_equal(mapped, array) and mapped.dtype == array.dtype


def test_what_is_not_mapped(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.arange(6))
    whole = path.read_bytes()
    for broken in (whole[:-1], whole + b"0", whole[:40], whole.replace(b"'<i8'", b"'|O1'"), b""):
        path.write_bytes(broken)
        with pytest.raises(ValueError, match=r"array of|header|begin"):
            map_npy(path)
    np.save(path, np.zeros((0, 3)))
    with pytest.raises(ValueError, match="an array of shape"):
        map_npy(path)
