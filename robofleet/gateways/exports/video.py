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
_FINE, _SMALL = "20", "28"  # crf of x264: of a film, and of one with many keyframes
_PRESET = "veryfast"
_COLOURS = 128  # of a GIF


def encoder() -> str:
    """Return the encoder of an MP4: the first of ours that this PyAV has."""
    return next(name for name in _ENCODERS if name in av.codec.codecs_available)


@contextmanager
def mp4(
    file: Path, width: int, height: int, rate_hz: Fraction, *, keyframe_every: int | None = None
) -> Iterator[Callable[[Image], None]]:
    """Give what takes the images of an MP4, in order, ``rate_hz`` of them a second; their sides are even.

    ``keyframe_every``: so many images; a reader that jumps decodes no more than these. None: as the encoder likes it.

    Raises:
        OSError: It cannot be written.
    """
    name, count = encoder(), itertools.count()
    with av.open(str(file), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream(name, rate=rate_hz)
        if name == "libx264":
            stream.options = {"crf": _FINE if keyframe_every is None else _SMALL, "preset": _PRESET}
        if keyframe_every is not None:
            stream.gop_size = keyframe_every
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = 1 / rate_hz

        def add(image: Image) -> None:
            frame = av.VideoFrame.from_ndarray(image, "gray" if image.ndim == 2 else "rgb24")
            frame.pts, frame.time_base = next(count), 1 / rate_hz
            container.mux(stream.encode(frame))

        yield add
        container.mux(stream.encode())


def gif(file: Path, images: Iterator[Image], delay_ms: int) -> None:
    """Write a GIF that goes round and round. Its colours are those of its first second.

    Raises:
        OSError: It cannot be written.
    """
    first = list(itertools.islice(images, 1000 // delay_ms))
    typical = Pictures.fromarray(np.concatenate([first[0], first[-1]]))
    palette = typical.quantize(_COLOURS, dither=Pictures.Dither.NONE)
    pictures = (
        Pictures.fromarray(image).quantize(palette=palette, dither=Pictures.Dither.NONE)
        for image in itertools.chain(first, images)
    )
    next(pictures).save(
        file, "GIF", save_all=True, append_images=pictures, duration=delay_ms, loop=0, disposal=1, optimize=False
    )
