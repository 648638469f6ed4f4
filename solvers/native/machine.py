"""The machine: a problem laid out in memory for the compiled solver, and its runs."""

from __future__ import annotations

import ctypes as ct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import CompiledProblem

from ..options import Options
from ..riccati import Sweep
from . import structs as s
from .library import Library

Array = NDArray[np.float64]


class Machine:
    """Memory of one problem and the library that solves it; all memory is allocated here, once.

    Args:
        problem: the compiled problem.
        library: the library of its modes.
        options: options.
    """

    def __init__(self, problem: CompiledProblem, library: Library, options: Options) -> None:
        self.problem, self.width, self.origin = problem, library.built.width, library
        modes, links, width = library.modes, library.links, library.built.width
        self.types = s.structs(width)
        self.library = library.loaded
        self.library.piaffe_solve.restype = ct.c_int
        self.library.piaffe_merit.restype = ct.c_double
        self._kept: list[Any] = []
        self.arrays: list[dict[str, Array]] = []
        self.c = self.types.Problem()
        self.phases = self._phases(modes)
        self.blocks: list[tuple[list[tuple[int, int]], str, dict[str, Array]]] = []
        groups = [self._group(number, mode) for number, mode in enumerate(modes)]
        linked = [self._link(number, link) for number, link in enumerate(links)]
        self.c.num_phases, self.c.num_groups, self.c.num_links = len(problem.phases), len(groups), len(linked)
        self.c.phases = self.phases
        self.c.groups = self._keep((self.types.Group * max(len(groups), 1))(*groups))
        self.c.links = self._keep((self.types.Group * max(len(linked), 1))(*linked))
        self.initial = self._array(problem.initial.size, problem.initial)
        self.c.initial = self._pointer(self.initial)
        self.history = self._keep((s.Record * options.max_iterations)())
        self.c.history = self.history
        most = max([1] + [sum(map(len, mode.rows.values())) for mode in modes])
        self.c.slope, self.c.curvature = (self._pointer(self._array(most * width)) for _ in range(2))
        for name in s.OPTIONS:
            value = getattr(options, name)
            setattr(self.c.options, name, 0.0 if value is None else value)

    # ---- memory

    def _keep(self, thing: Any) -> Any:
        self._kept.append(thing)
        return thing

    def _array(self, size: int, values: Array | float | None = None) -> Array:
        """Return an array of doubles aligned to 64 bytes."""
        raw = self._keep(np.zeros(max(size, 1) + 8))
        first = (-raw.ctypes.data % 64) // 8
        array: Array = raw[first : first + size]
        if values is not None:
            array[:] = np.ravel(values) if isinstance(values, np.ndarray) else values
        return array

    @staticmethod
    def _pointer(array: Array) -> Any:
        return array.ctypes.data_as(s.Doubles)

    # ---- phases

    def _phases(self, modes: Sequence[Any]) -> Any:
        phases = self._keep((s.Phase * len(self.problem.phases))())
        for i, (c, phase) in enumerate(zip(phases, self.problem.phases, strict=True)):
            n, nx, ndx, nu = phase.num_stages, phase.mode.state.nx, phase.mode.state.ndx, phase.mode.nu
            nw, after = ndx + nu, phase.transition.target.state.ndx if phase.transition is not None else 0
            sizes = {
                "x": (n + 1) * nx, "xt": (n + 1) * nx, "u": n * nu, "ut": n * nu,
                "x_outside": (n + 1) * nx, "u_outside": n * nu, "x_next": n * nx, "start": nx,
                "d": (n + 1) * ndx, "dt_trial": (n + 1) * ndx, "D": n * ndx * nw, "grad": n * nw, "H": n * nw * nw,
                "end_grad": ndx, "end_H": ndx * ndx, "P": after * ndx, "dx": (n + 1) * ndx, "du": n * nu, "k": n * nu,
                "K": n * nu * ndx, "V_x": (n + 1) * ndx, "V_xx": (n + 1) * ndx * ndx, "Q_x": n * ndx, "Q_u": n * nu,
                "Q_xx": n * ndx * ndx, "Q_ux": n * nu * ndx, "Q_uu": n * nu * nu,
            }  # fmt: skip
            arrays = {name: self._array(size) for name, size in sizes.items()}
            self.arrays.append(arrays)
            for name, array in arrays.items():
                setattr(c, name, self._pointer(array))
            c.N, c.dt = n, phase.dt
            c.mode = ct.addressof(ct.c_char.in_dll(self.library, f"mode{list(modes).index(phase.mode)}_table"))
            if i + 1 < len(phases):
                c.next = ct.pointer(phases[i + 1])
        return phases

    # ---- blocks

    def _group(self, number: int, mode: Any) -> Any:
        """Return the group of a mode: its stages and its phase ends, W to a block."""
        phases = [(i, phase) for i, phase in enumerate(self.problem.phases) if phase.mode is mode]
        stages = [(i, k) for i, phase in phases for k in range(phase.num_stages)]
        ends = [(i, phase.num_stages) for i, phase in phases]
        rows = {name: len(r) for name, r in mode.rows.items()}
        group = self.types.Group()
        sizes = s.ModeSizes.in_dll(self.library, f"mode{number}_table")
        group.mode = ct.addressof(sizes)
        blocks = [
            self._block(part, "stage", rows["stage_residual"], rows["stage_g"], rows["stage_h"], mode.nz, sizes.nf)
            for part in self._parts(stages)
        ]
        last = [
            self._block(part, "end", rows["terminal_residual"], rows["terminal_g"], rows["terminal_h"])
            for part in self._parts(ends)
        ]
        group.num_blocks, group.num_ends = len(blocks), len(last)
        group.blocks = self._keep((self.types.Block * max(len(blocks), 1))(*blocks))
        group.ends = self._keep((self.types.Block * max(len(last), 1))(*last))
        return group

    def _link(self, number: int, link: Any) -> Any:
        """Return the group of a transition."""
        where = [(i, phase.num_stages) for i, phase in enumerate(self.problem.phases) if phase.transition is link]
        group = self.types.Group()
        sizes = s.TransitionSizes.in_dll(self.library, f"link{number}_table")
        group.transition = ct.addressof(sizes)
        blocks = [self._block(part, "link", 0, 0, 0, link.nz, sizes.nf) for part in self._parts(where)]
        group.num_blocks = len(blocks)
        group.blocks = self._keep((self.types.Block * max(len(blocks), 1))(*blocks))
        return group

    def _parts(self, nodes: list[tuple[int, int]]) -> list[list[tuple[int, int]]]:
        return [nodes[i : i + self.width] for i in range(0, len(nodes), self.width)]

    def _block(
        self, nodes: list[tuple[int, int]], kind: str, nr: int, ng: int, nh: int, nz: int = 0, nf: int = 0
    ) -> Any:
        block = self.types.Block()
        block.count = len(nodes)
        for lane, (i, k) in enumerate(nodes):
            block.phase[lane], block.index[lane] = i, k
            block.dt[lane] = self.problem.phases[i].dt
        arrays: dict[str, Array] = {}
        for name, rows in (("z", nz), ("residual", nr), ("g", ng), ("h", nh), ("factors", nf)):
            arrays[name], arrays[name + "0"] = self._array(rows * self.width), self._array(rows * self.width)
        for name, rows in (("relaxation", ng), ("shift", ng), ("multiplier", nh), ("penalty", nh)):
            arrays[name] = self._array(rows * self.width)
        for name, rows in (("weight", nr), ("g_mask", ng), ("h_mask", nh)):
            arrays[name] = self._array(rows * self.width)
        arrays["p"] = self._array(self.width * self._numbers(nodes[0], kind, "p").size)
        for name, array in arrays.items():
            setattr(block, name, self._pointer(array))
        self.blocks.append((nodes, kind, arrays))
        self._fill(nodes, kind, arrays)
        return block

    def _numbers(self, node: tuple[int, int], kind: str, name: str) -> Array:
        phase, k = self.problem.phases[node[0]], node[1]
        if kind == "link":
            return phase.p_transition if name == "p" else np.zeros(0)
        if kind == "stage":
            table = {"p": phase.p, "weight": phase.weight, "g_mask": phase.g_mask, "h_mask": phase.h_mask}[name]
            row: Array = table[k]
            return row
        return {
            "p": phase.p_end, "weight": phase.end_weight, "g_mask": phase.end_g_mask, "h_mask": phase.end_h_mask
        }[name]  # fmt: skip

    def _fill(self, nodes: list[tuple[int, int]], kind: str, arrays: dict[str, Array]) -> None:
        """Write parameters, weights and masks of a block; lanes beyond the nodes repeat the first and weigh nothing."""
        for name in ("p", "weight", "g_mask", "h_mask"):
            rows = np.stack([self._numbers(node, kind, name) for node in nodes])
            spare = self.width - len(nodes)
            filler = np.repeat(rows[:1], spare, axis=0) if name == "p" else np.zeros((spare, rows.shape[1]))
            arrays[name][:] = np.concatenate([rows, filler]).T.reshape(-1)

    def fault(self) -> str:
        """Return where a step or its derivative is not finite in the solver's own memory; empty if nowhere.

        It is asked where NumPy, which pivots in the linear solve of an implicit step, finds nothing that is not.
        """
        for phase, own in zip(self.problem.phases, self.arrays, strict=True):
            for name, of in (("x_next", ""), ("D", "derivative of ")):
                bad = np.flatnonzero(~np.isfinite(own[name].reshape(phase.num_stages, -1)).all(axis=1))
                if bad.size:
                    return (
                        f"{of}dynamics of model '{phase.mode.model.name}' ({phase.interval.phase.source}) is not "
                        f"finite as compiled, without pivots, in phase '{phase.name}' ({phase.label}), node {bad[0]}, "
                        f"at {phase.times[bad[0]]:.4g} s; see ModelBase.definite_size, or solve with backend='numpy'."
                    )
        return ""

    def renumber(self, problem: CompiledProblem) -> None:
        """Turn to another problem of the same phases and functions, which differs in its numbers alone."""
        self.problem = problem
        self.initial[:] = problem.initial
        for nodes, kind, arrays in self.blocks:
            self._fill(nodes, kind, arrays)

    # ---- rows in lanes and back

    def write_rows(self, name: str, kind: str, values: list[Array]) -> None:
        """Write per-row values, (N, rows) per phase for stages or (rows,) for ends, into the lanes."""
        for nodes, own, arrays in self.blocks:
            if own != kind:
                continue
            lanes = arrays[name].reshape(-1, self.width)
            for lane in range(self.width):
                i, k = nodes[lane] if lane < len(nodes) else nodes[0]
                lanes[:, lane] = values[i][k] if kind == "stage" else values[i]

    def read_rows(self, name: str, kind: str) -> list[Array]:
        """Return what ``write_rows`` wrote and the solver changed."""
        out: list[Array] = [np.zeros(0)] * len(self.problem.phases)
        for nodes, own, arrays in self.blocks:
            if own != kind:
                continue
            lanes = arrays[name].reshape(-1, self.width)
            for lane, (i, k) in enumerate(nodes):
                if kind == "end":
                    out[i] = lanes[:, lane].copy()
                else:
                    if out[i].size == 0:
                        out[i] = np.zeros((self.problem.phases[i].num_stages, lanes.shape[0]))
                    out[i][k] = lanes[:, lane]
        return out

    def accepted(self, i: int, name: str) -> Array:
        """Return x, u or d of the accepted iterate of a phase; the solver swaps buffers, so ask through its pointer."""
        other = {"x": "xt", "u": "ut", "d": "dt_trial"}[name]
        here = ct.addressof(getattr(self.phases[i], name).contents)
        own = self.arrays[i]
        return own[name] if own[name].ctypes.data == here else own[other]

    def outside(self, i: int, name: str) -> Array:
        """Return x or u of the last trial whose merit was not finite."""
        return self.arrays[i][f"{name}_outside"]

    def policy(self) -> list[Sweep]:
        """Return the policy and expansions at the accepted iterate, least regularised; zeros if no sweep succeeds."""
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
        """Return the trial buffer that is not the accepted one."""
        other = {"x": "xt", "u": "ut"}[name]
        own = self.arrays[i]
        return own[other] if self.accepted(i, name) is own[name] else own[name]
