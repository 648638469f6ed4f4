"""How MuJoCo solves for contacts: stiffness, friction cone, solver and integrator of a simulated robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from piaffe.errors import ModelError

from ..mujoco_import import import_mujoco

Cone = Literal["pyramidal", "elliptic"]
Solver = Literal["newton", "pgs", "cg"]
Integrator = Literal["euler", "implicitfast"]


@dataclass(frozen=True, kw_only=True)
class SoftContact:
    """Options of MuJoCo's contacts; the default is for planners, which simulate thousands of steps per decision.

    Args:
        solref: time constant [s] and damping ratio of a contact; MuJoCo raises the first to two time steps.
        solimp: impedance of a contact: at the surface, deep below it, over which depth [m], midpoint and power.
        stick: how much harder friction is than the normal force (MuJoCo's ``impratio``); soft friction creeps.
        cone: friction cone, its pyramid or the exact one.
        solver: of the contact forces.
        iterations: of the solver at most.
        line_search: iterations of Newton's line search at most.
        integrator: ``"euler"`` applies a PD law's torque exactly as written; ``"implicitfast"`` takes its damping, and
            that of the joints, at the end of the step.
        warm_start: begin from the forces of the step before.
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
                raise ModelError(f"contact: {name} is no count - got {count!r}, expected a whole number ≥ 1; fix it")

    @staticmethod
    def accurate(**changes: Any) -> SoftContact:
        """Return options that solve each step to convergence, for a plant."""
        converged = {"stick": 10.0, "solver": "newton", "iterations": 100, "line_search": 50}
        return SoftContact(**{**converged, "integrator": "implicitfast", **changes})

    def apply_to(self, spec: Any) -> None:
        """Set the options of a ``mujoco.MjSpec``; what no scene of a robot has is switched off."""
        mujoco = import_mujoco()
        option, off = spec.option, mujoco.mjtDisableBit
        option.cone = getattr(mujoco.mjtCone, f"mjCONE_{self.cone.upper()}")
        option.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.solver.upper()}")
        option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        option.impratio = self.stick
        option.iterations, option.ls_iterations = self.iterations, self.line_search
        flags = (
            off.mjDSBL_EQUALITY, off.mjDSBL_FRICTIONLOSS, off.mjDSBL_SPRING, off.mjDSBL_DAMPER, off.mjDSBL_EULERDAMP,
            off.mjDSBL_SENSOR, off.mjDSBL_AUTORESET, off.mjDSBL_ISLAND, off.mjDSBL_FILTERPARENT, off.mjDSBL_MIDPHASE,
            off.mjDSBL_NATIVECCD, off.mjDSBL_MULTICCD,
        )  # fmt: skip
        for flag in flags if self.warm_start else (*flags, off.mjDSBL_WARMSTART):
            option.disableflags |= int(flag)

    def surface(self, friction: float) -> dict[str, Any]:
        """Return what the geoms of the robot say of their contacts."""
        return {
            "priority": 1,
            "condim": 3,
            "friction": (friction, 0.005, 0.0001),
            "solref": self.solref,
            "solimp": self.solimp,
        }


def pair_up(spec: Any) -> None:
    """Declare the contacts of a scene of a robot one by one, between the world's geoms and the robot's.

    MuJoCo then searches for no others, which makes up a thirtieth of a step. The contacts are those that the geoms' own
    bits and options make.
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
