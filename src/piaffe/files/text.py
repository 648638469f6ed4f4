"""Checked reading of JSON and TOML."""

from __future__ import annotations

import datetime
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from piaffe.errors import FileFormatError

_TOO_DEEP = "values nested too deeply"
_LIMIT = 2**26  # bytes; a study or a manifest has a few thousand


def read_json(path: Path, what: str, advice: str) -> dict[str, Any]:
    """Return the object of a JSON file.

    Args:
        path: the file.
        what: kind of file, for the error, as ``"dataset"``.
        advice: what to do if it cannot be read.

    Raises:
        FileFormatError: it is missing, damaged, not UTF-8, nested too deeply, or no object.
    """
    text = _text(path, what, "a JSON file", advice)
    try:
        found = json.loads(text)
        if not isinstance(found, dict):
            raise ValueError(f"{type(found).__name__}, not an object")
    except (ValueError, RecursionError) as error:
        raise _refusal(path, what, error, "an object in JSON", advice) from error
    return found


def read_toml(path: Path, what: str, advice: str = "correct it") -> dict[str, Any]:
    """Return the content of a TOML file, in values that JSON can hold.

    Args:
        path: the file.
        what: kind of file, for the error, as ``"study"``.
        advice: what to do if it cannot be read.

    Raises:
        FileFormatError: it is missing, not TOML, not UTF-8, nested too deeply, or has dates or times.
    """
    text = _text(path, what, "a TOML file", "correct the path")
    try:
        found = tomllib.loads(text)
        dated = [name for name, value in _leaves(found, "") if isinstance(value, datetime.date | datetime.time)]
    except (ValueError, RecursionError) as error:
        got = _TOO_DEEP if isinstance(error, RecursionError) else error
        raise FileFormatError(f"{what} '{path}': is no TOML file - got {got}, expected one; {advice}") from error
    if dated:
        raise FileFormatError(
            f"{what} '{path}', entry '{dated[0]}': is a date or a time - got one, expected a number, a text or a list; "
            "write it in quotes if it is a text"
        )
    return found


def _text(path: Path, what: str, expected: str, advice: str) -> str:
    try:
        if path.stat().st_size > _LIMIT:
            raise _refusal(path, what, f"{path.stat().st_size} bytes", f"at most {_LIMIT}", advice)
        return path.read_bytes().decode("utf-8")
    except OSError as error:
        raise FileFormatError(
            f"{what} '{path}': cannot be read - got {error.strerror or error}, expected {expected}; {advice}"
        ) from error
    except UnicodeDecodeError as error:
        raise _refusal(path, what, f"byte {error.start}, which is not UTF-8", "text in UTF-8", advice) from error


def _refusal(path: Path, what: str, got: object, expected: str, advice: str) -> FileFormatError:
    found = _TOO_DEEP if isinstance(got, RecursionError) else got
    return FileFormatError(f"{what} '{path}': cannot be read - got {found}, expected {expected}; {advice}")


def _leaves(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, entry in value.items():
            yield from _leaves(entry, f"{name}.{key}" if name else key)
    elif isinstance(value, list):
        for entry in value:
            yield from _leaves(entry, name)
    else:
        yield name, value
