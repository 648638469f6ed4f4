"""Trajectories as MCAP logs, which Foxglove opens: one topic per quantity, and one pose per floating base."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from piaffe.errors import ProblemError
from piaffe.files import whole_file

from .columns import labels_of
from .phase_trajectory import PhaseTrajectory
from .quantity import Quantity

WORLD = "world"
_NUMBER = {"type": "number"}
_POSE = {
    "type": "object",
    "title": "foxglove.FrameTransform",
    "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "parent_frame_id": {"type": "string"},
        "child_frame_id": {"type": "string"},
        "translation": {"type": "object", "properties": dict.fromkeys("xyz", _NUMBER)},
        "rotation": {"type": "object", "properties": dict.fromkeys("xyzw", _NUMBER)},
    },
}


def write_mcap(phases: Sequence[PhaseTrajectory], path: Path) -> Path:
    """Write phases as an MCAP log, see :meth:`Trajectory.to_mcap`."""
    try:
        from mcap.writer import Writer
    except ImportError as error:
        raise ProblemError(
            "to_mcap: the package that writes logs is missing - got no mcap, expected it; run pip install 'piaffe[log]'"
        ) from error
    with whole_file(path) as temporary, temporary.open("wb") as stream:
        writer = Writer(stream)
        writer.start(library="piaffe")
        channels: dict[str, int] = {}
        for t, topic, schema, message in sorted(_messages(phases), key=lambda each: (each[0], each[1])):
            if topic not in channels:
                name = schema.get("title", topic.removeprefix("/"))
                number = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
                channels[topic] = writer.register_channel(topic, "json", number)
            stamp = round(1e9 * t)
            writer.add_message(channels[topic], stamp, json.dumps(message).encode(), stamp)
        writer.finish()
    return path


def _messages(phases: Sequence[PhaseTrajectory]) -> Iterator[tuple[float, str, dict[str, Any], dict[str, Any]]]:
    """Yield time [s], topic, schema and message of each node; a phase's last node belongs to the next phase."""
    for part in phases:
        count = len(part.times) if part is phases[-1] else len(part.times) - 1
        states, controls = part.state.unpack(part.states), part.control.unpack(part.controls)
        for quantity, values in {**part.outputs, **states, **controls}.items():
            labels = _labels(part, quantity, values.shape[1])
            schema = {"type": "object", "title": str(quantity), "properties": dict.fromkeys(labels, _NUMBER)}
            for t, row in zip(part.times[:count], values[:count], strict=False):
                yield t, f"/{quantity}", schema, dict(zip(labels, row.tolist(), strict=True))
        for child, position, rotation in _poses(states):
            for t, place, turn in zip(part.times[:count], position, rotation, strict=False):
                yield t, f"/tf/{child}", _POSE, _pose(t, child, place, turn)
        yield part.times[0], "/phase", _TEXT, {"name": part.name, "mode": part.mode, "model": part.model}


_TEXT = {
    "type": "object",
    "title": "phase",
    "properties": {key: {"type": "string"} for key in ("name", "mode", "model")},
}


def _labels(part: PhaseTrajectory, quantity: Quantity, size: int) -> tuple[str, ...]:
    if quantity.kind == "rotation":
        return ("w", "x", "y", "z")
    for space in (part.state, part.control):
        if quantity in space.slices:
            return tuple(label or "value" for label in space.block(quantity).labels)
    return labels_of(part, quantity, size)


def _poses(states: dict[Quantity, NDArray[Any]]) -> Iterator[tuple[str, NDArray[Any], NDArray[Any]]]:
    """Yield what has a position and an orientation in the state: its name, places (n, 3) and quaternions (n, 4)."""
    for quantity, turns in states.items():
        prefix = quantity.path.rpartition(".")[0]
        for other, places in states.items():
            if quantity.kind == "rotation" and other.path == f"{prefix}.position" and places.shape[1] == 3:
                yield prefix, places, turns


def _pose(t: float, child: str, place: NDArray[Any], turn: NDArray[Any]) -> dict[str, Any]:
    second, rest = divmod(round(1e9 * t), 10**9)
    return {
        "timestamp": {"sec": int(second), "nsec": int(rest)},
        "parent_frame_id": WORLD,
        "child_frame_id": child,
        "translation": dict(zip("xyz", place.tolist(), strict=True)),
        "rotation": dict(zip("wxyz", np.asarray(turn).tolist(), strict=True)),
    }
