"""What a library's sources are made from is part of its key."""

import re
from pathlib import Path

from piaffe.solvers.ilqr.native import program


def test_modules_that_make_the_sources_are_part_of_the_key() -> None:
    package = Path(program.__file__).parent
    for module in program.MAKERS:
        found = re.findall(r"^from \.(\w+) import", (package / module).read_text(), re.MULTILINE)
        assert {f"{name}.py" for name in found} <= set(program.MAKERS), module
