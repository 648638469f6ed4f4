"""The caption of a film: phase, time, speed, and per foot a circle that is filled while the foot is in contact."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from .playback import Snapshot
from .style import INK, LEGS

FONT = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
_OFF = "#8A8F98"


class Caption:
    """Writes captions on pictures.

    Args:
        size: width and height of the finished pictures [pixels].
        feet: names of the feet, in the order of the snapshots' contacts.
    """

    def __init__(self, size: tuple[int, int], feet: Sequence[str]) -> None:
        self.size, self.feet = size, feet
        self.unit = size[1] / 36
        self.font = ImageFont.truetype(str(FONT), round(self.unit))
        self.small = ImageFont.truetype(str(FONT), round(0.72 * self.unit))

    def write(self, picture: NDArray[np.uint8], shown: Snapshot, speed: float, note: str = "") -> NDArray[np.uint8]:
        """Return a picture at its finished size with the caption on it.

        Args:
            picture: the rendered picture, of any size.
            shown: the snapshot in the picture.
            speed: speed of the film.
            note: text beside the speed.
        """
        image = Image.fromarray(picture)
        if image.size != self.size:
            image = image.resize(self.size, Image.Resampling.LANCZOS)
        draw = ImageDraw.Draw(image)
        unit, (width, height) = self.unit, self.size
        base = height - 1.2 * unit
        draw.text((1.4 * unit, base), f"{shown.time:5.2f} s   {shown.phase}", font=self.font, fill=INK, anchor="ls")
        pace = "" if speed == 1 else f"{speed:g} × speed"
        text = "   ".join(part for part in (note, pace) if part)
        draw.text((width - 1.4 * unit, base), text, font=self.font, fill=INK, anchor="rs")
        for i, (foot, on) in enumerate(zip(self.feet, shown.contact, strict=False)):
            x, y = 1.9 * unit + 2.3 * unit * i, base - 2.2 * unit
            r = 0.42 * unit
            draw.ellipse(
                (x - r, y - r, x + r, y + r),
                fill=LEGS[i % len(LEGS)] if on else None,
                outline=None if on else _OFF,
                width=2,
            )
            draw.text((x + 0.65 * unit, y), foot, font=self.small, fill=INK, anchor="lm")
        return np.asarray(image)
