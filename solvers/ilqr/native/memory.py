"""The memory of the compiled solver: the arrays and C structures of one problem."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.codegen import AlignedMemory
from piaffe.ocp import CompiledPhase, CompiledProblem, LoweredMode, LoweredTransition

from ..options import Options
from ..riccati import Sweep
from . import structs as s
from .library import Library

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NodeSizes:
    """Sizes of a node: parameters, rows of each kind, implicit variables, and factors of their matrix."""

    p: int
    residual: int = 0
    g: int = 0
    h: int = 0
    z: int = 0
    factors: int = 0

    def of_block(self) -> dict[str, int]:
        """Return the size per node of each array of a block."""
        values = {"z": self.z, "residual": self.residual, "g": self.g, "h": self.h, "factors": self.factors}
        return {
            **values, **{name + "0": count for name, count in values.items()},
            "relaxation": self.g, "shift": self.g, "multiplier": self.h, "penalty": self.h,
            "weight": self.residual, "g_mask": self.g, "h_mask": self.h, "p": self.p,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class NodeBlocks:
    """Blocks of W nodes of one kind and size; a SIMD instruction computes the W nodes of a block at once.

    Args:
        kind: ``"stage"``, ``"end"`` or ``"transition"``.
        nodes: phase and index of each node, phase by phase.
        blocks: arrays by name of each block, (rows W,): the numbers of the W nodes are adjacent.
        width: W.
    """

    kind: str
    nodes: list[tuple[int, int]]
    blocks: list[dict[str, Array]]
    width: int

    def write(self, name: str, table: Array, spare: float | None = None) -> None:
        """Write rows per node, (nodes, rows); unused places of a block are ``spare``, or repeat its first node."""
        for first, block in zip(range(0, len(table), self.width), self.blocks, strict=True):
            places, own = block[name].reshape(-1, self.width), table[first : first + self.width].T
            places[:, : own.shape[1]] = own
            places[:, own.shape[1] :] = own[:, :1] if spare is None else spare

    def read(self, name: str) -> Array:
        """Return rows per node, (nodes, rows)."""
        tables = [block[name].reshape(-1, self.width).T for block in self.blocks]
        return np.concatenate(tables)[: len(self.nodes)]


class SolverMemory:
    """The memory of the compiled solver for one problem; the constructor allocates all of it.

    Args:
        problem: the compiled problem.
        library: the library for its modes.
        options: options.
    """

    def __init__(self, problem: CompiledProblem, library: Library, options: Options) -> None:
        self.problem, self.width, self.compiled_library = problem, library.built.width, library
        modes, transitions, width = library.modes, library.transitions, library.built.width
        self.types = s.structs_of(width)
        self.library = library.loaded
        self.library.piaffe_solve.restype = ct.c_int
        self.library.piaffe_merit.restype = self.library.piaffe_predicted.restype = ct.c_double
        self.library.piaffe_predicted.argtypes = (ct.c_void_p, ct.c_double, ct.c_double)
        self._kept: list[Any] = []
        self._memory = AlignedMemory()
        self.arrays: list[dict[str, Array]] = []
        self.c = self.types.Problem()
        self.shooting: list[NDArray[np.uint8]] = []
        tables = [s.ModeSizes.in_dll(self.library, f"mode{i}_table") for i in range(len(modes))]
        links = [s.TransitionSizes.in_dll(self.library, f"transition{i}_table") for i in range(len(transitions))]
        self._work = self._array(max(each.num_work for each in (*tables, *links))).ctypes.data
        self.phases = self._phases(modes)
        self.blocks: list[NodeBlocks] = []
        groups = [self._mode_group(number, mode) for number, mode in enumerate(modes)]
        resets = [self._transition_group(number, transition) for number, transition in enumerate(transitions)]
        self.c.num_phases, self.c.num_groups, self.c.num_transitions = len(problem.phases), len(groups), len(resets)
        self.c.phases = self.phases
        self.c.groups = self._keep((self.types.Group * max(len(groups), 1))(*groups))
        self.c.transitions = self._keep((self.types.Group * max(len(resets), 1))(*resets))
        self.initial = self._array(problem.initial.size, problem.initial)
        self.c.initial = self.initial.ctypes.data
        self.history = self._keep((s.RecordStruct * options.max_iterations)())
        self.c.history = self.history
        rows = [mode.rows for mode in modes] + [transition.rows for transition in transitions]
        most = max([1, *(sum(map(len, each.values())) for each in rows)])
        self.c.slope, self.c.curvature = (self._array(most * width).ctypes.data for _ in range(2))
        self.set_options(options)

    def set_options(self, options: Options) -> None:
        """Write options, with costs in the problem's unit."""
        for name in s.OPTIONS:
            setattr(self.c.options, name, options.number(name))

    # ---- memory

    def _keep(self, thing: Any) -> Any:
        self._kept.append(thing)
        return thing

    def _array(self, size: int, values: Array | float | None = None) -> Array:
        """Return an array of doubles, aligned to 64 bytes; it is part of a larger one."""
        array = self._memory.zeros(size)
        if values is not None:
            array[:] = np.ravel(values) if isinstance(values, np.ndarray) else values
        return array

    # ---- phases

    def _phases(self, modes: Sequence[LoweredMode]) -> Any:
        phases = self._keep((s.Phase * len(self.problem.phases))())
        for i, (c, phase) in enumerate(zip(phases, self.problem.phases, strict=True)):
            n, nx, ndx, nu = phase.num_stages, phase.mode.state.nx, phase.mode.state.ndx, phase.mode.nu
            table = f"mode{list(modes).index(phase.mode)}_table"
            finish = s.ModeSizes.in_dll(self.library, table).num_finish
            nw, after = ndx + nu, phase.transition.target.state.ndx if phase.transition is not None else 0
            sizes = {
                "x": (n + 1) * nx, "xt": (n + 1) * nx, "u": n * nu, "ut": n * nu,
                "x_outside": (n + 1) * nx, "u_outside": n * nu, "x_next": n * nx, "start": nx,
                "d": (n + 1) * ndx, "dt_trial": (n + 1) * ndx, "D": n * ndx * nw, "finish": n * finish,
                "grad": n * nw, "H": n * nw * nw, "end_grad": ndx, "end_H": ndx * ndx, "P": after * ndx,
                "dx": (n + 1) * ndx, "du": n * nu, "k": n * nu, "K": n * nu * ndx, "V_x": (n + 1) * ndx,
                "V_xx": (n + 1) * ndx * ndx, "Q_x": n * ndx, "Q_u": n * nu, "Q_xx": n * ndx * ndx,
                "Q_ux": n * nu * ndx, "Q_uu": n * nu * nu,
            }  # fmt: skip
            arrays = {name: self._array(size) for name, size in sizes.items()}
            self.arrays.append(arrays)
            for name, array in arrays.items():
                setattr(c, name, array.ctypes.data)
            c.V_first, c.V_last = (arrays["V_xx"][k * ndx * ndx :].ctypes.data for k in (0, n))
            c.work = self._work
            self.shooting.append(self._array(n // 8 + 1, 0.0).view(np.uint8)[: n + 1])
            c.N, c.dt = n, phase.dt
            c.mode = ct.addressof(ct.c_char.in_dll(self.library, table))
            if i + 1 < len(phases):
                c.next = ct.pointer(phases[i + 1])
        return phases

    # ---- blocks

    def _mode_group(self, number: int, mode: LoweredMode) -> Any:
        """Return the group of a mode: the blocks of its stages and of its phase ends."""
        phases = [(i, phase) for i, phase in enumerate(self.problem.phases) if phase.mode is mode]
        stages = [(i, k) for i, phase in phases for k in range(phase.num_stages)]
        ends = [(i, phase.num_stages) for i, phase in phases]
        rows = {name: len(r) for name, r in mode.rows.items()}
        group = self.types.Group()
        sizes = s.ModeSizes.in_dll(self.library, f"mode{number}_table")
        group.mode = ct.addressof(sizes)
        size = mode.layout.size
        stage = NodeSizes(size, rows["stage_residual"], rows["stage_g"], rows["stage_h"], mode.nz, sizes.nf)
        end = NodeSizes(size, rows["terminal_residual"], rows["terminal_g"], rows["terminal_h"])
        group.blocks, group.num_blocks = self._blocks("stage", stages, stage)
        group.ends, group.num_ends = self._blocks("end", ends, end)
        return group

    def _transition_group(self, number: int, transition: LoweredTransition) -> Any:
        """Return the group of a transition."""
        phases = enumerate(self.problem.phases)
        where = [(i, phase.num_stages) for i, phase in phases if phase.transition is transition]
        group = self.types.Group()
        sizes = s.TransitionSizes.in_dll(self.library, f"transition{number}_table")
        group.transition = ct.addressof(sizes)
        counts = {kind: len(rows) for kind, rows in transition.rows.items()}
        own = NodeSizes(transition.layout.size, **counts, z=transition.nz, factors=sizes.nf)
        group.blocks, group.num_blocks = self._blocks("transition", where, own)
        return group

    def _blocks(self, kind: str, nodes: list[tuple[int, int]], sizes: NodeSizes) -> tuple[Any, int]:
        """Return the blocks of some nodes, and their number."""
        parts = [nodes[i : i + self.width] for i in range(0, len(nodes), self.width)]
        own = self._keep((self.types.Block * max(len(parts), 1))())
        arrays = [self._block(block, part, sizes) for block, part in zip(own, parts, strict=False)]
        self.blocks.append(NodeBlocks(kind, nodes, arrays, self.width))
        self._fill(self.blocks[-1])
        return own, len(parts)

    def _block(self, block: Any, nodes: list[tuple[int, int]], sizes: NodeSizes) -> dict[str, Array]:
        """Set the nodes of a block, and allocate its arrays."""
        block.count, block.work = len(nodes), self._work
        for lane, (i, k) in enumerate(nodes):
            block.phase[lane], block.index[lane] = i, k
            block.dt[lane] = self.problem.phases[i].dt
        arrays: dict[str, Array] = {}
        for name, count in sizes.of_block().items():
            arrays[name] = self._array(count * self.width)
            setattr(block, name, arrays[name].ctypes.data)
        return arrays

    def _fill(self, blocks: NodeBlocks) -> None:
        """Write parameters, weights and masks; unused places repeat the block's first node with weights and masks 0."""
        phases = [self.problem.phases[i] for i in dict.fromkeys(i for i, _ in blocks.nodes)]
        if not phases:
            return
        if blocks.kind != "stage":
            own = [phase.p_end if blocks.kind == "end" else phase.p_transition for phase in phases]
            blocks.write("p", np.array(own))
            for name in ("weight", "g_mask", "h_mask"):
                rows = [_of_end(phase, blocks.kind, name, getattr(phase, f"end_{name}")) for phase in phases]
                blocks.write(name, np.array(rows), spare=0.0)
        else:
            blocks.write("p", np.concatenate([phase.p for phase in phases]))
            for name in ("weight", "g_mask", "h_mask"):
                blocks.write(name, np.concatenate([getattr(phase, name) for phase in phases]), spare=0.0)

    def fault(self) -> str:
        """Return a sentence about a step or derivative that is not finite in the solver's memory; empty if all are.

        It is used if NumPy finds all values finite: NumPy's linear solve of the implicit step has pivots, this one not.
        """
        for phase, own in zip(self.problem.phases, self.arrays, strict=True):
            for name, of in (("x_next", ""), ("D", "derivative of "), ("finish", "derivative of ")):
                bad = np.flatnonzero(~np.isfinite(own[name].reshape(phase.num_stages, -1)).all(axis=1))
                if bad.size:
                    return (
                        f"{of}dynamics of model '{phase.mode.model.name}' ({phase.interval.phase.source}) is not "
                        f"finite as compiled, without pivots, in phase '{phase.name}' ({phase.label}), node {bad[0]}, "
                        f"at {phase.times[bad[0]]:.4g} s; see ModelBase.definite_size, or solve with backend='numpy'."
                    )
        return ""

    def set_numbers(self, problem: CompiledProblem) -> None:
        """Write the numbers of another problem, which has the same phases and functions."""
        self.problem = problem
        self.initial[:] = problem.initial
        for blocks in self.blocks:
            self._fill(blocks)

    def set_shooting(self, flags: Sequence[NDArray[np.bool_]]) -> None:
        """Write which nodes are shooting nodes, per phase (N+1,); the states of the others follow from the dynamics."""
        for c, own, given in zip(self.phases, self.shooting, flags, strict=True):
            own[:] = given
            c.shooting = None if np.all(given) else own.ctypes.data

    # ---- arrays with a number per row

    def write_rows(self, name: str, kind: str, values: list[Array]) -> None:
        """Write an array of the blocks from its values per phase: (N, rows) for ``"stage"``, (rows,) for ``"end"``."""
        for blocks in self.blocks:
            if (blocks.kind == "stage") != (kind == "stage") or not blocks.nodes:
                continue
            phases = list(dict.fromkeys(i for i, _ in blocks.nodes))
            if kind == "stage":
                blocks.write(name, np.concatenate([values[i] for i in phases]))
            else:
                own = [_of_end(self.problem.phases[i], blocks.kind, name, values[i]) for i in phases]
                blocks.write(name, np.array(own))

    def read_rows(self, name: str, kind: str) -> list[Array]:
        """Return an array of the blocks as values per phase, see :meth:`write_rows`."""
        out: list[Array] = [np.zeros(0)] * len(self.problem.phases)
        for blocks in self.blocks:  # the transitions come after the ends
            if (blocks.kind == "stage") != (kind == "stage") or not blocks.nodes:
                continue
            table, first = blocks.read(name), 0
            for i in dict.fromkeys(i for i, _ in blocks.nodes):
                if kind == "end":
                    out[i], first = np.concatenate([out[i], table[first]]), first + 1
                else:
                    count = self.problem.phases[i].num_stages
                    out[i], first = table[first : first + count], first + count
        return out

    def accepted(self, i: int, name: str) -> Array:
        """Return x, u or d of a phase's accepted iterate; the solver swaps buffers, so its pointer decides which."""
        other = {"x": "xt", "u": "ut", "d": "dt_trial"}[name]
        here = getattr(self.phases[i], name)
        own = self.arrays[i]
        return own[name] if own[name].ctypes.data == here else own[other]

    def outside(self, i: int, name: str) -> Array:
        """Return x or u of the last trial whose merit was not finite."""
        return self.arrays[i][f"{name}_outside"]

    def policy(self) -> list[Sweep]:
        """Return policy and expansions at the accepted iterate, least regularised; zeros if no sweep succeeds."""
        found = self.library.piaffe_policy(ct.byref(self.c))
        sweeps = []
        for own, phase in zip(self.arrays, self.problem.phases, strict=True):
            n, ndx, nu = phase.num_stages, phase.mode.state.ndx, phase.mode.nu
            shapes = {
                "k": (n, nu), "K": (n, nu, ndx), "V_x": (n + 1, ndx), "V_xx": (n + 1, ndx, ndx), "Q_x": (n, ndx),
                "Q_u": (n, nu), "Q_xx": (n, ndx, ndx), "Q_ux": (n, nu, ndx), "Q_uu": (n, nu, nu),
            }  # fmt: skip
            arrays = (own[name].reshape(s).copy() if found else np.zeros(s) for name, s in shapes.items())
            sweeps.append(Sweep(*arrays))
        return sweeps

    def trial(self, i: int, name: str) -> Array:
        """Return x or u of a phase's trial, which is the buffer that :meth:`accepted` does not return."""
        other = {"x": "xt", "u": "ut"}[name]
        own = self.arrays[i]
        return own[other] if self.accepted(i, name) is own[name] else own[name]


_KINDS = {
    "weight": "residual", "g_mask": "g", "relaxation": "g", "shift": "g", "h_mask": "h", "multiplier": "h",
    "penalty": "h",
}  # fmt: skip
"""The kind of the rows that an array has numbers for."""


def _of_end(phase: CompiledPhase, kind: str, name: str, values: Array) -> Array:
    """Return the part of an array of the last node's rows that a kind of blocks has: the mode's or the transition's."""
    own = len(phase.mode.rows[f"terminal_{_KINDS[name]}"])
    return values[:own] if kind == "end" else values[own:]
