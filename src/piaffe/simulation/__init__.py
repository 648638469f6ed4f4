"""Closed-loop episodes of a controller on a MuJoCo plant."""

from .controller import Controller as Controller
from .controller import Judgement as Judgement
from .controller import Plan as Plan
from .controller import TickingController as TickingController
from .episode import Episode as Episode
from .episode import Progress as Progress
from .episode import run_episode as run_episode
from .plant import MAX_SPEED as MAX_SPEED
from .plant import Plant as Plant
from .spread import Spread as Spread
