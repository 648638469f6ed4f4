"""What a controller has in memory, as C: tables that never change, and memory of which each controller has its own."""

from __future__ import annotations

import ctypes as ct
from importlib.resources import files
from typing import Any

from piaffe.codegen import LoadedLibrary, MemoryImage, defined_symbols

from ..receding import Keeper, MotionsTick, NativeTick
from ..tracking import NativeTick as LowTick

PLACES = 4
"""Plans in memory, see ``handover.h``."""
HANDOVER = files("piaffe.solvers.receding").joinpath("template", "handover.h").read_text(encoding="utf-8")


class ControllerMemory:
    """The memory of a planner and a low level that have not made a plan yet.

    Args:
        planner: the planner, of one motion or of several.
        low: the low level; it may have made ticks.

    Attributes:
        planners: the planner of each motion. motions: what decides between them; None for one motion.
        code: the libraries of the planners. plan_numbers: most doubles of a plan. plan_entries: of its header.
    """

    def __init__(self, planner: NativeTick, low: LowTick) -> None:
        self.low = low
        self.motions = planner.motions if isinstance(planner, MotionsTick) else None
        self.planners = (planner.memory,) if self.motions is None else self.motions.planners
        for each in self.planners:
            each.be_lean()
        if self.motions is not None:
            self.motions.share()
        self.code = code = self.planners[0].code
        self.plan_numbers = max(each.plan_numbers for each in self.planners)
        self.plan_entries = max(each.plan_entries for each in self.planners)
        self.solver, self.horizon, self.tick = code.solver.loaded, code.library, low.library
        symbols, kinds = _symbols(self.solver, self.horizon)
        headers = [text for library in (self.solver, self.horizon, self.tick) for text in _headers(library)]
        ahead = None if self.motions is None else self.motions.c.ahead
        more = () if ahead is None else (ahead.header, ahead.numbers, ahead.phases, ahead.view)
        outside = [self.planners[0].c.arena.base, low.c.plan, *more]
        self.image = MemoryImage(headers, symbols, kinds, [address for address in outside if address])
        self.image.know(_Holder(code.commands))
        for each in self.planners:
            self.image.know(each.tables, constant=True, vectors=each.tables.vectors)
            self.image.know(each, vectors=each.vectors)
        self.image.know(low)
        outcome = _Outcome(low)
        self.image.know(outcome)
        roots: dict[str, Any] = {"receding": self.planners[0].c, "low": low.c, "outcome": outcome.c}
        if self.motions is not None:
            self.image.know(self.motions)
            roots["motions"] = self.motions.c
        self.measured = len(low.readings) if low.c.contacts else 0
        """Number of measured contact flags."""
        if self.measured:
            roots["readings"] = low.readings
        if len(code.commands):
            roots["commands"] = code.commands
        self.image.use(**roots)
        self._externs = "".join(f"extern {kind} {name[1:]};\n" for name, kind in sorted(kinds.items()))

    @property
    def bytes(self) -> int:
        """Bytes of a controller at this machine's width of a vector, without its padding."""
        plan, places = 8 * (self.plan_numbers + self.plan_entries), PLACES + (self.motions is not None)
        return int(self.image.size + max(each.arena_bytes for each in self.planners) + places * plan)

    def files(self) -> dict[str, str]:
        """Return the header and the unit of the memory, by their paths."""
        template = files(__package__).joinpath("template")
        members = self.image.members()
        if not len(self.code.commands):
            members += "    double commands[1];\n"
        values = {
            "MEMBERS": members, "CONSTANTS": self.image.constants(), "FILLING": self.image.filling("m"),
            "EXTERNS": self._externs, "HORIZONS": "".join(
                f"    {{\n        static const Horizon horizon = {self.image.literal(each.tables.c)};\n"
                f"        most = larger(most, most_bytes(&horizon, {each.starts.start}, {each.starts.stop}, "
                f"{each.starts.step}));\n    }}\n"
                for each in self.planners
            ),
            "SPANS": str(max(each.num_spans for each in self.planners)),
            "NODES": str(3 * max(each.num_spans for each in self.planners)),
        }  # fmt: skip
        found = {}
        for name in ("memory.h", "memory.c"):
            text = template.joinpath(name).read_text(encoding="utf-8")
            for key, value in values.items():
                text = text.replace(f"@{key}@", value)
            found[name] = text
        return found


class _Outcome(Keeper):
    """The memory of what a tick tells, with all that it can tell."""

    def __init__(self, low: LowTick) -> None:
        super().__init__()
        self.c = type(low.outcome)(
        active=self.ints([0] * len(low.active)), nominal=self.zeros(low.modes[0].state.nx),
            recorded=self.zeros(max(sum(size for _, size in each.outputs) for each in low.modes)),
        )  # fmt: skip


class _Holder:
    def __init__(self, thing: object) -> None:
        self.thing = thing


def _headers(library: LoadedLibrary) -> list[str]:
    return [text for name, text in library.built.sources.make().headers.items() if name.endswith(".h")]


def _symbols(*libraries: LoadedLibrary) -> tuple[dict[int, str], dict[str, str]]:
    """Return the C expression of each function and table by its address, and the C type of each table."""
    symbols, kinds = {}, {}
    for library in libraries:
        for name in defined_symbols(library.built.path):
            address = ct.cast(getattr(library, name), ct.c_void_p).value
            assert address is not None  # it is defined
            table = name.endswith("_table")
            symbols[address] = f"&{name}" if table else name
            if table:
                kinds[f"&{name}"] = "const Mode" if name.startswith("mode") else "const Transition"
    return symbols, kinds
