"""Studies: many episodes of problems in Python files, their settings, files and tables."""

from .declared import load_declared as load_declared
from .file import StudyFile as StudyFile
from .file import read_study as read_study
from .file import try_controllers as try_controllers
from .records import load_episodes as load_episodes
from .records import save_episodes as save_episodes
from .runner import Runner as Runner
from .study import Case as Case
from .study import Study as Study
from .study import require_pyarrow as require_pyarrow
from .study import write_parquet as write_parquet
from .tables import cells as cells
from .tables import listed as listed
from .tables import text_of as text_of
from .tables import varied as varied
from .tables import write_tables as write_tables
from .trials import Trial as Trial
from .trials import complete as complete
from .trials import prepare as prepare
from .workers import FileTask as FileTask
from .workers import executor_of as executor_of
from .workers import require_executor as require_executor
