"""How the joints of massless legs move: as they are told to, or so that their feet stand."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as cs

from piaffe.errors import ModelError

from .kinematics import Kinematics
from .leg_expressions import LegExpression, damped_step, leg_expressions

_SMALLEST = 0.003  # distance over which a joint moves a foot, below which it does so less and less; of the leg's reach


@dataclass(frozen=True)
class LegMotion:
    """The motion of one leg below a base that moves.

    A foot that stands is held by J, the derivative of its place in base axes by the angles. J is not inverted but
    damped, J⁺ = Jᵀ (J Jᵀ + λ I)⁻¹: near a straight leg joint speeds stay finite, and the foot gives way.
    A leg of more than three joints also follows its commands as far as the foot stands.

    Args:
        leg: the leg.
        damping: λ [m²].
    """

    leg: LegExpression
    damping: float

    def rates(self, angles: cs.SX, commands: cs.SX, away: cs.SX) -> cs.SX:
        """Return the joint rates with which the foot stands, (k, 1) [rad/s].

        Args:
            angles: of the leg, (k, 1) [rad].
            commands: rates that the leg is told, (k, 1) [rad/s].
            away: velocity of the foot in base axes because it stands and the base moves, (3, 1) [m/s].
        """
        return self._nearest(self.leg.jacobian(angles)[1], commands, away)

    def moved(self, angles: cs.SX, turned: cs.SX, place: cs.SX) -> cs.SX:
        """Return the angles after a step in which the foot stands, (k, 1) [rad]: two steps of Newton's method.

        The base moves by a length of order dt, so the first step leaves an error of order dt², the second of dt⁴.

        Args:
            angles: before the step, (k, 1) [rad].
            turned: change of the angles that the leg is told, (k, 1) [rad].
            place: of the foot in the axes of the moved base, (3, 1) [m].
        """
        foot, jacobian = self.leg.jacobian(angles)
        angles = angles + self._nearest(jacobian, turned, place - foot)
        foot, jacobian = self.leg.jacobian(angles)
        return angles + self._nearest(jacobian, cs.SX(angles.numel(), 1), place - foot)

    def _nearest(self, jacobian: cs.SX, told: cs.SX, wanted: cs.SX) -> cs.SX:
        """Return what is nearest to the told change among those with which the foot moves as wanted, (k, 1)."""
        if len(self.leg.joints) > 3:
            return told + damped_step(jacobian, wanted - jacobian @ told, cs.SX(self.damping))
        return damped_step(jacobian, wanted, cs.SX(self.damping))


def leg_motions(kinematics: Kinematics, where: str) -> tuple[LegMotion, ...]:
    """Return the motions of a robot's legs.

    Raises:
        ModelError: two feet share a joint, so that they are no legs of their own.
    """
    legs, owner = leg_expressions(kinematics), dict[int, str]()
    names, joints = kinematics.robot.foot_names, kinematics.robot.joint_names
    for leg in legs:
        for joint in leg.joints:
            if joint in owner:
                raise ModelError(
                    f"{where}: two feet share joint '{joints[joint]}' - got feet '{owner[joint]}' and "
                    f"'{names[leg.foot]}', expected a leg of its own for each foot; name one contact point per leg, or "
                    "use models.WholeBody"
                )
            owner[joint] = names[leg.foot]
    return tuple(LegMotion(leg, float((_SMALLEST * kinematics.reach[leg.foot]) ** 2)) for leg in legs)
