# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""A client of a rig with generated messages only: python foreign_client.py SCHEDULE.json [CANCEL_AFTER_S]."""

import hashlib
import json
import sys
from pathlib import Path

import rclpy
from builtin_interfaces.msg import Duration
from eldir_msgs.action import RunSchedule
from eldir_msgs.msg import Heartbeat, RigDigest, Schedule, ScheduleEvent
from rclpy.action import ActionClient

FACES = {"front": ScheduleEvent.FRONT, "back": ScheduleEvent.BACK, "both": ScheduleEvent.BOTH}
file = json.loads(Path(sys.argv[1]).read_text())
ns = lambda seconds: round(seconds * 1e9)  # noqa: E731
lasting = lambda seconds: Duration(sec=ns(seconds) // 10**9, nanosec=ns(seconds) % 10**9)  # noqa: E731
plan = Schedule(period=lasting(file["period_s"]), settle=lasting(file["settle_s"]), springs=file["springs"])
plan.cycles, plan.conditioning_cycles = file["cycles"], file["conditioning_cycles"]
rows = [[ns(file["period_s"]), plan.cycles, plan.conditioning_cycles, ns(file["settle_s"]), *file["springs"]]]
for e in file["events"]:
    where = {"spring": e["spring"], "face": FACES[e["face"]], "channel": e["channel"]}
    plan.events.append(ScheduleEvent(time=lasting(e["t_s"]), closed=e["on"], **where))
    rows.append([ns(e["t_s"]), *where.values(), int(e["on"])])
text = "\n".join(" ".join(map(str, row)) for row in rows)  # as ScheduleOrigin.msg defines it
plan.origin.plan_digest = hashlib.sha256(text.encode()).hexdigest()
rig = file["provenance"]["digests"]["rig"]
plan.origin.rig_digests = [RigDigest(section=s, digest=d) for s, d in rig.items()]

rclpy.init()
node = rclpy.create_node("foreign_client")
alive = node.create_publisher(Heartbeat, "run_schedule/alive", 10)
node.create_timer(0.2, lambda: alive.publish(Heartbeat(name="foreign_client")))  # without them all is off
client = ActionClient(node, RunSchedule, "run_schedule")
client.wait_for_server()
goal = RunSchedule.Goal(schedule=plan, client="foreign_client")
sent = client.send_goal_async(goal, lambda m: print(list(m.feedback.closed), list(m.feedback.temperatures)))
rclpy.spin_until_future_complete(node, sent)
result = sent.result().get_result_async()
rclpy.spin_until_future_complete(node, result, timeout_sec=float(sys.argv[2]) if sys.argv[2:] else None)
if not result.done():
    sent.result().cancel_goal_async()
    rclpy.spin_until_future_complete(node, result)
print(result.result().result.message, result.result().result.all_off)
