"""A thread that runs a solver, and for whose end the main thread can wait despite Ctrl-C."""

from __future__ import annotations

import threading
from collections.abc import Callable


class Worker:
    """A daemon thread with an event that signals its end.

    In Python 3.11 and 3.12, Ctrl-C during ``Thread.join`` makes ``is_alive`` False although the thread still runs.

    Args:
        target: the function that the thread runs.
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
        """Whether the thread has started and not ended."""
        return self._started and not self._ended.is_set()

    def wait(self, timeout: float) -> None:
        """Wait for the end, but at most ``timeout`` [s]."""
        self._ended.wait(timeout)

    def wait_out(self) -> bool:
        """Wait for the end even if Ctrl-C is pressed; return whether it was pressed."""
        interrupted = False
        while self.runs:
            try:
                self._ended.wait()
            except KeyboardInterrupt:
                interrupted = True
        return interrupted
