"""The problem of ``vs_crocoddyl.py`` as a file of numbers, which ``standing.cpp`` reads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import crocoddyl
import numpy as np
import pinocchio
from numpy.typing import NDArray

Array = NDArray[np.float64]


def write_problem(
    path: Path,
    model: pinocchio.Model,
    problem: crocoddyl.ShootingProblem,
    settings: Sequence[float],
    x: Sequence[Array],
    u: Sequence[Array],
) -> None:
    """Write a model, a shooting problem of it, and an iterate.

    Args:
        path: the file.
        model: of the robot; its joints turn about an axis of their own frame, but for the free base.
        problem: each node has one residual of the state and the contacts of the others.
        settings: dt [s], Baumgarte's γ [1/s], weights of positions, of velocities and of torques.
        x: states of the iterate in Crocoddyl's layout, (nodes + 1, nx).
        u: controls of the iterate, (nodes, nu).
    """
    first = problem.runningModels[0].differential
    frames = [contact.contact.id for contact in first.contacts.contacts.todict().values()]
    targets = [node.differential.costs.costs["state"].cost.residual.reference for node in problem.runningModels]
    lines = [str(model.njoints - 1)]
    for i in range(1, model.njoints):
        joint, inertia = model.joints[i], model.inertias[i]
        lines += [f"{model.names[i]} {joint.shortname()} {model.parents[i]}", _placement(model.jointPlacements[i])]
        lines.append(_numbers([inertia.mass, *inertia.lever, *inertia.inertia.ravel()]))
    lines.append(str(len(frames)))
    for frame in (model.frames[number] for number in frames):
        lines += [f"{frame.name} {frame.parentJoint}", _placement(frame.placement)]
    lines += [str(len(frames)), *(model.frames[number].name for number in frames)]
    lines += [f"{len(targets)} {len(x[0])} {len(u[0])}", _numbers(settings)]
    lines += [_numbers(row) for row in (problem.x0, *targets, *x, *u)]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _placement(placement: pinocchio.SE3) -> str:
    return _numbers([*placement.rotation.ravel(), *placement.translation])


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
