"""The files of a project that is built without Python."""

import os
from pathlib import Path

from piaffe.codegen import write_files


def test_files_that_are_equal_are_not_written_again(tmp_path: Path) -> None:
    write_files(tmp_path, {"a.c": "one\n", "deep/b.bin": b"\0two"})
    for name in ("a.c", "deep/b.bin"):
        os.utime(tmp_path / name, (1.0, 1.0))
    write_files(tmp_path, {"a.c": "one\n", "deep/b.bin": b"\0three"})
    assert (tmp_path / "a.c").stat().st_mtime == 1.0
    assert (tmp_path / "deep" / "b.bin").stat().st_mtime > 1.0
    assert (tmp_path / "deep" / "b.bin").read_bytes() == b"\0three"
