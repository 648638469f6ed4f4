"""Comments of an exported controller's header: its state, its joints and its commands, with their units."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from textwrap import wrap
from typing import Any

from .layout import Layout

_WIDTH = 126


def header_values(layout: Layout, model: Any) -> dict[str, str]:
    """Return what the header's template needs.

    Args:
        layout: of the controller.
        model: the first model, of a robot or not.
    """
    robot = getattr(getattr(model, "robot", model), "name", model.name)
    torques = f"Torques, and angles and speeds of the joints, are in the order {', '.join(layout.control)}."
    declared = ", ".join(f"{name} {value:g}" for name, value in layout.commands.items())
    return {
        "STATE_WORDS": state_words(layout.state), "ROBOT": robot,
        "TORQUE_WORDS": _comment(torques),
        "DECLARED_WORDS": _comment(f"SI units: m/s, rad/s, m. At first commands are those declared: {declared}.")
        if declared else "",
    }  # fmt: skip


def state_words(state: Sequence[tuple[str, str]]) -> str:
    """Return the entries of a state as lines of a comment: places, quantity, components and unit.

    Args:
        state: name and unit of each entry; a name is a quantity and a component, separated by a blank.
    """
    lines, at = [], 0
    for (quantity, unit), entries in groupby(state, key=lambda entry: (entry[0].partition(" ")[0], entry[1])):
        labels = [name.partition(" ")[2] for name, _ in entries]
        places = f"{at}" if len(labels) == 1 else f"{at} to {at + len(labels) - 1}"
        text = f"{places:>8}  {quantity} [{unit or '1'}]: {', '.join(labels)}"
        lines += wrap(text, _WIDTH, initial_indent=" *  ", subsequent_indent=" *            ", drop_whitespace=True)
        at += len(labels)
    return "\n".join(lines)


def _comment(text: str) -> str:
    """Return a text as a comment of C, and the end of its line."""
    return "/* " + "\n * ".join(wrap(text, _WIDTH)) + " */\n"
