"""A lens from views of a pattern, against a camera whose lens is known; and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
import typer

from eldir.errors import EldirError, InputError
from eldir_app.commands.calibrate.camera import camera as camera_command
from eldir_hardware.camera import lens_fit
from eldir_hardware.camera.lens import Lens
from eldir_hardware.camera.lens_fit import calibrate_lens, coverage
from eldir_hardware.camera.plane_fit import calibrate_plane
from eldir_hardware.camera.views import Pattern, View, Views, find_views
from eldir_hardware.vision.virtual_camera import VirtualCamera
from tests.hardware.camera.known_camera import DISTORTION, MATRIX, PATTERN, POSES, SIZE, photographs, views
from tests.hardware.camera.lenses import lens_of
from tests.hardware.vision.walking_films import SPACE, TIMES, film
from tests.paths import SCHEMAS
from tests.raised import raises


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for name, image in photographs():
        cv2.imwrite(str(folder / name), image)
    return folder


def test_the_lens_is_found_within_what_it_says_of_itself() -> None:
    lens = calibrate_lens(views()).lens
    truth = np.concatenate([np.diag(MATRIX)[:2], MATRIX[:2, 2], DISTORTION])
    found = np.concatenate([lens.focal_px, lens.centre_px, lens.distortion])
    sure = lens.deviation > 0
    assert (np.abs(found - truth)[sure] < 4 * lens.deviation[sure]).all()
    assert lens.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.1)
    low, high = lens.rms_interval_px
    assert low < lens.rms_px < high < 1.2 * low
    assert lens.distortion[4] == 0 and lens.deviation[0] < 1


def moved_poses(rng: np.random.Generator) -> list[tuple[float, ...]]:
    spread = np.array([0.05, 0.05, 5.0, 5.0, 0.04])
    return [tuple(np.array(p) + spread * rng.uniform(-1, 1, 5)) for p in POSES]


@pytest.mark.parametrize(
    ("distortion", "noise", "count"),
    [
        ((-0.25, 0.1, 0.0015, 0.001, 0.15), 0.1, 20),  # a third radial term that the views hardly show
        *(
            pytest.param(distortion, noise, 40, marks=pytest.mark.stress)
            for distortion, noise in (
                ((-0.22, 0.08, 0.001, -0.0005, 0.0), 0.15),
                ((-0.3, 0.15, 0.001, -0.001, -0.06), 0.15),
                ((-0.25, 0.1, 0.0015, 0.001, 0.15), 0.1),
            )
        ),
    ],
)
def test_two_standard_deviations_cover_the_truth_in_95_of_100_calibrations(
    distortion: tuple[float, ...], noise: float, count: int
) -> None:
    truth = np.concatenate([np.diag(MATRIX)[:2], MATRIX[:2, 2], distortion])
    covered = []
    for seed in range(count):
        poses = moved_poses(np.random.default_rng([seed, 7]))
        lens = calibrate_lens(views(poses, noise, np.array(distortion), seed)).lens
        found = np.concatenate([lens.focal_px, lens.centre_px, lens.distortion])
        covered.append((np.abs(found - truth) < 2 * lens.deviation)[:8])  # k3 may stay zero
        assert (lens.deviation[:2] < 3).all()  # half a percent: the interval still says something
    share = np.mean(covered, axis=0)
    # 0.95 less three standard deviations of the share of so many samples.
    assert share.mean() > 0.94 and share.min() > 0.95 - 3 * np.sqrt(0.95 * 0.05 / count)


def test_corners_are_those_of_the_method_that_fits_best_and_the_others_widen_the_interval() -> None:
    exact = views(noise=0.1)
    rng = np.random.default_rng(5)
    both = [
        View(v.name, v.points, v.pixels + rng.normal(0, 0.3, v.pixels.shape), (v.pixels,))
        for v in exact.views
    ]
    alone = calibrate_lens(exact).lens
    lens = calibrate_lens(Views(SIZE, both, [], 0)).lens
    np.testing.assert_allclose(lens.focal_px, alone.focal_px)
    assert lens.rms_px == pytest.approx(alone.rms_px)
    assert (lens.deviation[:2] > alone.deviation[:2]).all()


def test_a_chessboards_corners_are_located_by_three_methods() -> None:
    """To 0.1 px before light that falls off within the squares."""
    image = np.full((480, 640), 255, np.uint8)
    for r in range(7):
        for c in range(10):
            if (r + c) % 2 == 0:
                image[60 + 24 * r : 84 + 24 * r, 90 + 24 * c : 114 + 24 * c] = 30
    shaded = image * np.linspace(1.0, 0.4, 640)[None]
    picture = cv2.GaussianBlur(shaded.astype(np.uint8), (0, 0), 0.8)
    (view,) = find_views([("a", picture)], Pattern(9, 6, 0.025, True)).views
    x, y = np.meshgrid(113.5 + 24 * np.arange(9), 83.5 + 24 * np.arange(6))
    expected = np.stack([x.ravel(), y.ravel()], axis=1)
    assert len(view.alternatives) == 2
    for pixels in (view.pixels, *view.alternatives):
        nearest = np.linalg.norm(expected[:, None] - pixels, axis=-1).min(axis=1)
        assert nearest.max() < 0.1


def test_photographs_of_the_sheet_calibrate(photos: Path, tmp_path: Path, capsys) -> None:
    out, picture = tmp_path / "camera.json", tmp_path / "map.png"
    (photos / "wall.png").write_bytes(cv2.imencode(".png", np.full((480, 640), 90, np.uint8))[1].tobytes())
    camera_command(photos, out=out, picture=picture)
    assert "focal length 6" in capsys.readouterr().out
    lens = Lens.load(out)
    assert lens.focal_px == pytest.approx([610, 612], abs=3)
    assert lens.centre_px == pytest.approx([326, 233], abs=3)
    assert lens.rms_px < 0.3
    values = json.loads(out.read_text())
    jsonschema.validate(values, json.loads((SCHEMAS / "camera.schema.json").read_text()))
    assert cv2.imread(str(picture)).shape == (520, 640, 3), "the picture, and the scale below it"
    with raises(EldirError, "file.exists"):
        camera_command(photos, out=out)


def test_the_sheet_is_printed_in_its_true_size(tmp_path: Path) -> None:
    camera_command(sheet=tmp_path / "sheet.pdf")
    data = (tmp_path / "sheet.pdf").read_bytes()
    assert data.startswith(b"%PDF") and b"/MediaBox [ 0 0 841" in data  # A4 across, in points
    with pytest.raises(typer.BadParameter):
        camera_command(Path("photos"), sheet=tmp_path / "b.pdf")
    with pytest.raises(typer.BadParameter, match="inner corners"):
        camera_command(Path("photos"), out=tmp_path / "c.json", chessboard="8by6")


def test_a_chessboard_serves_as_well() -> None:
    image = np.full((480, 640), 255, np.uint8)
    for r in range(7):
        for c in range(9):
            if (r + c) % 2 == 0:
                image[60 + 50 * r : 110 + 50 * r, 90 + 50 * c : 140 + 50 * c] = 0
    image = cv2.GaussianBlur(image, (0, 0), 0.8)
    pictures = [("a", image), ("b", image), ("c", np.full_like(image, 9))]
    found = find_views(pictures, Pattern(8, 6, 0.025, True))
    (view,) = found.views
    assert found.duplicates == 1 and found.without_pattern == ["c"]
    x, y = np.meshgrid(139.5 + 50 * np.arange(8), 109.5 + 50 * np.arange(6))
    expected = np.stack([x.ravel(), y.ravel()], axis=1)
    order = np.lexsort(np.round(view.pixels / 5).T)
    np.testing.assert_allclose(view.pixels[order], expected, atol=0.05)


def test_what_is_missing_is_said() -> None:
    every = views()
    with raises(
        InputError,
        "camera.too-few-views",
        match=r"at least 10.*found 6, 3 show no pattern \(such as a.png\), 2 show",
    ):
        calibrate_lens(Views(SIZE, every.views[:6], ["a.png", "b.png", "c.png"], 2))
    right = views([(0.28, y, a, b, 0.55) for _, y, a, b, _ in POSES])
    with raises(InputError, "camera.views-at-places", match="none at the top right, right, bottom right"):
        calibrate_lens(right)
    flat = views([(x, y, 0.3 * a, 0.3 * b, z) for x, y, a, b, z in POSES])
    with raises(InputError, "camera.views-alike", match="left or right by 15"):
        calibrate_lens(flat)
    with raises(InputError, "camera.views-disagree", match=r"view\d"):
        calibrate_lens(views(noise=2.0))
    with raises(InputError, "camera.sizes-differ", match=r"640 x 480.*320 x 240 in b"):
        find_views([("a", np.zeros((480, 640), np.uint8)), ("b", np.zeros((240, 320), np.uint8))], PATTERN)
    with raises(InputError, "camera.no-picture"):
        find_views([], PATTERN)


def test_a_blurred_view_is_left_out() -> None:
    found = views()
    bad = found.views[4]
    rng = np.random.default_rng(3)
    spoiled = View(bad.name, bad.points, bad.pixels + rng.normal(0, 2, bad.pixels.shape))
    done = calibrate_lens(Views(SIZE, [*found.views[:4], spoiled, *found.views[5:]], [], 0))
    assert done.outliers == ["view4.png"] and done.lens.rms_px < 0.2


def test_coverage_counts_corners_in_ninths() -> None:
    view = View("a", np.zeros((3, 3)), np.array([[1.0, 1], [639, 479], [320, 240]]))
    assert coverage([view], SIZE).tolist() == [1, 0, 0, 0, 1, 0, 0, 0, 1]


def test_the_map_says_how_long_an_error_is_drawn() -> None:
    """The bar below the picture is as long as an error of one pixel on it."""
    strip = lens_fit._map_legend(640, (640, 480)).astype(int)
    orange = np.flatnonzero((strip[20] - [0, 94, 213]).any(axis=1) == 0)
    assert abs(np.ptp(orange) - lens_fit._ERROR_MAGNIFICATION) <= 2
    assert (strip[:, 130:] < 100).any(), "the words"


def test_a_plane_with_a_known_lens_is_the_cameras() -> None:
    """The virtual camera's lens told exactly: the plane must not become worse by it."""
    camera = VirtualCamera(1, SPACE)
    secret = camera.plane
    unit = secret.half_diagonal_px
    focal = 800.0
    k = secret.radial * (focal / unit) ** np.array([2, 4])
    lens = lens_of(SIZE, [focal, focal], secret.centre_px, [*k, 0, 0, 0])
    np.testing.assert_allclose(lens.radial, secret.radial, atol=1e-6)
    images = [image for _, image in film(camera, TIMES[:5])]
    plane = calibrate_plane(images, camera.board, lens=lens)
    x, y = np.meshgrid(np.linspace(SPACE.min_x, SPACE.max_x, 20), np.linspace(0, SPACE.height, 8))
    points = np.stack([x, y], axis=-1)
    error = np.linalg.norm(plane.to_metres(secret.to_pixels(points)) - points, axis=-1)
    assert error.max() < 2e-4
    wrong = lens_of((800, 600), [focal] * 2, secret.centre_px, [*k, 0, 0, 0])
    with raises(InputError, "camera.other-size", match=r"800 x 600.*640 x 480"):
        calibrate_plane(images, camera.board, lens=wrong)
