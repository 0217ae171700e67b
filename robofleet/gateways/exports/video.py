"""Writes videos: MP4 (H.264) by PyAV, GIF by Pillow."""

import itertools
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pictures

Image = NDArray[np.uint8]  # (H, W) grey, or (H, W, 3) RGB

_ENCODERS = ("libx264", "libopenh264", "mpeg4")
_FILM = {"preset": "superfast", "crf": "23", "bf": "0", "rc-lookahead": "10", "x264-params": "mbtree=1"}
_DATASET = {"preset": "superfast", "crf": "28"}  # it has many keyframes
_FREQUENT, _FAR_APART, _UNKNOWN = 80, 47, -1  # colours of a GIF; one is left for what does not change


def encoder() -> str:
    """Return the encoder of an MP4: the first of ours that this PyAV has."""
    return next(name for name in _ENCODERS if name in av.codec.codecs_available)


@contextmanager
def mp4(
    file: Path, width: int, height: int, rate_hz: Fraction, *, keyframe_every: int | None = None
) -> Iterator[Callable[[Image], None]]:
    """Give what takes the images of an MP4, in order, ``rate_hz`` of them a second; their sides are even.

    An image that was given is not changed any more: it is encoded while the next one is drawn.

    ``keyframe_every``: so many images; a reader that jumps decodes no more than these, and finds every image. None: for
    people; an image that is given again stays, and is not encoded again.

    Raises:
        OSError: It cannot be written.
    """
    name, count = encoder(), itertools.count()
    shown: Image | None = None
    begun: Future[None] | None = None
    with av.open(str(file), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        stream: Any = container.add_stream(name, rate=rate_hz)
        if name == "libx264":
            stream.options = _FILM if keyframe_every is None else _DATASET
        if keyframe_every is not None:
            stream.gop_size = keyframe_every
        stream.codec_context.thread_type = "FRAME"  # several images at the same time
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = stream.codec_context.time_base = 1 / rate_hz

        def encode(image: Image, number: int) -> None:
            if image.ndim == 2:
                frame = av.VideoFrame.from_ndarray(image, "gray")
            else:  # a third of the time that FFmpeg's own conversion takes
                planes = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420), np.uint8)
                frame = av.VideoFrame.from_ndarray(planes, "yuv420p")
            frame.pts, frame.time_base = number, 1 / rate_hz
            container.mux(stream.encode(frame))

        def add(image: Image) -> None:
            nonlocal shown, begun
            number, repeated, shown = next(count), image is shown, image
            if repeated and keyframe_every is None:  # the image before stays
                return
            if begun is not None:
                begun.result()
            begun = encoding.submit(encode, image, number)

        with ThreadPoolExecutor(1) as encoding:  # while the next image is drawn
            yield add
        if begun is not None:
            begun.result()
        container.mux(stream.encode())


def gif(file: Path, images: Iterator[Image], delay_ms: int) -> None:
    """Write a GIF that goes round and round. Its colours are those of its first second.

    Raises:
        OSError: It cannot be written.
    """
    first = list(itertools.islice(images, 1000 // delay_ms))
    palette = _Palette(np.concatenate([first[0], first[-1]]))
    pictures = palette.pictures(itertools.chain(first, images))
    next(pictures).save(
        file, "GIF", save_all=True, append_images=pictures, duration=delay_ms, loop=0, disposal=1, optimize=False,
        palette=palette.table,
    )  # fmt: skip


class _Palette:
    """The colours of a GIF: the most frequent ones as they are, and some that are far apart."""

    def __init__(self, typical: Image) -> None:
        found, counts = np.unique(typical.reshape(-1, 3), axis=0, return_counts=True)
        picture = Pictures.fromarray(typical).quantize(_FAR_APART, Pictures.Quantize.MAXCOVERAGE)
        other = np.array(picture.getpalette(), np.uint8).reshape(-1, 3)
        both = np.concatenate([found[np.argsort(-counts)[:_FREQUENT]], other[:_FAR_APART]])
        self._colours = np.unique(both, axis=0)
        self._nearest = np.full(1 << 24, _UNKNOWN, np.int16)  # of each colour, as far as it was met
        packed = {int(colour) for colour in _packed(self._colours)}
        unused = next(k for k in range(1 << 24) if k not in packed)  # a colour of its own for what does not change
        self.table = self._colours.tobytes() + unused.to_bytes(3, "big")

    def pictures(self, images: Iterable[Image]) -> Iterator[Pictures.Image]:
        """Yield images in these colours; what does not change is transparent."""
        same = len(self._colours)
        before: Image = np.zeros(0, np.uint8)
        shown: NDArray[np.uint8] = np.zeros(0, np.uint8)
        for image in images:
            if not shown.size:
                shown = self._indices(image.reshape(-1, 3)).reshape(image.shape[:2])
                picture = shown.copy()
            else:
                changed = (image != before).any(axis=2)
                indices = self._indices(image[changed])
                picture = np.full_like(shown, same)
                picture[changed] = np.where(indices == shown[changed], same, indices)
                shown[changed] = indices
            before = image
            made = Pictures.fromarray(picture, "P")
            made.putpalette(self.table)
            made.info["transparency"] = same
            yield made

    def _indices(self, colours: Image) -> NDArray[np.uint8]:
        """Return the nearest colour's index for each of (n, 3)."""
        packed = _packed(colours)
        indices = self._nearest[packed]
        if len(new := np.unique(packed[indices == _UNKNOWN])):
            unpacked = np.stack([new >> 16, new >> 8 & 255, new & 255], axis=1)
            away = ((unpacked[:, None] - self._colours.astype(np.int32)) ** 2).sum(axis=2)
            self._nearest[new] = away.argmin(axis=1)
            indices = self._nearest[packed]
        return indices.astype(np.uint8)


def _packed(colours: Image) -> NDArray[np.int32]:
    red, green, blue = colours.T.astype(np.int32)
    return np.asarray(red << 16 | green << 8 | blue, np.int32)
