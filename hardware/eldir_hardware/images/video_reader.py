"""Reading films: each picture that the file holds, at the time that the file gives it.

A picture that cannot be decoded or converted is left out and counted; it never becomes a copy of another.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from eldir.errors import InputError
from eldir_hardware.camera.plane import Image
from eldir_hardware.images.file_kind import decoding_error

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.packet import Packet
    from av.stream import Stream
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

_OPTIONS = {"protocol_whitelist": "file"}  # a list of addresses is no film
_STRICT_DECODING = {"err_detect": "explode"}  # otherwise decoders fill damaged parts from other pictures
_THREADS = 2  # that decode frames; threads for the slices of a frame hide errors of H.264
_NO_TIMESTAMPS = 0x80  # AVFMT_NOTIMESTAMPS of FFmpeg: this kind of file carries none
_MAX_STEP_BACK_S = 0.5  # more is no jitter of a recorder: the times begin again
_MAX_LATE_SHARE = 0.1  # share of pictures that are not later than the one before
_TIMESTAMP_REMEDY = "give it timestamps, for instance 30 a second: ffmpeg -r 30 -i {name} out.mp4"
_MIN_READ_SHARE = 0.9  # share of the announced length; of a shorter film the end is missing


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
            return av.open(f"file:{self.path}", options=_OPTIONS, metadata_errors="ignore")
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
