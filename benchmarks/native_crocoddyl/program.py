"""The timing program at work: commands, and what it answers."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Any

from .build import program_for


class Program:
    """The timing program of a Crocoddyl, which waits for commands at one iterate of the problem.

    Args:
        target: what it is compiled for, or ``"wheel"``.
        problem: the file of the problem.
    """

    def __init__(self, target: str, problem: Path) -> None:
        self.target = target
        self._process = subprocess.Popen(
            [program_for(target), problem], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Program:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._process.communicate()  # it ends with its input

    def ask(self, command: str) -> dict[str, Any]:
        """Return the answer to a command."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise SystemExit(f"timing program, {self.target}: ended at {command!r}, with {self._process.wait()}")
        answer: dict[str, Any] = json.loads(line)
        return answer
