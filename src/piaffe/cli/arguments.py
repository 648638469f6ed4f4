"""Arguments and exit codes that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

FAILED, REFUSED, INTERRUPTED = 1, 2, 130
"""Exit codes: a negative result (not converged, not verified); an error stopped the command; Ctrl-C was pressed."""

File = Annotated[
    str, typer.Argument(metavar="FILE[:name]", help="Python file with `problem`, or another name after a colon.")
]
Saved = Annotated[Path, typer.Argument(metavar="R.npz", help="A saved solution.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else.")]
