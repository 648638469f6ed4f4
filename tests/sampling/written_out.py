"""A problem with terms of every kind, and what states and controls cost and violate, written out once more in NumPy."""

from functools import lru_cache

import numpy as np

from piaffe import models, ocp
from piaffe.models import base, joints, stance

DT, STEPS = 0.02, 4
ARRIVAL, END = 0.12, 0.2  # [s]
GOAL = np.array([0.06, -0.03, 0.25])  # [m]
PLACE, SPEED, TURN, TORQUE, LAST = np.array([30.0, 20.0, 90.0]), 0.02, 4.0, 0.05, np.array([50.0, 0.0, 80.0])
KP, KD = 4.0, 0.2  # of Solo12's default action: 2.7 Nm over 0.675 rad, and 0.05 s times that


@lru_cache
def problem():
    """Return a walk of the base to a place in 0.12 s and a rest there until 0.2 s, with terms of every kind."""
    plant = models.Mujoco(models.load("solo12"), contact=models.SoftContact(solver="newton", cone="pyramidal"))
    on_all = stance("FL FR HL HR")
    motion = ocp.Motion(
        ocp.Phase("go", on_all, ARRIVAL, ocp.Keyframe(position=GOAL)), ocp.Phase("stay", on_all, END - ARRIVAL)
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=PLACE),
        ocp.track(joints.velocity, weight=SPEED),
        ocp.regularize(joints.torque, weight=TORQUE),
        ocp.track(base.orientation, weight=ocp.by_phase(0.0, stay=TURN)),
        ocp.track(base.position, weight=LAST, at="end"),
    )
    limits = ocp.Constraints(
        models.joint_range("HAA", 0.05, scale=0.05),
        models.base_height(maximum=0.22, scale=0.1),
        ocp.inequality(_knee, upper=1.0, unit="rad/s", name="knee", when="stay"),
    )
    return ocp.Problem(motion, plant.over(STEPS * DT, dt=DT), objective, limits, initial=plant.state(joints="stand"))


def _knee(s):
    return s.joints.velocity["FL_KFE"]


def target(t):
    """Return where the base is to be at times (...,), (..., 3) [m]: on a straight line from its start, then at rest."""
    start = problem().initial[:3]
    return start + np.minimum(np.asarray(t) / ARRIVAL, 1.0)[..., None] * (GOAL - start)


def nodes(t):
    """Return the times of nodes 0 … H of a plan from t on, (H + 1,) [s]; beyond the motion's end it rests."""
    return np.minimum(t + DT * np.arange(STEPS + 1), END)


def stays(t):
    """Return which nodes are in the second phase, (H + 1,); a boundary belongs to the later one."""
    return nodes(t) > ARRIVAL - 1e-6


def running_cost(states, controls, t):
    """Return ½ Σ w r² of the running terms at nodes 0 … H, (n, H + 1)."""
    place = states[..., :3] - target(nodes(t))
    torque = KP * (controls - states[..., 7:19]) - KD * states[..., 25:]
    angle = 2 * np.arctan2(np.linalg.norm(states[..., 4:7], axis=-1), np.abs(states[..., 3]))  # from upright [rad]
    rates = (PLACE @ np.moveaxis(place**2, -1, -2), SPEED * np.sum(states[..., 25:] ** 2, axis=-1),
             TORQUE * np.sum(torque**2, axis=-1), TURN * stays(t) * angle**2)  # fmt: skip
    return 0.5 * sum(rates)


def last_cost(states, t):
    """Return ½ Σ w r² of the term at the end, at node H + 1, (n,)."""
    return 0.5 * (states[:, :3] - target(min(t + (STEPS + 1) * DT, END))) ** 2 @ LAST


def violations(states, t):
    """Return the violations of all rows over their scales, (10, n, H + 1)."""
    sideways = np.moveaxis(states[..., 7:19:3], -1, 0)
    height, knee = states[..., 2], states[..., 27]  # the ground is at height 0
    rows = [-0.05 - sideways, sideways - 0.05, (height - 0.22)[None], ((knee - 1.0) * stays(t))[None]]
    return np.maximum(np.concatenate(rows), 0.0) / np.repeat([0.05, 0.05, 0.1, 1.0], [4, 4, 1, 1])[:, None, None]
