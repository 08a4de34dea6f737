"""Films: each picture that a file holds, at the time that the file gives it; and writing VP9 in WebM, which
browsers play and which needs no licence.

A picture that cannot be decoded or converted is left out and counted; it never becomes a copy of another.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from eldir.core.files import write_bytes
from eldir.core.records import FloatArray, IntArray
from eldir.errors import InputError, MissingDependencyError
from eldir_hardware.camera.plane import Image
from eldir_hardware.images.file_kind import decoding_error

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.packet import Packet
    from av.stream import Stream
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_CODEC = "libvpx-vp9"
_OPTIONS = {"crf": "20", "deadline": "realtime", "cpu-used": "8"}
"""Drawings and camera pictures keep their looks; slower settings take up to eighty times as long."""
_PREDICTION_COLOUR = (0, 159, 230)  # BGR of the report's colour for what is predicted, #E69F00
GROUND_COLOUR = (255, 255, 0)
"""BGR of the surface of a printed ground in pictures of a camera: cyan, which no marker has."""
_FRACTION_BITS = 3  # bits of a pixel's fraction
_OPEN_OPTIONS = {"protocol_whitelist": "file"}  # a list of addresses is no film
_STRICT_DECODING = {"err_detect": "explode"}  # otherwise decoders fill damaged parts from other pictures
_THREADS = 2  # that decode frames; threads for the slices of a frame hide errors of H.264
_NO_TIMESTAMPS = 0x80  # AVFMT_NOTIMESTAMPS of FFmpeg: this kind of file carries none
_MAX_STEP_BACK_S = 0.5  # more is no jitter of a recorder: the times begin again
_MAX_LATE_SHARE = 0.1  # share of pictures that are not later than the one before
_TIMESTAMP_REMEDY = "give it timestamps, for instance 30 a second: ffmpeg -r 30 -i {name} out.mp4"
_MIN_READ_SHARE = 0.9  # share of the announced length; of a shorter film the end is missing


def encode_webm(frames: Iterable[np.ndarray], rate: float) -> bytes:
    """A film of RGB frames (height, width, 3) uint8 at `rate` a second."""
    import av

    remaining = iter(frames)
    first = next(remaining, None)
    if first is None:
        raise InputError("a video needs at least one frame")
    film = BytesIO()
    # Without this the file has a random number of its own, and no two are equal.
    with av.open(film, "w", format="webm", options={"fflags": "bitexact"}) as container:
        try:
            stream = container.add_stream(_CODEC, Fraction(rate).limit_denominator(1000), _OPTIONS)
        except ValueError:
            raise MissingDependencyError(
                f"this PyAV cannot write {_CODEC}", remedy="install the wheel of PyAV, which can"
            ) from None
        assert isinstance(stream, av.VideoStream)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        for frame in chain([first], remaining):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    return film.getvalue()


def write_webm(path: Path, frames: Iterable[np.ndarray], rate: float) -> None:
    """Write such a film; the whole file or none."""
    write_bytes(path, encode_webm(frames, rate))


def draw_body(picture: NDArray[np.uint8], pixels: FloatArray, springs: IntArray, text: str) -> None:
    """Draw into a BGR picture (H, W, 3) the masses at `pixels` (M, 2), the `springs` (S, 2) between them, and
    a line of text. A body that is not finite is left out."""
    import cv2

    if np.isfinite(pixels).all():
        points = np.round(pixels * 2**_FRACTION_BITS).astype(np.int32)
        for a, b in springs:
            cv2.line(
                picture,
                points[a].tolist(),
                points[b].tolist(),
                _PREDICTION_COLOUR,
                2,
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
        for place in points:
            cv2.circle(
                picture,
                place.tolist(),
                7 << _FRACTION_BITS,
                _PREDICTION_COLOUR,
                2,
                cv2.LINE_AA,
                _FRACTION_BITS,
            )
    cv2.rectangle(picture, (0, 0), (10 * len(text) + 12, 28), (0, 0, 0), cv2.FILLED)
    cv2.putText(picture, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, cv2.LINE_AA)


def draw_ground(picture: Image, pixels: FloatArray) -> None:
    """Draw into a BGR picture (H, W, 3) the surface of the ground with corners at `pixels` (K, 2)."""
    import cv2

    points = np.round(pixels * 2**_FRACTION_BITS).astype(np.int32)
    cv2.polylines(picture, [points], False, GROUND_COLOUR, 2, cv2.LINE_AA, _FRACTION_BITS)


def resize_to_width(picture: NDArray[np.uint8], width: int) -> tuple[NDArray[np.uint8], float]:
    """A copy of the picture that is `width` wide, with even sides as video needs them; and the scale."""
    import cv2

    scale = width / picture.shape[1]
    size = width, round(scale * picture.shape[0] / 2) * 2
    kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(picture, size, interpolation=kind), np.uint8), scale


def write_webp(path: Path, frames: Iterable[np.ndarray], rate: float, width: int = 640) -> None:
    """Write RGB frames (height, width, 3) uint8 as a picture that moves without end, WebP, `width` wide [px];
    the whole file or none."""
    from PIL import Image as pillow

    pictures = [pillow.fromarray(resize_to_width(frame, width)[0]) for frame in frames]
    if not pictures:
        raise InputError("a video needs at least one frame")
    film = BytesIO()
    options = {"duration": round(1000 / rate), "loop": 0, "quality": 50, "method": 4}
    pictures[0].save(film, "WEBP", save_all=True, append_images=pictures[1:], **options)
    write_bytes(path, film.getvalue())


@dataclass
class Video:
    """A video file. Iterating gives seconds since its first picture, and BGR pictures (H, W, 3) uint8, which
    have square pixels and are as the sensor took them, however the file asks to turn them."""

    path: Path
    rate: float | None = None
    """Frames per second of a file without times [1/s]."""
    attachments: dict[str, bytes] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list, init=False)
    """What the last whole reading found missing in the file."""

    @property
    def name(self) -> str:
        """The path, for messages."""
        return str(self.path)

    @property
    def has_times(self) -> bool:
        """Whether the file carries times; a bare stream of H.264 or JPEG does not."""
        with self._open() as container:
            return _has_times(container)

    def __iter__(self) -> Iterator[tuple[float, Image]]:
        """Raises `InputError` for a file that is no film or is interlaced, and where times are missing or
        wrong."""
        import av

        with self._open() as container:
            timed = _has_times(container)
            if not timed and self.rate is None:
                raise InputError(
                    f"{self.path} has no timestamps",
                    code="film.no-timestamps",
                    found=f"a bare stream ({container.format.name})",
                    remedy="give its frame rate, such as --rate 30",
                )
            stream = container.streams.best("video")
            if not isinstance(stream, av.VideoStream) or stream.codec_context is None:  # no decoder
                raise decoding_error(self.path)
            reading, times = _Decoder(container, stream), _Timestamps(self.name, stream.time_base)
            conversion = _Conversion(self.path, stream.sample_aspect_ratio)
            for number, frame in reading.frames():
                t = number / self.rate if not timed and self.rate else times.seconds(frame)
                yield t, conversion.picture(frame, t)
            if not reading.pictures:
                raise decoding_error(self.path)
            times.require_few_late(reading.pictures)
            self.remarks = reading.remarks(self.name)

    def _open(self) -> InputContainer:
        import av

        try:
            # "file:" lets a name contain a colon. Old cameras write metadata in their own alphabets.
            return av.open(f"file:{self.path}", options=_OPEN_OPTIONS, metadata_errors="ignore")
        except (av.FFmpegError, MemoryError, ValueError):
            raise decoding_error(self.path) from None


class _Conversion:
    """From the frames of a film to BGR pictures."""

    def __init__(self, path: Path, pixel_aspect: Fraction | None):
        from av.video.reformatter import VideoReformatter

        self._path, self._aspect = path, float(pixel_aspect or 1)
        self._reformatter = VideoReformatter()  # one for all frames: what it has set up is used again

    def picture(self, frame: VideoFrame, t: float) -> Image:
        """Raises `InputError` for an interlaced frame, and for one that cannot be converted."""
        import av

        if frame.interlaced_frame:
            raise InputError(
                f"{self._path} is interlaced at {t:.2f} s: odd and even lines are of different times",
                code="film.interlaced",
                expected="a progressive film",
                remedy=f"deinterlace it, for instance: ffmpeg -i {self._path.name} -vf bwdif out.mp4",
            )
        try:
            picture = self._reformatter.reformat(
                frame,
                width=round(frame.width * self._aspect),
                format="bgr24",
                src_color_range=frame.color_range,
                threads=1,
            ).to_ndarray()
        except (av.FFmpegError, MemoryError, ValueError) as error:
            raise InputError(
                f"the picture of {self._path} at {t:.2f} s cannot be converted",
                code="film.pixels",
                found=f"pixels as {frame.format.name}: {error}",
                remedy="convert the film, for instance with ffmpeg to .mp4",
            ) from None
        return picture


class _Decoder:
    """One pass over a film, and what is missing in it."""

    def __init__(self, container: InputContainer, stream: VideoStream):
        self.pictures = 0
        self._container, self._stream = container, stream
        self._packets = self._lost = 0
        self._end = 0.0  # of all streams [s]

    def frames(self) -> Iterator[tuple[int, VideoFrame]]:
        """Number in the film, and frame, of each whole picture.

        After damage, pictures are left out up to the next that needs no other: decoders fill what they lack
        from other pictures, and only some say so.
        """
        import av

        codec = self._stream.codec_context
        codec.options = _STRICT_DECODING
        codec.thread_type, codec.thread_count = "FRAME", _THREADS
        damaged = False
        for packet in chain(self._packets_of_file(), [None]):  # None: what the decoder still holds
            try:
                failed = packet is not None and packet.is_corrupt
                frames = [] if failed else self._stream.decode(packet)
            except av.FFmpegError:
                failed, frames = True, []
            damaged = damaged or failed
            self._lost += failed
            for frame in frames:
                damaged = damaged and not frame.key_frame
                if damaged:
                    self._lost += 1
                else:
                    yield self.pictures + self._lost, frame
                    self.pictures += 1

    def _packets_of_file(self) -> Iterator[Packet[Stream]]:
        """The packets of the film; those of its sound only show where the file ends."""
        import av

        with suppress(av.FFmpegError):  # the rest of the file is missing, and its length shows that
            for packet in self._container.demux():
                if not packet.size:  # a picture that AVI leaves out, or the end
                    continue
                stamp = packet.pts if packet.pts is not None else packet.dts
                if stamp is not None:
                    self._end = max(self._end, float((stamp + (packet.duration or 0)) * packet.time_base))
                if packet.stream_index == self._stream.index:
                    self._packets += 1
                    yield packet

    def remarks(self, name: str) -> list[str]:
        """Sentences about what is missing, after all was read."""
        sentences = [f"{name}: {self._lost} pictures are damaged and left out"] if self._lost else []
        announced = 1e-6 * (self._container.duration or 0)
        if self._packets < self._stream.frames and self._stream.average_rate:
            announced = max(announced, float(self._stream.frames / self._stream.average_rate))
        if self._end < _MIN_READ_SHARE * announced:
            sentences.append(
                f"{name} announces {announced:.1f} s, {self._end:.1f} s could be read: "
                "it may have been cut off"
            )
        return sentences


class _Timestamps:
    """The times of a film's pictures [s], from its first one on."""

    def __init__(self, name: str, unit: Fraction | None):
        self._name = name
        self._unit = unit  # of a timestamp [s]
        self._first: Fraction | None = None
        self._last = -np.inf
        self._late_count = 0

    def seconds(self, frame: VideoFrame) -> float:
        """Raises `InputError` where the frame has none, or the times begin again."""
        stamp = frame.pts if frame.pts is not None else frame.dts
        if stamp is None or self._unit is None:
            raise InputError(
                f"a picture of {self._name} has no timestamp",
                code="film.no-timestamps",
                remedy=_TIMESTAMP_REMEDY.format(name=self._name),
            )
        since = stamp * self._unit
        self._first = since if self._first is None else self._first
        t = float(since - self._first)
        if t < self._last - _MAX_STEP_BACK_S:
            raise InputError(
                f"the timestamps of {self._name} begin again: {t:.2f} s comes after {self._last:.2f} s",
                code="film.timestamps-again",
                expected="one film, and not several joined clips",
                remedy="track each clip on its own, or join them with new timestamps: ffmpeg -f concat",
            )
        self._late_count += t <= self._last
        self._last = max(t, self._last)
        return t

    def require_few_late(self, pictures: int) -> None:
        """Raise `InputError` if many pictures would be left out because they are not later than the one
        before."""
        if self._late_count > _MAX_LATE_SHARE * pictures:
            raise InputError(
                f"{self._name} has wrong timestamps",
                code="film.wrong-timestamps",
                expected="each picture later than the one before",
                found=f"{self._late_count} of {pictures} pictures that are not",
                remedy=_TIMESTAMP_REMEDY.format(name=self._name),
            )


def _has_times(container: InputContainer) -> bool:
    return not container.format.flags & _NO_TIMESTAMPS
