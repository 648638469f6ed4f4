"""Small URDF files for tests: a two-legged cart whose legs have three joints, with room for one change."""

from __future__ import annotations

LIMIT = '<limit lower="-2" upper="2.5" effort="25" velocity="15"/>'
FEET = ("l_foot", "r_foot")


def link(name: str, mass: object = None, com: str = "0 0 0", inertia: float = 0.01) -> str:
    """Return a link; without a mass it has no <inertial>."""
    if mass is None:
        return f'<link name="{name}"/>'
    tensor = f'<inertia ixx="{inertia}" iyy="{inertia}" izz="{inertia}" ixy="0" ixz="0" iyz="0"/>'
    return f'<link name="{name}"><inertial><origin xyz="{com}"/><mass value="{mass}"/>{tensor}</inertial></link>'


def joint(
    name: str, parent: str, child: str, *, kind: str = "revolute", xyz: str = "0 0 0", axis: str = "0 1 0",
    limit: str = LIMIT, extra: str = "",
) -> str:  # fmt: skip
    """Return a joint."""
    rest = "" if kind == "fixed" else f'<axis xyz="{axis}"/>{limit}'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{rest}{extra}</joint>'
    )


def leg(side: str, y: float, parent: str = "trunk") -> str:
    """Return a leg: roll and pitch at the hip, pitch at the knee."""
    return "".join([
        link(f"{side}_hip", 0.4, inertia=0.0008),
        joint(f"{side}_roll", parent, f"{side}_hip", xyz=f"0 {y} 0", axis="1 0 0"),
        link(f"{side}_thigh", 0.7, "0 0 -0.12", 0.004),
        joint(f"{side}_pitch", f"{side}_hip", f"{side}_thigh"),
        link(f"{side}_shank", 0.3, "0 0 -0.11", 0.002),
        joint(f"{side}_knee", f"{side}_thigh", f"{side}_shank", xyz="0 0 -0.25"),
        link(f"{side}_foot"),
        joint(f"{side}_ankle", f"{side}_shank", f"{side}_foot", kind="fixed", xyz="0 0 -0.24"),
    ])  # fmt: skip


def robot(body: str, name: str = "cart") -> str:
    """Return the text of a URDF file."""
    return f'<?xml version="1.0"?>\n<robot name="{name}">{body}</robot>\n'


def cart(extra: str = "") -> str:
    """Return the text of a trunk on two legs."""
    return robot(link("trunk", 6.0, inertia=0.08) + leg("l", 0.1) + leg("r", -0.1) + extra)
