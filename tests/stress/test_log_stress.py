"""Logs at length: a hundred killed programs, bytes flipped and cut at random, and 60 frames/s."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from eldir_hardware.log.background import BackgroundRecorder
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.log.recover import recover_log
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.log.damaged_logs import kill_and_recover, messages, record
from tests.hardware.log.log_contents import EPOCH
from tests.hardware.vision.walking_films import BODY, MARKED, NAMES, SPACE, SPRINGS, walk

pytestmark = pytest.mark.stress


def test_killed_at_a_hundred_random_instants(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    for batch in range(25):
        kill_and_recover(tmp_path / str(batch), rng.uniform(0.1, 3.0, 4).tolist())


def test_five_hundred_damaged_logs(tmp_path: Path) -> None:
    """Nothing recovered was not in the log, and no more is lost than the chunks that were hit."""
    log = record(tmp_path / "log.mcap", 30.0)
    data, original = log.read_bytes(), messages(log)
    rng = np.random.default_rng(2)
    kept_share = []
    for number in range(500):
        bad = bytearray(data)
        hits = int(rng.integers(1, 10))
        for place in rng.integers(0, len(data), hits):
            bad[place] = rng.integers(256)
        if number % 2:
            start = int(rng.integers(2500, len(data)))
            del bad[start : start + int(rng.integers(1, 20_000)) if number % 4 == 1 else None]
        (tmp_path / "bad.mcap").write_bytes(bad)
        out = tmp_path / "out.mcap"
        found = recover_log(tmp_path / "bad.mcap", out)
        kept = messages(out)
        assert len(kept - original) <= found.unchecked
        assert number % 2 or len(kept) >= len(original) - 60 * hits
        kept_share.append(len(kept) / len(original))
        out.unlink()
    print(f"kept on average {np.mean(kept_share):.2f} of all messages")


def test_sixty_frames_a_second_without_a_drop(tmp_path: Path) -> None:
    """640 x 480 with five tracks for 20 s; at most 15 % of a core."""
    camera = VirtualCamera(1, SPACE)
    images = [camera.render(walk(t), SPRINGS, MARKED) for t in np.arange(0, 6, 0.1)]
    with BackgroundRecorder(Recorder(tmp_path / "a.mcap", epoch_ns=EPOCH)) as log:
        start, spent = time.monotonic(), time.process_time()
        for i in range(1200):
            time.sleep(max(start + i / 60 - time.monotonic(), 0))
            log.on_frame(i / 60, images[i % 60])
            log.on_tracks(i / 60, NAMES, BODY[MARKED])
        share = (time.process_time() - spent) / (time.monotonic() - start)
        assert log.dropped_pictures == log.dropped_others == 0
    size = (tmp_path / "a.mcap").stat().st_size
    print(f"{100 * share:.1f} % of a core, {size / 20e6:.2f} MB/s")
    assert read_log(tmp_path / "a.mcap").frame_count == 1200
    assert share < 0.15
