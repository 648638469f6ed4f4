"""The horizon: a problem's numbers at any time, for controllers that plan again and again."""

from .calendar import Calendar as Calendar
from .calendar import Place as Place
from .course import Course as Course
from .horizon import Horizon as Horizon
from .spans import Span as Span
from .targets import moved_symbols as moved_symbols
