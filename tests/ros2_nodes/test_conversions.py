"""Conversions of messages, without ROS: every message goes over the wire as CDR and back."""

import numpy as np
import pytest
from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import HeatCommand, Run
from rosbags.highlevel import AnyReader
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from eldir.errors import InputError
from eldir_hardware.images import jpeg
from eldir_hardware.log.reader import read_log
from eldir_hardware.log.recorder import Recorder
from eldir_hardware.rig.configuration import Rig
from eldir_hardware.rig.template import virtual_rig
from eldir_hardware.run.player import ContactEdge
from eldir_hardware.schedule import ActuationSchedule
from eldir_ros.conversions import (
    board,
    duration_of,
    header_of,
    marks,
    nanoseconds,
    pictures,
    runs,
    seconds_from,
    time_of,
)
from eldir_ros.conversions.schedules import schedule_of
from tests.hardware.camera.lenses import lens_of
from tests.hardware.rigs_and_schedules import SCHEDULE
from tests.raised import raises
from tests.ros2_nodes.message_types import NOW, passed, store


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text(virtual_rig())
    return Rig.load(path)


@pytest.fixture
def picture():
    rng = np.random.default_rng(5)
    return rng.integers(0, 256, (48, 64, 3), dtype=np.uint8)


def test_a_stamp_comes_back_to_the_nanosecond():
    for stamp in (0, 1, 999_999_999, 1_000_000_000, NOW):
        assert nanoseconds(passed(time_of(stamp))) == stamp
    assert header_of(NOW, "ground").frame_id == "ground"


def test_a_raw_picture_comes_back_in_every_encoding(picture):
    message = passed(pictures.raw_of(NOW, picture))
    assert (message.encoding, message.step, message.header.frame_id) == ("bgr8", 192, "camera_optical_frame")
    np.testing.assert_array_equal(pictures.picture_from(message), picture)
    message.encoding = "rgb8"
    np.testing.assert_array_equal(pictures.picture_from(message), picture[:, :, ::-1])
    padded = np.concatenate([picture[:, :, 0], np.zeros((48, 8), np.uint8)], axis=1)
    message.encoding, message.step, message.data = "mono8", 72, padded.ravel()
    np.testing.assert_array_equal(pictures.picture_from(message)[:, :, 2], picture[:, :, 0])
    message.encoding = "yuv422"
    with pytest.raises(InputError, match="expected bgr8, rgb8 or mono8; found yuv422"):
        pictures.picture_from(message)


def test_a_compressed_picture_keeps_its_bytes(picture):
    data = jpeg.encode(picture).tobytes()
    message = passed(pictures.compressed_of(NOW, data))
    assert message.data.tobytes() == data and "jpeg" in message.format
    np.testing.assert_array_equal(pictures.picture_from(message), jpeg.decode(np.frombuffer(data, np.uint8)))
    info = passed(pictures.info_of(NOW, 64, 48))
    assert (info.width, info.height, info.k[0]) == (64, 48, 0)


def test_camera_info_tells_the_lens():
    lens = lens_of((64, 48), [70, 71], [31, 24], [-0.2, 0.05, 0.001, -0.002, 0])
    sent = pictures.info_of(NOW, 64, 48, lens)
    info = passed(sent)
    assert (info.header.frame_id, info.distortion_model) == ("camera_optical_frame", "plumb_bob")
    assert info.k.tolist() == [70, 0, 31, 0, 71, 24, 0, 0, 1]
    assert info.d.tolist() == lens.distortion.tolist()
    with raises(InputError, "camera.other-size", match="64 x 48 pixels; found 640 x 480"):
        pictures.info_of(NOW, 640, 480, lens)


def test_a_drivers_camera_info_is_recorded_as_it_came(tmp_path, picture):
    """Of a model that we do not have, binned, and of a part of the sensor."""
    told = {"height": 48, "width": 64, "distortion_model": "rational_polynomial", "binning_x": 2}
    told |= {"d": np.arange(8.0), "k": np.arange(1.0, 10.0), "r": np.eye(3).ravel(), "p": np.arange(12.0)}
    told |= {"binning_y": 2, "roi": RegionOfInterest(x_offset=4, do_rectify=True)}
    sent = passed(CameraInfo(**told))
    with Recorder(tmp_path / "a.mcap") as log:
        log.on_camera_info(0.0, pictures.info_from(sent))
        log.on_frame(0.1, picture)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        topics = [c for c in reader.connections if c.topic == "/camera/camera_info"]
        ((_, _, raw),) = reader.messages(connections=topics)
    kept = store().deserialize_cdr(raw, "sensor_msgs/msg/CameraInfo")
    assert kept.header.frame_id == "camera_optical_frame"
    kept.header = sent.header
    name = "sensor_msgs/msg/CameraInfo"
    assert store().serialize_cdr(kept, name) == store().serialize_cdr(sent, name)


def test_a_report_of_the_board_comes_back(rig):
    state = board.BoardState(
        NOW,
        0.05,
        "a",
        7,
        True,
        rig.channel_names,
        (True, False, True, False),
        rig.spring_names,
        (61.25, 22.0, 45.125, 22.5),
        62.0,
        0.003,
        (3.25, 0.0, 0.0, 0.0),
        (3.0, 0.0, 0.0, 0.0),
    )
    message = passed(board.states_of(state))
    assert board.state_from(message) == state
    message.closed = message.closed[:3]
    with pytest.raises(ValueError, match="one value for each contact"):
        board.state_from(message)
    stop = passed(board.stop_of(NOW, "pressed"))
    assert stop.stopped and stop.reason == "pressed"
    assert not board.stop_of(NOW, None).stopped


def test_an_edge_comes_back():
    sent = runs.edge_of(ContactEdge(0.5, 1, True))
    message = passed(sent)
    assert (seconds_from(message.elapsed), message.channel, message.closed) == (0.5, 1, True)


def test_outcomes_are_those_of_the_message():
    result = RunSchedule.Result
    assert (runs.FINISHED, runs.REFUSED, runs.STOPPED) == (result.FINISHED, result.REFUSED, result.STOPPED)
    assert 0 not in (HeatCommand.KEEPALIVE, HeatCommand.PULSES, Run.RUNNING), "an empty message says nothing"


def test_pulses_come_back_with_their_delay():
    sent = runs.pulses_of("a", 3, 0.25, {2: 0.7, 4: 1.5})
    message = passed(sent)
    assert message.command == message.PULSES and (message.run, message.sequence) == ("a", 3)
    assert runs.pulses_from(message) == (0.25, {2: 0.7, 4: 1.5})


@pytest.mark.parametrize(("delay", "seconds"), [(1.1, 1.0), (-0.6, 1.0), (0.3, 0.0), (0.3, -1.0)])
def test_what_is_no_duration_is_no_command(delay, seconds):
    message = runs.pulses_of("a", 1, delay, {1: seconds})
    with pytest.raises(ValueError, match=r"its delay|invalid durations"):
        runs.pulses_from(message)


@pytest.mark.parametrize(
    ("elapsed", "phase", "cycle"),
    [
        (-0.1, "ARMING", 0),
        (1.0, "SETTLING", 0),
        (3.0, "CONDITIONING", 1),
        (23.0, "COUNTING", 1),
        (99.0, "COUNTING", 3),
    ],
)
def test_the_phase_of_a_run_is_no_number_of_a_cycle(elapsed, phase, cycle):
    plan = ActuationSchedule(20.0, events=(), cycles=3, conditioning_cycles=1, settle_s=3.0)
    assert runs.phase_of(plan, elapsed) == (getattr(RunSchedule.Feedback, phase), cycle)


def test_durations_come_back_to_the_digit():
    for seconds in (0.0, 3.4, 0.1, -0.25, -1.5, 1e-9, 119.999, 1234.567891):
        assert seconds_from(passed(duration_of(seconds))) == seconds
    for wrong in (np.nan, np.inf):
        with pytest.raises((ValueError, OverflowError)):
            duration_of(wrong)


def test_ranges_of_motion_have_a_value_for_each_marker():
    ranges = {"predicted": np.array([0.01, 0.02]), "tracked": np.array([0.011, 0.019])}
    sent = runs.ranges_of(NOW, 2, ("m1", "m2"), ranges, 0.1)
    message = passed(sent)
    assert (message.cycle, message.markers, message.displacement) == (2, ["m1", "m2"], 0.1)
    assert message.predicted.tolist() == [0.01, 0.02] and message.tracked.tolist() == [0.011, 0.019]
    assert message.simulated.tolist() == [], "not known"


def test_a_log_recorded_from_messages_has_the_bytes_of_one_recorded_directly(rig, picture, tmp_path):
    """What passes through the graph loses nothing: the recorder node writes the library's log."""
    reports = [
        (k * 0.1, (k % 3 == 1, False, k % 2 == 0, False), (22.0 + k, 23.5, 61.0, 22.0)) for k in range(20)
    ]
    places = np.array([[0.1, 0.2], [np.nan, np.nan]])
    names = ("m1", "m2")
    options = (rig.channel_names, rig.spring_names, NOW)

    def stamp(t):
        return NOW + round(t * 1e9)

    with Recorder(tmp_path / "direct.mcap", *options) as log:
        for t, closed, heat in reports:
            log.on_relays(t, closed)
            log.on_temperatures(t, heat)
            log.on_frame(t, picture)
            log.on_tracks(t, names, places)
    with Recorder(tmp_path / "graph.mcap", *options) as log:
        for t, closed, heat in reports:
            state = board.BoardState(
                stamp(t), 0.0, "a", 1, True, options[0], closed, options[1], heat, 90.0, 0.0
            )
            state = board.state_from(passed(board.states_of(state)))
            at = (state.stamp - NOW) * 1e-9
            log.on_relays(at, state.closed)
            log.on_temperatures(at, state.temperatures)
            sent = pictures.compressed_of(stamp(t), jpeg.encode(picture).tobytes())
            seen = passed(sent)
            log.on_picture((nanoseconds(seen.header.stamp) - NOW) * 1e-9, seen.data, 64, 48)
            array = passed(marks.markers_of(stamp(t), names, places))
            at_ns, found, where = marks.tracks_from(array)
            log.on_tracks((at_ns - NOW) * 1e-9, found, where)
    assert (tmp_path / "direct.mcap").read_bytes() == (tmp_path / "graph.mcap").read_bytes()
    recorded = read_log(tmp_path / "graph.mcap")
    assert [data.tobytes() for _, data in recorded.pictures] == [jpeg.encode(picture).tobytes()] * 20


def test_the_boards_values_on_the_graph_are_the_logs_messages(rig, tmp_path):
    """Same topic, type and bytes: a log that is played on a graph feeds who listens there."""
    names = rig.channel_names, rig.spring_names
    with Recorder(tmp_path / "a.mcap", *names, NOW) as log:
        log.on_relays(0.0, (True, False, False, True))
        log.on_temperatures(0.0, (22.5, 61.0, 22.0, 23.0))
        log.on_currents(0.0, (3.25, 0.0, 0.0, 3.0), (3.0, 0.0, 0.0, 2.9))
    sent = {
        "/relays": board.contacts_of(NOW, names[0], (True, False, False, True)),
        "/currents": board.currents_of(NOW, names[1], (3.25, 0.0, 0.0, 3.0)),
        "/voltages": board.voltages_of(NOW, names[1], (3.0, 0.0, 0.0, 2.9)),
        "/springs/spring0_back/temperature": board.temperature_of(NOW, 61.0),
    }
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        kept = {c.topic: (c.msgtype, bytes(raw)) for c, _, raw in reader.messages()}
    for topic, message in sent.items():
        kind, raw = kept[topic]
        assert bytes(store().serialize_cdr(message, kind)) == raw, topic


def test_what_was_measured_of_the_air_goes_with_the_run():
    for room in (None, 21.4375):
        sent = runs.run_of(Run.RUNNING, "a", NOW, schedule_of(SCHEDULE), "", room)
        assert runs.room_of(passed(sent)) == room
    assert runs.room_from(None) is None and runs.room_from(21) == 21.0
