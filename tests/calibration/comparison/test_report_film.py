"""The report's film: the predicted body over the camera's pictures, in a file of bounded size."""

import re

import cv2
import numpy as np
import pytest

from eldir.trajectory import Trajectory
from eldir_calibration.comparison import film as filming
from eldir_calibration.comparison.film import (
    MAX_PICTURES,
    MAX_SIZE,
    PredictedBody,
    positions_at,
    render_film,
)
from eldir_calibration.report.comparison import Motion
from eldir_hardware.camera.plane import Plane
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder

PERIOD, CYCLES, START = 10.0, 2, 3.0
SIZE = (320, 240)
PLANE = Plane(*SIZE, np.diag([4.0, -4, 1]), [160, 120], [0, 0], 0.1)  # 800 px/m, the origin in the middle
BODY = np.array([[-0.12, 0.0], [-0.04, 0.0], [-0.08, 0.07]])
SPRINGS = np.array([[0, 1], [1, 2], [0, 2]])
TIMES = np.arange(0.0, 24.0, 0.2)


def places(speed: float) -> np.ndarray:
    """The body in each of `TIMES`: it goes ahead with that speed [m/s]."""
    return BODY + np.stack([speed * (TIMES - START), np.zeros_like(TIMES)], axis=1)[:, None]


def film(tmp_path, noise: float) -> tuple[bytes, list[np.ndarray]]:
    """Of a robot that walks 3 mm/s and was predicted to walk 6 mm/s, from another place."""
    draw = np.random.default_rng(1)
    with Recorder(tmp_path / "log.mcap", ["channel1"], ["spring0_front"]) as log:
        for t in TIMES:
            log.on_frame(t, np.clip(draw.normal(110, noise, (*SIZE[::-1], 3)), 0, 255).astype(np.uint8))
    walked = places(0.003)[:, [0, 2]]
    motion = Motion(Trajectory(("m1", "m2"), TIMES, walked), START, PERIOD, CYCLES, 0.1)
    body = PredictedBody(TIMES, places(0.006) + np.array([0.5, 0.0]), SPRINGS, np.array([0, 2]))
    data = render_film(read_log(tmp_path / "log.mcap"), PLANE, motion, body)
    (tmp_path / "film.webm").write_bytes(data)
    shown = cv2.VideoCapture(str(tmp_path / "film.webm"))
    pictures = []
    while (read := shown.read())[0]:
        pictures.append(read[1])
    return data, pictures


def orange(picture: np.ndarray) -> np.ndarray:
    """Columns that have the colour of the predicted body [px]."""
    blue, green, red = np.moveaxis(picture.astype(int), -1, 0)
    return np.unique(np.nonzero((red > 170) & (blue < 90) & (abs(green - 150) < 40))[1])


@pytest.mark.parametrize(
    ("t", "row"), [(-1.0, 0), (0.0, 0), (0.09, 0), (0.11, 1), (0.2, 1), (0.29, 1), (99.0, len(TIMES) - 1)]
)
def test_a_picture_shows_the_predicted_body_of_the_nearest_instant(t, row):
    body = PredictedBody(TIMES, places(0.006), SPRINGS, np.array([0, 2]))
    assert np.array_equal(positions_at(body, t), body.positions[row])


def test_the_predicted_body_starts_where_the_robot_is_and_walks_by_itself(tmp_path):
    data, pictures = film(tmp_path, noise=1.0)
    assert len(pictures) == MAX_PICTURES and len(data) < MAX_SIZE
    # The cut spans both walks: the film's scale is that of its width.
    spans = [orange(picture) for picture in (pictures[0], pictures[-1])]
    body_px = np.ptp(spans[0])
    ahead = spans[1].min() - spans[0].min()
    assert ahead / body_px == pytest.approx(0.006 * CYCLES * PERIOD / 0.08, rel=0.25)
    assert abs(pictures[0][60:].astype(int) - 110).mean() < 25, "the camera's picture is below"


def test_the_film_counts_its_cycles_from_one_to_the_last(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr(filming, "draw_body", lambda *given: said.append(given[3]))
    film(tmp_path, noise=1.0)
    told = [re.fullmatch(r"(\d+) s, cycle (\d) of 2", text).groups() for text in said]
    cycles = [(int(second), int(cycle)) for second, cycle in told]
    assert cycles[0] == (3, 1) and cycles[-1] == (23, 2)
    # The second one begins ten seconds after the first; where seconds are rounded to 13 both are right.
    assert {cycle for second, cycle in cycles if second < 13} == {1}
    assert {cycle for second, cycle in cycles if second > 13} == {2}
