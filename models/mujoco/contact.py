"""MuJoCo's contact options of a simulated robot: stiffness, friction cone, solver and integrator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from piaffe.errors import ModelError

from ..mujoco_import import import_mujoco

Cone = Literal["pyramidal", "elliptic"]
Solver = Literal["newton", "pgs", "cg"]
Integrator = Literal["euler", "implicitfast"]


@dataclass(frozen=True, kw_only=True)
class SoftContact:
    """Options of MuJoCo's contacts. The defaults are for planners, which simulate thousands of steps per plan.

    Args:
        solref: time constant [s] and damping ratio of a contact; MuJoCo uses at least two time steps for the first.
        solimp: impedance of a contact: at the surface, at full depth, this depth [m], midpoint and power.
        stick: ratio of friction impedance to normal impedance (MuJoCo's ``impratio``); feet slide slowly if it is
            small.
        cone: ``"pyramidal"`` or ``"elliptic"`` friction cone.
        solver: solver of the contact forces.
        iterations: largest number of iterations of the solver.
        line_search: largest number of iterations of Newton's line search.
        integrator: ``"euler"`` evaluates the PD law at the beginning of a step; ``"implicitfast"`` evaluates its
            damping, and that of the joints, at the end of the step.
        warm_start: begin with the forces of the previous step.
    """

    solref: tuple[float, float] = (0.02, 1.0)
    solimp: tuple[float, float, float, float, float] = (0.9, 0.95, 0.001, 0.5, 2.0)
    stick: float = 3.0
    cone: Cone = "elliptic"
    solver: Solver = "pgs"
    iterations: int = 4
    line_search: int = 5
    integrator: Integrator = "euler"
    warm_start: bool = True

    def __post_init__(self) -> None:
        for name, value, known in (
            ("cone", self.cone, ("pyramidal", "elliptic")),
            ("solver", self.solver, ("newton", "pgs", "cg")),
            ("integrator", self.integrator, ("euler", "implicitfast")),
        ):
            if value not in known:
                raise ModelError(f"contact: {name} is unknown - got {value!r}, expected one of {known}; choose one")
        for name, count in (("iterations", self.iterations), ("line_search", self.line_search)):
            if not (isinstance(count, int) and count >= 1):
                raise ModelError(
                    f"contact: {name} is out of range - got {count!r}, expected a whole number ≥ 1; change it"
                )

    @staticmethod
    def accurate(**changes: Any) -> SoftContact:
        """Return options that solve the contacts of each step to convergence, for a plant."""
        converged = {"stick": 10.0, "solver": "newton", "iterations": 100, "line_search": 50}
        return SoftContact(**{**converged, "integrator": "implicitfast", **changes})

    def apply_to(self, spec: Any) -> None:
        """Set the options of a ``mujoco.MjSpec``; features that scenes of robots do not use are disabled."""
        mujoco = import_mujoco()
        option, off = spec.option, mujoco.mjtDisableBit
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.solver.upper()}")
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        option.impratio = self.stick
        option.iterations, option.ls_iterations = self.iterations, self.line_search
        flags = [
            off.mjDSBL_EQUALITY, off.mjDSBL_SPRING,
            off.mjDSBL_SENSOR, off.mjDSBL_AUTORESET, off.mjDSBL_ISLAND, off.mjDSBL_FILTERPARENT, off.mjDSBL_MIDPHASE,
            off.mjDSBL_NATIVECCD, off.mjDSBL_MULTICCD,
        ]  # fmt: skip
        if not any(np.any(joint.damping) for joint in spec.joints):
            flags += [off.mjDSBL_DAMPER, off.mjDSBL_EULERDAMP]
        if not any(joint.frictionloss for joint in spec.joints):
            flags.append(off.mjDSBL_FRICTIONLOSS)
        for flag in flags if self.warm_start else (*flags, off.mjDSBL_WARMSTART):
            option.disableflags |= int(flag)

    def surface(self, friction: float) -> dict[str, Any]:
        """Return the contact options of the robot's geoms."""
        return {
            "priority": 1,
            "condim": 3,
            "friction": (friction, 0.005, 0.0001),
            "solref": self.solref,
            "solimp": self.solimp,
        }


def declare_pairs(spec: Any) -> None:
    """Declare the contact pairs of a scene explicitly: each geom of the world with each geom of the robot.

    Then MuJoCo does not search for pairs, which takes a thirtieth of a step. The contacts are the same as those of the
    geoms' own ``contype``, ``conaffinity`` and options.
    """
    grounds = [geom for geom in spec.worldbody.geoms if geom.contype]
    touching = [geom for geom in spec.geoms if geom.conaffinity]
    for geom in touching:
        slide, twist, roll = geom.friction
        for ground in grounds:
            spec.add_pair(
                geomname1=ground.name, geomname2=geom.name, condim=geom.condim, solref=geom.solref, solimp=geom.solimp,
                friction=(slide, slide, twist, roll, roll),
            )  # fmt: skip
    for geom in (*grounds, *touching):
        geom.contype = geom.conaffinity = 0
