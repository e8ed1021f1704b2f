"""Point clouds in every encoding give the same points; broken ones are named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cp_env.scenes.errors import BrokenData
from cp_env.scenes.formats import pcd

POINTS = np.random.default_rng(0).normal(0, 30, (500, 3)).astype(np.float32)


def pack_lzf(plain: bytes) -> bytes:
    """A plain and slow LZF packer: the longest earlier match of at most 264 bytes within 8 kB, else plain bytes."""
    packed, literal, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literal), 32):
            run = literal[start : start + 32]
            packed.append(len(run) - 1)
            packed.extend(run)
        literal.clear()

    while at < len(plain):
        length, start = 0, -1
        if at + 3 <= len(plain):
            start = plain.rfind(plain[at : at + 3], max(0, at - 8192), at + 2)
        if start >= 0:
            length = 3
            while at + length < len(plain) and length < 264 and plain[start + length] == plain[at + length]:
                length += 1
        if length < 3:
            literal.append(plain[at])
            at += 1
            continue
        flush()
        back = at - start - 1
        packed.append(min(length - 2, 7) << 5 | back >> 8)
        if length - 2 >= 7:
            packed.append(length - 9)
        packed.append(back & 255)
        at += length
    flush()
    return bytes(packed)


def compressed(points: np.ndarray, fields: str = "x y z rgb") -> bytes:
    """A compressed file as the Point Cloud Library lays it out: all x, all y, all z, all colours."""
    columns = np.concatenate([points.T.astype("<f4"), np.zeros((1, len(points)), "<f4")])
    packed = pack_lzf(columns.tobytes())
    header = (
        f"VERSION 0.7\nFIELDS {fields}\nSIZE 4 4 4 4\nTYPE F F F F\nWIDTH {len(points)}\nHEIGHT 1\n"
        f"POINTS {len(points)}\nDATA binary_compressed\n"
    )
    sizes = np.array([len(packed), columns.nbytes], "<u4").tobytes()
    return header.encode() + sizes + packed


@pytest.mark.parametrize("data", pcd.ENCODINGS)
def test_what_was_written_is_read(data: str, tmp_path: Path) -> None:
    pcd.write(tmp_path / "a.pcd", POINTS, data=data)
    assert np.abs(pcd.read(tmp_path / "a.pcd") - POINTS).max() <= (0 if data == "binary" else 1e-5)


def test_compressed_is_read(tmp_path: Path) -> None:
    points = np.round(POINTS)  # with repetitions to refer to
    (tmp_path / "a.pcd").write_bytes(compressed(points))
    assert (pcd.read(tmp_path / "a.pcd") == points).all()


@given(st.binary(max_size=3000), st.integers(1, 40))
def test_lzf_unpacks_what_was_packed(seed: bytes, times: int) -> None:
    plain = seed * times
    assert pcd.unpack_lzf(pack_lzf(plain), len(plain)) == plain


def test_lzf_by_hand() -> None:
    """`ab`, then six bytes from two back (overlapping what they make), then a literal `!`."""
    assert pcd.unpack_lzf(bytes([1, *b"ab", (6 - 2) << 5, 1, 0, *b"!"]), 9) == b"abababab!"
    for packed in (bytes([0x20]), bytes([0x20, 5]), bytes([4, *b"a"])):
        with pytest.raises(ValueError, match="packed data"):
            pcd.unpack_lzf(packed, 5)


def test_other_fields_orders_types_and_padding_are_passed_over(tmp_path: Path) -> None:
    row = np.dtype([("i", "<u2"), ("z", "<f8"), ("pad", "u1", (3,)), ("y", "<f4"), ("x", "<f4")])
    rows = np.zeros(3, row)
    rows["x"], rows["y"], rows["z"] = [1, 2, 3], [4, 5, 6], [7, 8, 9]
    header = (
        "# a comment\nVERSION .7\nFIELDS intensity z _ y x\nSIZE 2 8 1 4 4\nTYPE U F U F F\nCOUNT 1 1 3 1 1\n"
        "WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\n"
    )
    (tmp_path / "a.pcd").write_bytes(f"{header}DATA binary\n".encode() + rows.tobytes())
    text = "\n".join(f"0 {z} 0 0 0 {y} {x}" for x, y, z in ((1, 4, 7), (2, 5, 8), (3, 6, 9)))
    (tmp_path / "b.pcd").write_bytes(f"{header}DATA ascii\n{text}\n".encode())
    for name in "ab":
        assert pcd.read(tmp_path / f"{name}.pcd").tolist() == [[1, 4, 7], [2, 5, 8], [3, 6, 9]]


def test_points_that_are_no_returns_are_dropped(tmp_path: Path) -> None:
    points = POINTS.copy()
    points[::7, 1] = np.nan
    pcd.write(tmp_path / "a.pcd", points)
    assert (pcd.read(tmp_path / "a.pcd") == np.delete(POINTS, np.s_[::7], axis=0)).all()


@pytest.mark.parametrize("content", [b"", b"VERSION 0.7\nFIELDS x y z\n", b"\x80\x04\x95", b"<html>\n" * 30])
def test_what_is_no_point_cloud_is_named(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(content)
    with pytest.raises(BrokenData, match=r"a\.pcd: is no point cloud"):
        pcd.read(tmp_path / "a.pcd")


def test_missing_and_foreign_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(BrokenData, match=r"none\.pcd: cannot be read"):
        pcd.read(tmp_path / "none.pcd")
    pcd.write(tmp_path / "a.pcd", POINTS)
    good = (tmp_path / "a.pcd").read_bytes()
    for old, new, told in (
        (b"VERSION 0.7", b"VERSION 0.5", "its version is 0.5, this program reads 0.7"),
        (b"FIELDS x y z rgb", b"FIELDS u v z rgb", "without x, y and z"),
        (b"POINTS 500", b"POINTS -5", "promises -5 points"),
        (b"POINTS 500", b"POINTS 499", "promises 499 points in 1 rows of 500"),
        (b"DATA binary", b"DATA zipped", "known are ascii, binary"),
        (b"TYPE F F F F", b"TYPE F F F Q", "Q"),
        (b"SIZE 4 4 4 4", b"SIZE 4 4 4", "is no point cloud"),
    ):
        (tmp_path / "b.pcd").write_bytes(good.replace(old, new))
        with pytest.raises(BrokenData, match=told):
            pcd.read(tmp_path / "b.pcd")
    with pytest.raises(ValueError, match="data must be one of ascii, binary; got 'zip'"):
        pcd.write(tmp_path / "c.pcd", POINTS, data="zip")


def test_a_file_cut_short_is_named_wherever_it_is_cut(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    for data in pcd.ENCODINGS:
        pcd.write(path, POINTS, data=data)
        content = path.read_bytes()
        last = len(content) - (20 if data == "ascii" else 1)  # the last number of a text may be a shorter one
        for length in np.linspace(0, last, 40).astype(int):
            path.write_bytes(content[:length])
            with pytest.raises(BrokenData, match=r"a\.pcd: is no point cloud"):
                pcd.read(path)
    packed = compressed(np.round(POINTS))
    for length in np.linspace(0, len(packed) - 1, 40).astype(int):
        path.write_bytes(packed[:length])
        with pytest.raises(BrokenData, match=r"a\.pcd: is no point cloud"):
            pcd.read(path)


GOOD = (
    b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA %s\n"
    b"0 0 0 1 1 1 0 0 0 0 0 0 0"
)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (b"%s", b"binary_compressed\n\x04\0\0\0\xff\xff\xff\xff", "unpack to 4294967295 bytes; at most"),
        (b"%s\n", b"ascii\n" + b"1 " * (pcd.TEXT_BYTES // 2), "a text of .* bytes; at most"),
        (b"WIDTH 2\nHEIGHT 1\nPOINTS 2", b"WIDTH 99999999\nHEIGHT 1\nPOINTS 99999999", "cut short"),
        (b"COUNT 1 1 1", b"COUNT 1 1 0", "count 0 to 1 numbers"),
        (b"COUNT 1 1 1", b"COUNT 1 1 999999999", "count 1 to 999999999 numbers"),
        (b"SIZE 4 4 4", b"SIZE 4 4 4,i8", "of sizes"),
        (b"FIELDS x y z", b"FIELDS x y z" + b" w" * 100, "103 fields"),
        (b"VERSION 0.7", b"#" * 70_000 + b"\nVERSION 0.7", "header ends before the line DATA"),
        (b"POINTS 2", b"POINTS " + b"9" * 5000, "limit"),
    ],
)
def test_what_takes_too_much_is_refused(old: bytes, new: bytes, told: str, tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(GOOD.replace(old, new).replace(b"%s", b"ascii"))
    with pytest.raises(BrokenData, match=rf"a\.pcd: .*{told}"):
        pcd.read(tmp_path / "a.pcd")


def test_numbers_beyond_single_precision_are_no_return(tmp_path: Path) -> None:
    (tmp_path / "a.pcd").write_bytes(
        GOOD.replace(b"%s", b"ascii").replace(b"0 0 0 1 1 1 0 0 0 0 0 0 0", b"1e99 0 0 1 2 3")
    )
    assert pcd.read(tmp_path / "a.pcd").tolist() == [[1, 2, 3]]


def test_packed_points_are_held_to_their_size_while_they_unpack() -> None:
    much = b"\x00a" + b"\xe0\xff\x00" * 100_000  # 264 bytes each
    with pytest.raises(ValueError, match="its packed data give 265 bytes, not 10"):
        pcd.unpack_lzf(much, 10)
