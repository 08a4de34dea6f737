"""Every picture of a film is its own, at its own time: containers, time bases and field orders."""

from __future__ import annotations

import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.vision.sources import Source, open_source
from tests.hardware.vision.numbered_films import RATE, damage, number_in, numbered, write_film
from tests.raised import raises

FILES = {  # name: codec, pixels, options
    "film.mp4": ("libx264", "yuv420p", {"bf": "2"}),
    "film.mov": ("libx264", "yuv420p", {"bf": "2"}),
    "film.mkv": ("libx264", "yuv420p", {"bf": "2"}),
    "film.ts": ("libx264", "yuv420p", {"bf": "2"}),
    "mpeg4.mp4": ("mpeg4", "yuv420p", {"bf": "2"}),
    "mpeg4.avi": ("mpeg4", "yuv420p", {"bf": "0"}),
    "jpeg.avi": ("mjpeg", "yuvj420p", {}),
    "jpeg.mov": ("mjpeg", "yuvj420p", {}),
    "film.webm": ("libvpx-vp9", "yuv420p", {"cpu-used": "8", "deadline": "realtime"}),
    "ten.mp4": ("libx264", "yuv420p10le", {}),
}
STEPS = {
    "constant": list(range(30)),
    "variable": np.cumsum([0, *[1, 2, 1, 1, 5, 1, 1] * 4, 1]).tolist(),
    "gap": [*range(10), *range(30, 50)],
}


def shown(source: Source) -> list[tuple[float, int]]:
    return [(round(t, 6), number_in(image)) for t, image in source]


def expected(stamps: list[int]) -> list[tuple[float, int]]:
    return [(round((stamp - stamps[0]) / RATE, 6), number) for number, stamp in enumerate(stamps)]


@pytest.mark.parametrize("steps", STEPS)
@pytest.mark.parametrize("name", FILES)
def test_a_whole_film_gives_its_pictures_at_its_times(tmp_path: Path, name: str, steps: str) -> None:
    codec, pixels, options = FILES[name]
    write_film(tmp_path / name, codec, STEPS[steps], pixels=pixels, options=options)
    film = open_source(tmp_path / name)
    assert shown(film) == expected(STEPS[steps])
    assert film.remarks == []
    assert shown(film) == expected(STEPS[steps])  # a source can be read repeatedly


@pytest.mark.parametrize("name", ["film.mp4", "film.mkv", "film.ts"])
def test_a_film_that_starts_later_begins_at_zero(tmp_path: Path, name: str) -> None:
    film = open_source(write_film(tmp_path / name, container={"output_ts_offset": "5"}))
    assert shown(film) == expected(STEPS["constant"])
    assert film.remarks == []


def test_an_edit_list_leaves_pictures_out(tmp_path: Path) -> None:
    cut = {"avoid_negative_ts": "disabled", "use_editlist": "1"}
    write_film(tmp_path / "cut.mp4", stamps=range(-7, 23), options={"bf": "0"}, container=cut)
    film = open_source(tmp_path / "cut.mp4")
    assert shown(film) == [(n / RATE, n + 7) for n in range(23)]
    assert film.remarks == []


@pytest.mark.parametrize("codec", ["libx264", "mpeg2video"])
@pytest.mark.parametrize("name", ["film.mp4", "film.mkv", "film.ts"])
@pytest.mark.parametrize("top_first", [True, False])
def test_an_interlaced_film_is_refused_with_that_word(
    tmp_path: Path, name: str, codec: str, top_first: bool
) -> None:
    order = {"x264-params": f"{'t' if top_first else 'b'}ff=1"} if codec == "libx264" else {}
    fields = {"top": str(int(top_first))} if codec == "mpeg2video" else {}
    flags = {"flags": "+ilme+ildct", **order, **fields}
    write_film(tmp_path / name, codec, options=flags)
    with raises(InputError, "film.interlaced", match=r"0\.00 s.*ffmpeg -i film\.\w+ -vf bwdif"):
        list(open_source(tmp_path / name))


def test_a_film_that_becomes_interlaced_repeats_no_picture(tmp_path: Path) -> None:
    """OpenCV 5.0 gives the last progressive picture again and again, at rising times."""
    write_film(tmp_path / "a.ts", stamps=range(20), options={"bf": "0"})
    interlaced = {"flags": "+ilme+ildct", "x264-params": "tff=1", "bf": "0"}
    write_film(tmp_path / "b.ts", stamps=range(20, 40), numbers=range(20, 40), options=interlaced)
    mixed = tmp_path / "mixed.ts"
    mixed.write_bytes((tmp_path / "a.ts").read_bytes() + (tmp_path / "b.ts").read_bytes())
    seen = []
    with raises(InputError, "film.interlaced", match=r"mixed\.ts .*2\.00 s"):
        for _, image in open_source(mixed):
            seen.append(number_in(image))
    assert len(seen) > 15 and seen == list(range(len(seen)))


@pytest.mark.parametrize(
    ("name", "codec", "pixels"), [("raw.h264", "libx264", "yuv420p"), ("raw.mjpeg", "mjpeg", "yuvj420p")]
)
def test_a_bare_stream_takes_the_rate_that_is_given(
    tmp_path: Path, name: str, codec: str, pixels: str
) -> None:
    write_film(tmp_path / name, codec, pixels=pixels)
    with raises(InputError, "film.no-timestamps", match=rf"{name} .*--rate 30"):
        list(open_source(tmp_path / name))
    assert shown(open_source(tmp_path / name, rate=20)) == [(n / 20, n) for n in range(30)]
    twice = tmp_path / f"twice {name}"
    twice.write_bytes((tmp_path / name).read_bytes() * 2)
    assert shown(open_source(twice, rate=20)) == [(n / 20, n % 30) for n in range(60)]


@pytest.mark.parametrize("name", ["film.ts", "film.mkv"])
def test_joined_clips_whose_times_begin_again_are_refused(tmp_path: Path, name: str) -> None:
    clip = write_film(tmp_path / name, options={"bf": "0"})
    joined = tmp_path / f"joined {name}"
    joined.write_bytes(clip.read_bytes() * 2)
    with raises(InputError, "film.timestamps-again", match=r"0\.00 s comes after 2\.\d0 s"):
        list(open_source(joined))


def test_a_film_with_one_time_for_all_pictures_is_refused(tmp_path: Path) -> None:
    with (
        av.open(str(write_film(tmp_path / "a.mp4", options={"bf": "0"}))) as film,
        av.open(str(tmp_path / "still.mkv"), "w") as out,
    ):
        stream = out.add_stream_from_template(film.streams.video[0])
        for packet in film.demux(video=0):
            if packet.size:
                packet.stream, packet.pts, packet.dts = stream, 0, 0
                out.mux(packet)
    with raises(InputError, "film.wrong-timestamps", match=r"found 29 of 30 pictures.*ffmpeg -r 30 -i"):
        list(open_source(tmp_path / "still.mkv"))


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "part", "lost"),
    [
        ("film.mp4", "libx264", "yuv420p", (0.25, 0.5), range(13, 20)),
        ("film.mkv", "mpeg4", "yuv420p", (0.25, 0.75), range(13, 20)),
        ("film.mkv", "libx264", "yuv420p", (0.1, 0.2), range(13, 20)),
        ("film.mp4", "libvpx-vp9", "yuv420p", (0.0, 0.1), range(13, 20)),
        ("film.avi", "mjpeg", "yuvj420p", (0.25, 0.5), range(13, 14)),
    ],
)
def test_damaged_pictures_are_left_out_and_counted(
    tmp_path: Path, name: str, codec: str, pixels: str, part: tuple[float, float], lost: range
) -> None:
    """Up to the next key frame, every tenth here, pictures are made from the damaged one."""
    film = tmp_path / name
    options = {"g": "10", "bf": "0", "sc_threshold": "0" if codec == "libx264" else "1000000000"}
    options |= {"preset": "veryfast", "cpu-used": "8", "deadline": "realtime"}  # of x264, and of VP9
    write_film(film, codec, pixels=pixels, size=(320, 240), options=options, noise=20.0)
    whole = [image for _, image in open_source(film)]
    damage(film, 13, *part)
    source = open_source(film)
    kept = [(round(RATE * t), image) for t, image in source]
    assert [number for number, _ in kept] == [n for n in range(30) if n not in lost]
    for number, image in kept:
        np.testing.assert_array_equal(image, whole[number])
    assert source.remarks == [f"{film}: {len(lost)} pictures are damaged and left out"]


@pytest.mark.parametrize("name", ["film.mp4", "film.mkv", "jpeg.avi"])
def test_a_film_that_was_cut_off_is_told(tmp_path: Path, name: str) -> None:
    codec, pixels, options = FILES[name]
    front = {"movflags": "faststart"} if name.endswith("mp4") else {}
    film = tmp_path / name
    write_film(film, codec, pixels=pixels, options={**options, "g": "5"}, size=(320, 240), container=front)
    film.write_bytes(film.read_bytes()[: film.stat().st_size * 6 // 10])
    source = open_source(film)
    seen = shown(source)
    assert 5 < len(seen) < 25 and set(seen) < set(expected(STEPS["constant"]))
    assert any("announces 3.0 s" in said and "cut off" in said for said in source.remarks)


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_a_picture_is_as_the_sensor_took_it(tmp_path: Path, rotation: int) -> None:
    """A lens belongs to the sensor, however it was held."""
    film = open_source(write_film(tmp_path / "film.mp4", rotation=rotation))
    assert shown(film) == expected(STEPS["constant"])
    assert next(iter(film))[1].shape == (48, 64, 3)


def test_pixels_are_square_and_sizes_may_be_odd(tmp_path: Path) -> None:
    odd = open_source(write_film(tmp_path / "odd.mp4", pixels="yuv444p", size=(65, 49)))
    assert shown(odd) == expected(STEPS["constant"]) and next(iter(odd))[1].shape == (49, 65, 3)
    wide = open_source(write_film(tmp_path / "wide.mp4", pixel_aspect=Fraction(3, 2)))
    assert shown(wide) == expected(STEPS["constant"]) and next(iter(wide))[1].shape == (48, 96, 3)


@pytest.mark.parametrize("pixels", ["yuv420p", "yuvj420p", "yuv420p10le", "yuv444p"])
def test_colours_are_those_that_were_filmed(tmp_path: Path, pixels: str) -> None:
    """Of limited and full range: 40 and 200 of 255."""
    film = write_film(tmp_path / "film.mp4", pixels=pixels, options={"crf": "1"}, numbers=[0b1111] * 30)
    _, image = next(iter(open_source(film)))
    assert image.flags.c_contiguous and image.dtype == np.uint8
    np.testing.assert_allclose(image[20:28, 8:24], 200, atol=4)
    np.testing.assert_allclose(image[20:28, 40:56], 40, atol=4)


def test_a_film_without_pictures_is_named(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "sound.mp4"), "w") as file:
        stream = file.add_stream("aac", rate=48000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 48000
        file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    with raises(InputError, "film.not-decoded", match=r"sound\.mp4"):
        list(open_source(tmp_path / "sound.mp4"))


def test_a_film_of_an_unknown_codec_is_named(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.mkv")
    film.write_bytes(film.read_bytes().replace(b"V_MPEG4/ISO/AVC", b"V_NOBODY/KNOWS1"))
    with raises(InputError, "film.not-decoded", match=r"film\.mkv .*codec"):
        list(open_source(film))


@pytest.mark.parametrize("name", ["film.mp4", "film.mkv", "film.ts", "jpeg.avi"])
def test_random_damage_gives_pictures_or_one_line(tmp_path: Path, name: str) -> None:
    codec, pixels, options = FILES[name]
    whole = write_film(tmp_path / name, codec, pixels=pixels, options=options).read_bytes()
    random = np.random.default_rng(1)
    for _ in range(40):
        data = bytearray(whole)
        for at in random.integers(len(data), size=random.integers(1, 20)):
            data[at] = random.integers(256)
        (tmp_path / name).write_bytes(data[: random.integers(1, 2 * len(data))])
        try:
            times = [t for t, _ in open_source(tmp_path / name)]
            assert len(times) <= 30
        except InputError as error:
            assert "\n" not in str(error)


def test_names_are_no_addresses_and_no_patterns(tmp_path: Path) -> None:
    for name in ("concat:a.mp4", "50%d.mp4", "a\udcff.mp4", "-i.mp4", "take 1: 2|3.mp4"):
        film = write_film(tmp_path / "film.mp4").rename(tmp_path / name)
        assert len(shown(open_source(film))) == 30
    cv2.imwrite(str(tmp_path / "one.png"), numbered(5))
    assert shown(open_source(tmp_path / "one.png")) == [(0.0, 5)]


def test_the_library_is_loaded_when_a_film_is_opened() -> None:
    code = "import sys, eldir_hardware.vision.sources; sys.exit('av' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
