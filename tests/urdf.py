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


def crane() -> str:
    """Return the text of a trunk on two legs with prismatic knees, oblique to all axes, and a sliding weight on top."""
    slide = '<limit lower="-0.1" upper="0.15" effort="300" velocity="2"/>'
    text = cart(
        link("weight", 1.5, "0.02 0.01 0.03", 0.006)
        + joint("slide", "trunk", "weight", kind="prismatic", xyz="0.05 0 0.1", axis="0.6 0.64 0.48", limit=slide)
        + link("tip", 0.2, "0.03 0 0.02", 0.0005)
        + joint("wrist", "weight", "tip", xyz="0.01 0.02 0.05", axis="0 0.6 0.8")
    )
    for side in "lr":
        turning = joint(f"{side}_knee", f"{side}_thigh", f"{side}_shank", xyz="0 0 -0.25")
        place = "0 0 -0.25"
        axis = "0.1 0.05 -1"
        sliding = joint(
            f"{side}_knee", f"{side}_thigh", f"{side}_shank", kind="prismatic", xyz=place, axis=axis, limit=slide
        )
        assert turning in text
        text = text.replace(turning, sliding)
    return text
