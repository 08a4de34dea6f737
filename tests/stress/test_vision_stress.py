"""Eyes at length: ten thousand frames with crossings and cards in the way, and how fast."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest

from eldir.errors import InputError
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.images import jpeg
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.markers.discs import DiscTracker
from eldir_hardware.vision.pipeline import track_frames
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.markers.other_things_in_view import disturbed_film
from tests.hardware.vision.walking_films import BODY, MARKED, NAMES, SPACE, SPRINGS, cover, film, walk

pytestmark = pytest.mark.stress


def test_no_mark_changes_its_name_in_ten_thousand_frames() -> None:
    camera = VirtualCamera(21, SPACE)
    plane = calibrate_plane([image for _, image in film(camera)[:10]], camera.board)
    tracker = DiscTracker(plane, NAMES, BODY[MARKED])
    rng = np.random.default_rng(1)
    seen, worst, squares, spent = 0, 0.0, 0.0, 0.0
    for i in range(10_000):
        t = 0.1 * i
        body = walk(t % 6 if t % 12 < 6 else 12 - t % 12) + np.array([0, 0.005 * np.sin(5 * t)])
        if i % 400 > 200:  # m2 and m4 go round each other, through m3
            angle = 2 * np.pi * (i % 400 - 200) / 200
            middle, reach = (body[1] + body[3]) / 2, (body[3] - body[1]) / 2
            turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ reach
            body[1], body[3] = middle - turned, middle + turned
        image = camera.render(body, SPRINGS, MARKED)
        if i > 0 and i % 50 < 15:  # a card of random size before a random mark
            cover(image, camera, body[rng.integers(5)] + rng.normal(0, 0.01, 2), rng.uniform(0.01, 0.05))
        start = time.process_time()
        found = tracker.update(image, t)
        spent += time.process_time() - start
        error = np.linalg.norm(found - body[MARKED], axis=1)
        good = np.isfinite(error)
        seen += good.sum()
        squares += (error[good] ** 2).sum()
        worst = max(worst, error[good].max(initial=0.0))
    rate = 10_000 / spent
    rms = np.sqrt(squares / seen)
    print(f"seen {seen / 50_000:.3f}, rms {1e3 * rms:.3f} mm, worst {1e3 * worst:.2f} mm, {rate:.0f}/s")
    assert worst < 2e-3  # a swap would be 40 mm
    assert seen > 45_000
    assert rms < 1e-4
    assert rate > 250


def test_two_hundred_disturbed_films_have_no_wrong_mark_without_a_note() -> None:
    """Second robots, caps, reflections, lamps and cards; at most 2 mm off, or a note of it, or a refusal."""
    wrong, mistaken, silent, refused, seen = [], [], [], 0, []
    worst = 0.0
    films = 200
    for seed in range(films):
        found = disturbed_film(seed)
        images = [(t, jpeg.decode(jpeg.encode(image))) for t, image in found.frames]
        plane = calibrate_plane([image for _, image in images[:8]], found.camera.board)
        try:
            tracked = track_frames(images, plane, NAMES, BODY[MARKED])
        except InputError as error:
            refused += not found.alike
            print(f"{seed} {'alike' if found.alike else 'REFUSED'}: {error}; {found.words}")
            continue
        positions = np.where(tracked.trajectory.bridged[..., None], np.nan, tracked.trajectory.positions)
        error = np.linalg.norm(positions - found.truth, axis=-1)
        off = float(np.nanmax(error))
        seen.append(np.isfinite(error).mean())
        if off > 2e-3:
            print(f"{seed}: {1e3 * off:.1f} mm off, notes {tracked.quality.notes}; {found.words}")
            told = " ".join(tracked.quality.notes)
            which = [n for n, far in zip(NAMES, np.nanmax(error, axis=0) > 2e-3, strict=True) if far]
            if not ("second set" in told or all(name in told for name in which)):
                silent.append(seed)
            elif found.alike:
                mistaken.append(seed)  # ours was covered at first: nothing says which robot is ours
            else:
                wrong.append(seed)
        else:
            worst = max(worst, off)
    print(
        f"{films} films: {len(seen)} tracked, {100 * np.mean(seen):.1f} % of positions measured, "
        f"at most {1e3 * worst:.2f} mm off; wrong with a note {wrong}, robots alike {mistaken}, "
        f"without {silent}; refused {refused} without a robot alike"
    )
    assert not silent
    assert len(wrong) <= films // 50
    assert refused <= films // 10


@pytest.mark.parametrize(("size", "least", "anew"), [((640, 480), 250, 60), ((1920, 1080), 100, 25)])
def test_frames_a_second_on_one_core(size: tuple[int, int], least: float, anew: float) -> None:
    """From a decoded frame to points in metres; a film that is acquired once, and every frame anew."""
    camera = VirtualCamera(7, SPACE, size=size)
    frames = film(camera, np.arange(0, 6, 0.05))
    plane = calibrate_plane([image for _, image in frames[:10]], camera.board)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        tracker, film_spent, anew_spent, off = DiscTracker(plane, NAMES, BODY[MARKED]), [], [], []
        for i, (t, image) in enumerate(frames):
            start = time.thread_time()
            tracker.update(image, t)
            film_spent.append(time.thread_time() - start)
            if i % 4:
                continue
            start = time.thread_time()
            found = DiscTracker(plane, NAMES, BODY[MARKED]).update(image, t)
            anew_spent.append(time.thread_time() - start)
            off.append(plane.to_pixels(found) - plane.to_pixels(walk(t)[MARKED]))
    finally:
        cv2.setNumThreads(threads)
    rate, each = 1 / np.mean(film_spent), 1 / np.mean(anew_spent)
    rms = float(np.sqrt((np.array(off) ** 2).sum(axis=-1).mean()))
    print(f"{size}: {rate:.0f}/s with the first frame's acquisition, {each:.0f}/s each anew, {rms:.3f} px")
    assert rate > least and each > anew
    assert rms < 0.1


@pytest.mark.parametrize("size", [(640, 480), (1920, 1080)])
def test_error_in_poor_light(size: tuple[int, int]) -> None:
    """Light that falls by half over the picture, blur, noise of 4, tilt and a bent lens; ten cameras."""
    shade = np.linspace(1.1, 0.55, size[0])[None, :, None] * np.array([0.9, 1.0, 1.05])
    squares, worst = [], 0.0
    for seed in range(10):
        camera = VirtualCamera(100 + seed, SPACE, size=size, noise=4.0)
        frames = []
        for t, image in film(camera, np.arange(0, 6, 0.3)):
            blurred = cv2.GaussianBlur(image, (0, 0), 0.8)
            frames.append((t, np.clip(blurred * shade, 0, 255).astype(np.uint8)))
        tracker = DiscTracker(calibrate_plane([f for _, f in frames[:10]], camera.board), NAMES, BODY[MARKED])
        lens = camera.plane
        for t, image in frames:
            found = tracker.update(image, t)
            off = lens.to_pixels(found) - lens.to_pixels(walk(t)[MARKED])
            squares.append((off**2).sum(axis=1))
            worst = max(worst, float(np.nanmax(np.abs(off))))
    rms = float(np.sqrt(np.nanmean(squares)))
    print(f"{size}: rms {rms:.3f} px, worst {worst:.2f} px, seen {np.isfinite(squares).mean():.4f}")
    assert rms < 0.1
    assert np.isfinite(squares).mean() > 0.99


def test_a_whole_run_is_filmed_recorded_and_tracked_in_time(tmp_path) -> None:
    """146 s at 10 frames/s: at most 20 s of one core to render, 25 MB of log."""
    camera = VirtualCamera(1, SPACE)
    plane = calibrate_plane([image for _, image in film(camera)[:10]], camera.board)
    tracker = DiscTracker(plane, NAMES, BODY[MARKED])
    spent = {"render": 0.0, "record": 0.0, "track": 0.0}
    with Recorder(tmp_path / "a.mcap") as log:
        for t in np.arange(1460) * 0.1:
            clock = [time.process_time()]
            image = camera.render(walk(t % 6), SPRINGS, MARKED)
            clock.append(time.process_time())
            log.on_frame(t, image)
            clock.append(time.process_time())
            found = tracker.update(image, t)
            clock.append(time.process_time())
            log.on_tracks(t, NAMES, found)
            for name, passed in zip(spent, np.diff(clock), strict=True):
                spent[name] += passed
    size = (tmp_path / "a.mcap").stat().st_size
    print(", ".join(f"{k} {1e3 * v / 1460:.2f} ms" for k, v in spent.items()), f"{size / 1e6:.1f} MB")
    assert spent["render"] < 20
    assert size < 25e6
    assert read_log(tmp_path / "a.mcap").frame_count == 1460
