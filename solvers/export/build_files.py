"""Makefile and CMakeLists.txt of an exported controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files

from piaffe.codegen import flag_groups


def build_files(name: str, units: Mapping[str, Sequence[str]]) -> dict[str, str | bytes]:
    """Return the files that build a controller, by their paths.

    Args:
        name: of the controller.
        units: flags of each unit, by its path in the sources; ``{native}`` stands for the flag of the processor.
    """
    template = files(__package__).joinpath("template")
    rules, every = [], []
    for flags, own in flag_groups(units):
        objects = [f"$(BUILD)/{path[:-2]}.o" for path in own]
        every += objects
        words = " ".join("$(ARCH_FLAGS)" if flag == "{native}" else flag for flag in flags)
        rules.append(f"{' '.join(objects)}: OPTIMISE = {words}")
    text = template.joinpath("Makefile").read_text(encoding="utf-8")
    text = text.replace("@RULES@", "\n".join(rules)).replace("@OBJECTS@", " \\\n  ".join(every)).replace("@NAME@", name)
    return {"Makefile": text}
