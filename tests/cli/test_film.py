"""Films, and the simulation that may be filmed."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from matplotlib.image import imread

from piaffe.cli.app import main
from piaffe.errors import ModelError, ProblemError
from piaffe.solvers import Solution
from piaffe.viz import gl
from piaffe.viz.cuts import cuts_of, picture_size
from piaffe.viz.films import Cut, follow
from piaffe.viz.playback import Playback
from piaffe.viz.simulated import simulate


@pytest.fixture(scope="module")
def playback(hop: Path) -> Playback:
    return Playback(Solution.load(hop))


def command(*arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own: how MuJoCo renders is settled when it is imported."""
    line = [sys.executable, "-W", "error", "-m", "piaffe", *map(str, arguments)]
    return subprocess.run(line, env={**os.environ, **environment}, capture_output=True, text=True)


# ---- films


def test_solve_films_what_it_solved(hop_file: Path, tmp_path: Path) -> None:
    done = command("solve", hop_file, "--no-save", "--video", tmp_path / "hop.png", "--json")
    if done.returncode == 2:
        assert "OpenGL" in done.stderr
        return
    assert done.returncode == 0
    assert (tmp_path / "hop.png").read_bytes().startswith(b"\x89PNG")


def test_video_writes_a_film_or_names_the_package(hop: Path, tmp_path: Path) -> None:
    target = tmp_path / "new folder" / "hop.mp4"
    done = command(
        "video",
        hop,
        "-o",
        target,
        "--size",
        "192x108",
        "--fps",
        10,
        "--speed",
        1,
        "--speed",
        0.5,
        "--ghost",
        "--simulate",
    )
    if done.returncode:
        assert done.returncode == 2
        assert "libosmesa6" in done.stderr
        return
    assert done.stderr == ""
    assert "followed the plan to its end" in done.stdout
    raw = [
        imageio_ffmpeg.get_ffmpeg_exe(),
        "-loglevel",
        "error",
        "-i",
        target,
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-",
    ]
    film = subprocess.run(raw, capture_output=True, check=True).stdout
    pictures = np.frombuffer(film, np.uint8).reshape(-1, 108, 192, 3)
    assert len(pictures) == (4 + 1 + 4) + (8 + 1 + 4)  # 0.4 s, then once more at half the speed, each with a pause
    assert all(np.ptp(picture) > 100 for picture in pictures)
    assert np.any(pictures[0] != pictures[2])
    assert [path.name for path in target.parent.iterdir()] == ["hop.mp4"]


def test_video_writes_six_moments_as_a_picture(hop: Path, tmp_path: Path) -> None:
    target = tmp_path / "hop.png"
    done = command("video", hop, "-o", target, "--size", "300x160")
    if done.returncode:
        assert "libosmesa6" in done.stderr
        return
    picture = imread(target)
    assert picture.shape[:2] == (160 + 4, 300 + 8)
    assert np.abs(picture[:80, :100] - picture[84:, 208:]).max() > 0.3  # the first and the last moment


def test_a_machine_without_opengl_is_told_what_to_install(hop: Path, tmp_path: Path) -> None:
    done = command("video", hop, "-o", tmp_path / "hop.mp4", MUJOCO_GL="abacus")
    assert done.returncode == 2
    assert "MuJoCo cannot render here - got no working OpenGL (tried abacus), expected EGL or OSMesa" in " ".join(
        done.stderr.split()
    )
    assert "apt-get install libosmesa6" in " ".join(done.stderr.split())
    assert list(tmp_path.iterdir()) == []


def test_the_first_backend_that_works_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "")
    tried: list[str] = []

    def works(backend: str, timeout_s: float) -> bool:
        tried.append(backend)
        return backend == "osmesa"

    monkeypatch.setattr(gl, "works", works)
    assert gl.prepare() == "osmesa"
    assert tried == ["egl", "osmesa"]
    assert os.environ["MUJOCO_GL"] == "osmesa"


@pytest.mark.parametrize("size", ["big", "0x0", "641x360", "640", "640x360x3"])
def test_sizes_that_make_no_film_are_refused(size: str) -> None:
    with pytest.raises(ProblemError, match=f"size is unusable - got '{size}', expected two even numbers"):
        picture_size(size)


def test_an_unknown_ending_is_refused(hop: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["video", str(hop), "-o", str(tmp_path / "hop.avi")]) == 2
    assert (
        "unknown kind of film - got '.avi', expected '.mp4', or '.png' for single pictures" in capsys.readouterr().err
    )


def test_a_model_without_a_robot_cannot_be_shown(ball: Path) -> None:
    with pytest.raises(ModelError, match=r"no robot to show - got models \['ball'\]"):
        Playback(Solution.load(ball))


def test_speed_stretches_time(playback: Playback) -> None:
    slow = Cut(playback.at, 0.0, 0.4, 0.25)
    times = slow.times(50.0)
    assert np.all(np.diff(times) >= 0)
    assert times[-1] == pytest.approx(0.4)
    assert np.sum(times < 0.4 - 1e-9) == 80
    with pytest.raises(ProblemError, match="speed is out of range - got 0"):
        cuts_of(playback, [0.0], ghost=False, simulated=False, mu=None)


def test_the_camera_follows_without_jolts(playback: Playback) -> None:
    shown = [playback.at(t) for t in np.linspace(0, 0.4, 41)]
    still = follow([shown[0]] * 20, 50.0)
    np.testing.assert_allclose(still, np.tile(shown[0].qpos[:3], (20, 1)), atol=1e-12)
    path = follow(shown, 100.0)
    assert np.ptp(path[:, 2]) < np.ptp([snapshot.qpos[2] for snapshot in shown])


# ---- what is shown


def test_poses_are_those_of_the_nodes(playback: Playback) -> None:
    for part in playback.trajectory.phases:
        for k in range(len(part.times) - 1):
            shown = playback.at(float(part.times[k]))
            np.testing.assert_allclose(shown.qpos, part.states[k, :19], atol=1e-12)
            assert shown.phase == part.name
    assert playback.at(0.05).contact == (True,) * 4
    assert playback.at(0.22).contact == (False,) * 4


def test_the_ghost_is_what_was_asked_for(playback: Playback) -> None:
    asked = playback.at(0.16 - 1e-6, ghost=True).ghost
    assert asked is not None
    assert asked[:3] == pytest.approx([0, 0, 0.28], abs=1e-4)
    assert playback.at(0.1).ghost is None


# ---- simulation


def test_the_policy_hops_in_simulation(playback: Playback) -> None:
    run, snapshots = simulate(playback)
    assert run.lost_at is None
    assert len(snapshots) == 401
    assert run.position.max() < 0.05
    assert snapshots[0].forces[:, 2].sum() >= 0
    standing = [s for s in snapshots if s.time < 0.14]
    weight = playback.robot.mass * 9.81
    assert np.mean([s.forces[:, 2].sum() for s in standing]) == pytest.approx(weight, rel=0.6)
    assert max(abs(s.forces[:, 2]).max() for s in snapshots if 0.2 < s.time < 0.24) == 0


def test_what_is_seen_of_a_simulation_is_the_simulated_robot_with_the_plan_as_its_ghost(playback: Playback) -> None:
    run, snapshots = simulate(playback)
    for i in (0, 100, 200, 400):
        shown = snapshots[i]
        np.testing.assert_array_equal(shown.qpos, run.states[i, :19])
        assert shown.ghost == pytest.approx(playback.at(shown.time).qpos, abs=1e-12)
        assert shown.phase == playback.at(shown.time).phase
        assert shown.contact == tuple(force[2] > 1e-3 for force in run.forces[i])
    (cut,), said = cuts_of(playback, [0.5], ghost=False, simulated=True, mu=None)
    assert said == str(run)
    assert cut.note == "simulation"
    np.testing.assert_array_equal(cut.shown(0.1003).qpos, snapshots[100].qpos)
    assert cut.shown(0.1).ghost is None


def test_without_feedback_and_torque_the_plan_is_lost(playback: Playback) -> None:
    parts = tuple(replace(part, controls=np.zeros_like(part.controls)) for part in playback.trajectory.phases)
    gains = tuple(replace(p, feedback=np.zeros_like(p.feedback)) for p in playback.solution.phases)
    limp = replace(playback.solution, trajectory=replace(playback.trajectory, phases=parts), phases=gains)
    run, _ = simulate(Playback(limp))
    assert run.position.max() > 0.05
    assert run.position.max() > 3 * simulate(playback)[0].position.max()
    assert ("lost the plan at" in str(run)) == (run.lost_at is not None)


def test_only_a_whole_body_is_simulated(playback: Playback) -> None:
    parts = tuple(replace(part, states=part.states[:, :13]) for part in playback.trajectory.phases)
    short = replace(playback.solution, trajectory=replace(playback.trajectory, phases=parts))
    with pytest.raises(
        ModelError, match="does not begin with such states - got model 'mini_cheetah' with 13 states, expected 37"
    ):
        simulate(Playback(short))


# ---- a receding horizon


EXAMPLES = Path(__file__).parents[2] / "examples"


def test_the_film_of_a_receding_horizon_shows_what_stands_on_the_plants_ground(tmp_path: Path) -> None:
    text, pictures = (EXAMPLES / "other_go2.xml").read_text(), []
    box = '<geom type="box" pos="0.9 0 0.1" size="0.1 0.5 0.1" rgba="1 0 0 1"/>'
    for name, found in (("plain", text), ("box", text.replace("<worldbody>", f"<worldbody>{box}"))):
        (tmp_path / f"{name}.xml").write_text(found)
        done = command(
            "mpc", EXAMPLES / "go2_mpc.py", "--seconds", 0.1, "--plant", tmp_path / f"{name}.xml",
            "--names", EXAMPLES / "other_go2.toml", "--video", tmp_path / f"{name}.png", "--size", "480x270",
        )  # fmt: skip
        if done.returncode == 2:
            assert "libosmesa6" in done.stderr
            return
        assert done.returncode == 0, done.stderr
        pictures.append(imread(tmp_path / f"{name}.png")[..., :3])
    red = [(picture[..., 0] > 0.4) & (picture[..., 1:].max(axis=-1) < 0.2) for picture in pictures]
    assert red[0].mean() < 0.001
    assert red[1].mean() > 0.01
