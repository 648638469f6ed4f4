"""Contact sets: which feet are on the ground."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from piaffe.errors import ModelError

from .robot import Robot


@dataclass(frozen=True)
class Stance:
    """A set of feet on the ground, made by :func:`stance`; equal sets compare equal.

    Args:
        feet: names, sorted.
        roles: further feet by their roles, which :meth:`resolve` replaces by names: each entry stands for the feet that
            have all of its roles, ``"front left"``; ``"all"`` stands for every foot.
    """

    feet: tuple[str, ...] = ()
    roles: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join((*self.feet, *(f"<{role}>" for role in self.roles)))

    def resolve(self, robot: Robot) -> Stance:
        """Return the same set by the robot's foot names.

        Raises:
            UnknownNameError: the robot does not have a foot of that name, or there is no such role.
            ModelError: no foot of the robot has the roles.
        """
        names = {robot.foot(name).name for name in self.feet}
        for role in self.roles:
            found = robot.feet if role == "all" else robot.feet_with(role)
            if not found:
                raise ModelError(
                    f"robot '{robot.name}': no foot has the roles '{role}' - got feet "
                    f"{ {foot.name: ' '.join(sorted(foot.roles)) for foot in robot.feet} }; name the feet instead"
                )
            names.update(foot.name for foot in found)
        return Stance(tuple(sorted(names)))


def stance(feet: str | Iterable[str] = "", *, roles: str | Iterable[str] = ()) -> Stance:
    """Return the contact set of these feet: ``stance("FL HR")``, ``stance("")`` for flight.

    Args:
        feet: names separated by spaces, or a collection of names.
        roles: roles in place of names: ``"front"`` or ``"front left"`` (feet that have both), or several of these,
            ``("front left", "hind right")``, for the feet of all of them; ``"all"`` for every foot.
    """
    names = feet.split() if isinstance(feet, str) else feet
    entries = [entry for entry in ([roles] if isinstance(roles, str) else roles) if entry.split()]
    return Stance(tuple(sorted(set(names))), tuple(sorted({" ".join(sorted(entry.split())) for entry in entries})))
