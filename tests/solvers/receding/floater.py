"""A body that floats over the plane: a model of one's own with a frame, for motions that turn and repeat elsewhere."""

from __future__ import annotations

from collections.abc import Hashable, Mapping

import casadi as cs

from piaffe import ocp
from piaffe.ocp.language.model import Dynamics, Quantities, Reset
from piaffe.ocp.language.quantity import Bound, Quantity

PLACE, ATTITUDE = Quantity("place", "m", "point"), Quantity("attitude", "rad", "rotation")
SPEED, PUSH = Quantity("speed", "m/s", "direction"), Quantity("push", "N", "direction")
XYZ = ("x", "y", "z")


class Floater(ocp.ModelBase):
    """A mass of 1 kg with an attitude that follows a turn rate; its vertical speed ends where it ``rests``."""

    def __init__(self, name: str = "floater") -> None:
        state = ocp.Manifold((ocp.Block(PLACE, XYZ), ocp.Block(ATTITUDE, XYZ), ocp.Block(SPEED, XYZ, rate_of=PLACE)))
        control = ocp.Manifold((ocp.Block(PUSH, XYZ), ocp.Block(Quantity("turn", "rad/s"), XYZ)))
        slots = (
            ocp.Slot("rests", 1, (0.0,)), ocp.Slot("lands", 1, (0.0,)), ocp.Slot("mass", 1, (1.0,), positive=True)
        )  # fmt: skip
        super().__init__(name, state, control, slots=slots)

    @property
    def planar_pose(self) -> tuple[Quantity, Quantity]:
        return PLACE, ATTITUDE

    def mode_key(self, mode: Hashable) -> str:
        return "floats"

    def node_parameters(self, node: ocp.Node) -> dict[str, object]:  # type: ignore[override]
        return {"rests": [float(node.mode == "rest")], "lands": [float(self.lands(node))]}

    def lands(self, node: ocp.Node) -> bool:
        return node.next_mode == "rest" and node.mode != "rest"

    def dynamics(self, key: str, x: cs.SX, u: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Dynamics:
        speed, push = x[7:10], u[:3]
        held = cs.vertcat(1, 1, 1 - p["rests"])
        change = cs.vertcat(p["dt"] * speed, p["dt"] * u[3:], p["dt"] * held * (push / p["mass"] - 0.3 * speed))
        return Dynamics(cs.SX(0, 1), self.state.plus(x, change), self._quantities(x, u))

    def reset(self, key: str, x: cs.SX, z: cs.SX, p: Mapping[str, cs.SX]) -> Reset:
        return Reset(cs.SX(0, 1), cs.vertcat(x[:9], (1 - p["lands"]) * x[9]))

    def switching(self, key: str, quantities: Quantities, p: Mapping[str, cs.SX]) -> Bound:
        return Bound(Quantity("gap", "m"), quantities.bind("place").value[2], ("",), mask=p["lands"])

    def _quantities(self, x: cs.SX, u: cs.SX) -> Quantities:
        made = {}
        for space, symbol in ((self.state, x), (self.control, u)):
            for block in space.blocks:
                value = symbol[space.slices[block.quantity]]
                made[block.quantity.path] = lambda b=block, v=value: Bound(b.quantity, v, b.labels)
        return Quantities(self.name, made)
