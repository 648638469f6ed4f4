"""Films: a solution or a simulation as an MP4, at one speed after another."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from piaffe.errors import PiaffeError
from piaffe.files import whole_file

from .caption import Caption
from .playback import Snapshot
from .studio import Studio

Array = NDArray[np.float64]

_SMOOTH_S = 0.25  # the camera follows with about this inertia
_GAP = 4  # [pixels] between the pictures of a sheet
_HOLD_S = 0.4  # how long the last picture stays


class FilmError(PiaffeError, RuntimeError):
    """A film cannot be written."""


@dataclass(frozen=True)
class Cut:
    """One showing of a motion.

    Args:
        shown: snapshot at a time [s].
        start, end: from when to when [s].
        speed: 1 is real time, 0.25 four times slower.
        note: what the caption says beside the speed.
    """

    shown: Callable[[float], Snapshot]
    start: float
    end: float
    speed: float = 1.0
    note: str = ""

    def times(self, fps: float) -> Array:
        """Return the times of the pictures [s], the last one held."""
        count = max(round((self.end - self.start) / self.speed * fps), 1)
        moving = self.start + (self.end - self.start) * np.arange(count + 1) / count
        return np.concatenate([moving, np.full(round(_HOLD_S * fps), self.end)])


def write(path: Path, studio: Studio, cuts: Sequence[Cut], feet: Sequence[str], *, fps: int = 50) -> Path:
    """Write a film; the file appears whole or not at all.

    Args:
        path: the file, ``.mp4``.
        studio: draws the pictures; its size must be even.
        cuts: shown one after the other.
        feet: names of the feet, for the caption.
        fps: pictures per second.
    """
    caption = Caption(studio.size, feet)
    with whole_file(path) as temporary, studio:
        encode(temporary, _pictures(studio, cuts, caption, fps), studio.size, fps)
    return path


def sheet(path: Path, studio: Studio, cut: Cut, feet: Sequence[str], *, columns: int, rows: int) -> Path:
    """Write pictures of equally spaced moments into one, row by row.

    Args:
        path: the file, ``.png`` or another picture's ending.
        studio: draws the pictures, each at its size.
        cut: what is shown.
        feet: names of the feet, for the captions.
        columns: pictures beside each other.
        rows: and below each other.
    """
    count = columns * rows
    times = cut.start + (cut.end - cut.start) * (np.arange(count) + 0.5) / count
    caption = Caption(studio.size, feet)
    with studio:
        shown = [cut.shown(float(t)) for t in times]
        looks = follow(shown, count / (cut.end - cut.start))
        pictures = [caption.write(studio.picture(s, x), s, 1.0, cut.note) for s, x in zip(shown, looks, strict=True)]
    width, height = studio.size
    whole = Image.new("RGB", (columns * (width + _GAP) - _GAP, rows * (height + _GAP) - _GAP), "white")
    for i, picture in enumerate(pictures):
        whole.paste(Image.fromarray(picture), ((width + _GAP) * (i % columns), (height + _GAP) * (i // columns)))
    with whole_file(path) as temporary:
        whole.save(temporary)
    return path


def encode(path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], fps: int) -> None:
    """Write pictures, (height, width, 3) each, as H.264.

    Raises:
        FilmError: ffmpeg refuses them.
    """
    import imageio_ffmpeg

    width, height = size
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
    coding = ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20", "-movflags", "+faststart"]
    line = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error", *source, *coding, str(path)]
    with subprocess.Popen(line, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as ffmpeg:
        assert ffmpeg.stdin is not None  # both are pipes
        assert ffmpeg.stderr is not None
        try:
            for picture in pictures:
                ffmpeg.stdin.write(np.ascontiguousarray(picture).tobytes())
            ffmpeg.stdin.close()
        except BrokenPipeError:
            pass  # it says below what it minds
        except BaseException:
            ffmpeg.kill()
            raise
        said = ffmpeg.stderr.read().decode(errors="replace").strip()
    if ffmpeg.returncode:
        raise FilmError(
            f"file '{path.name}': ffmpeg cannot write it - got '{said}', expected a film; choose another size"
        )


def _pictures(studio: Studio, cuts: Sequence[Cut], caption: Caption, fps: int) -> Iterator[NDArray[np.uint8]]:
    for cut in cuts:
        times = cut.times(fps)
        shown = [cut.shown(float(t)) for t in times]
        for snapshot, look_at in zip(shown, follow(shown, cut.speed * fps), strict=True):
            yield caption.write(studio.picture(snapshot, look_at), snapshot, cut.speed, cut.note)


def follow(shown: Sequence[Snapshot], rate: float) -> Array:
    """Return where to look for each snapshot, (n, 3): the base's path without its jolts.

    Args:
        shown: snapshots at equal steps.
        rate: snapshots per second of motion.
    """
    places = np.array([snapshot.qpos[:3] for snapshot in shown])
    width = max(_SMOOTH_S * max(rate, 1.0), 1.0)
    reach = int(3 * width)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(places, ((reach, reach), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(3)], axis=1)
    smooth[:, 2] = 0.7 * smooth[:, 2] + 0.3 * places[:, 2].mean()
    return smooth
