"""Makefile and CMakeLists.txt of an exported controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from piaffe import __version__
from piaffe.codegen import flag_groups

_GCC_ONLY = "-fexpensive-optimizations"
"""A flag that gcc knows, and of which clang says that it ignores it."""
_FOR_MAKE = {"{native}": "$(ARCH_FLAGS)", "{narrow}": "$(ARCH_FLAG)", _GCC_ONLY: "$(EXPENSIVE)"}
_FOR_CMAKE = {_GCC_ONLY: f"$<$<C_COMPILER_ID:GNU>:{_GCC_ONLY}>"}
_CONTRACTION = "-ffp-contract=fast"


def build_values(units: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return what the templates of the build files need.

    Args:
        units: flags of each unit, by its path in the sources; see :meth:`Project.flags_of_units`. Wide
            vectors are set by the build files.
    """
    rules, every, sets = [], [], []
    for flags, own in flag_groups(units):
        objects = [f"$(BUILD)/{path[:-2]}.o" for path in own]
        every += objects
        words = " ".join(_FOR_MAKE.get(flag, flag) for flag in flags if "vector-width" not in flag)
        rules.append(f"{' '.join(objects)}: OPTIMISE = {words}")
        plain = ";".join(
            _FOR_CMAKE.get(flag, flag) for flag in flags
            if flag not in ("{native}", "{narrow}", _CONTRACTION) and "vector-width" not in flag
        )  # fmt: skip
        sources = "".join(f"\n  src/{path}" for path in own)
        sets.append(f'set(units{sources})\nset_source_files_properties(${{units}} PROPERTIES COMPILE_OPTIONS "'
                    f'{plain}")\nlist(APPEND NAME_UNITS ${{units}})')  # fmt: skip
    return {
        "RULES": "\n".join(rules), "OBJECTS": " \\\n  ".join(every), "UNITS": "\n".join(sets),
        "VERSION": __version__.partition("+")[0].partition(".dev")[0],
    }  # fmt: skip
