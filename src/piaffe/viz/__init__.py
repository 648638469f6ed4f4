"""Figures, films, pictures and progress displays."""

from . import gl as gl
from .cuts import cuts_of as cuts_of
from .cuts import is_sheet as is_sheet
from .cuts import picture_size as picture_size
from .episode_figure import plot_episodes as plot_episodes
from .episode_film import film_episode as film_episode
from .figure import plot as plot
from .figure import require_picture as require_picture
from .film import sheet as sheet
from .film import write as write
from .playback import Playback as Playback
from .progress import LiveTable as LiveTable
from .studio import Studio as Studio
from .study_figures import draw_study as draw_study
from .viewer import show as show
