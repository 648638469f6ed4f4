"""Trajectories as CSV and as tables of pandas: what is written is read back, and other files are read or refused."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from piaffe import models, ocp, solvers
from piaffe.errors import FileFormatError, ProblemError
from piaffe.models import base, feet, joints, stance

ROBOT = models.load("solo12")
BODY = models.WholeBody(ROBOT)
RIGID = models.SingleRigidBody(ROBOT)


@pytest.fixture(scope="module")
def solution() -> solvers.Solution:
    """A short hop whose last phase has another model: controls, forces, an impulse, two state sizes."""
    four = stance("FL FR HL HR")
    motion = ocp.Motion(
        ocp.Phase("push", four, 0.1, ocp.Keyframe(position=(0, 0, 0.24))),
        ocp.Phase("fly", stance(""), 0.06, ocp.Keyframe(position=(0, 0, 0.24))),
        ocp.Phase("land", four, 0.1, ocp.Keyframe(position=(0, 0, 0.24))),
        ocp.Phase("rest", four, 0.2, ocp.Keyframe(position=(0, 0, 0.24))),
    )
    objective = ocp.Objective(
        ocp.track(base.position, weight=20.0), ocp.track(base.orientation, weight=5.0),
        ocp.regularize(joints.torque, weight=0.05), ocp.regularize(models.feet.force, weight=1e-3),
    )  # fmt: skip
    schedule = BODY.over(0.26, dt=0.02) + RIGID.until_end(dt=0.05)
    problem = ocp.Problem(motion, schedule, objective, initial=BODY.state(joints="stand"))
    return solvers.MSiLQR(problem, solvers.Options(max_iterations=5)).solve()


def test_what_is_written_is_read_back(solution, tmp_path) -> None:
    path = solution.to_csv(tmp_path / "hop.csv")
    read = ocp.Trajectory.from_csv(path, BODY, RIGID)
    for found, part in zip(read.phases, solution.trajectory.phases, strict=True):
        assert (found.name, found.mode, found.model, found.ends_phase) == (
            part.name, part.mode, part.model, part.ends_phase,
        )  # fmt: skip
        for name in ("times", "states", "controls"):
            assert np.array_equal(getattr(found, name), getattr(part, name))
        for name in ("outputs", "reset_outputs"):
            kept = getattr(found, name)
            expected = {of: v for of, v in getattr(part, name).items() if of not in part.control.slices}
            assert list(kept) == list(expected)
            assert all(np.array_equal(kept[of], expected[of]) for of in expected)
            assert all(found.output_labels[of] == part.output_labels[of] for of in expected)
    assert any(part.reset_outputs for part in read.phases)
    assert ocp.Motion.from_trajectory(ocp.Trajectory(read.phases[:3])).duration == pytest.approx(0.26)


def test_columns_are_named_by_quantity_component_and_unit(solution, tmp_path) -> None:
    names, first, *_ = solution.to_csv(tmp_path / "hop.csv").read_text().splitlines()
    assert names.split(",")[:9] == [
        "time [s]", "phase", "mode", "model", "ends_phase",
        "base.position x [m]", "base.position y [m]", "base.position z [m]", "base.orientation w",
    ]  # fmt: skip
    assert {"joints.position FL_HAA [rad]", "feet.force FL x [N]", "feet.impulse HR z [N s]"} <= set(names.split(","))
    assert first.split(",")[:4] == ["0.0", "push", "FL FR HL HR", "solo12"]


def test_labels_of_outputs_are_saved_with_a_solution(solution, tmp_path) -> None:
    read = solvers.Solution.load(solution.save(tmp_path / "hop.npz"))
    assert [p.output_labels for p in read.trajectory.phases] == [p.output_labels for p in solution.trajectory.phases]


def test_motion_capture_needs_neither_velocities_nor_controls(tmp_path) -> None:
    times = np.linspace(0.0, 0.5, 26)
    rows = [BODY.state(position=(0.4 * t, 0, 0.25), rpy=(0, 0, 0.6 * t), joints="stand") for t in times]
    names = ["time [s]", *(f"base.position {axis} [m]" for axis in "xyz"), *(f"base.orientation {c}" for c in "wxyz")]
    names += [f"joints.position {name} [rad]" for name in ROBOT.joint_names]
    table = np.column_stack([times, np.array(rows)[:, :19]])
    np.savetxt(tmp_path / "capture.csv", table, "%.17g", ",", header=",".join(names), comments="")
    (part,) = ocp.Trajectory.from_csv(tmp_path / "capture.csv", BODY).phases
    values = part.state.unpack(part.states)
    assert np.allclose(values[base.linear_velocity], (0.4, 0, 0), atol=1e-12)
    assert np.allclose(values[base.angular_velocity], (0, 0, 0.6), atol=1e-12)
    assert not part.controls.any()
    assert part.controls.shape == (25, 12)
    assert ocp.Motion.from_trajectory(ocp.Trajectory((part,)), {"recorded": stance("FL FR HL HR")}).duration == 0.5


HEAD = "time [s],z,vz,thrust\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no table - got 0 rows"),
        (HEAD, "has no table - got 0 rows"),
        ("t,z,vz\n0,1,0\n1,1,0\n", r"has no column 'time \[s\]' - got \['t', 'z', 'vz'\]"),
        (HEAD + "0,1,0,0\n", "times do not increase"),
        (HEAD + "0,1,0,0\n0.2,1,0,0\n0.1,1,0,0\n", "times do not increase"),
        (HEAD + "0,1,0,0\n0.1,1,0\n", "row 2: has another length - got 3 values, expected 4"),
        (HEAD + "0,1,0,0\n0.1,1;5,0,0\n", "column 'z': is no number - got .*1;5"),
        ("time [s],vz\n0,1\n0.1,1\n", "has no column 'z'"),
        ("time [s],model,z,vz\n0,other,1,0\n0.1,other,1,0\n", r"unknown - got 'other', expected one of \['ball'\]"),
        (b"\xff\xfe", "cannot be read - got .* codec"),
    ],
)  # fmt: skip
def test_other_files_are_refused_by_name(text, words, tmp_path) -> None:
    def fall(s):
        return {"z": s.vz, "vz": s.thrust}

    ball = ocp.Model("ball", state={"z": 1, "vz": 1}, control={"thrust": 1}, modes={"fall": fall})
    path = tmp_path / "file.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(FileFormatError, match=rf"trajectory '{path}'.*{words}"):
        ocp.Trajectory.from_csv(path, ball)
    with pytest.raises(FileFormatError, match="cannot be read - got .*No such file"):
        ocp.Trajectory.from_csv(tmp_path / "missing.csv", ball)


def test_quaternions_of_another_length_are_refused(solution, tmp_path) -> None:
    path = solution.to_csv(tmp_path / "hop.csv")
    path.write_text(path.read_text().replace(",1.0,0.0,0.0,0.0,", ",1.5,0.0,0.0,0.0,", 1))
    with pytest.raises(FileFormatError, match=r"is no rotation - got a quaternion of length 1\.5"):
        ocp.Trajectory.from_csv(path, BODY, RIGID)


def test_a_table_of_pandas_has_the_same_columns(solution, monkeypatch, tmp_path) -> None:
    pandas = pytest.importorskip("pandas") if "pandas" in sys.modules else SimpleNamespace(DataFrame=dict)
    monkeypatch.setitem(sys.modules, "pandas", pandas)
    table = solution.to_pandas()
    names = solution.to_csv(tmp_path / "hop.csv").read_text().splitlines()[0].split(",")
    assert list(table) == names
    states = np.concatenate([part.states[:, 2] for part in solution.trajectory.phases])
    assert np.array_equal(np.asarray(table["base.position z [m]"]), states)


def test_a_log_has_every_number(solution, tmp_path) -> None:
    from mcap.reader import make_reader

    path = solution.to_mcap(tmp_path / "hop.mcap")
    found: dict[str, list[tuple[float, dict]]] = {}
    with path.open("rb") as stream:
        reader = make_reader(stream)
        for schema, channel, message in reader.iter_messages():
            assert schema.encoding == "jsonschema"
            found.setdefault(channel.topic, []).append((message.log_time * 1e-9, json.loads(message.data)))
    parts = solution.trajectory.phases
    times = np.concatenate([part.times[: len(part.times) if part is parts[-1] else -1] for part in parts])
    assert np.allclose([t for t, _ in found["/base.position"]], times, atol=1e-9)
    heights = np.concatenate([p.states[: len(p.times) if p is parts[-1] else -1, 2] for p in parts])
    assert np.allclose([message["z"] for _, message in found["/base.position"]], heights, atol=1e-12)
    forces = np.concatenate([p.sample(t)[feet.force][:3][None] for p in parts for t in p.times[:-1]])
    logged = [[message[f"FL {axis}"] for axis in "xyz"] for _, message in found["/feet.force"]]
    assert np.allclose(logged, forces, atol=1e-12)
    assert set(found["/joints.position"][0][1]) == set(ROBOT.joint_names)
    _, pose = found["/tf/base"][3]
    assert pose["child_frame_id"] == "base"
    assert list(pose["rotation"].values()) == pytest.approx(list(parts[0].states[3, 3:7]), abs=1e-12)
    assert [message["name"] for _, message in found["/phase"]] == [part.name for part in parts]


def test_a_log_without_its_package_says_what_to_install(solution, monkeypatch, tmp_path) -> None:
    monkeypatch.setitem(sys.modules, "mcap.writer", None)
    with pytest.raises(ProblemError, match=r"to_mcap: .* pip install 'piaffe\[log\]'"):
        solution.to_mcap(tmp_path / "hop.mcap")
    assert list(tmp_path.iterdir()) == []
