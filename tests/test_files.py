"""Files appear whole or not at all, and archives are checked when they are read."""

import io
import json
import os
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piaffe.errors import FileWriteError
from piaffe.files import Fault, read_archive, read_arrays, whole_file, write_arrays, write_whole


class RefusedError(Exception):
    def __init__(self, fault: Fault) -> None:
        super().__init__(fault.kind)
        self.fault = fault


def npz(header: Any, **arrays: np.ndarray) -> bytes:
    content = io.BytesIO()
    np.savez_compressed(content, **({} if header is None else {"header": header}), **arrays)
    return content.getvalue()


def in_bytes(header: Any) -> np.ndarray:
    return np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)


def refused(content: bytes, header: str = "header.npy", version: int | None = 3) -> Fault:
    with pytest.raises(RefusedError) as caught:
        read_archive(content, "shoe", version, RefusedError, header=header)
    return caught.value.fault


# ---- writing


def test_a_file_is_seen_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "new" / "film.mp4"
    with whole_file(path) as temporary:
        temporary.write_bytes(b"whole")
        assert not path.exists()
        assert temporary.parent == path.parent
        assert temporary.suffix == ".mp4"
    assert path.read_bytes() == b"whole"
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_an_older_file_stays_when_writing_fails(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "table.parquet"
    path.write_bytes(b"old")

    def half() -> None:
        with whole_file(path) as temporary:
            temporary.write_bytes(b"half")
            raise error

    with pytest.raises(error):
        half()
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_writer_that_writes_nothing_is_an_error(tmp_path: Path) -> None:
    with (
        pytest.raises(FileWriteError, match=r"nothing.mp4': cannot be written - got No such"),
        whole_file(tmp_path / "nothing.mp4"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_files_have_the_permissions_that_the_user_wants(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_whole(tmp_path / "a.txt", b"text")
    finally:
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640


def test_arrays_come_back(tmp_path: Path) -> None:
    arrays = {"a/b": np.arange(3.0), "text": np.array("x"), "empty": np.zeros((0, 2), np.float32)}
    write_arrays(tmp_path / "a.npz", arrays)
    read = read_arrays(tmp_path / "a.npz", RefusedError)
    assert {name: (value.dtype, value.shape) for name, value in read.items()} == {
        name: (value.dtype, value.shape) for name, value in arrays.items()
    }
    np.testing.assert_array_equal(read["a/b"], arrays["a/b"])


# ---- reading


@pytest.mark.parametrize("version", [1, 3])
def test_an_archive_of_a_known_version_is_read(version: int) -> None:
    header = {"format": "shoe", "version": version, "size": 42}
    for stored in (in_bytes(header), np.array(json.dumps(header))):
        read, arrays = read_archive(npz(stored, sole=np.arange(2)), "shoe", 3, RefusedError)
        assert read == header
        assert list(arrays) == ["sole"]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("manifest.json", json.dumps(header))
    assert read_archive(content.getvalue(), "shoe", 3, RefusedError, header="manifest.json") == (header, {})


def test_a_format_without_versions_needs_none() -> None:
    assert read_archive(npz(in_bytes({"format": "shoe"})), "shoe", None, RefusedError) == ({"format": "shoe"}, {})


@pytest.mark.parametrize(
    ("content", "got"),
    [
        (b"", "an empty file"),
        (b"hello", "no archive"),
        (b"\x80\x04N.", "no archive"),
        (b"\x93NUMPY\x01\x00", "a single array"),
        (b"PK", "File is not a zip file"),
        (npz(in_bytes({"format": "shoe", "version": 1}), a=np.arange(99.0))[:-40], "File is not a zip file"),
    ],
)
def test_truncated_files_and_others_are_damaged(content: bytes, got: str) -> None:
    fault = refused(content)
    assert fault.kind == "damaged"
    assert str(fault.got) == got


def test_pickled_objects_are_never_loaded() -> None:
    evil = np.array([{"format": "shoe", "version": 1}], dtype=object)
    assert refused(npz(in_bytes({"format": "shoe", "version": 1}), evil=evil)).kind == "damaged"
    assert refused(npz(evil)).kind == "headless"


@pytest.mark.parametrize("header", [None, np.frombuffer(b"not json", dtype=np.uint8), np.array(""), np.zeros(3)])
def test_an_archive_without_a_header_is_headless(header: Any) -> None:
    assert refused(npz(header, a=np.zeros(2))).kind == "headless"


def test_the_member_that_lacks_is_named() -> None:
    assert str(refused(npz(None, a=np.zeros(2))).got) == "no 'header.npy' in the archive"
    assert str(refused(npz(None, a=np.zeros(2)), "manifest.json").got) == "no 'manifest.json' in the archive"


@pytest.mark.parametrize("header", [{"format": "boot", "version": 1}, {"version": 1}, [1, 2], "shoe", None])
def test_another_format_is_foreign(header: Any) -> None:
    fault = refused(npz(in_bytes(header)))
    assert fault.kind == "foreign"
    assert "format" in str(fault.got)


@pytest.mark.parametrize("version", [None, "two", [1]])
def test_a_version_is_a_number(version: object) -> None:
    fault = refused(npz(in_bytes({"format": "shoe", "version": version})))
    assert (fault.kind, fault.got) == ("unversioned", f"version {version!r}")


def test_a_newer_version_is_told() -> None:
    assert refused(npz(in_bytes({"format": "shoe", "version": 4}))) == Fault("newer", "version 4", "shoe", 4)
