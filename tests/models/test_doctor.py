"""The doctor finds what was broken on purpose, names the part, and leaves healthy robots alone."""

import re

import pytest

from piaffe import models
from tests.robots import ROBOTS

FEET = ("FL_FOOT", "FR_FOOT", "HL_FOOT", "HR_FOOT")
CHEETAH = models.load("mini_cheetah").urdf.read_text()


def broken(tmp_path, *edits, feet=FEET):
    """Return the findings on Mini Cheetah after edits (pattern, replacement), each of which must apply."""
    text = CHEETAH
    for pattern, replacement in edits:
        text, count = re.subn(pattern, replacement, text, count=1, flags=re.DOTALL)
        assert count == 1, pattern
    urdf = tmp_path / "broken.urdf"
    urdf.write_text(text)
    return models.diagnose(urdf, feet=feet)


def of(findings, severity):
    return [str(finding) for finding in findings if finding.severity == severity]


@pytest.mark.parametrize("name", ROBOTS)
def test_known_robots_have_no_errors(name):
    assert of(models.diagnose(name), "error") == []


def test_go2_has_nothing_worth_a_warning():
    assert [finding.severity for finding in models.diagnose("go2")] == ["note"]


def test_equal_findings_of_several_parts_are_one():
    (warning,) = of(models.diagnose("mini_cheetah"), "warning")
    assert "link 'FL_THIGH', 'FR_THIGH', 'HL_THIGH', 'HR_THIGH': inertia is impossible for a rigid body" in warning


LINK, JOINT = r'(<link name="FL_SHANK">.*?', r'(<joint name="FL_KFE".*?'
CASES = [  # pattern, replacement, finding
    (LINK + r'ixx=")0.000245', r"\1-0.000245", r"error: link 'FL_SHANK': inertia is not positive"),
    (LINK + r'izz=")0.000006', r"\g<1>0", r"warning: link 'FL_SHANK': inertia is zero about an axis"),
    (
        LINK + r'ixx=").*?"/>',
        r'\g<1>245" iyy="248" izz="6" ixy="0" ixz="0" iyz="0"/>',
        r"warning: body 'FL_SHANK': inertia does not fit its mass - got a radius of gyration of",
    ),
    (LINK + r'<mass value=")0.064', r"\g<1>0", r"error: joint 'FL_KFE': moves no mass - got 0 kg"),
    (LINK + r'<mass value=")', r"\1-", r"error: link 'FL_SHANK': mass is impossible - got -0.064 kg"),
    (LINK + r'<mass value=")', r"\1x", r"error: link 'FL_SHANK': <inertial> is not numeric"),
    (JOINT + r")<limit.*?/>", r"\1", r"error: joint 'FL_KFE': has no <limit> - got none"),
    (JOINT + r'effort=")17', r"\g<1>0", r"warning: joint 'FL_KFE': torque limit is zero - got 0 Nm"),
    (JOINT + r'velocity=")20', r"\g<1>0", r"warning: joint 'FL_KFE': speed limit is missing - got 0 rad/s"),
    (
        JOINT + r'effort=")17',
        r"\g<1>1e4",
        r"warning: joint 'FL_KFE': torque limit looks like a placeholder - got 10000",
    ),
    (
        JOINT + r'effort=")17',
        r"\g<1>0.5",
        r"warning: joint 'FL_KFE': has too little torque to stand - got a limit of 0.5 Nm",
    ),
    (JOINT + r'upper=")', r"\1-9", r"error: joint 'FL_KFE': range is reversed - got -3.14159 to -93.1416"),
    (JOINT + r'type=")revolute', r"\1planar", r"error: joint 'FL_KFE': its type is not supported - got 'planar'"),
    (JOINT + r'axis xyz=")0 1 0', r"\g<1>0 2 0", r"warning: joint 'FL_KFE': axis is not a unit vector - got \[0.0,"),
    (JOINT + r'child link="FL_)SHANK', r"\1SHIN", r"error: joint 'FL_KFE': names a link that does not exist"),
    (r'(name="FL_HAA".*?<axis xyz=")1 0 0', r"\g<1>0 1 0", r"warning: foot 'FL': cannot move in all three di"),
    (r'(<link name="body">.*?origin xyz=")0 0 0', r"\1-0.6 0 0", r"warning: foot 'FL'.*: carries no weight in pose"),
]


@pytest.mark.parametrize(("pattern", "replacement", "message"), CASES, ids=[case[2][:60] for case in CASES])
def test_what_was_broken_is_found(pattern, replacement, message, tmp_path):
    findings = [str(finding) for finding in broken(tmp_path, (pattern, replacement))]
    assert any(re.match(message, finding) for finding in findings), findings


def test_limits_of_the_legs_that_keep_a_foot_up_are_found(tmp_path):
    edits = [
        (rf'(<joint name="FL_{joint}".*?)lower=".*?" upper=".*?"', rf'\1lower="{lower}" upper="{upper}"')
        for joint, lower, upper in (("HAA", -0.1, 0.1), ("HFE", 1.6, 1.7), ("KFE", 0.0, 0.1))
    ]
    (error,) = of(broken(tmp_path, *edits), "error")
    assert re.search(r"foot 'FL': does not reach the ground - got -?0.\d+ m at its lowest, expected below", error)


@pytest.mark.parametrize(
    ("feet", "severity", "message"),
    [
        (
            None,
            "note",
            r"feet: are not given - got none, expected at least one; choose their frames.* \['FL_SHANK', 'FL_FOO",
        ),
        (("FL_TOE",), "error", r"no frame 'FL_TOE' .* did you mean 'FL_FOOT'"),
        (("body", *FEET), "error", r"foot 'body': is fixed to the base - got no joint between base and foot, exp"),
        (("FL_SHANK", *FEET), "warning", r"foot 'FL_SHANK': shares joints .* - got joints in common with \['FL'\]"),
        (("FL_THIGH", *FEET[1:]), "warning", r"foot 'FL_THIGH': cannot move in all three directions - got 2 joint"),
    ],
)
def test_feet_are_examined(feet, severity, message, tmp_path):
    findings = of(broken(tmp_path, feet=feet), severity)
    assert any(re.search(message, finding) for finding in findings), findings


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nothing", r"is not XML - got 'syntax error"),
        ("<sdf/>", r"is not a URDF - got <sdf> as outermost tag, expected <robot>; convert"),
        ('<robot name="a"/>', r"robot: does not have one base link - got no links"),
        ('<robot name="a"><link name="b"/></robot>', r"robot: has no joints - got none that moves"),
    ],
)
def test_files_without_a_robot_are_distinguished(text, message, tmp_path):
    urdf = tmp_path / "odd.urdf"
    urdf.write_text(text)
    (finding,) = of(models.diagnose(urdf), "error")
    assert re.search(message, finding)


def test_the_worst_comes_first(tmp_path):
    severities = [f.severity for f in broken(tmp_path, (LINK + r'ixx=")0.000245', r"\1-0.000245"))]
    assert severities == sorted(severities, key=["error", "warning", "note"].index)


def test_a_copy_of_a_known_robot_is_told_by_its_name(tmp_path):
    notes = of(broken(tmp_path), "note")
    assert "note: robot: equals 'mini_cheetah': models.load('mini_cheetah') has its feet, poses and limits" in notes
    heavier = of(broken(tmp_path, (LINK + r'<mass value=")0.064', r"\g<1>0.074")), "note")
    assert not [note for note in heavier if "equals" in note]


def test_the_call_that_loads_the_robot_is_there_to_paste(tmp_path):
    (entry,) = [
        one.text for one in models.diagnose(written(tmp_path), feet=FEET, foot_radius=0.02) if one.where == "loader"
    ]
    assert entry.endswith("'HR': 'HR_FOOT'}, foot_radius=0.02)")
    robot = eval(entry, {"models": models})
    assert robot.foot_names == ("FL", "FR", "HL", "HR")
    assert robot.foot_radius == 0.02


def written(tmp_path):
    urdf = tmp_path / "mine.urdf"
    urdf.write_text(CHEETAH)
    return urdf
