"""A thread that runs a solver and can be waited for, Ctrl-C or not."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Worker:
    """A daemon thread that is waited for by an event of its own.

    In Python 3.11 and 3.12, Ctrl-C during ``Thread.join`` makes ``is_alive`` False although the thread still runs.

    Args:
        target: what the thread does.
    """

    def __init__(self, target: Callable[[], object]) -> None:
        self._ended = threading.Event()

        def run() -> None:
            try:
                target()
            finally:
                self._ended.set()

        self._thread = threading.Thread(target=run, daemon=True)
        self._started = False

    def start(self) -> None:
        """Start the thread."""
        self._started = True
        self._thread.start()

    @property
    def runs(self) -> bool:
        """Whether the thread has begun and not ended."""
        return self._started and not self._ended.is_set()

    def wait(self, timeout: float) -> None:
        """Wait for the end, but not longer than ``timeout`` [s]."""
        self._ended.wait(timeout)

    def wait_out(self) -> bool:
        """Wait for the end, however often Ctrl-C is pressed meanwhile; return whether it was."""
        interrupted = False
        while self.runs:
            try:
                self._ended.wait()
            except KeyboardInterrupt:
                interrupted = True
        return interrupted
