# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Stops that meet a fault: a rig file that is gone, a contact that stays closed, current that still flows."""

import json
import shutil
import time
from contextlib import contextmanager

import pytest

rclpy = pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")

from eldir_msgs.msg import HeatCommand, Pulse  # noqa: E402
from graph import Graph, wait_until  # noqa: E402
from schedules import CONFIG, LONG  # noqa: E402

from eldir_hardware.rig.configuration import Rig  # noqa: E402
from eldir_hardware.virtual.rig import VirtualRig  # noqa: E402
from eldir_ros.base.qualities import COMPLETE  # noqa: E402
from eldir_ros.conversions import duration_of, runs  # noqa: E402

CALLED = "the emergency stop was called"


@pytest.fixture
def rig(tmp_path):
    """A copy of the example's rig file, with its design."""
    for name in ("design.json", "rig.yaml"):
        shutil.copy(CONFIG / name, tmp_path)
    return tmp_path / "rig.yaml"


@contextmanager
def measured_board(folder):
    """A graph whose relay board has a current sensor; and the emulated devices, which can have faults."""
    values = Rig.load(CONFIG / "rig.yaml").to_json()
    values |= {"sensor": {"kind": "ina3221"}, "virtual": values["virtual"] | {"clock": "wall"}}
    with VirtualRig(Rig.from_json(values), None) as virtual, Graph(folder, ()) as graph:
        values["sensor"]["port"] = virtual.sensor_port
        (folder / "measured.yaml").write_text(json.dumps(values))
        graph.start("relay_board", rig=folder / "measured.yaml", port=virtual.emulator.port)
        yield graph, virtual


def weld(virtual, channel):
    """The contact stays closed, which the board does not notice. It conducts until the cut-off opens."""
    repair(virtual, channel)
    virtual.emulator.set_coil(channel, True, virtual.clock.now())
    virtual.emulator.faults.welded.add(channel)
    virtual.emulator.set_coil(channel, False, virtual.clock.now())


def repair(virtual, channel):
    """The contact opens again."""
    virtual.emulator.faults.welded.discard(channel)
    virtual.emulator.set_coil(channel, False, virtual.clock.now())


def test_the_emergency_stop_needs_no_rig_file(tmp_path, rig):
    with Graph(tmp_path, ("relay_board", "actuation_sequencer"), rig=rig) as graph:
        graph.ready()
        goal = graph.heating(LONG)
        rig.write_text("x")
        asked = time.monotonic()
        answer = graph.call("emergency_stop")
        off = graph.all_off()
        print(f"emergency stop without a rig file: off {off - asked:.3f} s after the call")
        assert answer.success, answer.message
        graph.require_within(off - asked, 0.5)
        result = graph.result(goal)
        assert result.outcome == runs.STOPPED and CALLED in result.message and result.all_off
        assert (graph.stops[-1].stopped, graph.stops[-1].reason) == (True, CALLED)
        answer = graph.call("emergency_stop")
        assert answer.success, "no guardian holds the board now, and the rig that was opened is still known"
        assert not graph.call("reset_emergency_stop").success and graph.stops[-1].stopped
        shutil.copy(CONFIG / "rig.yaml", rig)
        assert graph.call("reset_emergency_stop").success
        wait_until(lambda: not graph.stops[-1].stopped, 5)


def test_a_stop_of_a_board_that_was_never_opened_is_latched_for_the_port_of_the_parameter(tmp_path, rig):
    with Graph(tmp_path, (), rig=rig) as graph:
        rig.write_text("x")
        graph.start("relay_board")
        answer = graph.call("emergency_stop")
        assert not answer.success and "rig.yaml" in answer.message, "nothing was proven"
        wait_until(lambda: graph.stops[-1].stopped, 5)
        shutil.copy(CONFIG / "rig.yaml", rig)
        assert graph.configure("relay_board") and not graph.activate("relay_board")
        assert graph.call("reset_emergency_stop").success


def test_stop_and_reset_measure_where_there_is_a_sensor(tmp_path):
    with measured_board(tmp_path) as (graph, virtual):
        assert graph.state("relay_board") == "unconfigured"
        for service in ("emergency_stop", "reset_emergency_stop"):
            weld(virtual, 4)
            answer = graph.call(service)
            assert not answer.success and "current flows in channel 4" in answer.message
            assert "cut the heating supply now" in answer.message
            wait_until(lambda: graph.stops[-1].stopped, 5)
        repair(virtual, 4)
        virtual.emulated_sensor.faults.silent = True
        answer = graph.call("emergency_stop")
        assert answer.success and "latched" in answer.message and "no current was measured" in answer.message
        assert not graph.call("reset_emergency_stop").success and graph.stops[-1].stopped
        virtual.emulated_sensor.faults.silent = False
        answer = graph.call("reset_emergency_stop")
        assert answer.success and "the sensor shows no current in channels 1 to 4" in answer.message
        wait_until(lambda: not graph.stops[-1].stopped, 5)
        assert graph.configure("relay_board") and graph.activate("relay_board"), graph.said("relay_board")
        answer = graph.call("emergency_stop")
        assert answer.success and "current" in answer.message, "the guardian measured"


def test_a_node_whose_contact_stays_closed_is_not_deactivated_in_order(tmp_path):
    with measured_board(tmp_path) as (graph, virtual):
        assert graph.configure("relay_board") and graph.activate("relay_board"), graph.said("relay_board")
        commands = graph.node.create_publisher(HeatCommand, "relay_board/commands", COMPLETE)
        wait_until(lambda: commands.get_subscription_count() > 0, 10)
        pulse = [Pulse(channel=1, duration=duration_of(4.0))]
        commands.publish(HeatCommand(command=HeatCommand.PULSES, run="x", sequence=1, pulses=pulse))
        wait_until(lambda: virtual.emulator.contacts[0], 10)
        virtual.emulator.faults.deaf.add(1)
        assert not graph.deactivate("relay_board")
        assert graph.state("relay_board") == "unconfigured"
        wait_until(lambda: graph.stops[-1].stopped, 5)
        assert "cut the heating supply now" in graph.said("relay_board")
        virtual.emulator.faults.deaf.clear()
        assert graph.call("reset_emergency_stop").success
