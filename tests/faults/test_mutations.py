"""Damaged files of every format: one class of error, no other numbers, no more memory than their headers declare."""

import io
import json
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from piaffe.errors import FileFormatError, SamplingError, UnknownNameError
from piaffe.files import read_archive, write_archive
from piaffe.sampling import load_episodes, load_value
from piaffe.sampling.learning import dataset
from piaffe.sampling.learning.dataset import Dataset
from piaffe.sampling.study import records
from piaffe.sampling.study.file import read_study
from piaffe.sampling.value import store
from piaffe.sampling.value.store import digest
from piaffe.solvers import Solution
from piaffe.solvers.solution import file as solution_file

DATA = Path(__file__).parent.parent / "data"
MUTATIONS = 2000


def numbers(found: Any) -> list[Any]:
    """Return everything that an object holds, arrays as bytes, so that two objects can be compared."""
    if isinstance(found, np.ndarray):
        return [found.shape, found.tobytes()]
    if isinstance(found, dict):
        return [part for key, value in found.items() for part in [repr(key), *numbers(value)]]
    if isinstance(found, list | tuple):
        return [part for value in found for part in numbers(value)]
    if hasattr(found, "__dataclass_fields__"):
        return [
            part for name in found.__dataclass_fields__ if name != "_bound" for part in numbers(getattr(found, name))
        ]
    return [repr(found)]


def read_dataset(path: Path) -> Any:
    return Dataset(path.parent, {"of": "a test"}, 1).load()


READERS: dict[str, tuple[Path, Callable[[Path], Any]]] = {
    "solution": (DATA / "solution-1.npz", Solution.load),
    "value": (DATA / "value-1.value", load_value),
    "episodes": (DATA / "episodes-1.npz", load_episodes),
    "shard": (DATA / "dataset-1" / "shard-00000.npz", read_dataset),
    "manifest": (DATA / "dataset-1" / "manifest.json", read_dataset),
}


@pytest.fixture(params=list(READERS))
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Callable[[Path], Any]]:
    """Return a copy of a file of a format, with the files that it belongs to, and its reader."""
    source, read = READERS[request.param]
    for each in source.parent.iterdir():
        if each.is_file():
            (tmp_path / each.name).write_bytes(each.read_bytes())
    return tmp_path / source.name, read


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """Return content with a bit flipped, bytes replaced, cut out, doubled or appended, or the end cut off."""
    data = bytearray(content)
    at, length = int(rng.integers(len(data))), int(rng.integers(1, 32))
    match int(rng.integers(6)):
        case 0:
            data[at] ^= 1 << int(rng.integers(8))
        case 1:
            data[at : at + length] = rng.bytes(length)
        case 2:
            del data[at : at + length]
        case 3:
            data[at:at] = data[at : at + length]
        case 4:
            data += rng.bytes(length)
        case _:
            del data[at:]
    return bytes(data)


def test_files_of_every_released_version_are_read(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    assert numbers(read(path))


@pytest.mark.parametrize(
    ("name", "newest"),
    [
        ("solution-{}.npz", solution_file.VERSION),
        ("value-{}.value", store.VERSION),
        ("dataset-{}/manifest.json", dataset.VERSION),
        ("episodes-{}.npz", int(records.FORMAT.split()[-1])),
    ],
)
def test_every_version_of_a_format_has_a_file(name: str, newest: int) -> None:
    """Who makes a new version adds a file, and an entry of ``READERS``."""
    for version in range(1, newest + 1):
        assert DATA / name.format(version) in [path for path, _ in READERS.values()]


def test_released_files_have_the_numbers_that_were_written() -> None:
    """The numbers are those that the release printed which wrote the files."""
    assert Solution.load(DATA / "solution-1.npz").cost == pytest.approx(0.019515616136575167, rel=1e-12)
    network = load_value(DATA / "value-1.value").network
    assert float(network(np.ones((1, 4)))[0]) == pytest.approx(0.3953235149383545, rel=1e-6)
    episodes, about = load_episodes(DATA / "episodes-1.npz")
    np.testing.assert_allclose(episodes["seed 3"].times, 0.02 * np.arange(5))
    assert about == {"problem": "a trot"}
    np.testing.assert_array_equal(read_dataset(DATA / "dataset-1" / "manifest.json").cost, np.arange(5.0))


def test_a_mutated_file_is_refused_or_has_the_same_numbers(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    content, rng = path.read_bytes(), np.random.default_rng(0)
    right = numbers(read(path))
    refused = 0
    for _ in range(MUTATIONS):
        path.write_bytes(mutated(content, rng))
        tracemalloc.start()
        found, error = outcome(path, read)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert most < 2**23  # these files declare less than 100 kB; what is left is the reader itself
        if error is None:
            assert found == right
            continue
        refused += 1
        # a manifest that is still JSON is of another data set
        assert isinstance(error, FileFormatError) or (path.suffix == ".json" and type(error) is SamplingError), error
        assert path.name in str(error) or type(error) is SamplingError
    assert refused > MUTATIONS // 3


def outcome(path: Path, read: Callable[[Path], Any]) -> tuple[list[Any], Exception | None]:
    """Return the numbers of a file, or the error of its reader."""
    try:
        return numbers(read(path)), None
    except Exception as error:
        return [], error


def repacked(content: bytes, change: Callable[[dict[str, bytes]], None]) -> bytes:
    """Return an archive whose members were changed, with right check sums."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    return packed.getvalue()


def as_member(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def header_of(members: dict[str, bytes]) -> tuple[str, Any]:
    if "manifest.json" in members:
        return "manifest.json", json.loads(members["manifest.json"])
    stored = np.load(io.BytesIO(members["header.npy"]))
    return "header.npy", json.loads(str(stored) if stored.dtype.kind == "U" else stored.tobytes())


def with_header(members: dict[str, bytes], header: Any) -> None:
    name = "manifest.json" if "manifest.json" in members else "header.npy"
    text = json.dumps(header).encode()
    members[name] = text if name == "manifest.json" else as_member(np.frombuffer(text, dtype=np.uint8))


@pytest.mark.parametrize("kind", ["solution", "value", "episodes"], indirect=True)
def test_a_header_of_any_content_is_read_or_refused(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    content, rng = path.read_bytes(), np.random.default_rng(1)
    others = [None, -1, 1e300, "text", [], {}, [[]], True, {"a": {"b": None}}]

    def leaves(value: Any) -> list[tuple[Any, Any]]:
        entries = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        return [pair for key, entry in entries for pair in [(value, key), *leaves(entry)]]

    def change(members: dict[str, bytes]) -> None:
        _, header = header_of(members)
        found = leaves(header)
        owner, key = found[int(rng.integers(len(found)))]
        if rng.integers(3):
            owner[key] = others[int(rng.integers(len(others)))]
        else:
            del owner[key]
        with_header(members, header)

    for _ in range(300):
        path.write_bytes(repacked(content, change))
        _, error = outcome(path, read)
        # a feature of the user's own is unknown by its name
        assert error is None or type(error) in (FileFormatError, UnknownNameError), error


@pytest.mark.parametrize("kind", ["solution", "value", "episodes", "shard"], indirect=True)
def test_arrays_that_do_not_fit_are_refused(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    content = path.read_bytes()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        arrays = [name for name in archive.namelist() if name not in ("header.npy", "manifest.json")]
    for name in arrays:
        for other in (np.zeros((2, 3, 4)), np.zeros(0), np.array("text")):

            def change(members: dict[str, bytes], name: str = name, other: np.ndarray = other) -> None:
                members[name] = as_member(other)

            path.write_bytes(repacked(content, change))
            if "multipliers" in name or "outputs" in name or (name.startswith("head_bias") and not other.size):
                continue
            with pytest.raises(FileFormatError, match=path.name):
                read(path)


def test_weights_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    content = (DATA / "value-1.value").read_bytes()
    path = tmp_path / "a.value"
    for name in ("head.npy", "0.kernel.npy", "0.bias.npy", "mean.npy", "std.npy", "head_bias.npy"):
        for bad in (np.nan, np.inf):

            def change(members: dict[str, bytes], name: str = name, bad: float = bad) -> None:
                weights = np.load(io.BytesIO(members[name])).copy()
                weights.flat[-1] = bad
                members[name] = as_member(weights)

            path.write_bytes(repacked(content, change))
            with pytest.raises(FileFormatError, match=r"a.value': cannot be read - got .* not finite"):
                load_value(path)


@pytest.mark.parametrize("kind", ["solution", "value", "episodes", "shard"], indirect=True)
def test_a_bomb_is_refused_before_it_is_inflated(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    with zipfile.ZipFile(path) as archive:
        name = next(name for name in archive.namelist() if name not in ("header.npy", "manifest.json"))
    many = 2**28  # bytes; they are compressed to a thousandth
    content = repacked(path.read_bytes(), lambda members: members.update({name: as_member(np.zeros(many // 8))}))
    path.write_bytes(content)
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=rf"{path.name}.* got .*arrays of \d+ bytes in a file of \d+ bytes"):
            read(path)
        assert tracemalloc.get_traced_memory()[1] < 2**24
    finally:
        tracemalloc.stop()


def test_an_array_takes_the_memory_that_the_header_declares(tmp_path: Path) -> None:
    path = Solution.load(DATA / "solution-1.npz").save(tmp_path / "a.npz")

    def change(members: dict[str, bytes]) -> None:  # larger than the header says
        members["0/states.npy"] = as_member(np.zeros((2**22, 2)))

    path.write_bytes(repacked(path.read_bytes(), change))
    tracemalloc.start()
    try:
        with pytest.raises(FileFormatError, match=r"a.npz.*0/states.npy' is an array .* but the header says"):
            Solution.load(path)
        assert tracemalloc.get_traced_memory()[1] < 2**22
    finally:
        tracemalloc.stop()


def test_reading_takes_at_most_four_times_the_declared_size(tmp_path: Path) -> None:
    arrays = {"noise": np.random.default_rng(0).normal(size=(2**20, 2)), "zeros": np.zeros((3, 2**21), order="F")}
    write_archive(tmp_path / "large.npz", {"format": "large"}, arrays)
    declared = sum(array.nbytes for array in arrays.values())
    tracemalloc.start()
    try:
        _, read = read_archive(tmp_path / "large.npz", "large", None, lambda fault: ValueError(str(fault)))
        assert tracemalloc.get_traced_memory()[1] < 4 * declared
    finally:
        tracemalloc.stop()
    for name, array in arrays.items():
        np.testing.assert_array_equal(read[name], array)


@pytest.mark.parametrize("kind", ["solution", "value", "episodes"], indirect=True)
def test_values_nested_too_deeply_are_refused(kind: tuple[Path, Callable[[Path], Any]]) -> None:
    path, read = kind
    deep = b"[" * 200_000

    def change(members: dict[str, bytes]) -> None:
        name, _ = header_of(members)
        members[name] = deep if name == "manifest.json" else as_member(np.frombuffer(deep, dtype=np.uint8))

    path.write_bytes(repacked(path.read_bytes(), change))
    with pytest.raises(FileFormatError, match=path.name):
        read(path)


def test_a_digest_of_a_damaged_value_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.value"
    path.write_bytes((DATA / "value-1.value").read_bytes()[:-30])
    with pytest.raises(FileFormatError, match=r"a.value"):
        digest(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"seeds = 1979-05-27", "entry 'seeds': is a date or a time"),
        (b"[[grid]]\nnoise = [[1979-05-27T07:32:00Z]]", "entry 'grid.noise': is a date or a time"),
        (b"a = " + b"[" * 100_000, "is no TOML file - got values nested too deeply"),
        (b"file = '\xff\xfe'", "got byte 8, which is not UTF-8"),
        (b"a = ", "is no TOML file - got Invalid value"),
    ],
)
def test_a_study_that_is_no_plain_toml_is_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "study.toml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        read_study(path)
    assert message in str(caught.value)
    assert "study.toml" in str(caught.value)
