"""Processes that compile: they can be stopped, and their errors become exceptions."""

from __future__ import annotations

import contextlib
import os
import shlex
import signal
import subprocess
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

from piaffe.errors import SolverError

from .compilers import Compiler, first_lines

_LINES = 12  # of a compiler's output, shown in the error


class CompileError(SolverError):
    """A translation unit does not compile, or the link fails.

    Args:
        text: the message.
        unit: name of the translation unit, or ``"link"``.
        output: the whole output of the compiler.
    """

    def __init__(self, text: str, unit: str, output: str) -> None:
        self.unit, self.output = unit, output
        super().__init__(text)

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, str]]:  # processes of a study send errors to each other
        return type(self), (str(self), self.unit, self.output)


@dataclass
class Runner:
    """Runs compilers in a folder; several threads may call it."""

    compiler: Compiler
    folder: Path
    stopped: bool = False
    _running: set[subprocess.Popen[str]] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def __call__(self, unit: str, arguments: Sequence[str]) -> None:
        """Run the compiler.

        Raises:
            CompileError: it fails.
        """
        command = [*self.compiler.command, *self.compiler.flags, *arguments]
        own = str(self.folder)  # a killed compiler leaves temporary files: they are removed with this folder
        with self._lock:
            if self.stopped:
                return
            try:
                process = subprocess.Popen(
                    command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                    stderr=subprocess.STDOUT, text=True, errors="replace", start_new_session=True,
                    env={**os.environ, "LC_ALL": "C", "TMPDIR": own, "ZIG_LOCAL_CACHE_DIR": own},
                )  # fmt: skip
            except OSError as error:
                raise self._error(unit, command, str(error)) from error
            self._running.add(process)
        try:
            output, _ = process.communicate()
        except BaseException:  # an interrupt while linking, which runs in the main thread
            _kill(process)
            process.wait()
            raise
        finally:
            with self._lock:
                self._running.discard(process)
        if process.returncode and not self.stopped:
            killed = f"killed by {signal.Signals(-process.returncode).name}" if process.returncode < 0 else ""
            raise self._error(unit, command, output.strip() or killed or f"exit code {process.returncode}")

    def stop(self) -> None:
        """Kill every running compiler and its child processes; later calls start no compiler."""
        with self._lock:
            self.stopped = True
            for process in self._running:
                _kill(process)

    def _error(self, unit: str, command: Sequence[str], output: str) -> CompileError:
        return CompileError(
            f"native backend, unit '{unit}': {self.compiler.version} fails - got\n{first_lines(output, _LINES)}\n"
            f"expected no error; set CC to another compiler, or use backend=\"numpy\"\n"
            f"(the command was {shlex.join(command)})",
            unit, output,
        )  # fmt: skip


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a compiler and its child processes: they are a process group."""
    if process.returncode is None:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
