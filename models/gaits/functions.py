"""The functions of a gait: its reference at any time after now, and its memory as time goes on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as cs
import numpy as np
from numpy.typing import NDArray

from piaffe.ocp import (
    SAME_TIME,
    Manifold,
    Quantity,
    ReferenceFunctions,
    require_entries,
    rotation,
    split_entries,
)

from ..kinematics import Kinematics
from ..leg_expressions import foot_expressions, leg_expressions
from ..quantities import base, feet, joints
from .footsteps import ContactSchedule
from .memory import GaitMemory, memory_size
from .path_expression import PathExpression, turned, within_half_turn
from .phase_row import FootRow, phase_row, row_size, rows_of
from .slope_expression import GroundPoint, SlopeExpression, slope_expression
from .step_expressions import StepExpressions, Swing
from .terrain_step_expressions import TerrainStepExpressions

Array = NDArray[np.float64]

COMMANDS = ("speed", "lateral_speed", "yaw_rate", "height")
_STEPS = 8  # of the inverse kinematics; from the standing pose to a reachable foot, five or six are exact to rounding
_CSE = {"cse": True}


@dataclass(frozen=True, eq=False)
class GaitFunctions:
    """Numbers of a gait, and its functions.

    Args:
        state: state space of the first model.
        kinematics: of the robot.
        schedule: contacts over time.
        steps: footholds and swings.
        command: declared values of ``COMMANDS``.
        ramp: length of a ramp [s].
        heading_limit: largest angle between the kept heading and the measured one [rad].
        lag_gain: velocity that makes up for a lag, per length of the lag [1/s].
        lag_limit: largest lag, forward and left [m].
        terrain: height of level ground [m]; 0 on a terrain.
        weight: sum of the vertical contact forces while there are any [N].

    On a terrain, which the footholds know, the functions read where the plan's frame is in the world; posture is then
    relative to the plane that fits the ground below the feet.
    """

    state: Manifold
    kinematics: Kinematics
    schedule: ContactSchedule
    steps: StepExpressions
    command: Array
    ramp: float
    heading_limit: float
    lag_gain: float
    lag_limit: float
    terrain: float
    weight: float

    def compile(self) -> ReferenceFunctions:
        """Return the functions."""
        nf = len(self.kinematics.robot.feet)
        m, row = cs.SX.sym("m", memory_size(nf)), cs.SX.sym("row", row_size(nf))
        c, motion, start = cs.SX.sym("c", len(COMMANDS)), cs.SX.sym("motion", 3), cs.SX.sym("start", 13 + 3 * nf)
        x, (tau, dt, phi) = cs.SX.sym("x", self.state.nx), (cs.SX.sym(name) for name in ("tau", "dt", "phi"))
        memory, feet_rows = GaitMemory.of(m), rows_of(row)
        aimed = memory.corrected(self.lag_gain)
        sample = self._sample(tau, aimed, phi, feet_rows)
        state = tuple((block.quantity, block.nx) for block in self.state.blocks)
        anchors, named = ([], []) if self.grounded is None else ([self.grounded.placed.anchor], ["anchor"])

        def function(name: str, inputs: list[cs.SX], names: list[str], output: cs.SX, out: str) -> cs.Function:
            return cs.Function(name, inputs, [cs.densify(output)], names, [out], _CSE)

        advanced = self._advanced(memory, dt, split_entries(x, state), c, phi, feet_rows)
        return ReferenceFunctions(
            quantities=tuple((quantity, value.numel()) for quantity, value in sample.items()),
            commands=COMMANDS,
            command=self.command,
            schedule=self._row,
            pick=self._pick,
            start=function("start", [x], ["x"], self._start(split_entries(x, state)), "start"),
            begin=function(
                "begin", [start, c, *anchors], ["start", "c", *named], self._begun(start, c).stacked(), "m"
            ),
            advance=function(
                "advance", [m, dt, x, c, phi, row, *anchors], ["m", "dt", "x", "c", "phi", "row", *named],
                advanced.stacked(), "m_next",
            ),
            move=function("move", [m, motion], ["m", "motion"], _moved(memory, motion).stacked(), "moved"),
            sample=function(
                "sample", [tau, m, phi, row, *anchors], ["tau", "m", "phi", "row", *named],
                cs.vertcat(*sample.values()), "s",
            ),
            pose=function(
                "pose", [tau, m], ["tau", "m"], cs.vertcat(aimed.path.position(tau), aimed.path.yaw(tau)), "pose"
            ),
        )  # fmt: skip

    @property
    def grounded(self) -> TerrainStepExpressions | None:
        """Footholds and swings on a terrain; None on level ground."""
        return self.steps if isinstance(self.steps, TerrainStepExpressions) else None

    def _row(self, index: int) -> Array:
        flags = self.schedule.flags(index)
        return phase_row(self.schedule, index, flags * self.weight / max(flags.sum(), 1.0))

    # ---- the start

    def _pick(self, entries: tuple[tuple[Quantity, int], ...]) -> cs.Function:
        require_entries("gait", entries, (base.position, base.orientation))
        s = cs.SX.sym("s", sum(size for _, size in entries))
        return cs.Function("pick", [s], [cs.densify(self._start(split_entries(s, entries)))], ["s"], ["start"], _CSE)

    def _start(self, values: dict[Quantity, cs.SX]) -> cs.SX:
        position, orientation = values[base.position], values[base.orientation]
        velocities = (values.get(rate, cs.SX.zeros(3)) for rate in (base.linear_velocity, base.angular_velocity))
        standing = cs.SX(self.kinematics.robot.pose("stand"))
        places = values.get(feet.position)
        if places is None:
            places = cs.vertcat(*self._world_feet(position, orientation, values.get(joints.position, standing)))
        return cs.vertcat(position, orientation, *velocities, places)

    def _begun(self, start: cs.SX, c: cs.SX) -> GaitMemory:
        """Return the memory at the gait's start, as ``BoundGait`` begins."""
        rpy, ramp = rotation.to_rpy(start[3:7]), cs.SX(self.ramp)
        first = cs.vertcat(turned(-rpy[2], start[7:9]), start[12])
        path = PathExpression(cs.vertcat(start[:2], rpy[2]), first, c[:3], ramp)
        places = []
        for foot in range(len(self.kinematics.robot.feet)):
            place = start[13 + 3 * foot : 16 + 3 * foot]
            flies = self.schedule.stances(foot, 0.0)[0, 1] <= SAME_TIME
            places.append(place if flies else self.steps.standing(place[:2]))
        posture = cs.vertcat(start[2], rpy[:2])
        if self.grounded is not None:
            still = cs.SX.zeros(2)
            points = [GroundPoint(p[:2], self.grounded.placed.height(p), still, cs.SX(0)) for p in places]
            posture = posture - slope_expression(points, path, cs.SX(0)).posture
        return GaitMemory(path, c[3], posture, cs.SX.zeros(3), ramp, cs.SX.zeros(2), cs.SX.zeros(2), places)

    # ---- as time goes on

    def _advanced(
        self, memory: GaitMemory, dt: cs.SX, x: dict[Quantity, cs.SX], c: cs.SX, phi: cs.SX, rows: list[FootRow]
    ) -> GaitMemory:
        """Return the memory at a later time, anchored at a measured state, as ``BoundGait.anchored``.

        The position is the measured one. The heading is that of the path, an integral of the command, within the limit
        about the measured one. What the base is behind the integral of the command goes into the lag.
        """
        later, position = memory.path.later(dt), x[base.position]
        heading = rotation.to_rpy(x[base.orientation])[2]
        ahead = within_half_turn(later.pose[2] - heading)
        kept = cs.fmin(cs.fmax(ahead, -self.heading_limit), self.heading_limit)
        pose = cs.vertcat(position[:2], within_half_turn(heading + kept))
        changes = cs.sumsqr(c - cs.vertcat(later.last, memory.height)) > 0
        ramp = cs.if_else(changes, self.ramp, later.ramp)
        path = PathExpression(pose, later.first, c[:3], ramp)
        posture, rates = memory.ease(self.terrain).at(dt)
        lag = cs.SX.zeros(2)
        if self.lag_gain:
            behind = memory.lag + turned(-pose[2], later.pose[:2] - position[:2])
            lag = cs.fmin(cs.fmax(behind, -self.lag_limit), self.lag_limit)
        measured = None
        if joints.position in x:
            measured = self._world_feet(position, x[base.orientation], x[joints.position])
        aimed = memory.corrected(self.lag_gain)
        places = [
            self._place(foot, aimed, dt, phi, row, None if measured is None else measured[foot][:2])
            for foot, row in enumerate(rows)
        ]
        upright = cs.fmax(memory.upright - dt, 0)
        advanced = GaitMemory(path, c[3], posture, rates, upright, cs.SX.zeros(2), lag, places)
        velocity = x.get(base.linear_velocity, cs.SX.zeros(3))[:2]
        return replace(advanced, error=velocity - advanced.corrected(self.lag_gain).path.velocity(cs.SX(0)))

    def _place(
        self, foot: int, memory: GaitMemory, dt: cs.SX, phi: cs.SX, row: FootRow, measured: cs.SX | None
    ) -> cs.SX:
        """Return where a foot stands, or has last stood, at a time dt after now; phi and row are those of this time."""
        # at a phase's end, a foot that lands there stands
        lands = cs.logic_and(row.lands > 0.5, phi + row.next_touchdown <= SAME_TIME)
        before, touchdown = (
            cs.if_else(lands, row.touchdown, row.before),
            cs.if_else(lands, row.next_touchdown, row.touchdown),
        )
        length = cs.if_else(lands, row.next_length, row.length)
        since = phi + dt  # start of the phase after the old now
        is_old = since + touchdown <= SAME_TIME
        ahead = self.steps.foothold(foot, memory, since + touchdown, length, since + before <= SAME_TIME)
        place = cs.if_else(is_old, memory.places[foot], ahead)
        if measured is None:
            return place
        stands = cs.logic_or(lands, phi + row.liftoff >= -SAME_TIME)
        if self.grounded is not None:
            return cs.if_else(stands, self.grounded.standing(measured), place)
        return cs.vertcat(cs.if_else(stands, measured, place[:2]), place[2])

    # ---- the targets

    def _sample(self, tau: cs.SX, memory: GaitMemory, phi: cs.SX, rows: list[FootRow]) -> dict[Quantity, cs.SX]:
        path, (posture, rates) = memory.path, memory.ease(self.terrain).at(tau)
        swings = [self.steps.swing(foot, memory, row, phi, tau) for foot, row in enumerate(rows)]
        slope = self._slope(swings, path, tau)
        if slope is not None:
            posture, rates = posture + slope.posture, rates + slope.rates
        yaw, position = path.yaw(tau), cs.vertcat(path.position(tau), posture[0])
        rpy = cs.vertcat(posture[1:], yaw)
        orientation = rotation.from_rpy(rpy)
        velocity = cs.vertcat(path.velocity(tau), rates[0])
        omega = rotation.body_rate(rpy, cs.vertcat(rates[1:], path.command(tau)[2]))
        inward = rotation.matrix(orientation).T
        angles = [cs.SX(angle) for angle in self.kinematics.robot.pose("stand")]
        speeds = [cs.SX(0)] * len(angles)
        arms = [inward @ (swing.place - position) for swing in swings]
        legs = leg_expressions(self.kinematics)
        for leg in legs:
            found = leg.inverse(arms[leg.foot], cs.vertcat(*(angles[j] for j in leg.joints)), _STEPS)
            for j, angle in zip(leg.joints, cs.vertsplit(found), strict=True):
                angles[j] = angle
        for leg in legs:
            relative = inward @ (swings[leg.foot].rate - velocity) - cs.cross(omega, arms[leg.foot])
            found = leg.rates(cs.vertcat(*(angles[j] for j in leg.joints)), relative)
            for j, speed in zip(leg.joints, cs.vertsplit(found), strict=True):
                speeds[j] = speed
        targets = {
            base.position: position,
            base.orientation: orientation,
            base.linear_velocity: velocity,
            base.angular_velocity: omega,
            base.height: position[2] - self.terrain,
            base.ground_normal: inward[:, 2],
            joints.position: cs.vertcat(*angles),
            joints.velocity: cs.vertcat(*speeds),
            feet.position: cs.vertcat(*(swing.place for swing in swings)),
            feet.velocity: cs.vertcat(*(swing.rate for swing in swings)),
            feet.reach: cs.vertcat(*(turned(-yaw, (swing.place - position)[:2]) for swing in swings)),
            feet.height: cs.vertcat(*(swing.place[2] - self.steps.ground for swing in swings)),
            feet.force: cs.vertcat(*(cs.vertcat(0, 0, row.force) for row in rows)),
        }
        if slope is None or self.grounded is None:
            return targets
        own = {base.height: position[2] - slope.mean, base.ground_normal: inward @ slope.normal}
        return {**targets, **own, **self.grounded.planes(swings)}

    def _slope(self, swings: list[Swing], path: PathExpression, tau: cs.SX) -> SlopeExpression | None:
        """Return the plane that fits the ground of the feet; None on level ground."""
        if self.grounded is None:
            return None
        points = []
        for swing in swings:
            first, last = (self.grounded.placed.height(place) for place in (swing.first, swing.last))
            height = first + swing.share * (last - first)
            points.append(GroundPoint(swing.place[:2], height, swing.rate[:2], swing.share_rate * (last - first)))
        return slope_expression(points, path, tau)

    def _world_feet(self, position: cs.SX, orientation: cs.SX, angles: cs.SX) -> list[cs.SX]:
        to_world = rotation.matrix(orientation)
        return [position + to_world @ place for place in foot_expressions(self.kinematics, angles)]


def _moved(memory: GaitMemory, motion: cs.SX) -> GaitMemory:
    """Return the memory moved by a planar motion (x, y, yaw)."""
    path, shift, yaw = memory.path, motion[:2], motion[2]
    pose = cs.vertcat(shift + turned(yaw, path.pose[:2]), within_half_turn(path.pose[2] + yaw))
    places = [cs.vertcat(shift + turned(yaw, place[:2]), place[2]) for place in memory.places]
    moved = PathExpression(pose, path.first, path.last, path.ramp)
    error = turned(yaw, memory.error)
    return GaitMemory(moved, memory.height, memory.posture, memory.rates, memory.upright, error, memory.lag, places)
