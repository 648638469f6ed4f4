"""README.md of an exported controller: its orders and units, rates, limits, and how to call it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files

from .layout import Layout

MEASURED = """## Measured

Nothing yet: `piaffe export --check` builds, runs `make check` and `make loop`, and writes what they find here.

"""
"""The section that a check replaces."""
_COMMANDS = "SI units: speeds in m/s, rates in rad/s, lengths in m.\n\n| command | declared |\n|---|---|\n"

_MOTIONS = """

The motions are {names}, with the numbers `NAME_MOTION_...` of the header.
`commands.set = NAME_MOTION; commands.motion = ...` asks for one. It begins where the robot is, at the next boundary of
phases at which contacts allow, or when a motion with an end is over. A request counts until its motion begins, or until
the next request; to ask for the motion that is active takes it back.
`output.motion` is the motion of the plan that acts, and `output.next_motion` the one that is asked for.
While a change is prepared, a plan takes up to twice as long, and `time_limit` counts twice.
"""


def readme(layout: Layout, values: Mapping[str, object]) -> str:
    """Return the text.

    Args:
        layout: of the controller.
        values: what the template names.
    """
    text = files(__package__).joinpath("template", "README.md").read_text(encoding="utf-8")
    state = "".join(f"| {i} | {label} | {unit or '1'} |\n" for i, (label, unit) in enumerate(layout.state))
    limits = zip(layout.control, layout.lower, layout.upper, strict=True)
    torques = "".join(f"| {i} | {name} | {low:g} to {high:g} |\n" for i, (name, low, high) in enumerate(limits))
    recorded = "".join(
        f"* `{path.replace('.', '_')}[{len(names)}]`: {path} [{unit or '1'}] in the world, of these torques, in the "
        f"order {', '.join(names)}.\n"
        for path, unit, names in layout.recorded
    )
    commands = "".join(f"| `{name}` | {value:g} |\n" for name, value in layout.commands.items())
    motions = _MOTIONS.format(names=", ".join(f"`{name}`" for name in layout.motions)) if layout.motions else ""
    own = {
        "MOTION_WORDS": motions, "STATE": state, "TORQUES": torques, "RECORDED_WORDS": recorded,
        "MEASURED": MEASURED, "COMMAND_WORDS": f"{_COMMANDS}{commands}" if commands else "This motion has none.\n",
    }  # fmt: skip
    for key, value in {**own, **values}.items():
        text = text.replace(f"@{key}@", str(value).rstrip("\n") if key in own and key != "MEASURED" else str(value))
    return text
