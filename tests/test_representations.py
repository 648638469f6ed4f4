"""What a notebook or a prompt shows of an object: one line of text, or a short table."""

from html.parser import HTMLParser

import pytest

from piaffe import html, models, ocp, solvers
from tests import balls


class Shown(HTMLParser):
    """Counts rows, and checks that tags are closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows, self.words = 0, ""
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes) -> None:
        if not self.get_starttag_text().endswith("/>"):
            self.open.append(tag)
        self.rows += tag == "tr"

    def handle_endtag(self, tag) -> None:
        if tag != "polyline":
            assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        self.words += data + " "


def problem() -> ocp.Problem:
    motion = ocp.Motion(balls.phase("rise <fast>", 0.3, 1.2), balls.phase("fall", 0.2, 0.8))
    return balls.problem(motion, balls.ball().until_end(dt=0.01))


def objects() -> dict[str, object]:
    declared = problem()
    solver = solvers.MSiLQR(declared, backend="numpy")
    solution = solver.solve()
    return {
        "problem": declared, "motion": declared.motion, "compiled problem": solver.problem, "solution": solution,
        "trajectory": solution.trajectory, "robot": models.load("solo12"),
    }  # fmt: skip


@pytest.fixture(scope="module")
def shown() -> dict[str, object]:
    return objects()


@pytest.mark.parametrize("name", ["problem", "motion", "compiled problem", "solution", "trajectory", "robot"])
def test_an_object_is_shown_in_one_line_and_in_a_short_table(shown, name) -> None:
    text = repr(shown[name])
    assert "\n" not in text
    assert len(text) < 400
    table = Shown(shown[name]._repr_html_())
    assert 2 <= table.rows <= 2 * html.ROWS
    assert len(shown[name]._repr_html_()) < 10_000


def test_what_is_shown_is_what_matters(shown) -> None:
    assert repr(shown["motion"]) == "Motion(2 phases, 0.5 s: rise <fast>, fall)"
    assert "balls.py" in repr(shown["problem"])
    assert "ball until the end in 0.01 s; 3 costs, 1 constraints" in repr(shown["problem"])
    assert "2 phases, 50 stages of ball; 4 terms" in repr(shown["compiled problem"])
    assert repr(shown["solution"]).startswith(f"Solution(CONVERGED, {shown['solution'].iterations} iterations, ")
    assert repr(shown["trajectory"]) == "Trajectory(2 phases, 0 to 0.5 s: rise <fast>, fall)"
    assert repr(shown["trajectory"].phases[1]) == (
        "PhaseTrajectory('fall' of 'ball', 0.3 to 0.5 s, states (21, 2), controls (20, 1))"
    )
    assert "track z" in Shown(shown["problem"]._repr_html_()).words
    assert "FL_KFE" in Shown(shown["robot"]._repr_html_()).words
    assert "cost, by iteration" in Shown(shown["solution"]._repr_html_()).words


def test_names_are_text_also_if_they_look_like_tags(shown) -> None:
    assert "rise <fast>" in Shown(shown["motion"]._repr_html_()).words  # the parser found no tag of this name


def test_long_tables_are_cut() -> None:
    table = Shown(html.html_table("many", ("n",), [(n,) for n in range(100)]))
    assert table.rows == html.ROWS + 2
    assert "and 76 more" in table.words


@pytest.mark.parametrize("values", [[], [1.0], [0.0, -1.0, float("nan")]])
def test_a_curve_without_two_points_is_left_out(values) -> None:
    assert html.html_curve("cost", values) == ""
    assert html.html_curve("cost", [1.0, 1.0]).startswith("<figure")


def test_an_unconverged_solution_is_short_too() -> None:
    solution = solvers.MSiLQR(problem(), solvers.Options(max_iterations=1), backend="numpy").solve()
    assert repr(solution).startswith("Solution(ITERATION_LIMIT, 1 iterations")
    assert Shown(solution._repr_html_()).rows >= 2
