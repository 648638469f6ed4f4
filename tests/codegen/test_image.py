"""Memory of Python as C, and the names that a library defines."""

import ctypes as ct
from pathlib import Path

import numpy as np
import pytest

from piaffe.codegen import MemoryImage, build, defined_symbols, load
from piaffe.codegen.cache import Cache
from piaffe.errors import SolverError

HEADER = """
#include <string.h>
typedef struct { int count; const double *numbers; double *work; const char *word; } Table;
struct own_part { double first[2]; Table *table; };
"""


class Table(ct.Structure):
    _fields_ = [
        ("count", ct.c_int), ("numbers", ct.c_void_p), ("work", ct.c_void_p), ("word", ct.c_void_p),
    ]  # fmt: skip


class _OwnPart(ct.Structure):
    _fields_ = [("first", ct.c_double * 2), ("table", ct.c_void_p)]


class Unknown(ct.Structure):
    _fields_ = [("numbers", ct.c_void_p)]


class Owner:
    """Has a table with constant numbers, and memory to work in."""

    def __init__(self) -> None:
        self.numbers = np.array([1.5, -0.0, np.inf, 1 / 3])
        self.work = np.zeros(3)
        self.tail = self.work[1:]
        self.table = Table(3, self.numbers.ctypes.data + 8, self.tail.ctypes.data, 4096)
        self.part = _OwnPart((0.25, np.nan), ct.addressof(self.table))


def image(owner: Owner, *, constants: object) -> MemoryImage:
    made = MemoryImage([HEADER], {4096: "word"}, {"word": "const char"})
    made.know(constants, constant=True)
    made.know(owner)
    return made


class Constants:
    def __init__(self, *things: object) -> None:
        self.things = things


def test_memory_has_the_same_values_in_c(tmp_path: Path) -> None:
    owner = Owner()
    made = image(owner, constants=Constants(owner.numbers))
    made.use(part=owner.part)
    text = f"""
{HEADER}
#include <math.h>
static const char word[] = "told";
{made.constants()}
struct memory {{
{made.members()}}};
double piaffe_test(int which)
{{
    static struct memory memory, *m = &memory;
{made.filling("m")}
    const double found[] = {{m->part.first[0], m->part.first[1], m->part.table->count, m->part.table->numbers[0],
        m->part.table->numbers[1], m->part.table->numbers[2], m->part.table->work[1], m->part.table->word[3]}};
    return found[which];
}}
"""
    library = load(build([("image", text)], cache=Cache(tmp_path)))
    library.piaffe_test.restype = ct.c_double
    found = [library.piaffe_test(i) for i in range(8)]
    assert np.array_equal(found, [0.25, np.nan, 3, -0.0, np.inf, 1 / 3, 0.0, ord("d")], equal_nan=True)
    assert np.signbit(found[3])
    assert defined_symbols(library.built.path) == ("piaffe_test",)


def test_what_refers_to_memory_that_changes_is_no_constant() -> None:
    owner = Owner()
    made = image(owner, constants=Constants(owner.numbers, owner.table))
    made.use(part=owner.part)
    assert "Table" in made.members()
    assert "0.3333333333333333" in made.constants()
    assert "0.3333333333333333" not in made.members() + made.filling("m")


def test_an_address_of_nothing_is_refused() -> None:
    owner = Owner()
    owner.table.numbers = 8192
    with pytest.raises(SolverError, match="an address is unknown - got 0x2000"):
        image(owner, constants=Constants()).use(part=owner.part)


def test_a_structure_that_the_headers_lack_is_refused() -> None:
    class Holder:
        def __init__(self) -> None:
            self.thing = Unknown()

    holder = Holder()
    made = MemoryImage([HEADER], {}, {})
    made.know(holder)
    made.use(thing=holder.thing)
    with pytest.raises(SolverError, match="a structure is unknown - got 'Unknown'"):
        made.members()


def test_a_file_that_is_no_library_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.so").write_bytes(b"text")
    with pytest.raises(SolverError, match="its names cannot be read - got a file that begins with b'text'"):
        defined_symbols(tmp_path / "a.so")
