"""Compilers at work: processes that can be stopped, and what they say when they refuse a text."""

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

from piaffe.errors import SolverError

from .compilers import Compiler, first_lines

_LINES = 12  # of a compiler's message


class CompileError(SolverError):
    """The compiler refuses a text.

    Args:
        text: what to tell.
        unit: name of the translation unit, or ``"link"``.
        said: all that the compiler said.
    """

    def __init__(self, text: str, unit: str, said: str) -> None:
        self.unit, self.said = unit, said
        super().__init__(text)


@dataclass
class Runner:
    """Runs compilers in a folder, from several threads, until it is stopped."""

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
        own = str(self.folder)  # for what compilers leave when they are killed
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
            said, _ = process.communicate()
        except BaseException:  # interrupted while linking, which this thread does itself
            _kill(process)
            process.wait()
            raise
        finally:
            with self._lock:
                self._running.discard(process)
        if process.returncode and not self.stopped:
            killed = f"killed by {signal.Signals(-process.returncode).name}" if process.returncode < 0 else ""
            raise self._error(unit, command, said.strip() or killed or f"exit code {process.returncode}")

    def stop(self) -> None:
        """Kill every compiler that runs, with what it has started; start no other."""
        with self._lock:
            self.stopped = True
            for process in self._running:
                _kill(process)

    def _error(self, unit: str, command: Sequence[str], said: str) -> CompileError:
        return CompileError(
            f"native backend, unit '{unit}': {self.compiler.version} refuses it - got\n{first_lines(said, _LINES)}\n"
            f"expected no error; set CC to another compiler, or use backend=\"numpy\"\n(it ran {shlex.join(command)})",
            unit, said,
        )  # fmt: skip


def _kill(process: subprocess.Popen[str]) -> None:
    """Kill a compiler and what it has started; it leads a group of its own."""
    if process.returncode is None:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
