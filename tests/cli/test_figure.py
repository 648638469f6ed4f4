"""The figure shows what a solution holds."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from piaffe.cli.app import main
from piaffe.solvers import Solution
from piaffe.viz.curves import feet_of, forces, friction, panels, stance_feet
from piaffe.viz.figure import draw


def titles(figure: Figure) -> list[str]:
    return [axes.get_title(loc="left") for axes in figure.axes]


@pytest.mark.parametrize("ending", ["png", "pdf", "svg"])
def test_plot_writes_a_picture(ball: Path, tmp_path: Path, ending: str) -> None:
    target = tmp_path / "new folder" / f"ball.{ending}"
    assert main(["plot", str(ball), "-o", str(target), "--dpi", "60"]) == 0
    assert target.stat().st_size > 5000
    if ending == "png":
        assert np.ptp(imread(target)[..., :3]) > 0.9


def test_an_unknown_ending_is_refused(ball: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plot", str(ball), "-o", str(tmp_path / "ball.xyz")]) == 2
    assert "unknown kind of picture - got '.xyz', expected '.png', '.pdf' or '.svg'" in capsys.readouterr().err


def test_a_robots_figure_has_everything(hop: Path) -> None:
    figure = draw(Solution.load(hop))
    shown = titles(figure)
    wanted = ["Base position", "Base orientation", "Base velocity", "Base angular velocity"]
    wanted += [f"{joint} {what}" for what in ("angle", "speed", "torque") for joint in ("HAA", "HFE", "KFE")]
    wanted += ["Normal force", "Friction cone", "Cost", "Violations", "Cost by term"]
    assert [title for title in wanted if title not in shown] == []
    torque = figure.axes[shown.index("KFE torque")]
    limits = [
        line.get_ydata()[0] for line in torque.lines if len(set(line.get_ydata())) == 1 and len(line.get_ydata()) == 2
    ]
    assert -17.0 in limits  # the knees push near their limit


def test_models_of_ones_own_get_a_panel_per_quantity(ball: Path) -> None:
    solution = Solution.load(ball)
    assert [panel.title for panel in panels(solution)] == ["z", "vz", "thrust"]
    thrust = panels(solution)[-1]
    assert thrust.bounds == ((-3.0, 3.0),)
    assert thrust.curves[0].held
    assert feet_of(solution) == []
    assert {"z", "vz", "thrust", "Cost"} <= set(titles(draw(solution)))


def test_curves_are_those_of_the_solution(hop: Path) -> None:
    solution = Solution.load(hop)
    by_title = {panel.title: panel for panel in panels(solution)}
    knee = by_title["KFE angle"]
    assert [curve.label for curve in knee.curves] == ["FL", "FR", "HL", "HR"]
    assert len({curve.colour for curve in knee.curves}) == 4
    np.testing.assert_array_equal(knee.curves[2].values, solution.states[:, 7 + 8])
    np.testing.assert_array_equal(by_title["Base position"].curves[2].values, solution.states[:, 2])
    assert by_title["KFE torque"].bounds == ((-17.0, 17.0),)


def test_forces_are_those_of_the_feet_on_the_ground(hop: Path) -> None:
    solution = Solution.load(hop)
    times, force = forces(solution)
    assert (times.shape, force.shape) == ((23,), (23, 4, 3))
    assert friction(solution) == 0.6
    feet = feet_of(solution)
    assert [stance_feet(part, feet) for part in solution.trajectory.phases] == [feet, [], feet]
    flying = (times > 0.16 + 1e-9) & (times < 0.28 - 1e-9)
    assert np.all(force[flying] == 0)
    assert np.all(force[~flying][..., 2].sum(axis=1) >= 0)
