"""A kinematic tree as arrays: placements of the joints and inertial parameters, read from a ``pinocchio.Model``."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from piaffe.errors import ModelError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """A point fixed to a link.

    Args:
        link: index of the link, 0 for the base.
        offset: position in the link's frame, (3,) [m].
    """

    link: int
    offset: Array


@dataclass(frozen=True, eq=False)
class Tree:
    """A tree of links; joint i − 1, revolute or prismatic, connects link i > 0 to its parent.

    Args:
        parents: parent of every link, −1 for the base; a parent comes before its children.
        rotations: orientation of every joint in its parent's frame at angle zero, (nb, 3, 3).
        offsets: position of every joint in its parent's frame, (nb, 3) [m].
        axes: joint axis in the link's own frame, (nb, 3).
        mass: (nb,) [kg].
        com: centre of mass in the link's frame, (nb, 3) [m].
        inertia: about the centre of mass, in the link's axes, as xx, yy, zz, xy, xz, yz, (nb, 6) [kg m²].
        slides: the links whose joint is prismatic.
        fixed: whether the base stands still at the origin of the world; it has no velocities then.
    """

    parents: tuple[int, ...]
    rotations: Array
    offsets: Array
    axes: Array
    mass: Array
    com: Array
    inertia: Array
    slides: tuple[int, ...] = ()
    fixed: bool = False

    @staticmethod
    def from_pinocchio(model: pin.Model, *, fixed: bool = False) -> Tree:
        """Return the tree of a model with a free-flyer root and joints of one degree of freedom.

        Args:
            model: the model.
            fixed: whether its base stands still at the origin.

        Raises:
            ModelError: the first joint is not a free flyer, or another joint is not revolute or prismatic.
        """
        if model.njoints < 2 or model.joints[1].shortname() != "JointModelFreeFlyer":
            raise ModelError(
                f"robot '{model.name}': no floating base - got {model.njoints - 1} joints, expected a free-flyer "
                "first; build the model with pinocchio.JointModelFreeFlyer()"
            )
        axes, slides = np.zeros((model.njoints - 1, 3)), []
        for i in range(2, model.njoints):
            axes[i - 1], translates = _axis(model, i)
            if translates:
                slides.append(i - 1)
        inertias = [model.inertias[i] for i in range(1, model.njoints)]
        tensors = np.array([link.inertia for link in inertias])
        return Tree(
            parents=tuple(int(model.parents[i]) - 1 for i in range(1, model.njoints)),
            rotations=np.array([_clean(model.jointPlacements[i].rotation) for i in range(1, model.njoints)]),
            offsets=np.array([_clean(model.jointPlacements[i].translation) for i in range(1, model.njoints)]),
            axes=axes,
            mass=np.array([link.mass for link in inertias]),
            com=np.array([link.lever for link in inertias]),
            inertia=tensors[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
            slides=tuple(slides),
            fixed=fixed,
        )

    @property
    def num_links(self) -> int:
        """Number of links, the base included."""
        return len(self.parents)

    @property
    def nv(self) -> int:
        """Number of velocities: six of a base that floats, one per joint."""
        return self.num_links - 1 if self.fixed else self.num_links + 5

    @property
    def nq(self) -> int:
        """Number of stored positions: seven of a base that floats, with its quaternion, one per joint."""
        return self.nv if self.fixed else self.nv + 1

    def path(self, link: int) -> list[int]:
        """Return the links from ``link`` to the base, the base excluded."""
        links = []
        while link > 0:
            links.append(link)
            link = self.parents[link]
        return links


@dataclass(frozen=True, eq=False)
class Inertials:
    """Inertial parameters of the links as expressions: mass m, first moment h and second moment Σ about the origin."""

    mass: list[cs.SX]
    first: list[cs.SX]
    second: list[cs.SX]

    @staticmethod
    def of(mass: cs.SX, com: cs.SX, inertia: cs.SX) -> Inertials:
        """Convert masses (nb,), centres of mass (3 nb,) and inertias (6 nb,), stacked as in :class:`Tree`."""
        first, second = [], []
        for i in range(mass.numel()):
            c, (xx, yy, zz, xy, xz, yz) = com[3 * i : 3 * i + 3], cs.vertsplit(inertia[6 * i : 6 * i + 6])
            half = (xx + yy + zz) / 2
            about_com = [[half - xx, -xy, -xz], [-xy, half - yy, -yz], [-xz, -yz, half - zz]]
            first.append(mass[i] * c)
            second.append(stack(about_com) + mass[i] * c @ c.T)
        return Inertials(cs.vertsplit(mass), first, second)


def _axis(model: pin.Model, joint: int) -> tuple[Array, bool]:
    """Return the axis of a joint, (3,), and whether it translates."""
    kind = model.joints[joint]
    if kind.nq != 1 or kind.nv != 1:
        raise ModelError(
            f"robot '{model.name}', joint '{model.names[joint]}': unsupported type {kind.shortname()} - got nq "
            f"{kind.nq}, expected a revolute joint with one angle, or a prismatic one; load the URDF with models.load, "
            "or lock the joint"
        )
    data = kind.createData()
    kind.calc(data, pin.neutral(model))
    subspace = np.asarray(data.S, dtype=float).reshape(6)
    translates = bool(np.any(subspace[:3]))
    if translates and np.any(subspace[3:]):
        raise ModelError(
            f"robot '{model.name}', joint '{model.names[joint]}': unsupported type {kind.shortname()} - got a joint "
            "that turns and slides, expected one of both; use two joints"
        )
    return _clean(subspace[:3] if translates else subspace[3:]), translates


def _clean(numbers: Array) -> Array:
    """Round numbers that are almost 0, 1 or −1, so that expressions do not contain the rounding errors of the URDF."""
    numbers = np.array(numbers, dtype=float)
    for exact in (0.0, 1.0, -1.0):
        numbers[np.abs(numbers - exact) < 1e-14] = exact
    return numbers


def stack(rows: list[list[cs.SX]]) -> cs.SX:
    """Return the matrix of rows of scalars."""
    return cs.vertcat(*(cs.horzcat(*row) for row in rows))
