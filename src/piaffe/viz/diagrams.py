"""The diagrams of a figure: curves over time, forces with their cone, defects, history and cost by term."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from piaffe.models import measures

from .curves import Panel, feet_of, forces, friction, impulses
from .style import AXES, BOUND, FAINT, FLIGHT, INK, LEGS, NEUTRAL, SHADES

_LEGEND = 3  # largest number of entries of a legend next to each other

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from piaffe.solvers import Solution

_SMALLEST = 0.02  # [m], [rad], ...: smallest range of a diagram's vertical axis
_TERMS = 9  # more do not fit


# ---- common parts of panels


def over_time(axes: Axes, solution: Solution) -> None:
    """Shade the phases and set the time axis."""
    parts = solution.trajectory.phases
    for i, part in enumerate(parts):
        axes.axvspan(part.times[0], part.times[-1], color=shade(solution, i), lw=0, zorder=0)
    axes.set_xlim(parts[0].times[0], parts[-1].times[-1])
    axes.tick_params(labelsize=7.5)


def shade(solution: Solution, i: int) -> str:
    """Return the background colour of a phase."""
    part = solution.trajectory.phases[i]
    return FLIGHT if feet_of(solution) and part.mode in ("", "flight") else SHADES[i % 2]


def draw_panel(axes: Axes, panel: Panel) -> None:
    """Draw curves, targets and limits."""
    for curve in panel.curves:
        style = "steps-post" if curve.held else "default"
        axes.plot(curve.times, curve.values, color=curve.colour, label=curve.label, drawstyle=style)
    low, high = axes.get_ylim()
    if panel.unit and high - low < _SMALLEST:  # smaller motions are not relevant
        low, high = 0.5 * (low + high - _SMALLEST), 0.5 * (low + high + _SMALLEST)
    for curve in panel.curves:
        if curve.target is not None:
            axes.plot(curve.times, curve.target, color=curve.colour, lw=0.9, ls=(0, (1, 1.6)), alpha=0.75, zorder=1.5)
    for lower, upper in panel.bounds:
        for bound, sign in ((lower, -1), (upper, 1)):
            if bound is None:
                continue
            near = sign * bound - sign * (high if sign > 0 else low) < 0.5 * (high - low)
            if near or panel.curves[0].held:  # limits of controls are always shown
                low, high = min(low, bound), max(high, bound)
                axes.axhline(bound, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    for times, values in panel.moving_bounds:
        axes.plot(times, values, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
        if np.any(np.isfinite(values)):
            low, high = min(low, np.nanmin(values)), max(high, np.nanmax(values))
    margin = 0.05 * (high - low)
    axes.set_ylim(low - margin, high + margin)
    axes.set_title(panel.title)
    axes.set_ylabel(f"[{panel.unit}]" if panel.unit else "")
    if panel.legend:
        add_legend(axes, min(len(panel.curves), _LEGEND))


def add_legend(axes: Axes, columns: int) -> None:
    """Draw the legend above the diagram, at the right of its title."""
    axes.legend(
        loc="lower right", bbox_to_anchor=(1.0, 0.97), borderaxespad=0.0, ncols=min(columns, 6), handletextpad=0.4,
        handlelength=1.0, columnspacing=0.9,
    )  # fmt: skip


# ---- forces


def normal_forces(axes: Axes, solution: Solution) -> None:
    """Draw the force on each foot, along the normal of the ground."""
    over_time(axes, solution)
    times, force = forces(solution)
    for i, foot in enumerate(feet_of(solution)):
        axes.plot(times, force[:, i, 2], color=LEGS[i % len(LEGS)], drawstyle="steps-post", label=foot)
    axes.set_title("Normal force")
    axes.set_ylabel("[N]")


def cone(axes: Axes, solution: Solution) -> None:
    """Draw tangential against normal force, with the friction cone; impulses too, scaled to the same size."""
    _, force = forces(solution)
    normal = force[..., 2]
    pushing = np.abs(force).max(axis=-1) > 1e-6
    for i in range(force.shape[1]):
        on = pushing[:, i]
        axes.plot(force[on, i, 0], normal[on, i], ".", ms=3.2, color=LEGS[i % len(LEGS)], alpha=0.85)
        axes.plot(force[on, i, 1], normal[on, i], "+", ms=3.6, mew=0.8, color=LEGS[i % len(LEGS)], alpha=0.85)
    mu, top = friction(solution), float(np.nanmax(normal, initial=1.0)) * 1.08
    _, impulse = impulses(solution)
    largest = float(np.nanmax(np.abs(impulse), initial=0.0))
    if largest > 0.0:
        scaled = impulse * (0.9 * top / largest)
        for i in range(scaled.shape[1]):
            on = np.isfinite(impulse[:, i, 0])
            look: dict[str, Any] = {
                "ls": "",
                "mec": LEGS[i % len(LEGS)],
                "mfc": "none",
                "mew": 0.9,
                "ms": 4.5,
                "zorder": 3,
            }
            axes.plot(scaled[on, i, 0], scaled[on, i, 2], marker="D", **look)
            axes.plot(scaled[on, i, 1], scaled[on, i, 2], marker="s", **look)
        axes.text(
            1.0, 0.03, f"◇ $Λ_x$, □ $Λ_y$ [N s] × {0.9 * top / largest:.3g} /s", transform=axes.transAxes, ha="right",
            va="bottom", color=FAINT, fontsize=7,
        )  # fmt: skip
    if mu is not None:
        axes.plot([-mu * top, 0, mu * top], [top, 0, top], color=BOUND, lw=0.9, ls=(0, (4, 2)), zorder=1)
        axes.fill([-mu * top, 0, mu * top], [top, 0, top], color="#EAF3EC", zorder=0.5, lw=0)
        axes.text(0.02, 0.04, f"μ = {mu:g}", color=FAINT, fontsize=8, transform=axes.transAxes)
    axes.set_ylim(-0.04 * top, top)
    axes.set_title("Friction cone")
    axes.set_xlabel("$F_x$ (·), $F_y$ (+) [N]", labelpad=1)
    axes.set_ylabel("$F_z$ [N]")
    axes.tick_params(labelsize=7.5)


def cone_use(axes: Axes, solution: Solution) -> None:
    """Draw the larger tangential component relative to the largest that friction allows; impulses as diamonds."""
    over_time(axes, solution)
    times, force = forces(solution)
    mu = friction(solution) or 1.0
    for i in range(force.shape[1]):
        pushing = force[:, i, 2] > 1e-3
        use = np.full(len(times), np.nan)
        use[pushing] = np.abs(force[pushing, i, :2]).max(axis=1) / (mu * force[pushing, i, 2])
        axes.plot(times, use, color=LEGS[i % len(LEGS)], drawstyle="steps-post")
    at, impulse = impulses(solution)
    for i in range(impulse.shape[1]):
        axes.plot(
            at,
            measures.impulse_ratios(impulse[:, i]) / mu,
            "D",
            ms=4.0,
            mfc="none",
            mew=0.9,
            color=LEGS[i % len(LEGS)],
            clip_on=False,
        )
    axes.axhline(1.0, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    axes.set_ylim(0, 1.15)
    axes.set_title("Use of friction  max(|$F_x$|, |$F_y$|) / μ$F_z$" if friction(solution) else "Slope of the force")
    axes.set_ylabel("[-]")


# ---- convergence


def defects(axes: Axes, solution: Solution) -> None:
    """Draw the defect of every node, with marks for those of the initial state and of resets."""
    over_time(axes, solution)
    for part, policy in zip(solution.trajectory.phases, solution.phases, strict=True):
        size = np.maximum(np.max(np.abs(policy.defects), axis=1, initial=0.0), 1e-16)
        axes.semilogy(part.times[1:], size[1:], color=NEUTRAL, lw=1.0)
        axes.semilogy(part.times[:1], size[:1], "D", ms=3.2, color=AXES[0], zorder=3)
    axes.axhline(1e-4, color=BOUND, lw=0.8, ls=(0, (4, 2)), zorder=1)
    axes.set_ylim(bottom=max(axes.get_ylim()[0], 1e-16))
    axes.set_title("Defects (◆ at phase starts)")
    axes.set_ylabel("∞-norm")


def over_iterations(axes: Axes) -> None:
    """Set the axis of iterations."""
    axes.set_xlabel("iteration", labelpad=1)
    axes.tick_params(labelsize=7.5)
    axes.margins(x=0.01)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def cost(axes: Axes, solution: Solution) -> None:
    """Draw the cost over the iterations."""
    over_iterations(axes)
    iterations = [record.iteration for record in solution.history]
    axes.plot(iterations, [record.cost for record in solution.history], color=LEGS[0])
    axes.set_title("Cost")
    costs = np.array([record.cost for record in solution.history])
    if costs.size and costs.min() > 0 and costs.max() > 30 * costs.min():
        axes.set_yscale("log")


def violations(axes: Axes, solution: Solution) -> None:
    """Draw the largest defect and violations over the iterations."""
    over_iterations(axes)
    iterations = [record.iteration for record in solution.history]
    kinds = (("defect", "defect", NEUTRAL), ("equality", "eq.", LEGS[0]), ("inequality", "ineq.", LEGS[1]))
    for name, label, colour in kinds:
        values = np.array([getattr(record, f"max_{name}") for record in solution.history])
        if np.any(values > 0):
            axes.semilogy(iterations, np.where(values > 0, values, np.nan), color=colour, label=label)
    axes.set_title("Violations")
    if axes.get_legend_handles_labels()[0]:
        add_legend(axes, 3)


def terms(axes: Axes, solution: Solution) -> None:
    """Draw the cost of each term, the largest on top."""
    costs = sorted(((cost, name) for name, cost in solution.term_costs.items()), reverse=True)
    shown = costs[:_TERMS]
    if len(costs) > _TERMS:
        shown = [*costs[: _TERMS - 1], (sum(cost for cost, _ in costs[_TERMS - 1 :]), "others")]
    axes.barh(range(len(shown)), [cost for cost, _ in shown], height=0.66, color="#B9C9DC", zorder=2)
    for row, (_, name) in enumerate(shown):
        axes.text(
            0.015, row, name, transform=axes.get_yaxis_transform(), va="center", fontsize=7.5, color=INK, zorder=3
        )
    axes.set_ylim(len(shown) - 0.5, -0.5)
    axes.set_yticks([])
    axes.grid(axis="y", visible=False)
    axes.tick_params(labelsize=7.5)
    axes.set_title("Cost by term")
