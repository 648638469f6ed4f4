"""Figures, films, pictures and progress displays: the same for Python and the command line.

A name is imported from its module when it is first used, because the import of matplotlib, MuJoCo and Pillow takes
longer than most commands.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from . import gl as gl

if TYPE_CHECKING:  # for type checkers and import-linter; at run time `_MODULES` has the same names
    from .bars import progress_bars as progress_bars
    from .bars import stage_bars as stage_bars
    from .building import start_solver as start_solver
    from .cuts import cuts_of as cuts_of
    from .cuts import is_sheet as is_sheet
    from .cuts import picture_size as picture_size
    from .episode_figure import plot_episodes as plot_episodes
    from .episode_film import film_episode as film_episode
    from .figure import plot as plot
    from .figure import require_picture as require_picture
    from .films import sheet as sheet
    from .films import write as write
    from .online_figure import plot_online as plot_online
    from .online_film import film_online as film_online
    from .playback import Playback as Playback
    from .poses import keyframes as keyframes
    from .poses import picture as picture
    from .poses import save_picture as save_picture
    from .poses import strip as strip
    from .progress import LiveTable as LiveTable
    from .simulated import simulate as simulate
    from .solution_film import film as film
    from .studio import Studio as Studio
    from .study_figures import draw_study as draw_study
    from .viewer import show as show
else:
    _MODULES = {
        "progress_bars": "bars",
        "stage_bars": "bars",
        "start_solver": "building",
        "cuts_of": "cuts",
        "is_sheet": "cuts",
        "picture_size": "cuts",
        "plot_episodes": "episode_figure",
        "film_episode": "episode_film",
        "plot": "figure",
        "require_picture": "figure",
        "sheet": "films",
        "write": "films",
        "plot_online": "online_figure",
        "film_online": "online_film",
        "Playback": "playback",
        "keyframes": "poses",
        "picture": "poses",
        "save_picture": "poses",
        "strip": "poses",
        "LiveTable": "progress",
        "simulate": "simulated",
        "film": "solution_film",
        "Studio": "studio",
        "draw_study": "study_figures",
        "show": "viewer",
    }

    def __getattr__(name: str) -> object:
        if name not in _MODULES:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        found = getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
        globals()[name] = found  # the next access does not call this function
        return found

    def __dir__() -> list[str]:
        return sorted({*globals(), *_MODULES})
