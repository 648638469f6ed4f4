"""Conversion of a MuJoCo model for the SIMD engine, with errors for what the engine does not support."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import SamplingError
from piaffe.models import Point, Tree, import_mujoco
from piaffe.ocp import rotation

from .simd_scene import Contact, Ground, Limit, Scene, Soft

Array = NDArray[np.float64]

_EPSILON = 1e-15  # MuJoCo's mjMINVAL
_LEAST_FRICTION = 1e-5  # MuJoCo's mjMINMU
_MOST_GROUPS = 300  # contacts and limits; tables and memory grow with their square
_MOST_ORDERS = 2_000_000  # entries of the solver's table of orders
# Arrays that must be zero; older versions of MuJoCo lack some of them.
_NEUTRAL = (
    "body_gravcomp", "actuator_armature", "actuator_damping", "dof_dampingpoly", "jnt_stiffnesspoly", "geom_surfacevel",
    "geom_adhesion", "pair_adhesion", "pair_margin", "pair_gap", "pair_solreffriction", "jnt_actfrclimited",
    "jnt_actgravcomp", "geom_contype", "geom_conaffinity",
)  # fmt: skip


def scene_of(model: Any) -> Scene:
    """Return the scene of a ``mujoco.MjModel``.

    Raises:
        SamplingError: the model has a part that the engine does not support.
    """
    mujoco = import_mujoco()
    _check_options(mujoco, model)
    _check_parts(mujoco, model)
    tree, opt = _tree(model), model.opt
    robot = [i for i in range(model.ngeom) if model.geom_bodyid[i]]
    world = [i for i in range(model.ngeom) if not model.geom_bodyid[i]]
    pairs = [_pair(mujoco, model, i) for i in range(model.npair)]
    used = {
        "ball": [i for i in robot if any(i == ball for _, ball, _ in pairs)],
        "ground": [i for i in world if any(i == ground for ground, _, _ in pairs)],
    }
    contacts = tuple(
        Contact(used["ball"].index(ball), used["ground"].index(ground), _friction(model, i), soft)
        for i, (ground, ball, soft) in enumerate(pairs)
    )
    limited = model.actuator_forcelimited.astype(bool)[:, None]
    return Scene(
        tree=tree,
        armature=model.dof_armature[6:].copy(),
        gravity=opt.gravity.copy(),
        gain=model.actuator_gainprm[:, 0].copy(),
        bias=model.actuator_biasprm[:, :3] * (model.actuator_biastype != int(mujoco.mjtBias.mjBIAS_NONE))[:, None],
        force_range=np.where(limited, model.actuator_forcerange, [-np.inf, np.inf]),
        balls=tuple(Point(int(model.geom_bodyid[i]) - 1, model.geom_pos[i].copy()) for i in used["ball"]),
        radii=model.geom_size[used["ball"], 0],
        grounds=tuple(_ground(mujoco, model, i) for i in used["ground"]),
        contacts=contacts,
        limits=tuple(_limit(model, i) for i in range(1, model.njnt) if model.jnt_limited[i]),
        impratio=float(opt.impratio),
        iterations=int(opt.iterations),
        enough=float(opt.tolerance * model.stat.meaninertia * max(1, model.nv)),
        warm_start=not opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_WARMSTART),
        timestep=float(opt.timestep),
    )


def _refuse(what: str, got: object, expected: str) -> SamplingError:
    return SamplingError(
        f'simd engine: {what} - got {got}, expected {expected}; change the model, or choose engine="native"'
    )


def _check_options(mujoco: Any, model: Any) -> None:
    opt, off = model.opt, mujoco.mjtDisableBit
    for what, got, kinds, wanted in (
        ("solver of contacts", opt.solver, mujoco.mjtSolver, mujoco.mjtSolver.mjSOL_PGS),
        ("friction cone", opt.cone, mujoco.mjtCone, mujoco.mjtCone.mjCONE_ELLIPTIC),
        ("integrator", opt.integrator, mujoco.mjtIntegrator, mujoco.mjtIntegrator.mjINT_EULER),
    ):
        if int(got) != int(wanted):
            raise _refuse(what, kinds(int(got)).name, wanted.name)
    if opt.iterations < 1:
        raise _refuse("iterations of the solver", opt.iterations, "at least 1")
    groups = model.npair + int(np.sum(model.jnt_limited))
    if groups > _MOST_GROUPS or groups**2 * opt.iterations > 2 * _MOST_ORDERS:
        raise _refuse(
            "contacts and limits", f"{groups}, {opt.iterations} iterations", f"at most {_MOST_GROUPS}, or fewer"
        )
    if opt.disableactuator:
        raise _refuse("disabled actuators", "some", "none")
    if opt.noslip_iterations:
        raise _refuse("noslip iterations", opt.noslip_iterations, "none")
    if opt.density or opt.viscosity or np.any(opt.wind) or opt.enableflags:
        raise _refuse("a medium or flags that enable", "some", "none")
    damped = np.any(model.dof_damping) and not opt.disableflags & int(off.mjDSBL_DAMPER)
    sprung = np.any(model.jnt_stiffness) and not opt.disableflags & int(off.mjDSBL_SPRING)
    rubbed = np.any(model.dof_frictionloss) and not opt.disableflags & int(off.mjDSBL_FRICTIONLOSS)
    if damped or sprung or rubbed:
        raise _refuse("springs, damping or friction of joints", "some", "none")
    needed = off.mjDSBL_CONSTRAINT | off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_GRAVITY | off.mjDSBL_REFSAFE
    if opt.disableflags & int(needed | off.mjDSBL_ACTUATION | off.mjDSBL_CLAMPCTRL):
        raise _refuse("flags that disable", opt.disableflags, "constraints, contacts, limits and gravity enabled")


def _check_parts(mujoco: Any, model: Any) -> None:
    kinds = mujoco.mjtJoint
    hinges = model.nbody - 2
    one_each = model.njnt == 1 + hinges and np.array_equal(model.jnt_bodyid, np.arange(1, model.nbody))
    if (
        not one_each
        or model.jnt_type[0] != int(kinds.mjJNT_FREE)
        or np.any(model.jnt_type[1:] != int(kinds.mjJNT_HINGE))
    ):
        raise _refuse("joints", f"{model.njnt} of {model.nbody - 1} bodies", "a free base, then one hinge per body")
    if hinges < 1 or np.any(model.body_parentid[2:] < 1):
        raise _refuse("bodies", "one attached to the world, or the base alone", "hinges on the base's tree")
    if np.any(model.qpos0[7:]) or np.any(model.dof_armature[:6]):
        raise _refuse("angles of reference, or inertia of rotors at the base", "some", "none")
    for name in _NEUTRAL:
        if np.any(getattr(model, name, 0)):
            raise _refuse(name, "numbers", "zeros")
    if np.any(model.jnt_pos):
        raise _refuse("places of joints", "some beside their bodies' origins", "the origins")
    joints = int(mujoco.mjtTrn.mjTRN_JOINT)
    acts = model.nu == hinges and np.array_equal(model.actuator_trnid[:, 0], np.arange(1, 1 + hinges))
    if not acts or np.any(model.actuator_trntype != joints) or np.any(model.actuator_gear[:, 0] != 1):
        raise _refuse("actuators", model.nu, "one per hinge, in their order, without gears")
    plain = np.all(model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_FIXED)) and np.all(
        np.isin(model.actuator_biastype, (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)))
    )
    if (
        not plain
        or np.any(model.actuator_dyntype != int(mujoco.mjtDyn.mjDYN_NONE))
        or np.any(model.actuator_ctrllimited)
    ):
        raise _refuse("actuators", "gains, dynamics or limits of controls", "fixed gains and an affine bias")
    if model.neq or model.ntendon:
        raise _refuse("equalities or tendons", "some", "none")
    if np.any(model.jnt_margin[1:]):
        raise _refuse("margins of limits", "some", "none")


def _tree(model: Any) -> Tree:
    turned = rotation.np_matrix(model.body_iquat[1:])
    inertia = np.einsum("bij,bj,bkj->bik", turned, model.body_inertia[1:], turned)
    return Tree(
        parents=tuple(int(parent) - 1 for parent in model.body_parentid[1:]),
        rotations=rotation.np_matrix(model.body_quat[1:]),
        offsets=model.body_pos[1:].copy(),
        axes=np.vstack([np.zeros(3), model.jnt_axis[1:]]),
        mass=model.body_mass[1:].copy(),
        com=model.body_ipos[1:].copy(),
        inertia=inertia[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]],
    )


def _pair(mujoco: Any, model: Any, i: int) -> tuple[int, int, Soft]:
    """Return ground, ball and softness of a pair."""
    kinds, types = mujoco.mjtGeom, model.geom_type
    ground, ball = sorted(
        map(int, (model.pair_geom1[i], model.pair_geom2[i])), key=lambda k: bool(model.geom_bodyid[k])
    )
    shapes = [kinds(int(types[k])) for k in (ground, ball)]
    known = (kinds.mjGEOM_PLANE, kinds.mjGEOM_BOX)
    of_robot = [bool(model.geom_bodyid[k]) for k in (ground, ball)]
    if of_robot != [False, True] or shapes[0] not in known or shapes[1] != kinds.mjGEOM_SPHERE:
        names = " and ".join(shape.name for shape in shapes)
        raise _refuse("shapes that touch", names, "planes and boxes of the world, and balls of the robot")
    if model.pair_dim[i] != 3:
        raise _refuse("dimension of a contact", int(model.pair_dim[i]), "3")
    moved = float(model.body_invweight0[model.geom_bodyid[ball], 0])
    return ground, ball, _soft(model, model.pair_solref[i], model.pair_solimp[i], moved)


def _friction(model: Any, i: int) -> tuple[float, float]:
    """Return the friction of a pair along its two tangents."""
    one, other = np.maximum(model.pair_friction[i, :2], _LEAST_FRICTION)
    return float(one), float(other)


def _ground(mujoco: Any, model: Any, i: int) -> Ground:
    box = model.geom_type[i] == int(mujoco.mjtGeom.mjGEOM_BOX)
    axes = rotation.np_matrix(model.geom_quat[i])
    return Ground(model.geom_pos[i].copy(), axes, model.geom_size[i].copy() if box else None)


def _limit(model: Any, i: int) -> Limit:
    dof = int(model.jnt_dofadr[i])
    soft = _soft(model, model.jnt_solref[i], model.jnt_solimp[i], float(model.dof_invweight0[dof]))
    lower, upper = model.jnt_range[i]
    return Limit(i - 1, float(lower), float(upper), soft)


def _soft(model: Any, solref: Array, solimp: Array, inverse_mass: float) -> Soft:
    """Return the softness of a constraint, as in MuJoCo's makeImpedance."""
    time, ratio = solref
    if (time > 0) != (ratio > 0):
        raise _refuse("solref", solref.tolist(), "a time constant and a damping ratio, or both negative")
    start, end = np.clip(solimp[:2], 1e-4, 0.9999)
    width, middle, power = (
        max(float(solimp[2]), 0.0),
        float(np.clip(solimp[3], 1e-4, 0.9999)),
        max(1.0, float(solimp[4])),
    )
    if time > 0:
        time = max(time, 2 * model.opt.timestep)
        stiffness = 1 / max(_EPSILON, (end * time * ratio) ** 2)
    else:
        stiffness = -time / max(_EPSILON, end**2)
    damping = 2 / max(_EPSILON, end * time) if ratio > 0 else -ratio / max(_EPSILON, end)
    return Soft(float(stiffness), float(damping), (float(start), float(end), width, middle, power), inverse_mass)
