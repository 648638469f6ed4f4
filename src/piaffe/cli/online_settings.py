"""The settings of ``piaffe mpc`` and of a study's cells with it, and their checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

import numpy as np

from piaffe.errors import ModelError, SolverError, UnknownNameError
from piaffe.simulation import NOISE, Perturbation, SensorNoise, Variation

LOWS = ("vwbc", "riccati", "pd")
QPS = ("own", "numpy", "daqp", "osqp")
COMMANDS = "command line"

MASS, FRICTION = 0.05, (0.5, 0.8)
"""What seeds draw by default: share of the masses, and friction."""


@dataclass(frozen=True, kw_only=True)
class OnlineSettings:
    """What is run, in values that JSON can hold.

    Args:
        low: name of the low level.
        qp: method of its quadratic program; None for its own.
        gains: of the joints, as ``"3:0.5"`` [Nm/rad], [Nm s/rad]: added to those of vwbc and riccati, or those of pd.
        seconds: duration of an episode [s].
        latency: from a state to the first effect of its plan [s]; None for that of the file.
        push, command: texts, as ``"1.5@2.7:y"`` and ``"vx=0.5@0"``.
        payload: mass on the plant's base [kg].
        plant: path of a MuJoCo model of the robot; None for the robot of the problem.
        joints, feet: from the robot's names to those of this file.
        spread: whether seeds draw masses, friction, first state and noise, where these are not given.
        mass_spread: largest relative change of masses.
        friction: of the plant; two numbers are the range of what is drawn.
        perturbation: factor of the perturbations of the first state.
        noise: factor of the sensors' noise.
        settle: time after each change of the command that does not count for the speed [s].
        speed_bound: largest relative error of the speed of a success.

    Raises:
        ModelError: a number is out of range.
        UnknownNameError: there is no such low level or quadratic program.
        SolverError: the low level has no quadratic program.
    """

    low: str = "vwbc"
    qp: str | None = None
    gains: str | None = None
    seconds: float = 10.0
    latency: float | None = None
    push: str = ""
    command: str = ""
    payload: float = 0.0
    plant: str | None = None
    joints: Mapping[str, str] = field(default_factory=dict)
    feet: Mapping[str, str] = field(default_factory=dict)
    spread: bool = True
    mass_spread: float | None = None
    friction: float | tuple[float, float] | None = None
    perturbation: float | None = None
    noise: float | None = None
    settle: float = 2.0
    speed_bound: float = 0.05

    def __post_init__(self) -> None:
        if self.low not in LOWS:
            raise UnknownNameError(COMMANDS, "low level", self.low, LOWS)
        if self.qp is not None and self.qp not in QPS:
            raise UnknownNameError(COMMANDS, "quadratic program", self.qp, QPS)
        if self.qp is not None and self.low != "vwbc":
            raise SolverError(
                f"{COMMANDS}: low level '{self.low}' has no quadratic program - got --qp {self.qp}, expected --low "
                "vwbc; remove --qp"
            )
        self.joint_gains  # noqa: B018  # refused now
        if (self.joints or self.feet) and self.plant is None:
            raise ModelError(
                f"{COMMANDS}: names are given without a file that has them - got joints={dict(self.joints)} and feet="
                f"{dict(self.feet)}, expected --plant FILE.xml, too; give it"
            )
        for name in ("settle", "speed_bound", "perturbation", "noise"):
            value = getattr(self, name)
            if value is not None and not (_is_number(value) and 0 <= value < np.inf):
                raise ModelError(
                    f"{COMMANDS}: {name} is out of range - got {value!r}, expected a number ≥ 0; change it"
                )

    @property
    def values(self) -> dict[str, Any]:
        """All settings, with the quadratic program and what is drawn filled in."""
        drawn = self.variation
        return {
            **asdict(self), "qp": (self.qp or "own") if self.low == "vwbc" else None, "mass_spread": drawn.mass,
            "friction": self.fixed_friction if drawn.friction is None else list(drawn.friction),
            "perturbation": self._factor(self.perturbation), "noise": self._factor(self.noise),
        }  # fmt: skip

    @property
    def joint_gains(self) -> tuple[float, float] | None:
        """Stiffness and damping of the joints; None for the low level's own."""
        if self.gains is None:
            return None
        try:
            kp, kd = (float(part) for part in self.gains.split(":"))
        except (ValueError, AttributeError):
            kp = kd = np.nan
        if not (0 <= kp < np.inf and 0 <= kd < np.inf):
            raise ModelError(
                f"{COMMANDS}: gains are unusable - got {self.gains!r}, expected stiffness and damping, two numbers ≥ 0 "
                "as 3:0.5; change them"
            )
        return kp, kd

    @property
    def fixed_friction(self) -> float | None:
        """Friction of all seeds; None if it is drawn or not given."""
        return float(self.friction) if isinstance(self.friction, int | float) else None

    @property
    def variation(self) -> Variation:
        """What seeds draw. A file has masses and friction of its own: these are drawn only if a range is given."""
        own = self.spread and self.plant is None
        pair = (FRICTION if own else None) if self.friction is None else self.friction
        mass = (MASS if own else 0.0) if self.mass_spread is None else self.mass_spread
        return Variation(
            mass=mass,
            friction=None if isinstance(pair, int | float) or pair is None else (pair[0], pair[1]),
            start=Perturbation().scaled(self._factor(self.perturbation)),
            noise=NOISE.scaled(self._factor(self.noise)) if self._factor(self.noise) else SensorNoise(),
        )

    def _factor(self, given: float | None) -> float:
        return float(self.spread) if given is None else float(given)


def settings_of(given: Mapping[str, Any], where: str) -> OnlineSettings:
    """Return settings by name, as a study's file has them.

    Raises:
        UnknownNameError: there is no such setting.
        ModelError: a value is unusable.
    """
    known = [each.name for each in fields(OnlineSettings)]
    for name in given:
        if name not in known:
            raise UnknownNameError(where, "setting of 'mpc'", name, known)
    values = dict(given)
    if isinstance(values.get("friction"), str):
        values["friction"] = friction_of(values["friction"])
    for name, kind in {"spread": bool, "low": str, "push": str, "command": str, "joints": dict, "feet": dict}.items():
        if name in values and not isinstance(values[name], kind):
            raise ModelError(f"{where}: {name} is unusable - got {values[name]!r}, expected a {kind.__name__}; fix it")
    for name in ("seconds", "latency", "payload"):
        if not (_is_number(values.get(name, 0.0)) or (name == "latency" and values[name] is None)):
            raise ModelError(f"{where}: {name} is unusable - got {values[name]!r}, expected a number; fix it")
    return OnlineSettings(**values)


def friction_of(text: str) -> float | tuple[float, float]:
    """Return the friction of a text, ``"0.6"``, or the two ends of ``"0.5:0.8"``.

    Raises:
        ModelError: the text is neither.
    """
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        return numbers[0]
    if len(numbers) == 2:
        return numbers[0], numbers[1]
    raise ModelError(
        f"{COMMANDS}: friction is unusable - got '{text}', expected a number, or two as 0.5:0.8 to draw one; change it"
    )


def friction_text(friction: float | tuple[float, float] | None) -> float | str | None:
    """Return a friction as a study's file has it: a number, or a range as a text."""
    return f"{friction[0]:g}:{friction[1]:g}" if isinstance(friction, tuple) else friction


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
