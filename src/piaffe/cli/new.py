"""The command that begins a motion: a commented problem file, ready to solve."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Annotated

import typer

from piaffe.errors import FileWriteError


def new(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder for the files; it is made if it is missing.")],
    robot: Annotated[str, typer.Option(help="A robot that Piaffe knows by name.")] = "mini_cheetah",
) -> None:
    """Write a commented problem file, motion.py, and the commands to solve, verify and film it."""
    from piaffe import models
    from piaffe.files import write_whole

    feet = " ".join(models.load(robot).foot_names)
    starters = {each.name.removesuffix(".in"): each for each in files("piaffe.cli").joinpath("starter").iterdir()}
    present = sorted(name for name in starters if (folder / name).exists())
    if present:
        raise FileWriteError(
            f"new: '{folder / present[0]}' exists - got a folder with this file, expected one without it; choose "
            "another folder, or move the file"
        )
    for name, starter in sorted(starters.items()):
        text = starter.read_text(encoding="utf-8").replace("ROBOT", robot).replace("FEET", feet)
        write_whole(folder / name, text.encode())
        print(f"saved {folder / name}")
