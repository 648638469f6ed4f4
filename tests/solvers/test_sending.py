"""Problems, compiled problems, solvers and options in other processes: the same bits, or an error by name."""

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import ProblemError
from piaffe.models import base, feet, joints, stance

ROBOT = models.load("solo12")
BODY = models.WholeBody(ROBOT)


def leap() -> ocp.Problem:
    """Return a jump with every constraint of the library, and a masked term."""
    four = stance("FL FR HL HR")
    motion = ocp.Motion(
        ocp.Phase("push", four, 0.2, ocp.Keyframe(position=(0, 0, 0.24))),
        ocp.Phase("flight", stance(""), 0.16, ocp.Keyframe(position=(0.05, 0, 0.24))),
        ocp.Phase("land", four, 0.2, ocp.Keyframe(position=(0.1, 0, 0.24))),
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=20.0), ocp.track(base.orientation, weight=5.0, to=(1, 0, 0, 0)),
        ocp.regularize(base.linear_velocity, weight=0.1), ocp.regularize(joints.velocity, weight=0.01),
        ocp.regularize(joints.torque, weight=0.05), ocp.regularize(feet.velocity, weight=0.01, mask=swing),
        models.soft_landing(weight=0.1),
    )  # fmt: skip
    limits = ocp.Constraints(
        models.friction_cone(mu=0.7), models.torque_limits(0.95), models.joint_limits(0.01),
        models.joint_speed_limits(0.9), models.joint_range("HAA", 0.8), models.base_height(minimum=0.08),
        models.foot_clearance(minimum=0.0),
    )  # fmt: skip
    return ocp.Problem(motion, BODY.until_end(dt=0.02), objective, limits, initial=BODY.state(joints="stand"))


def swing(s):
    """Return 1 for feet in the air."""
    return 1 - s.feet.contact


def states(solution: solvers.Solution) -> list[np.ndarray]:
    return [phase.states for phase in solution.trajectory.phases]


def solved(problem: ocp.Problem | ocp.CompiledProblem | solvers.MSiLQR) -> list[np.ndarray]:
    """Return the states of a solution."""
    solver = problem if isinstance(problem, solvers.MSiLQR) else solvers.MSiLQR(problem)
    return states(solver.solve())


@pytest.fixture(scope="module")
def made() -> dict[str, object]:
    problem = leap()
    solver = solvers.MSiLQR(problem, solvers.Options(max_iterations=30))
    solver.solve()  # models and functions have their caches now
    return {"problem": problem, "compiled": solver.problem, "solver": solver}


@pytest.mark.parametrize("sent", [lambda each: pickle.loads(pickle.dumps(each)), copy.deepcopy], ids=["pickle", "copy"])
@pytest.mark.parametrize("what", ["problem", "compiled", "solver"])
def test_what_is_sent_solves_to_the_same_bits(made, what, sent) -> None:
    found, expected = solved(sent(made[what])), solved(made[what])
    assert all(np.array_equal(a, b) for a, b in zip(found, expected, strict=True))


def test_options_and_backends_are_sent_with_a_solver() -> None:
    options = solvers.Options(max_iterations=3, time_limit_s=9.0)
    sent = pickle.loads(pickle.dumps(solvers.MSiLQR(falling(), options, backend="numpy")))
    assert sent.options == options
    assert sent.backend == "numpy"


SCRIPT = """
import multiprocessing, sys
import numpy as np
from piaffe import models, ocp, solvers
from piaffe.models import base, feet, joints, stance

def swing(s): return 1 - s.feet.contact

def leap():
    body = models.WholeBody(models.load("solo12"))
    objective = ocp.Objective(ocp.track(base.position, weight=20.0), ocp.regularize(joints.velocity, weight=0.01),
        ocp.regularize(joints.torque, weight=0.05), ocp.regularize(feet.velocity, weight=0.01, mask=swing))
    motion = ocp.Motion(ocp.Phase("push", stance("FL FR HL HR"), 0.2), ocp.Phase("fly", stance(""), 0.1))
    return ocp.Problem(motion, body.until_end(dt=0.02), objective,
        ocp.Constraints(models.torque_limits(0.9)), initial=body.state())

def solved(solver): return solver.solve().trajectory.phases[-1].states

if __name__ == "__main__":
    solver = solvers.MSiLQR(leap())
    with multiprocessing.get_context(sys.argv[1]).Pool(1) as pool:
        print(np.array_equal(pool.map(solved, [solver])[0], solved(solver)))
"""


@pytest.mark.parametrize("method", ["spawn", "fork"])
def test_a_pool_of_processes_takes_a_solver(method, tmp_path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    found = subprocess.run(
        [sys.executable, str(script), method], capture_output=True, text=True, timeout=300, check=False
    )
    assert found.stdout.split() == ["True"], found.stderr


def test_what_was_compiled_is_not_sent_with_a_problem(made) -> None:
    assert len(pickle.dumps(made["problem"])) < 1.2 * len(pickle.dumps(leap()))


def falling(*terms, rows=(), mode=None, reset=None) -> ocp.Problem:
    """Return a problem of a ball with something that a function declares."""
    ball = ocp.Model("ball", state={"z": 1, "v": 1}, control={"push": 1}, modes={"fall": mode or fall})
    motion = ocp.Motion(ocp.Phase("one", "fall", 0.2, reset=reset), ocp.Phase("two", "fall", 0.2))
    objective = ocp.Objective(ocp.regularize("push", weight=1.0), *terms)
    return ocp.Problem(motion, ball.until_end(dt=0.02), objective, ocp.Constraints(*rows), initial=[1.0, 0.0])


def fall(s):
    """Return the derivatives of a ball that is pushed."""
    return {"z": s.v, "v": s.push - 9.81}


def height(s):
    """Return the height."""
    return s.z


@pytest.mark.parametrize(
    ("declared", "words"),
    [
        (
            lambda: falling(ocp.residual(lambda s: s.z).weighted(1.0)),
            r"term '.*' \(.*\): .* a lambda of .* as function",
        ),
        (lambda: falling(ocp.track("z", weight=1.0, to=0.0, when=lambda name: True)), r"term 'track z' .* as when"),
        (lambda: falling(ocp.track("z", weight=1.0, to=0.0, mask=lambda s: 1)), r"term 'track z' .* as mask"),
        (lambda: falling(rows=[ocp.inequality(height, lower=lambda model: 0.0)]), r"'height' .* as lower"),
        (lambda: falling(mode=lambda s: fall(s)), r"model 'ball': .* a lambda of .* as modes"),
        (lambda: falling(reset=ocp.reset(lambda s: {"v": 0.0})), r"reset \(.*\): .* a lambda of .* as function"),
    ],
)
def test_what_a_lambda_prevents_is_said_by_name(declared, words) -> None:
    problem = declared()
    with pytest.raises(ProblemError, match=words):
        pickle.dumps(problem)
    assert solvers.MSiLQR(copy.deepcopy(problem)).solve().converged  # in this process a copy needs no names
