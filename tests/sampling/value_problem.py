"""A trot of Solo12 to sample, for tests of value functions."""

from typing import Any

from piaffe import models, ocp
from piaffe.models import base, feet, gaits, joints


def speed_excess(s: Any, limit: Any) -> Any:
    return limit - s.joints.velocity**2


def trot_problem(
    *,
    speed: float = 0.3,
    weight: float = 1.0,
    place: Any = None,
    limit: float = 0.2,
    fastest: float = 20.0,
    plant: models.Mujoco | None = None,
    horizon: int = 8,
    **model: Any,
) -> ocp.Problem:
    plant = plant or models.Mujoco(models.load("solo12"), armature=0.01, **model)
    objective = ocp.Objective(
        ocp.track(base.orientation, 0.5),
        ocp.track(base.linear_velocity, weight),
        ocp.track(feet.height, 40.0),
        ocp.regularize(joints.velocity, 1e-4),
    )
    if place is not None:
        objective += ocp.track(base.position, place)
    fast = ocp.inequality(speed_excess, name="joint speed", unit="rad^2/s^2", parameters={"limit": fastest**2})
    return ocp.Problem(
        gaits.trot(speed=speed, ramp=1.0),
        plant.over(horizon * 0.02, dt=0.02),
        objective,
        ocp.Constraints(models.joint_range("HAA", limit), fast),
        initial=plant.state(),
    )
