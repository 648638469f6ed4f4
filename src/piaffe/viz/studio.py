"""Pictures of a robot: MuJoCo's renderer with a moving camera, arrows for forces and a transparent second pose."""

from __future__ import annotations

from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

import numpy as np
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from piaffe.models import Robot

from .playback import Snapshot
from .style import LEGS

Array = NDArray[np.float64]

_GHOST = (0.25, 0.45, 0.85, 0.18)
_LONGEST = 1.5  # longest arrow, relative to that of the robot's weight; arrows of impacts would cover the picture
_OVERSAMPLING = 1.5  # size of the rendered picture relative to the result: smooth edges with any driver


class Studio:
    """Renders snapshots of a robot; use it in a ``with`` block.

    Args:
        robot: the robot.
        size: width and height of the pictures [pixels].
        azimuth: direction of view about the vertical [degree]; 90 looks along +y.
        elevation: elevation of the view [degree], negative from above.
        distance: distance of the camera, relative to the size of the standing robot (diagonal of its bounding box).
        spec: a ``mujoco.MjSpec`` of the robot in another scene; by default on a level floor.
    """

    def __init__(
        self,
        robot: Robot,
        size: tuple[int, int],
        *,
        azimuth: float = 60.0,
        elevation: float = -14.0,
        distance: float = 1.85,
        spec: Any = None,
    ) -> None:
        import mujoco

        from piaffe.models import mujoco_spec, restore_inertias

        self.mujoco, self.robot, self.size = mujoco, robot, size
        spec = mujoco_spec(robot, contacts="none") if spec is None else spec
        self.drawn = tuple(int(_OVERSAMPLING * side) for side in size)
        spec.visual.quality.offsamples, spec.visual.quality.shadowsize = 0, 2048  # fast enough for software rendering
        spec.material("tiles").reflectance = 0.0
        spec.visual.global_.offwidth, spec.visual.global_.offheight = self.drawn
        self.model: Any = spec.compile()
        restore_inertias(self.model, robot)
        self.data, self.shade = mujoco.MjData(self.model), mujoco.MjData(self.model)
        self.camera = mujoco.MjvCamera()
        self.camera.azimuth, self.camera.elevation = azimuth, elevation
        self.length = self._size()
        self.camera.distance = distance * self.length
        self.weight = robot.mass * 9.81

    def __enter__(self) -> Self:
        width, height = self.drawn
        self.renderer = self.mujoco.Renderer(self.model, height, width, max_geom=2000)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.renderer.close()

    @property
    def fixed(self) -> Array | None:
        """The middle of a robot with a fixed base in its pose ``"stand"``, (3,) [m]; None if the base floats."""
        return None if self.robot.base == "free" else np.asarray(np.mean(self._box(), axis=0))

    def _size(self) -> float:
        """Return the diagonal of the bounding box of the standing robot [m]."""
        return float(np.linalg.norm(np.ptp(self._box(), axis=0)))

    def _box(self) -> Array:
        """Return the smallest and the largest corner of the bounding box of the standing robot, (2, 3) [m]."""
        self.data.qpos[-self.robot.num_joints :] = self.robot.pose("stand")
        if self.robot.base == "free":
            self.data.qpos[2] = self.robot.base_height()
        self.mujoco.mj_forward(self.model, self.data)
        corners = []
        for i in np.flatnonzero(self.model.geom_bodyid):
            turn = self.data.geom_xmat[i].reshape(3, 3)
            centre = self.data.geom_xpos[i] + turn @ self.model.geom_aabb[i, :3]
            half = np.abs(turn) @ self.model.geom_aabb[i, 3:]
            corners += [centre - half, centre + half]
        return np.array([np.min(corners, axis=0), np.max(corners, axis=0)])

    def picture(
        self, shown: Snapshot, look_at: Array, marked: Mapping[str, tuple[float, float, float, float]] | None = None
    ) -> NDArray[np.uint8]:
        """Return a picture of a snapshot, (height, width, 3), at the size in which it is drawn.

        Args:
            shown: the snapshot.
            look_at: the point in the middle of the picture, (3,) [m].
            marked: name of a foot → colour of a ball around it.
        """
        self.data.qpos[:] = shown.qpos
        self.mujoco.mj_forward(self.model, self.data)
        self.camera.lookat[:] = look_at
        self.renderer.update_scene(self.data, self.camera)
        if shown.ghost is not None:
            self._add_ghost(shown.ghost)
        for foot, force, leg in zip(self.robot.feet, shown.forces, range(len(shown.forces)), strict=False):
            if np.linalg.norm(force) > 0.01 * self.weight:
                self._add_arrow(self.data.site(foot.name).xpos, force, LEGS[leg % len(LEGS)])
        for name, colour in (marked or {}).items():
            self._add_ball(self.data.site(name).xpos, colour)
        return np.asarray(self.renderer.render())

    def _add_ghost(self, qpos: Array) -> None:
        """Add the robot in another pose, transparent."""
        mujoco, scene = self.mujoco, self.renderer.scene
        self.shade.qpos[:] = qpos
        mujoco.mj_forward(self.model, self.shade)
        first = scene.ngeom
        mujoco.mjv_addGeoms(
            self.model, self.shade, mujoco.MjvOption(), mujoco.MjvPerturb(), mujoco.mjtCatBit.mjCAT_DYNAMIC, scene
        )
        for i in range(first, scene.ngeom):
            scene.geoms[i].rgba[:] = _GHOST
            scene.geoms[i].matid, scene.geoms[i].transparent = -1, 1

    def _add_ball(self, at: Array, colour: tuple[float, float, float, float]) -> None:
        """Add a ball around a point."""
        mujoco, scene = self.mujoco, self.renderer.scene
        radius, rgba = np.full(3, 0.035 * self.length), np.array(colour, dtype=np.float32)
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_SPHERE, radius, np.asarray(at), np.eye(3).ravel(), rgba
        )
        scene.ngeom += 1

    def _add_arrow(self, at: Array, force: Array, colour: str) -> None:
        """Add an arrow for a force; a force equal to the robot's weight has 0.6 of the robot's size."""
        mujoco, scene = self.mujoco, self.renderer.scene
        if scene.ngeom >= scene.maxgeom:
            return
        geom = scene.geoms[scene.ngeom]
        rgba = np.array(to_rgba(colour, 0.9), dtype=np.float32)
        mujoco.mjv_initGeom(geom, mujoco.mjtGeom.mjGEOM_ARROW, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
        tip = at + 0.6 * self.length * force / max(self.weight, float(np.linalg.norm(force)) / _LONGEST)
        mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_ARROW, 0.011 * self.length, np.asarray(at), tip)
        scene.ngeom += 1
