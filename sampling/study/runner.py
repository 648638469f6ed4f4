"""Controllers of a study that are not sampling controllers: who reads the study brings them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol


class Runner(Protocol):
    """What a study asks of a controller that ``sampling`` does not know; it must be possible to pickle it.

    A study's file names it, as ``controller = "mpc"``. Settings are values that JSON can hold. Paths in them are
    relative to the study's folder.
    """

    @property
    def title(self) -> str:
        """Its name in tables, for cells without a label."""

    def complete(self, given: Mapping[str, Any], where: str, folder: Path) -> dict[str, Any]:
        """Return settings completed with all defaults; raise an error if one is unknown or out of range.

        Args:
            given: settings by name, without ``controller``.
            where: start of error messages.
            folder: the study's folder.
        """

    def files(self, settings: Mapping[str, Any], folder: Path) -> Mapping[str, Path]:
        """Return the files that the settings refer to, by name, so that the study notices their changes."""

    def prepare(self, spec: str, settings: Mapping[str, Any], folder: Path) -> None:
        """Make everything that an episode needs, so that errors are raised now.

        Args:
            spec: the problem's file, and the problem's name.
            settings: completed settings.
            folder: the study's folder.
        """

    def run(
        self, spec: str, settings: Mapping[str, Any], seed: int, folder: Path
    ) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
        """Run an episode.

        Returns:
            Its figures: ``success`` and ``fell`` at least, and numbers, texts or None by name; and what is known of its
            settings by name, ``dt_s`` at least.
        """
