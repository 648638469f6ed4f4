"""Roll-outs with SIMD are MuJoCo's, whatever the robot, the ground, and how samples are shared out."""

import copy
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from piaffe import models
from piaffe.codegen.compilers import NoCompilerError
from piaffe.errors import SamplingError
from piaffe.models import SoftContact
from piaffe.sampling.engines import engine_for, simd, simd_text
from piaffe.sampling.engines.engine import MAX_SPEED
from piaffe.sampling.engines.native import NativeEngine
from piaffe.sampling.engines.simd import DifferentError, SimdEngine
from tests.robots import ROBOTS

N, STEPS = 37, 8  # no multiple of what an instruction takes

TERRAINS = {
    "flat": models.terrain.flat(),
    "high": models.terrain.flat(level=0.1),
    "incline": models.terrain.incline(0.18),
    "stairs": models.terrain.stairs(rise=0.04, run=0.25, steps=3),
    "boxes": models.terrain.boxes(models.terrain.Box((0.2, 0.1), (0.3, 0.4), 0.03, yaw=0.4)),
}
HINDERED = {  # what takes the solver through its branches
    "no warm start": {"contact": SoftContact(warm_start=False)},
    "one iteration": {"contact": SoftContact(iterations=1)},
    "slippery": {"friction": 0.05},
    "stiff and damped": {"contact": SoftContact(solref=(-3000.0, -80.0), stick=1.0)},
    "another impedance": {"contact": SoftContact(solimp=(0.5, 0.99, 0.01, 0.3, 3.0))},
    "constant impedance": {"contact": SoftContact(solimp=(0.9, 0.9, 0.001, 0.5, 1.0))},
    "substeps": {"timestep": 0.005, "substeps": 4},
    "torques": {"action": models.torques(2.0)},
    "payload": {"payload": models.payload(1.0, offset=(0.1, 0.0, 0.05))},
}


def simulated(robot="solo12", **changes):
    return models.Mujoco(models.load(robot), **changes)


def start(model, random, n=N):
    """States about the stand, (n, nx): feet up to 1 cm in the ground or above it, some joints beyond their limits."""
    x = np.tile(model.state(joints="stand"), (n, 1))
    x[:, 0] += random.uniform(-0.2, 1.0, n)
    x[:, 4:7] += 0.05 * random.standard_normal((n, 3))
    nq = model.tree.nv + 1
    x[:, 7:nq] += 0.15 * random.standard_normal((n, nq - 7))
    compiled = model.compiled()
    low, high = compiled.jnt_range[1:].T
    beyond = (random.uniform(size=(n, nq - 7)) < 0.05) & (compiled.jnt_limited[1:] > 0)
    x[:, 7:nq] = np.where(beyond, np.where(random.uniform(size=(n, nq - 7)) < 0.5, low - 0.01, high + 0.01), x[:, 7:nq])
    x[:, nq:] = 0.5 * random.standard_normal((n, nq - 1))
    x[:, 2] += (
        0.01 - (model.height_above_terrain(x) - model.height_above_terrain(x[:1])) - 0.02 * random.uniform(size=n)
    )
    return x


def controls(model, random, n=N, steps=STEPS):
    spread = random.uniform(-1, 1, (n, 1, model.robot.num_joints)) + 0.3 * random.standard_normal(
        (n, steps, model.robot.num_joints)
    )
    return model.action.centre + model.action.half_range * np.clip(spread, -1, 1)


def assert_mujoco(model, x, u, **options):
    with NativeEngine(model, threads=0, **options) as native, SimdEngine(model, threads=2, **options) as engine:
        want, got = native.rollout(x, u), engine.rollout(x, u)
        assert want.failed.tolist() == got.failed.tolist()
        error = np.abs(got.states - want.states) / np.maximum(1.0, np.abs(want.states))
        assert np.max(error) < 1e-9
        return want


@pytest.mark.parametrize("terrain", TERRAINS)
def test_states_are_mujocos_on_every_ground_of_planes_and_boxes(terrain):
    random = np.random.default_rng(1)
    model = simulated(terrain=TERRAINS[terrain])
    rolled = assert_mujoco(model, start(model, random), controls(model, random))
    assert np.abs(np.diff(rolled.states[:, :, 25:], axis=1)).max() > 1.0  # something happened


@pytest.mark.parametrize("robot", ROBOTS)
def test_states_are_mujocos_for_every_quadruped(robot):
    random = np.random.default_rng(2)
    model = simulated(robot)
    assert_mujoco(model, start(model, random), controls(model, random))


@pytest.mark.parametrize("hindrance", HINDERED)
def test_states_are_mujocos_whatever_the_contact(hindrance):
    random = np.random.default_rng(3)
    model = simulated(**HINDERED[hindrance])
    assert_mujoco(model, start(model, random), controls(model, random))


def test_at_convergence_a_few_samples_end_a_sweep_apart():
    # rounding decides whether the last sweep still improved enough, which is worth the solver's own tolerance
    random, model = np.random.default_rng(3), simulated(contact=SoftContact(iterations=50))
    x, u = start(model, random, 200), controls(model, random, 200)
    with NativeEngine(model, threads=0) as native, SimdEngine(model) as engine:
        apart = np.abs(engine.rollout(x, u).states - native.rollout(x, u).states).max(axis=(1, 2))
    assert np.mean(apart < 1e-9) > 0.9
    assert np.max(apart) < 1e-3


def odd_robot():
    """A branching leg, balls on base, knee and feet, tilted boxes, two frictions per contact, no two alike."""
    balls, grounds = ("belly", "knee", "toe", "heel"), ("floor", "box0", "box1")
    pairs = [
        f'<pair geom1="{ground}" geom2="{ball}" condim="3" friction="{0.5 + 0.1 * i} {0.9 - 0.1 * i} 1 1 1" '
        f'solref="{0.02 + 0.002 * i} 1.{i}" solimp=".9 .95 .01 .5 {1 + i % 3}"/>'
        for i, ball in enumerate(balls)
        for ground in grounds
    ]

    def ball(name, radius, place):
        return f'<geom name="{name}" type="sphere" size="{radius}" pos="{place}" mass="0" contype="0" conaffinity="0"/>'

    def link(name, place, axis, *inside):
        return (
            f'<body name="{name}" pos="{place}" euler="10 20 30"><joint name="{name}" type="hinge" axis="{axis}" '
            'armature=".01" limited="true" range="-1 1"/><inertial pos=".01 .02 -.05" mass=".3" '
            f'fullinertia=".002 .0015 .001 .0002 .0001 -.0001"/>{"".join(inside)}</body>'
        )

    boxes = "".join(
        f'<geom name="box{i}" type="box" size=".3 .2 .03" pos="{0.2 * i} .05 .01" euler="{90 * i} 3 20" contype="0" '
        'conaffinity="0"/>'
        for i in range(2)
    )
    branches = (
        link("c", "0 0 -.15", "0 1 0", ball("toe", 0.02, ".03 0 -.15")),
        link("d", "0 .05 -.15", "0 1 .3", ball("heel", 0.025, "0 0 -.15")),
    )
    leg = link("a", ".2 .1 0", "1 0 .2", link("b", "0 0 -.1", "0 1 .1", ball("knee", 0.03, "0 0 -.1"), *branches))
    motors = "".join(f'<motor joint="{joint}"/>' for joint in "abcd")
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><option timestep="0.004" cone="elliptic" solver="PGS" iterations="4" impratio="2"
        gravity=".3 -.2 -9.5"/><compiler autolimits="false" inertiafromgeom="false"/><worldbody>
        <geom name="floor" type="plane" size="1 1 .1" contype="0" conaffinity="0"/>{boxes}
        <body name="base" pos="0 0 .4"><freejoint/><inertial pos=".02 .01 .03" mass="3"
        fullinertia=".05 .06 .07 .005 -.004 .003"/>{ball("belly", 0.08, "0 0 -.15")}{leg}</body></worldbody>
        <contact>{"".join(pairs)}</contact><actuator>{motors}</actuator></mujoco>"""
    )
    return SimpleNamespace(compiled=lambda: model, substeps=2)


def test_states_are_mujocos_for_a_robot_that_branches():
    model, random, n = odd_robot(), np.random.default_rng(9), 200
    x = np.zeros((n, 21))
    x[:, :3] = random.uniform((-0.3, -0.2, 0.1), (0.5, 0.2, 0.35), (n, 3))
    x[:, 3:7] = [1.0, 0.0, 0.0, 0.0] + 0.4 * random.standard_normal((n, 4))
    x[:, 3:7] /= np.linalg.norm(x[:, 3:7], axis=1)[:, None]
    x[:, 7:11], x[:, 11:] = random.uniform(-1.1, 1.1, (n, 4)), random.standard_normal((n, 10))
    assert_mujoco(model, x, random.uniform(-1, 1, (n, 6, 4)))


def test_a_warm_start_can_be_refused():
    random = np.random.default_rng(3)
    model = simulated()
    x, u = start(model, random), controls(model, random)
    cold = assert_mujoco(model, x, u, warm_start=False).states.copy()
    assert np.abs(assert_mujoco(model, x, u).states - cold).max() > 1e-6


def test_deep_inside_a_box_the_nearest_face_is_the_way_out():
    model, random = simulated(terrain=TERRAINS["boxes"]), np.random.default_rng(4)
    x = start(model, random)
    x[:, 2] -= 0.03
    assert_mujoco(model, x, controls(model, random, steps=2))


@pytest.mark.parametrize("substeps", [1, 4])
def test_first_steps_that_all_share_are_the_same_steps(substeps):
    model, random = simulated(timestep=0.02 / substeps, substeps=substeps), np.random.default_rng(5)
    x, u = start(model, random, 1)[0], controls(model, random)
    u[:, :3] = u[0, :3]
    assert_mujoco(model, x, u)
    with SimdEngine(model) as engine:
        together = engine.rollout(x, u).states.copy()
        each = engine.rollout(np.tile(x, (N, 1)), u).states
    assert np.array_equal(together, each)


def test_neither_threads_nor_neighbours_change_a_sample():
    model, random = simulated(terrain=TERRAINS["stairs"]), np.random.default_rng(6)
    x, u = start(model, random), controls(model, random)
    order = random.permutation(N)
    with SimdEngine(model, threads=1) as one, SimdEngine(model, threads=3) as three:
        alone, shared = one.rollout(x, u).states.copy(), three.rollout(x[order], u[order]).states
        assert np.array_equal(alone[order], shared)
        few = one.rollout(x[:2], u[:2]).states
    assert np.array_equal(few, alone[:2])


@pytest.mark.parametrize("width", [1, 2, 4, 8])
def test_states_are_mujocos_however_wide_the_vectors(width):
    model, random = simulated(terrain=TERRAINS["stairs"]), np.random.default_rng(8)
    x, u = start(model, random), controls(model, random)
    with SimdEngine(model, threads=1, width=width) as engine, NativeEngine(model, threads=0) as native:
        assert np.abs(engine.rollout(x, u).states - native.rollout(x, u).states).max() < 1e-9


def test_samples_that_diverge_fail_alone():
    model, random = simulated(), np.random.default_rng(7)
    x, u = start(model, random), controls(model, random)
    u[1, 4, 3], u[2, 0, 3], x[4, 25], x[5, 20] = np.nan, np.inf, np.nan, 2 * MAX_SPEED
    with SimdEngine(model) as engine, NativeEngine(model, threads=0) as native:
        got, want = engine.rollout(x, u), native.rollout(x, u)
    assert np.flatnonzero(got.failed).tolist() == np.flatnonzero(want.failed).tolist() == [1, 2, 4, 5]
    assert np.abs(got.states - want.states).max() < 1e-9


# ---- what it refuses


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"contact": SoftContact(solver="newton")}, "solver of contacts - got mjSOL_NEWTON, expected mjSOL_PGS"),
        ({"contact": SoftContact(cone="pyramidal")}, "friction cone - got mjCONE_PYRAMIDAL, expected mjCONE_ELLIPTIC"),
        ({"contact": SoftContact(integrator="implicitfast")}, "integrator - got mjINT_IMPLICITFAST, expected mjINT_EU"),
        ({"body_collisions": True}, "shapes that touch - got mjGEOM_PLANE and mjGEOM_BOX, expected planes and boxes"),
        (
            {"terrain": models.terrain.heightfield(0.1 * np.eye(4), (2.0, 2.0))},
            "shapes that touch - got mjGEOM_HFIELD and mjGEOM_SPHERE",
        ),
    ],
    ids=["newton", "pyramidal", "implicitfast", "body", "height field"],
)
def test_what_it_does_not_simulate_is_named_and_left_to_mujoco(changes, message):
    model = simulated(**changes)
    with pytest.raises(SamplingError, match=f'simd engine: {message}.*; change the model, or choose engine="native"'):
        engine_for(model, "simd")
    with engine_for(model) as engine:
        assert isinstance(engine, NativeEngine)


def test_auto_takes_simd_where_it_can():
    with engine_for(simulated(), threads=1) as engine:
        assert isinstance(engine, SimdEngine)


def test_without_a_compiler_auto_takes_mujoco(monkeypatch):
    def fail(*args, **options):
        raise NoCompilerError("no compiler")

    monkeypatch.setattr(simd, "build", fail)
    with pytest.raises(SamplingError, match=r'simd engine: no compiler; install one, pip install "piaffe\[compiler'):
        SimdEngine(simulated())
    with engine_for(simulated()) as engine:
        assert isinstance(engine, NativeEngine)


@pytest.mark.parametrize("terrain", ["flat", "high", "boxes"])
def test_another_mujoco_is_noticed_before_use(monkeypatch, terrain):
    def in_order(most, rounds):
        return [[k for count in range(1, most + 1) for k in range(count)]] * rounds

    monkeypatch.setattr(simd_text, "orders", in_order)
    model = simulated(terrain=TERRAINS[terrain])
    with pytest.raises(DifferentError, match=r"states differ from those of MuJoCo \d.* - got .* less than 1e-07"):
        SimdEngine(model)
    with pytest.warns(UserWarning, match="rolling out with MuJoCo itself"), engine_for(model) as engine:
        assert isinstance(engine, NativeEngine)


def test_trials_that_all_diverge_are_no_agreement(monkeypatch):
    model = simulated()
    lost = np.full((32, 37), np.nan), np.zeros((32, 3, 12))
    monkeypatch.setattr(simd, "_states_in_contact", lambda *args: lost)
    with pytest.raises(DifferentError, match="0 of 32 trials finite"):
        SimdEngine(model)


def test_what_is_in_the_cache_is_not_written_again(monkeypatch):
    def fail(*args, **options):
        raise AssertionError("written again")

    SimdEngine(simulated()).close()
    monkeypatch.setattr(simd, "generate", fail)
    SimdEngine(simulated()).close()
    changed = models.Mujoco(models.load("solo12"), payload=models.payload(0.01 * np.random.default_rng().uniform()))
    with pytest.raises(AssertionError, match="written again"):
        SimdEngine(changed)


FOREIGN = {
    "body_gravcomp": lambda model: model.body_gravcomp.__setitem__(3, 0.5),
    "geom_surfacevel": lambda model: model.geom_surfacevel.__setitem__(0, 0.1),
    "pair_margin": lambda model: model.pair_margin.__setitem__(0, 0.01),
    "angles of reference": lambda model: model.qpos0.__setitem__(8, 0.2),
    "solref": lambda model: model.pair_solref.__setitem__((0, 1), -5.0),
    "iterations of the solver": lambda model: setattr(model.opt, "iterations", 0),
    "dimension of a contact": lambda model: model.pair_dim.__setitem__(0, 4),
    "friction of joints": lambda model: (
        model.dof_frictionloss.__setitem__(7, 0.1) or setattr(model.opt, "disableflags", 0)
    ),
    "contacts and limits": lambda model: setattr(model.opt, "iterations", 100_000),
}


@pytest.mark.parametrize("what", FOREIGN)
def test_what_others_may_set_is_refused_by_name(what):
    compiled = copy.copy(simulated().compiled())
    FOREIGN[what](compiled)
    with pytest.raises(SamplingError, match=rf"simd engine: .*{what}"):
        SimdEngine(SimpleNamespace(compiled=lambda: compiled, substeps=1))


def test_a_closed_engine_says_so():
    model = simulated()
    engine = SimdEngine(model)
    engine.close()
    with pytest.raises(SamplingError, match="simd engine: rollout after close"):
        engine.rollout(model.state(joints="stand"), np.zeros((1, 1, 12)))
