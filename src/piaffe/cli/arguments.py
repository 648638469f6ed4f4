"""What the commands' arguments and exit codes have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FAILED, REFUSED = 1, 2
"""Exit codes: the result is not what was hoped for; the command could not do what was asked."""

File = Annotated[
    str, typer.Argument(metavar="FILE[:name]", help="Python file with `problem`, or another name after a colon.")
]
Saved = Annotated[Path, typer.Argument(metavar="R.npz", help="A saved solution.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
