"""Mistakes in declarations, by kind: a text of a problem's file, and words of the message that names it.

The line at fault ends with ``# here``. Every file begins with an import of :mod:`tests.mistakes.jump`.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Mistake:
    """A file with one mistake.

    Args:
        name: what is wrong.
        text: the file after its import; the line at fault ends with ``# here``.
        words: part of the message.
    """

    name: str
    text: str
    words: str


SIZES = (
    Mistake("two weights for three components",
            "p = ocp.track(base.position, weight=(1.0, 10.0))  # here\nproblem = jump(objective=OBJECTIVE + p)",
            "weight has the wrong size - got 2 entries, expected 1 or 3"),
    Mistake("a residual that is a matrix",
            "f = ocp.residual(lambda s: cs.skew(s.base.position)).weighted(1.0)  # here\n"
            "problem = jump(objective=OBJECTIVE + f)",
            "the function returned a matrix - got shape (3, 3), expected a column"),
    Mistake("a state without its last velocity",
            "x = BODY.state(joints='stand')[:-1]\n"
            "problem = ocp.Problem(jump().motion, BODY.until_end(dt=0.02), OBJECTIVE, initial=x)  # here",
            "initial state has the wrong size for model 'go2' - got shape (36,)"),
    Mistake("two bounds for three rows",
            "low = ocp.inequality(lambda s: s.base.position, lower=(0.0, 0.1))  # here\n"
            "problem = jump(limits=LIMITS + low)",
            "lower bound is unusable - got [0.0, 0.1], expected 1 or 3 numbers"),
    Mistake("a target that is a matrix",
            "q = ocp.track(joints.velocity, to=np.zeros((4, 3)))  # here\nproblem = jump(objective=OBJECTIVE + q)",
            "target is a matrix - got shape (4, 3)"),
    Mistake("a weight that is a matrix",
            "w = ocp.track('x', weight=np.eye(2), to=1.0)  # here\nproblem = drive(objective=CHEAP + w)",
            "weight is a matrix - got shape (2, 2)"),
)  # fmt: skip

NAMES = (
    Mistake("a joint that the robot does not have",
            "w = ocp.track(joints.position, weight={'knee': 2.0})  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "one name may stand for several components: hip_joint, thigh_joint, calf_joint in every leg, FL, "),
    Mistake("a pose that the robot does not have",
            "problem = jump(ocp.Phase('stand', ALL, 0.2, ocp.Keyframe(joints='tuck')))  # here",
            "add it: models.load(..., poses={'tuck': angles}), or write the angles"),
    Mistake("an argument that a term does not take",
            "w = ocp.track(base.position, weights=2.0)  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "expected the arguments quantity, weight, at, when, to, mask, name"),
    Mistake("a problem without its initial state",
            "problem = ocp.Problem(jump().motion, BODY.until_end(dt=0.02), OBJECTIVE, LIMITS)  # here",
            "initial, parameters (initial: initial state"),
    Mistake("a pose in place of a position",
            "x = BODY.state('stand')  # here\nproblem = jump(initial=x)",
            "a pose has a name of its own: state(joints='stand')"),
    Mistake("a phase that the motion does not have",
            "w = ocp.track(base.position, when='fligth')  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "no phase 'fligth'"),
    Mistake("a robot that is not shipped",
            "robot = models.load('go3')  # here\nproblem = jump(body=models.WholeBody(robot))",
            "no robot 'go3'"),
    Mistake("a foot that the robot does not have",
            "problem = jump(ocp.Phase('stand', stance('FL HR'), 0.2, pose()))  # here",
            "no foot 'HR'"),
    Mistake("a quantity that the model does not have",
            "w = ocp.residual(lambda s: s.base.heigth).weighted(1.0)  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "base.heigth"),
    Mistake("a target that no model has",
            "problem = jump(ocp.Phase('stand', ALL, 0.2, ocp.Keyframe(postion=(0, 0, 0.3))))  # here",
            "no target 'postion'"),
)  # fmt: skip

UNITS = (
    Mistake("a yaw in degrees",
            "problem = jump(ocp.Phase('turn', ALL, 0.4, pose(rpy=(0, 0, 45))))  # here",
            "yaw changes by many turns - got 45 rad"),
    Mistake("a pitch in degrees that keyframes before it pass through",
            "up = ocp.Phase('up', ALL, 0.4, ocp.Keyframe(position=(0, 0, 0.3)))  # here\n"
            "problem = jump(up, ocp.Phase('nose', ALL, 0.4, pose(rpy=(0, -40, 0))))",
            "turns, in 0.4 s, on the way to the next keyframe that has one, expected"),
    Mistake("durations in milliseconds",
            "go = ocp.Motion(ocp.Phase('go', 'roll', 400.0), ocp.Phase('on', 'roll', 800.0))\n"
            "problem = drive(motion=go, schedule=cart.until_end(dt=0.1))  # here",
            "the horizon has very many nodes - got 12000: 1200 s in steps of 0.1 s, expected at most 10000"),
    Mistake("a target of an orientation in degrees",
            "w = ocp.track(base.orientation, to=(0, 0, 90))  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "its target is many turns - got 90 rad, 14.3 turns"),
    Mistake("a target of joints in degrees",
            "w = ocp.track(joints.position, to=np.full(12, -50.0))  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "its target is many turns - got -50 rad"),
    Mistake("a height in millimetres",
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose(z=280)))  # here",
            "the base is far from the keyframe before - got 280 m in 0.4 s"),
    Mistake("a joint angle in degrees",
            "bent = ocp.Keyframe(position=(0, 0, HEIGHT), joints={'FL_calf_joint': -103})\n"
            "problem = jump(ocp.Phase('stand', ALL, 0.4, bent))  # here",
            "joint beyond its limit - got FL_calf_joint at -103.000 rad"),
    Mistake("a step in milliseconds",
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose()), dt=20)  # here",
            "not a whole number of steps - got 0.4 s with dt 20 s"),
    Mistake("a velocity in millimetres a second",
            "problem = jump(ocp.Phase('go', ALL, 0.4, pose(linear_velocity=(500, 0, 0))))  # here",
            "'base.linear_velocity' is very fast - got 500 m/s"),
    Mistake("an angular velocity in degrees a second",
            "problem = jump(ocp.Phase('turn', ALL, 0.4, pose(angular_velocity=(0, 0, 180))))  # here",
            "'base.angular_velocity' is very fast - got 180 rad/s"),
    Mistake("joint velocities in degrees a second",
            "problem = jump(ocp.Phase('go', ALL, 0.4, pose(joint_velocities=np.full(12, 300.0))))  # here",
            "'joints.velocity FL_hip_joint' is very fast - got 300"),
    Mistake("an initial velocity in millimetres a second",
            "x = BODY.state(joints='stand', linear_velocity=(900, 0, 0))\n"
            "problem = jump(ocp.Phase('go', ALL, 0.4, pose()), initial=x)  # here",
            "initial state: 'base.linear_velocity' is very fast - got 900 m/s"),
    Mistake("an initial roll in degrees",
            "x = BODY.state(joints='stand', rpy=(30, 0, 0))  # here\nproblem = jump(initial=x)",
            "target 'rpy': is many turns - got [30.0, 0.0, 0.0] rad"),
    Mistake("an angle in degrees for a friction coefficient",
            "limits = ocp.Constraints(models.friction_cone(mu=35))  # here\nproblem = jump(limits=limits)",
            "parameter 'mu' is larger than such numbers are - got 35, expected at most 2"),
    Mistake("a friction coefficient in per cent, as a parameter",
            "limits = ocp.Constraints(models.friction_cone(0.7))  # here\n"
            "problem = jump(limits=limits).with_parameters({'friction cone.mu': 60.0})",
            "parameter 'mu' is larger than such numbers are - got 60"),
    Mistake("a gait's speed in kilometres an hour",
            "problem = jump(motion=models.gaits.trot(18.0).cycles(2))  # here",
            "its reference is out of reach"),
)  # fmt: skip

SIGNS = (
    Mistake("a negative weight",
            "w = ocp.track(base.position, weight=-1.0)  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "weight is unusable - got [-1.0, -1.0, -1.0]"),
    Mistake("a negative friction coefficient",
            "limits = ocp.Constraints(models.friction_cone(-0.7))  # here\nproblem = jump(limits=limits)",
            "mu is out of range - got -0.7"),
    Mistake("a height below the ground",
            "low = models.base_height(maximum=-0.28)  # here\nproblem = jump(limits=LIMITS + low)",
            "the initial state violates it"),
    Mistake("bounds in reverse",
            "box = ocp.inequality(lambda s: s.base.position[2], lower=0.4, upper=0.2)  # here\n"
            "problem = jump(limits=LIMITS + box)",
            "bounds exclude each other - got lower 0.4 above upper 0.2"),
    Mistake("a clearance of feet that land",
            "high = models.foot_clearance(0.05)  # here\nproblem = jump(limits=LIMITS + high)",
            "got 'foot clearance FL lower' and 'switching FL', which the next phase's contacts need, 0.05 m apart"),
    Mistake("a keyframe below the ground",
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose(z=-HEIGHT)))  # here",
            "stance foot is not on the ground"),
    Mistake("gravity that points up",
            "problem = jump().with_parameters({'go2.gravity': (0.0, 0.0, 9.81)})  # here",
            "parameter 'go2.gravity': is out of range - got [0.0, 0.0, 9.81], expected a vector that "
            "does not point up"),
)  # fmt: skip

FRAMES = (
    Mistake("a quaternion with w at its end",
            "x = BODY.state(joints='stand')\nx[3:7] = (0.0, 0.0, np.sin(0.1), np.cos(0.1))\n"
            "problem = ocp.Problem(jump().motion, BODY.until_end(dt=0.02), OBJECTIVE, initial=x)  # here",
            "'base.orientation' of the initial state is far from upright"),
    Mistake("the state of another robot",
            "x = models.WholeBody(models.load('solo12')).state(joints='stand')\n"
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose()), initial=x)  # here",
            "standing foot is not on the ground"),
    Mistake("the state of a robot that is a little larger",
            "cheetah = models.WholeBody(models.load('mini_cheetah'))\n"
            "x = BODY.state(joints='stand')\n"
            "problem = jump(ocp.Phase('stand', ALL, 0.4), body=cheetah, initial=x,"
            " limits=ocp.Constraints(models.torque_limits()))  # here",
            "all standing feet are off the ground - got 0.0"),
    Mistake("the state of a robot whose knees bend the other way",
            "x = models.WholeBody(models.load('mini_cheetah')).state(joints='stand')\n"
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose()), initial=x)  # here",
            "joint of the initial state beyond its limit - got FL_calf_joint at 2."),
    Mistake("a base at the height of the ground",
            "x = BODY.state(position=(0, 0, 0), joints='stand')\n"
            "problem = jump(ocp.Phase('stand', ALL, 0.4, pose()), initial=x)  # here",
            "standing foot is not on the ground - got FL 0."),
    Mistake("a foothold far from where the feet stand",
            "at = ocp.equality(lambda s: s.feet.position['FL x'] - 2.4, name='foothold', unit='m', at='phase_end',"
            " when='flight')  # here\nproblem = jump(limits=LIMITS + at)",
            "it is out of reach"),
    Mistake("a rotation's component by the name of an angle",
            "w = ocp.track(base.orientation, weight={'yaw': 3.0})  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "the components are axes; for yaw write 'z'"),
    Mistake("a quaternion that is not of unit length",
            "x = BODY.state(joints='stand')\nx[3:7] = (1.0, 0.0, 0.0, 1.0)\n"
            "problem = ocp.Problem(jump().motion, BODY.until_end(dt=0.02), OBJECTIVE, initial=x)  # here",
            "invalid 'base.orientation' - got a quaternion of length 1.41"),
    Mistake("a base that leaves its feet behind",
            "far = ocp.Keyframe(position=(0.7, 0, HEIGHT), joints='stand')\n"
            "problem = jump(ocp.Phase('lean', ALL, 0.6, far))  # here",
            "the base moves away from feet that stand - got FL 0."),
)  # fmt: skip

DURATIONS = (
    Mistake("a truth value", "problem = drive(ocp.Phase('go', 'roll', True))  # here",
            "duration is out of range - got True"),
    Mistake("almost nothing", "problem = drive(ocp.Phase('go', 'roll', 1e-11))  # here",
            "duration is out of range - got 1e-11"),
    Mistake("a flight over two seconds",
            "up = ocp.Phase('up', NONE, 2.2)  # here\n"
            "problem = jump(ocp.Phase('push', ALL, 0.4, pose()), up, ocp.Phase('land', ALL, 0.4, pose()))",
            "the flight is long - got 2.2 s without contact"),
    Mistake("one step",
            "problem = drive(ocp.Phase('go', 'roll', 0.1), ocp.Phase('on', 'roll', 1.0))  # here",
            "the phase has few steps - got 1 of 0.1 s in 0.1 s"),
    Mistake("no whole number of steps", "problem = drive(ocp.Phase('go', 'roll', 0.93))  # here",
            "not a whole number of steps - got 0.93 s with dt 0.1 s"),
    Mistake("a text", "problem = drive(ocp.Phase('go', 'roll', '1 s'))  # here",
            "duration is out of range - got '1 s'"),
)  # fmt: skip

REFERENCES = (
    Mistake("times that decrease", "path = ocp.FromArrays([0.0, 0.6, 0.5], {'x': np.zeros((3, 1))})  # here",
            "times are unusable"),
    Mistake("a row too few", "path = ocp.FromArrays([0.0, 0.5, 1.0], {'x': np.zeros((2, 1))})  # here",
            "'x': wrong number of rows"),
    Mistake("a value that is not a number",
            "path = ocp.FromArrays([0.0, 1.0], {'x': [[0.0], [float('nan')]]})  # here",
            "'x': values are unusable"),
    Mistake("a column of text", "path = ocp.FromArrays([0.0, 1.0], {'x': ['left', 'right']})  # here",
            "'x' is unusable - got ['left', 'right']"),
    Mistake("keyframes and a reference",
            "path = ocp.FromArrays([0.0, 1.0], {'x': np.zeros((2, 1))})\n"
            "go = ocp.Phase('go', 'roll', 1.0, ocp.Keyframe(x=1.0))  # here\n"
            "problem = drive(motion=ocp.Motion(go, reference=path))",
            "its keyframe applies nowhere"),
    Mistake("a quantity without a target",
            "w = ocp.track(feet.position)  # here\nproblem = jump(objective=OBJECTIVE + w)",
            "the motion has no target for it"),
    Mistake("a column that no model has",
            "path = ocp.FromArrays([0.0, 1.0], {'y': np.zeros((2, 1))})  # here\n"
            "problem = drive(motion=ocp.Motion(ocp.Phase('go', 'roll', 1.0), reference=path))",
            "'y': no model has it, and no cost tracks it"),
    Mistake("the name of a quantity in place of it",
            "path = ocp.FromArrays([0.0, 1.0], {'base.position': np.zeros((2, 3))})  # here\n"
            "problem = jump(motion=ocp.Motion(ocp.Phase('go', ALL, 1.0), reference=path))",
            "is the name of a quantity - got text"),
    Mistake("times that end before the motion",
            "path = ocp.FromArrays([0.0, 0.4], {'x': np.zeros((2, 1))})  # here\n"
            "problem = drive(motion=ocp.Motion(ocp.Phase('go', 'roll', 1.0), reference=path))",
            "the times do not cover the motion - got 0 s to 0.4 s, expected 0 s to 1 s"),
    Mistake("rotations that are no quaternions",
            "path = ocp.FromArrays([0.0, 1.0], {base.orientation: np.ones((2, 4))})  # here",
            "'base.orientation': values are no quaternions - got [1.0, 1.0, 1.0, 1.0] in row 0"),
)  # fmt: skip

OWN_TERMS = (
    Mistake("float of a symbol",
            "def high(s):\n    return 1.0 if float(s.x) > 0.2 else 0.0  # here\n"
            "problem = drive(objective=CHEAP + ocp.residual(high).weighted(1.0))",
            "a symbol is no number"),
    Mistake("an if on a symbol",
            "def high(s):\n    if s.x > 0.2:  # here\n        return s.x\n    return 0.2\n"
            "problem = drive(objective=CHEAP + ocp.residual(high).weighted(1.0))",
            "a symbol has no truth value"),
    Mistake("the larger of two symbols",
            "def most(s):\n    return max(s.x, s.v)  # here\n"
            "problem = drive(objective=CHEAP + ocp.residual(most).weighted(1.0))",
            "a symbol has no truth value"),
    Mistake("a square root of Python's math",
            "import math\ndef root(s):\n    return math.sqrt(s.x + 1.0)  # here\n"
            "problem = drive(objective=CHEAP + ocp.residual(root).weighted(1.0))",
            "a symbol is no number"),
    Mistake("a row that depends on nothing",
            "off = ocp.inequality(lambda s: -0.3, name='off')  # here\nproblem = drive(limits=ocp.Constraints(off))",
            "row 'off lower' depends on neither state nor control and is violated - got 0.3"),
    Mistake("a control where there is none",
            "end = ocp.equality(lambda s: s.push, at='end')  # here\nproblem = drive(limits=ocp.Constraints(end))",
            "depends on control or contact force where there is none"),
    Mistake("a symbol of its own",
            "k = cs.SX.sym('k')\nw = ocp.residual(lambda s: k * s.x).weighted(1.0)  # here\n"
            "problem = drive(objective=CHEAP + w)",
            "a symbol is not from the node's quantities - got 'k'"),
    Mistake("the same constraint twice",
            "more = models.friction_cone(0.4)  # here\nproblem = jump(limits=LIMITS + more)",
            "the constraint is declared twice - got it with lower 0, mu 0.7 and lower 0, mu 0.4"),
    Mistake("two bounds that exclude each other",
            "a = ocp.inequality(lambda s: s.v, upper=0.5, unit='m/s', name='slow', when='on')\n"
            "b = ocp.inequality(lambda s: 2 * s.v, lower=1.4, unit='m/s', name='fast', when='on')  # here\n"
            "problem = drive(ocp.Phase('go', 'roll', 1.0), ocp.Phase('on', 'roll', 0.5), limits=ocp.Constraints(a, b))",
            "two rows exclude each other - got 'fast lower' and 'slow upper'"),
    Mistake("a root at zero",
            "end = ocp.inequality(lambda s: 1 - cs.sqrt(s.x), at='end')  # here\n"
            "problem = drive(limits=ocp.Constraints(end))",
            "phase 'go', node 10: derivative at the initial guess is not finite"),
    Mistake("a cost of a number",
            "off = ocp.residual(lambda s: 0.4 - 0.1).weighted(2.0)  # here\nproblem = drive(objective=CHEAP + off)",
            "it depends on neither state nor control"),
)  # fmt: skip

SCHEDULES = (
    Mistake("a horizon beyond the motion",
            "problem = drive(schedule=cart.over(1.4, dt=0.1))  # here",
            "the horizon is longer than the motion - got 1.4 s"),
    Mistake("the end of a motion without end",
            "round = ocp.Motion(ocp.Phase('go', 'roll', 1.0), cyclic=True)\n"
            "problem = drive(motion=round, schedule=cart.until_end(dt=0.1))  # here",
            "the motion never ends"),
    Mistake("a term that is not in the problem",
            "other = ocp.inequality(lambda s: s.x)\n"
            "problem = drive(schedule=cart.until_end(dt=0.1).without(other))  # here",
            "leaves out a term that is not in the problem"),
    Mistake("two models of one name",
            "other = ocp.Model('cart', state={'x': 1, 'v': 1}, control={'push': 1}, modes=dict(cart.modes))\n"
            "problem = drive(schedule=cart.over(0.5, dt=0.1) + other.until_end(dt=0.1))  # here",
            "two models share a name"),
    Mistake("a negative step", "problem = drive(schedule=cart.until_end(dt=-0.1))  # here",
            "dt is out of range - got -0.1"),
)  # fmt: skip

RESETS = (
    Mistake("a state that the model does not have",
            "back = ocp.reset(lambda s: {'y': 0.0})  # here\n"
            "problem = drive(ocp.Phase('go', 'roll', 1.0, reset=back), ocp.Phase('on', 'roll', 1.0))",
            "'y'"),
    Mistake("a reset after the last phase",
            "back = ocp.reset(lambda s: {'v': 0.0})\n"
            "problem = drive(ocp.Phase('go', 'roll', 1.0, reset=back))  # here",
            "its reset applies nowhere"),
    Mistake("two values for one state",
            "back = ocp.reset(lambda s: {'v': [0.0, 1.0]})  # here\n"
            "problem = drive(ocp.Phase('go', 'roll', 1.0, reset=back), ocp.Phase('on', 'roll', 1.0))",
            "wrong size"),
    Mistake("a switching constraint that is an inequality",
            "there = ocp.inequality(lambda s: s.x)\n"
            "problem = drive(ocp.Phase('go', 'roll', 1.0, until=there), ocp.Phase('on', 'roll', 1.0))  # here",
            "until is no switching constraint"),
    Mistake("a switching constraint out of reach",
            "tall = ocp.equality(lambda s: s.base.position[2] - 1.1, name='tall', unit='m')  # here\n"
            "problem = jump(ocp.Phase('push', ALL, 0.2, until=tall), ocp.Phase('stand', ALL, 0.1))",
            "it is out of reach"),
)  # fmt: skip

PARAMETERS = (
    Mistake("a value that is not a number", "gap = ocp.parameter('gap', float('nan'))  # here",
            "value is unusable - got nan"),
    Mistake("a name with a dot", "gap = ocp.parameter('cart.gap', 0.1)  # here",
            "name is unusable - got 'cart.gap'"),
    Mistake("a parameter that does not exist",
            "problem = jump().with_parameters({'friction cone.nu': 0.5})  # here",
            "no parameter 'friction cone.nu'"),
    Mistake("friction below zero", "problem = jump().with_parameters({'friction cone.mu': -0.5})  # here",
            "parameter 'friction cone.mu': is out of range - got [-0.5]"),
    Mistake("masses below zero",
            "problem = jump().with_parameters({'go2.link_mass': -1.0 * np.ones(13)})  # here",
            "parameter 'go2.link_mass': is out of range"),
    Mistake("damping below zero",
            "problem = jump().with_parameters({'go2.joint_damping': np.full(12, -0.1)})  # here",
            "parameter 'go2.joint_damping': is out of range"),
    Mistake("two parameters of one name",
            "a, b = ocp.parameter('gap', 0.1), ocp.parameter('gap', 0.2)\n"
            "near = ocp.residual(lambda s: s.x - a).weighted(1.0)\n"
            "far = ocp.residual(lambda s: s.x - b).weighted(1.0)  # here\n"
            "problem = drive(objective=CHEAP + near + far)",
            "parameter 'gap': two parameters share a name"),
)  # fmt: skip

SAMPLING = (
    Mistake("no samples", "options = sampling.Options(samples=0)  # here", "samples is out of range - got 0"),
    Mistake("a temperature below zero", "options = sampling.Options(temperature=-0.1)  # here",
            "temperature is out of range - got -0.1"),
    Mistake("a discount in per cent", "options = sampling.Options(p_max={'friction cone': 25})  # here",
            "p_max is out of range"),
    Mistake("an engine that does not exist", "options = sampling.Options(engine='cuda')  # here",
            "engine is out of range - got 'cuda'"),
    Mistake("a number of knots that is not whole", "options = sampling.Options(knots=4.5)  # here",
            "knots is out of range - got 4.5"),
)  # fmt: skip

KINDS = {
    "sizes": SIZES, "names": NAMES, "units": UNITS, "signs": SIGNS, "frames": FRAMES, "durations": DURATIONS,
    "references": REFERENCES, "own terms": OWN_TERMS, "schedules": SCHEDULES, "resets": RESETS,
    "parameters": PARAMETERS, "sampling": SAMPLING,
}  # fmt: skip
