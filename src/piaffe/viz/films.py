"""Films: a solution or a simulation as an MP4 file, at several speeds in turn."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from piaffe.errors import PiaffeError
from piaffe.files import whole_file, write_whole

from .bars import progress_bars
from .caption import Caption
from .playback import Snapshot
from .studio import Studio

Array = NDArray[np.float64]

_SMOOTH_S = 0.25  # standard deviation of the filter that smooths the camera's path
_GAP = 4  # [pixels] between the pictures of a sheet
_HOLD_S = 0.4  # additional time of the last picture


class FilmError(PiaffeError, RuntimeError):
    """A film cannot be written."""


@dataclass(frozen=True)
class Cut:
    """One part of a film: a motion at one speed.

    Args:
        shown: function of time [s] that returns the snapshot.
        start, end: first and last time [s].
        speed: 1 is real time, 0.25 four times slower.
        note: text of the caption beside the speed.
    """

    shown: Callable[[float], Snapshot]
    start: float
    end: float
    speed: float = 1.0
    note: str = ""

    def times(self, fps: float) -> Array:
        """Return the times of the pictures [s]; the last one repeats."""
        count = max(round((self.end - self.start) / self.speed * fps), 1)
        moving = self.start + (self.end - self.start) * np.arange(count + 1) / count
        return np.concatenate([moving, np.full(round(_HOLD_S * fps), self.end)])


def write(path: Path, studio: Studio, cuts: Sequence[Cut], feet: Sequence[str], *, fps: int = 50) -> Path:
    """Write a film, atomically; return its path. A bar on a terminal shows the pictures that are done.

    Args:
        path: the file, ``.mp4``.
        studio: renders the pictures; its width and height must be even.
        cuts: the parts of the film, in order.
        feet: names of the feet, for the caption.
        fps: pictures per second.
    """
    caption = Caption(studio.size, feet)
    total = sum(len(cut.times(fps)) for cut in cuts)
    with whole_file(path) as temporary, studio, progress_bars() as bars:
        pictures = bars.track(_pictures(studio, cuts, caption, fps), total=total, description="film, pictures")
        encode(temporary, iter(pictures), studio.size, fps)
    return path


def sheet(path: Path, studio: Studio, cut: Cut, feet: Sequence[str], *, columns: int, rows: int) -> Path:
    """Write one picture that shows equally spaced moments of a motion, row by row; return its path.

    Args:
        path: the file, with the suffix of a picture.
        studio: renders the picture of each moment.
        cut: the motion.
        feet: names of the feet, for the captions.
        columns: number of moments in a row.
        rows: number of rows.
    """
    count = columns * rows
    times = cut.start + (cut.end - cut.start) * (np.arange(count) + 0.5) / count
    caption = Caption(studio.size, feet)
    with studio:
        shown = [cut.shown(float(t)) for t in times]
        looks = follow(shown, count / (cut.end - cut.start), studio.fixed)
        pictures = [caption.write(studio.picture(s, x), s, 1.0, cut.note) for s, x in zip(shown, looks, strict=True)]
    width, height = studio.size
    whole = Image.new("RGB", (columns * (width + _GAP) - _GAP, rows * (height + _GAP) - _GAP), "white")
    for i, picture in enumerate(pictures):
        whole.paste(Image.fromarray(picture), ((width + _GAP) * (i % columns), (height + _GAP) * (i // columns)))
    content = BytesIO()
    whole.save(content, format=Image.registered_extensions()[path.suffix.lower()])
    write_whole(path, content.getvalue())
    return path


def encode(path: Path, pictures: Iterator[NDArray[np.uint8]], size: tuple[int, int], fps: int) -> None:
    """Write pictures, (height, width, 3) each, as an H.264 film.

    Raises:
        FilmError: ffmpeg fails.
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
            pass  # ffmpeg has stopped; its message is read below
        except BaseException:
            ffmpeg.kill()
            raise
        message = ffmpeg.stderr.read().decode(errors="replace").strip()
    if ffmpeg.returncode:
        raise FilmError(
            f"file '{path.name}': ffmpeg cannot write it - got '{message}', expected a film; choose another size"
        )


def _pictures(studio: Studio, cuts: Sequence[Cut], caption: Caption, fps: int) -> Iterator[NDArray[np.uint8]]:
    for cut in cuts:
        times = cut.times(fps)
        shown = [cut.shown(float(t)) for t in times]
        for snapshot, look_at in zip(shown, follow(shown, cut.speed * fps, studio.fixed), strict=True):
            yield caption.write(studio.picture(snapshot, look_at), snapshot, cut.speed, cut.note)


def follow(shown: Sequence[Snapshot], rate: float, fixed: Array | None = None) -> Array:
    """Return the point in the middle of each picture, (n, 3) [m]: the smoothed path of the base.

    Args:
        shown: snapshots at equal time steps.
        fixed: a point to look at, for a robot with a fixed base.
        rate: snapshots per second of motion.
    """
    if fixed is not None:
        return np.tile(fixed, (len(shown), 1))
    places = np.array([snapshot.qpos[:3] for snapshot in shown])
    width = max(_SMOOTH_S * max(rate, 1.0), 1.0)
    reach = int(3 * width)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / width) ** 2)
    kernel /= kernel.sum()
    padded = np.pad(places, ((reach, reach), (0, 0)), mode="edge")
    smooth = np.stack([np.convolve(padded[:, axis], kernel, mode="valid") for axis in range(3)], axis=1)
    smooth[:, 2] = 0.7 * smooth[:, 2] + 0.3 * places[:, 2].mean()
    return smooth
