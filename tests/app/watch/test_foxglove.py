"""The live connection, by a plain WebSocket client that speaks Foxglove's protocol."""

import json
import struct
import time

from typer.testing import CliRunner
from websockets.sync.client import connect

from eldir_app.commands.rig import rig as command
from eldir_hardware.log import messages as m
from tests.app.watch.bench import virtual_run, watching

_MESSAGE = struct.Struct("<BIQ")  # kind, subscription, time of the message [ns]


def test_a_viewer_sees_the_topics_of_the_run_that_goes_on(tmp_path):
    rig = tmp_path / "virtual.yaml"
    with virtual_run(tmp_path), watching("--rig", rig, "--foxglove", 0) as (_, server):
        place = server.told.split()[-1]
        with connect(place, subprotocols=["foxglove.sdk.v1"]) as viewer:
            assert viewer.subprotocol == "foxglove.sdk.v1"
            channels, deadline = {}, time.monotonic() + 20
            while not {m.RELAYS, m.STATUS, "/springs/spring0_front/temperature"} <= channels.keys():
                assert time.monotonic() < deadline, channels
                news = json.loads(viewer.recv(10))
                if news["op"] == "serverInfo":
                    assert "clientPublish" not in news["capabilities"]
                for channel in news.get("channels", ()):
                    channels[channel["topic"]] = channel
            relays = channels[m.RELAYS]
            assert (relays["encoding"], relays["schemaEncoding"]) == ("cdr", "ros2msg")
            assert relays["schemaName"] == "control_msgs/msg/DynamicJointState"
            wanted = [{"id": 7, "channelId": relays["id"]}]
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
            while isinstance(told := viewer.recv(10), str):
                pass
            kind, subscription, stamp = _MESSAGE.unpack_from(told)
            assert (kind, subscription) == (1, 7) and abs(time.time_ns() - stamp) < 2e9
            report = m.typestore().deserialize_cdr(told[_MESSAGE.size :], relays["schemaName"])
            assert report.joint_names[0] == "channel1" and len(report.interface_values) == 4


def test_a_port_that_is_taken_is_told():
    with watching("--listen", "127.0.0.1:0", "--foxglove", 0) as (_, server):
        taken = server.told.rpartition(":")[2]
        found = CliRunner().invoke(command, ["watch", "--listen", "127.0.0.1:0", "--foxglove", taken])
    assert "for Foxglove" in str(found.exception)
