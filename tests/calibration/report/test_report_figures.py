"""The report's figures: names at the paths, and a legend that leaves the maximum free."""

from dataclasses import replace

import numpy as np
import pytest

from eldir_calibration.report._figures import draw_heating, draw_heights, draw_paths
from eldir_calibration.report.comparison import Motion
from eldir_calibration.report.controls import compare_with_others
from eldir_calibration.report.page import write_report
from tests.calibration.report.report_input import HEATING, content
from tests.calibration.report.striding_walkers import CYCLES, PERIOD, walker


def test_every_path_has_the_name_of_its_mark() -> None:
    motions = {kind: walker() for kind in ("simulated", "predicted", "tracked")}
    (axes,) = draw_paths(motions).axes
    assert [t.get_text() for t in axes.texts] == list(motions["tracked"].trajectory.names)


def hide(motion: Motion, mark: int, begin: float, end: float) -> Motion:
    """The motion without the places of a mark between two times [s]."""
    path = motion.trajectory
    x = path.positions.copy()
    x[(path.times > begin) & (path.times < end), mark] = np.nan
    return replace(motion, trajectory=replace(path, positions=x))


@pytest.mark.filterwarnings("error")
def test_a_marker_that_is_lost_is_drawn_as_far_as_it_was_seen(tmp_path) -> None:
    """One is found after the start of the cycles that count, the other is lost in the last of them."""
    tracked = hide(hide(walker(noise=1e-5), 0, 0.0, 35.0), 1, 112.0, 1e3)
    motions = {"simulated": walker(), "predicted": walker(), "tracked": tracked}
    (axes,) = draw_paths(motions).axes
    assert [t.get_text() for t in axes.texts] == ["m2"], "m1 has no place at the start"
    drawn = [np.isfinite(line.get_ydata()).sum() for line in axes.get_lines()[-2:]]
    assert drawn == [pytest.approx(435, abs=2), pytest.approx(470, abs=2)]
    heights = draw_heights(motions, 0)
    assert all(np.isfinite(line.get_ydata()).all() for row in heights.axes for line in row.get_lines())
    for cycle in range(CYCLES):
        tracked = hide(tracked, 0, (cycle + 1.3) * PERIOD, (cycle + 1.7) * PERIOD)
    never, _ = draw_heights(motions | {"tracked": tracked}, 0).axes
    assert [np.isfinite(line.get_ydata()).any() for line in never.get_lines()].count(False) == 1
    told = write_report(content(tracked=tracked, before=walker(lift=0.0031)), tmp_path / "report")
    assert told.displacement["tracked"] == pytest.approx(0.25, abs=0.01)


def test_figures_without_data_are_left_out_and_told(tmp_path) -> None:
    """A log without contacts and temperatures, and other bodies without a correlation."""
    none = replace(HEATING, relays=HEATING.relays & False, temperatures=HEATING.temperatures * np.nan)
    whole = content(heating=none)
    others = compare_with_others({"predicted": whole.predicted}, whole.tracked, [walker(noise=1e-4)])
    unknown = replace(
        others, profile_correlation={"predicted": np.nan}, profile_correlation_of_others=(np.nan,)
    )
    write_report(replace(whole, others=unknown), tmp_path / "report")
    page = " ".join((tmp_path / "report/index.html").read_text().split())
    assert (
        "Not drawn: correlation of profiles: none is known; motion and heating over time: the log has no "
        "contacts and no temperatures." in page
    )
    assert not {p.name for p in (tmp_path / "report").iterdir()} & {"heating.png", "profiles.png"}


@pytest.mark.parametrize("maximum", [80.0, 90.0])
def test_the_legend_is_above_the_line_at_the_rigs_maximum(maximum: float) -> None:
    t = np.arange(0.0, 120.0)
    springs = ("spring0_front", "spring0_back", "spring1_front", "spring1_back")
    figure = draw_heating(
        walker(), t, np.ones((120, 4), bool), tuple("1234"), t, np.full((120, 4), 76.0), springs, maximum
    )
    figure.draw_without_rendering()  # a figure without a window has a canvas that draws nothing
    bottom = figure.axes[-1]
    heights = [set(line.get_ydata()) for line in bottom.lines]
    assert heights == [{76.0}] * 4 + [{maximum}]
    assert [text.get_text() for text in bottom.texts] == ["maximum"]
    assert bottom.get_legend().get_window_extent().y0 > bottom.transData.transform((0.0, maximum))[1]
