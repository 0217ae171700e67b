"""Writes videos: MP4 (H.264) by PyAV, GIF by Pillow."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures

Image = NDArray[np.uint8]  # (H, W) grey, or (H, W, 3) RGB

_ENCODERS = ("libx264", "libopenh264", "mpeg4")
_FINE, _SMALL = "23", "28"  # crf of x264: of a film, and of one with many keyframes
_PRESET = "superfast"
_FREQUENT, _FAR_APART, _UNKNOWN = 80, 47, -1  # colours of a GIF; one is left for what does not change


def encoder() -> str:
    """Return the encoder of an MP4: the first of ours that this PyAV has."""
    return next(name for name in _ENCODERS if name in av.codec.codecs_available)


@contextmanager
def mp4(
    file: Path, width: int, height: int, rate_hz: Fraction, *, keyframe_every: int | None = None
) -> Iterator[Callable[[Image], None]]:
    """Give what takes the images of an MP4, in order, ``rate_hz`` of them a second; their sides are even.

    ``keyframe_every``: so many images; a reader that jumps decodes no more than these, and finds every image. None: for
    people; an image that is given again stays, and is not encoded again.

    Raises:
        OSError: It cannot be written.
    """
    name, count = encoder(), itertools.count()
    shown: Image | None = None
    with av.open(str(file), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream(name, rate=rate_hz)
        if name == "libx264":
            stream.options = {"crf": _FINE if keyframe_every is None else _SMALL, "preset": _PRESET}
        if keyframe_every is not None:
            stream.gop_size = keyframe_every
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = 1 / rate_hz

        def add(image: Image) -> None:
            nonlocal shown
            number, repeated, shown = next(count), image is shown, image
            if repeated and keyframe_every is None:  # the image before stays
                return
            frame = av.VideoFrame.from_ndarray(image, "gray" if image.ndim == 2 else "rgb24")
            frame.pts, frame.time_base = number, 1 / rate_hz
            container.mux(stream.encode(frame))

        yield add
        container.mux(stream.encode())


def gif(file: Path, images: Iterator[Image], delay_ms: int) -> None:
    """Write a GIF that goes round and round. Its colours are those of its first second.

    Raises:
        OSError: It cannot be written.
    """
    first = list(itertools.islice(images, 1000 // delay_ms))
    palette = _Palette(np.concatenate([first[0], first[-1]]))
    pictures = map(palette.picture, itertools.chain(first, images))
    next(pictures).save(
        file, "GIF", save_all=True, append_images=pictures, duration=delay_ms, loop=0, disposal=1, optimize=False
    )


class _Palette:
    """The colours of a GIF: the most frequent ones as they are, and some that are far apart."""

    def __init__(self, typical: Image) -> None:
        found, counts = np.unique(typical.reshape(-1, 3), axis=0, return_counts=True)
        picture = Pictures.fromarray(typical).quantize(_FAR_APART, Pictures.Quantize.MAXCOVERAGE)
        other = np.array(picture.getpalette(), np.uint8).reshape(-1, 3)
        self._colours = np.concatenate([found[np.argsort(-counts)[:_FREQUENT]], other[:_FAR_APART]])
        self._nearest = np.full(1 << 24, _UNKNOWN, np.int16)  # of each colour, as far as it was met

    def picture(self, image: Image) -> Pictures.Image:
        """Return an image in these colours."""
        packed = image.astype(np.int32) @ (1 << 16, 1 << 8, 1)
        indices = self._nearest[packed]
        if len(new := np.unique(packed[indices == _UNKNOWN])):
            colours = np.stack([new >> 16, new >> 8 & 255, new & 255], axis=1)
            away = ((colours[:, None] - self._colours.astype(np.int32)) ** 2).sum(axis=2)
            self._nearest[new] = away.argmin(axis=1)
            indices = self._nearest[packed]
        picture = Pictures.fromarray(indices.astype(np.uint8), "P")
        picture.putpalette(self._colours.tobytes())
        return picture
