"""Names of joints and feet in a plant's file, from a TOML file and from the command line."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from piaffe.errors import FileFormatError, ModelError
from piaffe.files import read_toml

from .online_settings import COMMANDS


def names_of(file: Path | None, joints: Iterable[str], feet: Iterable[str]) -> dict[str, dict[str, str]]:
    """Return the mappings ``joints`` and ``feet`` of a TOML file and of texts ``ours=theirs``, which come after it.

    Raises:
        FileFormatError: it is not such a file.
        ModelError: a text has another form.
    """
    found: dict[str, dict[str, str]] = {"joints": {}, "feet": {}} if file is None else _read(file)
    for option, kind, texts in (("--joint", "joints", joints), ("--foot", "feet", feet)):
        for text in texts:
            ours, equal, theirs = text.partition("=")
            if not (ours and equal and theirs):
                raise ModelError(
                    f"{COMMANDS}: {option} is unusable - got '{text}', expected the robot's name and the file's, as "
                    "OURS=THEIRS; change it"
                )
            found[kind][ours] = theirs
    return found


def _read(file: Path) -> dict[str, dict[str, str]]:
    given = read_toml(file, "names")
    for kind, table in given.items():
        if kind not in ("joints", "feet"):
            raise FileFormatError(
                f"names '{file}': no table '{kind}' is known - got it, expected [joints] and [feet]; fix it"
            )
        if not (isinstance(table, dict) and all(isinstance(name, str) for name in table.values())):
            raise FileFormatError(
                f"names '{file}', table '{kind}': is no mapping of names - got {table!r}, expected lines as "
                'FL_hip_joint = "abduction"; correct it'
            )
    return {"joints": dict(given.get("joints", {})), "feet": dict(given.get("feet", {}))}
