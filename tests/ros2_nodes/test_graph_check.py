"""The doctor's judgement of a graph: one line for each thing that is wrong, with its remedy."""

from dataclasses import replace

import pytest

from eldir_ros.remote.graph_check import HEATING, OBSERVERS, GraphSnapshot, examine

NODES = (*HEATING, *OBSERVERS)
WELL = GraphSnapshot(
    7,
    "LOCALHOST",
    "rmw_cyclonedds_cpp",
    "/left",
    nodes=(*NODES, "virtual_bench"),
    states=dict.fromkeys(NODES, "active"),
    commanders=("actuation_sequencer",),
    skew=0.004,
    pictures=20,
    duration=2.0,
)


def test_a_graph_that_is_complete_has_no_wrong_line():
    found = examine(WELL)
    assert all(f.ok for f in found), found
    assert found[0].text == "domain 7, localhost, namespace /left"
    assert {f.subject for f in found} >= {*NODES, "middleware", "clock", "pictures", "emergency stop"}


@pytest.mark.parametrize(
    ("change", "subject", "text"),
    [
        ({"middleware": "rmw_fastrtps_cpp"}, "middleware", "export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp"),
        ({"nodes": NODES[1:]}, "relay_board", "is not running"),
        ({"nodes": (*NODES, "camera")}, "camera", "2 nodes have this name"),
        ({"states": dict.fromkeys(NODES[:-1], "active")}, "range_of_motion", "sends no heartbeats"),
        (
            {"states": dict.fromkeys(NODES, "active") | {"relay_board": "unconfigured"}},
            "relay_board",
            "ros2 lifecycle set /left/relay_board configure, then activate",
        ),
        ({"commanders": ("actuation_sequencer", "x")}, "commands", "also sent by x"),
        ({"foreign": {"run": "a/msg/B instead of c/msg/D"}}, "types", "run has the type a/msg/B instead"),
        ({"skew": -0.2}, "clock", "-200 ms from this computer's"),
        ({"pictures": 2}, "pictures", "1.0 pictures a second"),
        ({"stopped": "pressed"}, "emergency stop", "latched: pressed; look at the rig"),
        ({"faults": ("camera: broken",)}, "diagnostics", "camera: broken"),
    ],
)
def test_what_is_wrong_is_one_line_with_a_remedy(change, subject, text):
    (wrong,) = [f for f in examine(replace(WELL, **change)) if not f.ok]
    assert wrong.subject == subject and text in wrong.text and "\n" not in wrong.text


def test_pictures_of_another_program_need_no_camera_node():
    found = examine(replace(WELL, nodes=tuple(n for n in NODES if n != "camera")))
    assert all(f.ok for f in found)
    assert ("camera", True, "another program publishes the pictures") in found


def test_a_simulated_clock_is_told():
    found = examine(replace(WELL, clocks=1, skew=5.0))
    assert all(f.ok for f in found) and any("heat never" in f.text for f in found)
