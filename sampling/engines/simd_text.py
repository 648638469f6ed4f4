"""The C code of a scene: the smooth dynamics as an expression, and tables for the template ``simulate.c``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from math import isfinite

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.models import Inertials, Recursion

from .simd_scene import Ground, Scene, Soft

Array = NDArray[np.float64]

_FREE = 6  # degrees of freedom of the base


class SceneText:
    """The expression and the tables of a scene for the template ``simulate.c``.

    The *chain* of a degree of freedom are the degrees of freedom that move its link: the six of the base first, then
    those of the hinges from the base to this one. Each row of the factor L of M = Lᵀ D L has its nonzeros in the chain.

    Args:
        scene: the scene.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.nv = scene.tree.nv

    @cached_property
    def chains(self) -> list[list[int]]:
        """The chain of every degree of freedom, ascending."""
        base = [list(range(i + 1)) for i in range(_FREE)]
        tree = self.scene.tree
        return base + [[*range(_FREE), *(5 + k for k in reversed(tree.path(i)))] for i in range(1, tree.num_links)]

    @cached_property
    def smooth(self) -> cs.Function:
        """(q, v, u) → strict rows of L, 1/D, smooth accelerations, and the centres of the balls and their Jacobians.

        ``moves`` contains, for every ball and every entry of its chain after the third, the velocity of the ball's
        centre and its angular velocity per unit velocity of that entry, in world axes, (6,).
        """
        scene, tree, nv = self.scene, self.scene.tree, self.nv
        q, v, u = cs.SX.sym("q", nv + 1), cs.SX.sym("v", nv), cs.SX.sym("u", nv - _FREE)
        body = Inertials.of(cs.SX(tree.mass), cs.SX(np.ravel(tree.com)), cs.SX(np.ravel(tree.inertia)))
        motion = Recursion(tree, q, v)
        force = scene.gain * u + scene.bias[:, 0] + scene.bias[:, 1] * q[7:] + scene.bias[:, 2] * v[_FREE:]
        low, high = scene.force_range.T
        limited = [_clip(force[i], low[i], high[i]) for i in range(nv - _FREE)]
        pushed = cs.vertcat(cs.SX.zeros(_FREE), *limited) - motion.inverse_dynamics(body, cs.SX(scene.gravity))
        M = motion.mass_matrix(body) + cs.diag(np.r_[np.zeros(_FREE), scene.armature])
        rows, inverse = self._factors(M)
        moves = [part for ball in scene.balls for part in self._moves(motion, ball.link, motion.point(ball))]
        outputs = {
            "factor": cs.vertcat(*(entry for row in rows for entry in row)),
            "inverse": cs.vertcat(*inverse),
            "acceleration": self._solved(rows, inverse, pushed),
            "centre": cs.vertcat(*(motion.point(ball) for ball in scene.balls)),
            "moves": cs.vertcat(*moves),
        }
        dense = [cs.densify(each) for each in outputs.values()]
        return cs.Function("smooth", [q, v, u], dense, ["q", "v", "u"], list(outputs), {"cse": True})

    @property
    def numbers(self) -> str:
        """All numbers in :attr:`smooth`, with all digits."""
        scene, tree = self.scene, self.scene.tree
        arrays = [
            tree.rotations, tree.offsets, tree.axes, tree.mass, tree.com, tree.inertia, scene.armature, scene.gravity,
            scene.gain, scene.bias, scene.force_range, *(ball.offset for ball in scene.balls),
        ]  # fmt: skip
        return repr([tree.parents, [ball.link for ball in scene.balls], [array.tolist() for array in arrays]])

    @cached_property
    def header(self) -> str:
        """Text of ``scene.h``."""
        scene, chains = self.scene, self.chains
        longest = max(map(len, chains))
        tips = [chains[5 + ball.link] for ball in scene.balls]
        starts = np.concatenate([[0], np.cumsum([6 * (len(chain) - 3) for chain in tips])])[:-1]
        lines = [
            "#ifndef PIAFFE_SCENE_H", "#define PIAFFE_SCENE_H",
            *(f"#define {name} {value}" for name, value in {
                "NV": self.nv, "NQ": self.nv + 1, "NU": self.nv - _FREE, "CHAIN": longest,
                "FACTORS": sum(len(chain) - 1 for chain in chains), "BALLS": len(scene.balls),
                "MOVES": sum(6 * (len(chain) - 3) for chain in tips), "CONTACTS": len(scene.contacts),
                "LIMITS": len(scene.limits), "GROUNDS": len(scene.grounds), "ITERATIONS": scene.iterations,
                "WARM": int(scene.warm_start), "ENOUGH": _number(scene.enough), "STEP": _number(scene.timestep),
                "IMPRATIO": _number(max(1e-15, scene.impratio)),
            }.items()),
            _table("int", "chain_size", [len(chain) for chain in chains]),
            _table("int", "chain", [[*chain, *[0] * (longest - len(chain))] for chain in chains]),
            _table("int", "factor_start", np.cumsum([0, *(len(chain) - 1 for chain in chains)])[:-1].tolist()),
            _table("int", "shared", [[_common(a, b) for b in chains] for a in chains]),
            _table("int", "ball_dof", [5 + ball.link for ball in scene.balls]),
            _table("int", "ball_moves", starts.tolist()),
            _table("double", "ball_radius", scene.radii),
            _table("int", "order", orders(len(scene.limits) + len(scene.contacts), scene.iterations)),
            _structs("ground", [_ground(ground) for ground in scene.grounds]),
            _structs("contact", [
                f"{contact.ball}, {contact.ground}, {_braced(contact.friction)}, {_soft(contact.soft)}"
                for contact in scene.contacts
            ]),
            _structs("limit", [
                f"{_FREE + limit.joint}, {_number(limit.lower)}, {_number(limit.upper)}, {_soft(limit.soft)}"
                for limit in scene.limits
            ]),
            "#endif",
        ]  # fmt: skip
        return "\n".join(lines) + "\n"

    def _factors(self, M: cs.SX) -> tuple[list[list[cs.SX]], list[cs.SX]]:
        """Return the strict rows of L, each over its chain, and 1/D, with M = Lᵀ D L."""
        rows = [[M[i, j] for j in chain] for i, chain in enumerate(self.chains)]
        inverse = [cs.SX(0)] * self.nv
        for i in reversed(range(self.nv)):
            row, chain = rows[i], self.chains[i]
            inverse[i] = 1 / row[-1]
            scaled = [entry * inverse[i] for entry in row[:-1]]
            for at, j in enumerate(chain[:-1]):
                rows[j] = [entry - scaled[at] * other for entry, other in zip(rows[j], row, strict=False)]
            rows[i] = scaled
        return rows, inverse

    def _solved(self, rows: Sequence[Sequence[cs.SX]], inverse: Sequence[cs.SX], right: cs.SX) -> cs.SX:
        """Return M⁻¹ times a vector."""
        x = [right[i] for i in range(self.nv)]
        for i in reversed(range(self.nv)):
            for j, entry in zip(self.chains[i], rows[i], strict=False):
                x[j] -= entry * x[i]
        x = [a * b for a, b in zip(x, inverse, strict=True)]
        for i in range(self.nv):
            for j, entry in zip(self.chains[i], rows[i], strict=False):
                x[i] -= entry * x[j]
        return cs.vertcat(*x)

    def _moves(self, motion: Recursion, link: int, centre: cs.SX) -> list[cs.SX]:
        """Return the velocity of a point and of its link's rotation for each chain entry after the third, (6,) each."""
        tree, turned, place = motion.tree, motion.attitude, motion.position
        moves = [cs.vertcat(cs.cross(turned[:, k], centre - place), turned[:, k]) for k in range(3)]
        for i in reversed(tree.path(link)):
            place = place + turned @ tree.offsets[i]
            turned = turned @ motion.turn(i)
            axis = turned @ tree.axes[i]
            moves.append(cs.vertcat(cs.cross(axis, centre - place), axis))
        return moves


def orders(most: int, rounds: int) -> list[list[int]]:
    """Return the orders in which MuJoCo 4.0's PGS updates 1, 2, … ``most`` constraints, one after another, per sweep.

    A sweep shuffles the order of the last one [Fisher and Yates], by PCG32 from a state of one.
    """
    table: list[list[int]] = [[] for _ in range(rounds)]
    for count in range(1, most + 1):
        order, state = list(range(count)), 1
        for row in table:
            for k in range(count, 1, -1):
                mixed, turn = ((state >> 18 ^ state) >> 27) & 0xFFFFFFFF, state >> 59
                drawn = (mixed >> turn | mixed << (-turn & 31)) & 0xFFFFFFFF
                order[k - 1], order[drawn % k] = order[drawn % k], order[k - 1]
                state = (state * 0x5851F42D4C957F2D + 1) % 2**64
            row += order
    return table


def _common(a: Sequence[int], b: Sequence[int]) -> int:
    """Return how many first entries of two chains are equal."""
    return sum(1 for x, y in zip(a, b, strict=False) if x == y)


def _clip(value: cs.SX, low: float, high: float) -> cs.SX:
    value = cs.fmin(value, high) if isfinite(high) else value
    return cs.fmax(value, low) if isfinite(low) else value


# ---- text


def _number(value: float) -> str:
    return float(value).hex()


def _braced(values: Iterable[float]) -> str:
    return "{" + ", ".join(map(_number, values)) + "}"


def _table(kind: str, name: str, values: Sequence[object] | Array) -> str:
    """Return a constant array of one or two axes, with at least one entry, as C requires."""
    rows = np.asarray(values if len(values) else [0])
    shape = "".join(f"[{size}]" for size in rows.shape)
    text = str if kind == "int" else _number
    body = [text(row) if rows.ndim == 1 else "{" + ", ".join(map(text, row)) + "}" for row in rows.tolist()]
    return f"static const {kind} {name}{shape} = {{{', '.join(body)}}};"


def _structs(name: str, rows: Sequence[str]) -> str:
    body = ",\n    ".join(f"{{{row}}}" for row in rows) or "{0}"
    return f"static const struct {name} {name}s[{max(1, len(rows))}] = {{\n    {body}}};"


def _soft(soft: Soft) -> str:
    numbers = [soft.stiffness, soft.damping, *soft.impedance, soft.inverse_mass]
    return _braced(numbers)


def _ground(ground: Ground) -> str:
    half = np.zeros(3) if ground.half is None else ground.half
    axes = "{" + ", ".join(map(_braced, ground.axes)) + "}"
    return f"{int(ground.half is not None)}, {_braced(ground.place)}, {axes}, {_braced(half)}"
