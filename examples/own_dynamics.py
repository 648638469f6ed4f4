"""Two problems without a robot: a ball with a thruster bounces; a rocket burns fuel, drops its tank and coasts."""

import argparse

from piaffe import ocp, solvers

G = 9.81  # [m/s^2]

# A ball falls, must be on the ground after 0.45 s, and rises with a fraction of its speed.


def fall(s):
    """Return the derivatives of height and speed; the thrust is per mass [m/s^2]."""
    return {"z": s.vz, "vz": s.thrust - G}


restitution = ocp.parameter("restitution", 0.8)  # a change does not compile anything
ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
bounce = ocp.Motion(
    ocp.Phase(
        "drop", "fall", 0.45,  # [s]
        until=ocp.equality(lambda s: s.z, name="ground", unit="m"),
        reset=ocp.reset(lambda s: {"vz": -restitution * s.vz}),
    ),
    ocp.Phase("rise", "fall", 0.40, target={"z": 0.6}),  # [s], [m]
)  # fmt: skip
problem = ocp.Problem(
    bounce,
    ball.until_end(dt=0.01),
    ocp.Objective(ocp.track("z", weight=1000.0, at="end"), ocp.regularize("thrust", weight=0.1)),
    initial=[1.0, 0.0],  # [m], [m/s]
)

# A rocket with a tank drops it and becomes a capsule, which has one state less and no control.


def burn(s):
    """Return the derivatives of height, speed and fuel; thrust in N, 1 kg without fuel, exhaust speed 1000 m/s."""
    return {"z": s.vz, "vz": s.thrust / (1.0 + s.fuel) - G, "fuel": -s.thrust / 1000.0}


def coast(s):
    """Return the derivatives of height and speed under gravity alone."""
    return {"z": s.vz, "vz": -G}


rocket = ocp.Model(
    "rocket", state={"z": 1, "vz": 1, "fuel": 1}, control={"thrust": 1}, modes={"burn": burn}, integrator="rk4"
)
capsule = ocp.Model("capsule", state={"z": 1, "vz": 1}, modes={"coast": coast}, integrator="rk4")
limits = ocp.Constraints(
    ocp.inequality(lambda s: s.thrust, lower=0.0, upper=25.0, unit="N", name="thrust limit"),
    ocp.inequality(lambda s: s.fuel, unit="kg", name="fuel left"),
)
launch = ocp.Problem(
    # no reset is needed: the states of the capsule, height and speed, are states of the rocket, too
    ocp.Motion(ocp.Phase("burn", "burn", 1.0, target={"z": 5.0}), ocp.Phase("coast", "coast", 1.0, target={"z": 10.0})),
    rocket.over(1.0, dt=0.05) + capsule.over(1.0, dt=0.05),
    ocp.Objective(
        ocp.track("z", weight=100.0, at="end"),
        ocp.track("vz", weight=10.0, to=0.0, at="end"),
        ocp.regularize("thrust", weight=1e-3),
    ),
    limits,
    initial=[0.0, 0.0, 0.1],  # [m], [m/s], [kg]
)


def main(name: str = "problem", bounciness: float = 0.8) -> float:
    """Solve one of the two and return the height at the end [m]."""
    declared = {"problem": problem.with_parameters(restitution=bounciness), "launch": launch}[name]
    solution = solvers.MSiLQR(declared).solve().raise_if_failed()
    print(declared)
    print(solution)
    return float(solution.trajectory.phases[-1].states[-1, 0])


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--name", default="problem", choices=["problem", "launch"])
    parser.add_argument("--bounciness", type=float, default=0.8)
    print(f"{main(**vars(parser.parse_args())):.3f} m")
