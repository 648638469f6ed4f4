"""The command that checks a robot's description."""

from __future__ import annotations

from typing import Annotated

import typer

from .arguments import FAILED
from .reports import plain, terminal


def doctor(
    urdf: Annotated[str, typer.Argument(metavar="URDF", help="A URDF file, or the name of a known robot.")],
    feet: Annotated[
        str | None, typer.Option(metavar="'FRAME ...'", help="Frames of the feet, separated by spaces or commas.")
    ] = None,
    foot_radius: Annotated[float | None, typer.Option(help="Radius of the foot's ball \\[m].")] = None,
    base: Annotated[str | None, typer.Option(metavar="free|fixed", help="Whether the base floats.")] = None,
    lock: Annotated[
        list[str] | None, typer.Option(metavar="JOINT=X", help="A joint that does not move, and its position.")
    ] = None,
) -> None:
    """List what is wrong or missing in a robot's description. Exit code 1 if it cannot be used."""
    from piaffe.models import diagnose

    names = feet.replace(",", " ").split() if feet else None
    findings = diagnose(urdf, feet=names, foot_radius=foot_radius, base=base, locked=_locked(lock or []))
    console = terminal()
    colours = {"error": "bold red", "warning": "bold yellow", "note": "dim"}
    for finding in findings:
        console.print(
            f"[{colours[finding.severity]}]{finding.severity}:[/] {plain(f'{finding.where}: {finding.text}')}",
            soft_wrap=True,
        )
    errors = sum(finding.severity == "error" for finding in findings)
    warnings = sum(finding.severity == "warning" for finding in findings)
    console.print(f"{errors} errors, {warnings} warnings")
    raise typer.Exit(FAILED if errors else 0)


def _locked(options: list[str]) -> dict[str, float]:
    """Return joints and positions of ``JOINT=X`` options."""
    locked = {}
    for option in options:
        name, _, position = option.partition("=")
        try:
            locked[name] = float(position)
        except ValueError:
            raise typer.BadParameter(
                f"'{option}': expected JOINT=X, a name and a position", param_hint="--lock"
            ) from None
    return locked
