"""Silhouettes of MuJoCo geoms: how far they extend in directions of a vertical plane."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ModelError
from piaffe.models import import_mujoco

Array = NDArray[np.float64]


class Silhouette:
    """The moving geoms of a MuJoCo model, projected along a horizontal line onto the vertical plane across it.

    A convex geom is described by its support function: its extent h(d) = max d · p over its points p, exact for balls,
    capsules, boxes, cylinders and ellipsoids; for meshes over their vertices.

    Args:
        model: the ``mujoco.MjModel``. Geoms that are fixed to the world do not count.
        directions: of the vertical plane (m, 2): across the line, and up.
        along: direction of the line in the ground plane [rad]; 0 is the world's x axis.

    Raises:
        ModelError: nothing moves, or a moving geom is of a kind without a support function.
    """

    def __init__(self, model: Any, directions: Array, along: float) -> None:
        mujoco = import_mujoco()
        self._mujoco, self._model, self._data = mujoco, model, mujoco.MjData(model)
        self._geoms = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] != 0]
        kinds = mujoco.mjtGeom
        names = ("SPHERE", "CAPSULE", "BOX", "CYLINDER", "ELLIPSOID", "MESH")
        known = {int(getattr(kinds, f"mjGEOM_{name}")) for name in names}
        strange = [model.geom(g).name or f"number {g}" for g in self._geoms if int(model.geom_type[g]) not in known]
        if strange or not self._geoms:
            raise ModelError(
                f"silhouette: geoms are unusable - got {strange or 'none that moves'}, expected balls, capsules, "
                "boxes, cylinders, ellipsoids or meshes on moving bodies; replace them"
            )
        across = np.array([-np.sin(along), np.cos(along), 0.0])
        self._directions = directions[:, :1] * across + directions[:, 1:] * np.array([0.0, 0.0, 1.0])
        self._vertices = {g: self._mesh(g) for g in self._geoms if int(model.geom_type[g]) == int(kinds.mjGEOM_MESH)}

    def extents(self, qpos: Array) -> Array:
        """Return the extent of each moving geom in each direction, (geoms, m) [m], at a position (nq,)."""
        data = self._data
        data.qpos[:] = qpos
        self._mujoco.mj_kinematics(self._model, data)
        found = np.empty((len(self._geoms), len(self._directions)))
        for i, g in enumerate(self._geoms):
            local = self._directions @ data.geom_xmat[g].reshape(3, 3)
            found[i] = self._directions @ data.geom_xpos[g] + self._own(g, local)
        return found

    def _own(self, g: int, d: Array) -> Array:
        """Return the extents of a geom in its own axes, in directions (m, 3)."""
        kinds, size = self._mujoco.mjtGeom, self._model.geom_size[g]
        across = np.hypot(d[:, 0], d[:, 1])
        match kinds(int(self._model.geom_type[g])):
            case kinds.mjGEOM_SPHERE:
                found = size[0] * np.linalg.norm(d, axis=1)
            case kinds.mjGEOM_CAPSULE:
                found = size[0] * np.linalg.norm(d, axis=1) + size[1] * np.abs(d[:, 2])
            case kinds.mjGEOM_CYLINDER:
                found = size[0] * across + size[1] * np.abs(d[:, 2])
            case kinds.mjGEOM_BOX:
                found = np.abs(d) @ size
            case kinds.mjGEOM_ELLIPSOID:
                found = np.linalg.norm(d * size, axis=1)
            case _:
                found = (d @ self._vertices[g].T).max(axis=1)
        return np.asarray(found)

    def _mesh(self, g: int) -> Array:
        mesh = self._model.geom_dataid[g]
        first, count = self._model.mesh_vertadr[mesh], self._model.mesh_vertnum[mesh]
        return np.asarray(self._model.mesh_vert[first : first + count], dtype=float)
