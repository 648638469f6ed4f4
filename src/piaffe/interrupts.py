"""Ctrl-C that is not lost: CasADi's functions clear the exception of an interrupt that comes while they run.

A handler notes the exception that the previous handler raises. Long work asks for it between its steps.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType


class _State:
    """The interrupt of the main thread."""

    guarded: bool = False
    pending: BaseException | None = None


@contextmanager
def interruptible() -> Iterator[None]:
    """Return a context, also a decorator, at whose end an interrupt is raised that was lost within it.

    The handler that was there is called and comes back at the end. Nothing is installed in other threads than the main
    one, within another such context, and where interrupts are ignored.
    """
    previous = signal.getsignal(signal.SIGINT)
    main = threading.current_thread() is threading.main_thread()
    if _State.guarded or not main or not callable(previous):
        yield
        check_interrupt()
        return

    def heard(number: int, frame: FrameType | None) -> None:
        try:
            previous(number, frame)
        except BaseException as error:
            _State.pending = error
            raise

    _State.guarded, _State.pending = True, None
    try:
        signal.signal(signal.SIGINT, heard)
        try:
            yield
        except BaseException as error:
            if _State.pending is not None and error is not _State.pending:
                raise _State.pending from error  # the error is what became of the interrupt, or came after it
            raise
        check_interrupt()
    finally:
        _State.guarded, _State.pending = False, None
        if signal.getsignal(signal.SIGINT) is heard:
            signal.signal(signal.SIGINT, previous)


def exit_on_interrupt(code: int) -> None:
    """Have an interrupt end the process with an exit code from now on; for the end of a command, whose work is done.

    Without this, an interrupt while Python ends kills the process by the signal, or prints calls of Python.
    """

    def heard(number: int, frame: FrameType | None) -> None:
        with suppress(Exception):  # the signal may have come within a flush, which refuses another one
            sys.stdout.flush()
        os._exit(code)

    if threading.current_thread() is threading.main_thread() and callable(signal.getsignal(signal.SIGINT)):
        signal.signal(signal.SIGINT, heard)


def check_interrupt() -> None:
    """Raise the interrupt that came since the begin of the context, if it was lost; call it between steps."""
    if _State.pending is not None and threading.current_thread() is threading.main_thread():
        raise _State.pending


@contextmanager
def deferred() -> Iterator[None]:
    """Return a context at whose end an interrupt is raised that came within it, for steps that must not break off."""
    previous = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(previous):
        yield
        return
    frames: list[FrameType | None] = []
    signal.signal(signal.SIGINT, lambda number, frame: frames.append(frame))
    try:
        yield
    finally:  # an error of the step does not replace the interrupt
        signal.signal(signal.SIGINT, previous)
        if frames:
            previous(signal.SIGINT, frames[0])
