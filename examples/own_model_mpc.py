"""A quadrotor in the plane, a model of your own: it flies from random starts to a point, with a receding horizon."""

import argparse

import numpy as np
from casadi import cos, sin

from piaffe import ocp, solvers

G, MASS, INERTIA, ARM, MOST = 9.81, 0.5, 0.004, 0.17, 5.0  # [m/s^2], [kg], [kg m^2], [m], [N] of a rotor


def fly(s):
    """Return the derivatives of place, angle and velocities; left and right are the forces of the rotors [N]."""
    lift = (s.left + s.right) / MASS
    return {
        "x": s.vx, "z": s.vz, "angle": s.rate, "vx": -lift * sin(s.angle), "vz": lift * cos(s.angle) - G,
        "rate": ARM * (s.right - s.left) / INERTIA,
    }  # fmt: skip


quadrotor = ocp.Model(
    "quadrotor", state={"x": 1, "z": 1, "angle": 1, "vx": 1, "vz": 1, "rate": 1}, control={"left": 1, "right": 1},
    modes={"fly": fly}, integrator="rk4",
)  # fmt: skip
weights = {"x": 4.0, "z": 40.0, "angle": 0.5, "vx": 1.0, "vz": 2.0, "rate": 0.02}
objective = ocp.Objective(
    *(ocp.track(name, weight=weight, to=0.0) for name, weight in weights.items()),
    ocp.track("left", weight=0.02, to=MASS * G / 2),
    ocp.track("right", weight=0.02, to=MASS * G / 2),
)
limits = ocp.Constraints(
    ocp.inequality(lambda s: s.left, lower=0.0, upper=MOST, unit="N", name="left rotor"),
    ocp.inequality(lambda s: s.right, lower=0.0, upper=MOST, unit="N", name="right rotor"),
)
flight = ocp.Motion(ocp.Phase("flight", "fly", 60.0))  # [s]; a plan sees one second of it
problem = ocp.Problem(flight, quadrotor.over(1.0, dt=0.02), objective, limits, initial=np.zeros(6))


def plant(x, u):
    """Return the derivatives of the real quadrotor: 15 % more mass and inertia, one weak rotor, and drag."""
    lift = (0.95 * u[0] + u[1]) / (1.15 * MASS)
    drag = 0.1 * x[3:5] * (1 + np.hypot(*x[3:5])) / MASS
    turn = ARM * (u[1] - 0.95 * u[0]) / (1.15 * INERTIA)
    return np.array([x[3], x[4], x[5], -lift * np.sin(x[2]) - drag[0], lift * np.cos(x[2]) - G - drag[1], turn])


def step(x, u, dt=0.002):
    """Return the state after a step of Runge and Kutta's method."""
    a = plant(x, u)
    b = plant(x + dt / 2 * a, u)
    c = plant(x + dt / 2 * b, u)
    return x + dt / 6 * (a + 2 * b + 2 * c + plant(x + dt * c, u))


def start(seed):
    """Return a random state: up to 3 m away, tilted by up to 1 rad, moving and turning."""
    return np.random.default_rng(seed).uniform(-1, 1, 6) * [3.0, 3.0, 1.0, 2.0, 2.0, 3.0]


def run(mpc, low, x, seconds=6.0):
    """Return the states of a flight: a plan every 20 ms, its policy every 2 ms."""
    mpc.reset()
    states = [x]
    for i in range(round(seconds / 0.002)):
        t = 0.002 * i
        if i % 10 == 0:
            low.follow(mpc.plan(x, t))
        x = step(x, np.clip(low.control(x, t), 0.0, MOST))
        states.append(x)
    return np.array(states)


def main(seeds: int = 20) -> float:
    """Fly from random starts, and return the largest distance from the point after 6 s [m]."""
    mpc = solvers.RecedingHorizon(problem)
    low = solvers.Riccati(mpc.plan(problem.initial, 0.0))
    flights = [run(mpc, low, start(seed)) for seed in range(seeds)]
    ends = [float(np.hypot(*states[-1, :2])) for states in flights]
    tilts = [float(np.abs(states[:, 2]).max()) for states in flights]
    print(
        f"{seeds} starts; distance at the end {np.median(ends):.3f} m in the median, largest tilt {max(tilts):.2f} rad"
    )
    return max(ends)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    print(f"at most {main(**vars(parser.parse_args())):.3f} m")
