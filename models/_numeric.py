"""Sizes and numerical evaluation of the whole-body model: NumPy arrays in and out, through cached CasADi functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import casadi as cs
import numpy as np
from numpy.typing import ArrayLike, NDArray

from piaffe.ocp import Node, Quantity

from .bindings import stacked
from .holding import Holding
from .legged import LeggedModel
from .quantities import joints
from .recursions import Recursion
from .stance import Stance
from .tree import Inertials, Point, Tree

Array = NDArray[np.float64]
Contacts = str | Stance

_LARGEST_GAMMA = 200.0  # [1/s]: at smaller steps the error of a step is so small that a larger one is of no use


class NumericWholeBody(LeggedModel):
    """Sizes and numerical evaluation of a :class:`WholeBody`.

    In every method, ``feet`` names the feet on the ground, for example ``"FL HR"``, and ``parameters`` are values of
    slots by name. Velocity v and acceleration a have the layout of the state: world linear, body angular, joints.
    """

    tree: Tree
    contacts: tuple[Point, ...]
    _baumgarte: float | None

    # ---- sizes

    @property
    def nq(self) -> int:
        """Number of stored positions; one more than ``nv``, because of the quaternion, if the base floats."""
        return self.tree.nq

    @property
    def nv(self) -> int:
        """Number of velocities."""
        return self.tree.nv

    def implicit_size(self, key: str) -> int:
        """Return nv + 3 nf: acceleration and contact forces."""
        return self.nv + 3 * self.num_feet

    def reset_size(self, key: str) -> int:
        """Return nv + 3 nf: velocity after an impact, and its impulses."""
        return self.nv + 3 * self.num_feet

    def definite_size(self, key: str) -> int:
        """Return nv, the size of the mass matrix, which is positive definite."""
        return self.nv

    # ---- values

    def acceleration(self, x: ArrayLike, u: ArrayLike, feet: Contacts, **parameters: Any) -> Array:
        """Return dv/dt, (nv,)."""
        return self._solve_contact(x, u, feet, 0.0, parameters)[: self.tree.nv]

    def contact_forces(self, x: ArrayLike, u: ArrayLike, feet: Contacts, **parameters: Any) -> Array:
        """Return the world force of the ground on each foot, (nf, 3) [N]; it is zero for feet in the air."""
        forces = self._solve_contact(x, u, feet, 0.0, parameters)[self.tree.nv :].reshape(-1, 3)
        return forces * self.flags(feet)[:, None]

    def impact(self, x: ArrayLike, feet: Contacts, **parameters: Any) -> Array:
        """Return the state after the inelastic impact of the feet that ``feet`` names, held ones included, (nx,)."""
        state = self.checked("x", x, self.state.nx)
        p = self.numbers(impact=self.flags(feet), **parameters)
        residual, matrix = self._functions["impact"](state, *p.values())
        z = -np.linalg.solve(matrix.full(), residual.full().ravel())
        return np.concatenate([state[: self.tree.nq], z[: self.tree.nv]])

    def step(self, x: ArrayLike, u: ArrayLike, feet: Contacts, dt: float, **parameters: Any) -> Array:
        """Return the state one time step later, (nx,), with a unit quaternion."""
        parameters = {"gamma": self.gamma(dt), **parameters}
        p = self.numbers(contact=self.flags(feet), **parameters)
        state, control = self.checked("x", x, self.state.nx), self.checked("u", u, self.control.nx)
        z = self._solve_contact(state, control, feet, dt, parameters)
        return self.state.np_normalise(self._functions["step"](state, control, z, dt, *p.values()).full().ravel())

    def gamma(self, dt: float) -> float:
        """Return Baumgarte's γ for a time step [s], in 1/s: 2/dt, at most 200, unless the model was given one.

        The limit is that of a robot of usual size; others have it divided by their natural time.
        """
        return min(2 / dt, _LARGEST_GAMMA / self.sizes.time) if self._baumgarte is None else self._baumgarte

    def foot_positions(self, x: ArrayLike) -> Array:
        """Return the world positions of the feet's frames, (nf, 3) [m]."""
        return self._call("feet", x).reshape(-1, 3)

    def contact_jacobian(self, x: ArrayLike) -> Array:
        """Return J, for which J v is the stacked world velocities of the feet, (3 nf, nv)."""
        return self._call("jacobian", x)

    def mass_matrix(self, x: ArrayLike, **parameters: Any) -> Array:
        """Return the joint-space inertia matrix M, rotor inertias included, (nv, nv)."""
        return self._call("mass_matrix", x, **parameters)

    def bias(self, x: ArrayLike, **parameters: Any) -> Array:
        """Return n, the Coriolis, centrifugal and gravity terms as a generalised force, without losses, (nv,)."""
        return self._call("bias", x, **parameters).ravel()

    def control_guess(self, nodes: Sequence[Node], states: Array, p: Mapping[str, Array]) -> dict[Quantity, Array]:
        """Return the torques with which the robot stands still on its feet, within their limits; zero in flight."""
        motors = list(self.robot.motors)
        limit = self.robot.torque_limit[motors]
        torques = self._holding.torques(states[:-1, : self.tree.nq], p["contact"], p)[:, motors]
        return {joints.torque: np.clip(torques, -limit, limit)}

    def joint_torques(self, u: cs.SX) -> cs.SX:
        """Return the torques of all joints, (n, 1), of a control; passive joints have none."""
        if len(self.robot.motors) == self.robot.num_joints:
            return u
        torques = cs.SX(self.robot.num_joints, 1)
        for entry, joint in enumerate(self.robot.motors):
            torques[joint] = u[entry]
        return torques

    @cached_property
    def _holding(self) -> Holding:
        return Holding(self.tree, self.contacts, self.sizes.length)

    def _solve_contact(
        self, x: ArrayLike, u: ArrayLike, feet: Contacts, dt: float, parameters: dict[str, Any]
    ) -> Array:
        """Return z = (a, F) of a time step; with dt = 0 that of the continuous dynamics."""
        state = self.checked("x", x, self.state.nx)
        control = self.checked("u", u, self.control.nx)
        p = self.numbers(contact=self.flags(feet), **parameters)
        residual, matrix = self._functions["contact"](state, control, dt, *p.values())
        z: Array = -np.linalg.solve(matrix.full(), residual.full().ravel())
        return z

    def _call(self, name: str, x: ArrayLike, **parameters: Any) -> Array:
        state = self.checked("x", x, self.state.nx)
        value: Array = self._functions[name](state, *self.numbers(**parameters).values()).full()
        return value

    @cached_property
    def _functions(self) -> dict[str, cs.Function]:
        """Every function above, compiled for CasADi's virtual machine."""
        nq, nv = self.tree.nq, self.tree.nv
        x, u, dt = cs.SX.sym("x", self.state.nx), cs.SX.sym("u", self.control.nx), cs.SX.sym("dt")
        z, zero = cs.SX.sym("z", self.implicit_size("contact")), cs.SX.zeros(self.implicit_size("contact"))
        p = {slot.name: cs.SX.sym(slot.name, slot.size) for slot in self.slots}
        slots, v = list(p.values()), cs.SX.sym("v", nv)
        dynamics = self.dynamics("contact", x, u, z, {**p, "dt": dt})
        reset = self.reset("contact", x, z, p)
        rest, moving = Recursion(self.tree, x[:nq]), Recursion(self.tree, x[:nq], x[nq:])
        body = Inertials.of(p["link_mass"], p["link_com"], p["link_inertia"])
        with_v = Recursion(self.tree, x[:nq], v)
        on_base = cs.SX(0 if self.tree.fixed else 6, 1)
        M = rest.mass_matrix(body) + cs.diag(cs.vertcat(on_base, p["armature"]))
        outputs: dict[str, tuple[list[cs.SX], list[cs.SX]]] = {
            "contact": ([x, u, dt], [cs.substitute(dynamics.implicit, z, zero), cs.jacobian(dynamics.implicit, z)]),
            "impact": ([x], [cs.substitute(reset.implicit, z, zero), cs.jacobian(reset.implicit, z)]),
            "step": ([x, u, z, dt], [dynamics.next_state]),
            "feet": ([x], [stacked([rest.point(point) for point in self.contacts])]),
            "jacobian": ([x], [cs.jacobian(stacked([with_v.velocity(point) for point in self.contacts]), v)]),
            "mass_matrix": ([x], [M]),
            "bias": ([x], [moving.inverse_dynamics(body, p["gravity"])]),
        }
        return {name: cs.Function(name, [*inputs, *slots], values) for name, (inputs, values) in outputs.items()}
