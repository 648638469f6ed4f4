"""Files: atomic writing, destinations that are checked before work begins, checked reading of archives and texts."""

from .archive import Arrays as Arrays
from .archive import Fault as Fault
from .archive import Kind as Kind
from .archive import Refuse as Refuse
from .archive import assembling as assembling
from .archive import read_archive as read_archive
from .archive import read_arrays as read_arrays
from .archive import write_archive as write_archive
from .archive import write_arrays as write_arrays
from .text import read_json as read_json
from .text import read_toml as read_toml
from .writing import check_destination as check_destination
from .writing import whole_file as whole_file
from .writing import write_whole as write_whole
