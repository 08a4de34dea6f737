# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""Checks the graph of a rig, from what was observed on it for some seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

TESTED = "rmw_cyclonedds_cpp"
"""The middleware that the nodes were tested on."""
HEATING = ("relay_board", "actuation_sequencer")
"""Nodes through which a schedule heats the springs."""
OBSERVERS = ("camera", "mass_tracker", "mcap_recorder", "range_of_motion")
"""Nodes that do not heat, but that every run needs."""
_MAX_SKEW = 0.05  # between two clocks: half a picture's interval [s]
_MIN_FRAME_RATE = 5.0  # below it markers get lost between two pictures [1/s]


class GraphFinding(NamedTuple):
    """Result of one check."""

    subject: str
    ok: bool
    text: str


@dataclass
class GraphSnapshot:
    """Observations of the graph; names are those within the rig's namespace."""

    domain: int
    discovery_range: str
    """Range in which nodes discover each other, such as LOCALHOST."""
    middleware: str
    namespace: str
    nodes: tuple[str, ...] = ()
    """Names of all nodes in the namespace; a name that two nodes have occurs twice."""
    states: Mapping[str, str] = field(default_factory=dict)
    """Lifecycle state in the last heartbeat of each node."""
    commanders: tuple[str, ...] = ()
    """Nodes that publish commands to the relay board."""
    foreign: Mapping[str, str] = field(default_factory=dict)
    """Topics that have another type than expected, with both."""
    clocks: int = 0
    """Number of programs that publish /clock."""
    skew: float | None = None
    """By how much the relay board's clock is ahead of this computer's [s]; None without a report."""
    pictures: int = 0
    duration: float = 1.0
    """Time in which the pictures were counted [s]."""
    stopped: str = ""
    """Why the emergency stop is latched."""
    faults: tuple[str, ...] = ()
    """Errors in the diagnostics."""


def examine(graph: GraphSnapshot) -> list[GraphFinding]:
    """One finding for each check; those that are not ok say what to do."""
    location = f"domain {graph.domain}, {graph.discovery_range.lower()}, namespace {graph.namespace}"
    findings = [GraphFinding("graph", True, location), _middleware(graph)]
    for name in (*HEATING, *OBSERVERS):
        findings.append(_node(graph, name))
    for topic, types in graph.foreign.items():
        text = f"{topic} has the type {types}: build the same eldir_msgs on all computers"
        findings.append(GraphFinding("types", False, text))
    findings += [_commands(graph), _clock(graph), _pictures(graph)]
    latched = f"latched: {graph.stopped}; look at the rig, then call reset_emergency_stop"
    findings.append(
        GraphFinding("emergency stop", not graph.stopped, latched if graph.stopped else "not latched")
    )
    findings += [GraphFinding("diagnostics", False, fault) for fault in graph.faults]
    return findings


def _middleware(graph: GraphSnapshot) -> GraphFinding:
    if graph.middleware == TESTED:
        return GraphFinding("middleware", True, graph.middleware)
    text = f"{graph.middleware} was not tested: export RMW_IMPLEMENTATION={TESTED} on all computers"
    return GraphFinding("middleware", False, text)


def _node(graph: GraphSnapshot, name: str) -> GraphFinding:
    count, state = graph.nodes.count(name), graph.states.get(name, "")
    place = f"{graph.namespace.rstrip('/')}/{name}"
    if count > 1:
        return GraphFinding(name, False, f"{count} nodes have this name: end all but one, or use namespaces")
    if not count and name == "camera" and graph.pictures:
        return GraphFinding(name, True, "another program publishes the pictures")
    if not count:
        return GraphFinding(name, False, "is not running: start it, or compare domain and namespace")
    if not state:
        return GraphFinding(
            name, False, "sends no heartbeats: it hangs, or messages do not arrive; restart it"
        )
    if state != "active":
        steps = ("configure, then activate") if state == "unconfigured" else "activate"
        return GraphFinding(name, False, f"{state}: ros2 lifecycle set {place} {steps}")
    return GraphFinding(name, True, state)


def _commands(graph: GraphSnapshot) -> GraphFinding:
    others = [n for n in graph.commanders if n != "actuation_sequencer"]
    if others:
        text = f"also sent by {', '.join(others)}: end it; only the sequencer may heat"
        return GraphFinding("commands", False, text)
    return GraphFinding(
        "commands", True, "sent by the sequencer alone" if graph.commanders else "none are sent"
    )


def _clock(graph: GraphSnapshot) -> GraphFinding:
    if graph.clocks:
        return GraphFinding(
            "clock", True, "/clock is published: with use_sim_time stamps follow it, heat never"
        )
    if graph.skew is None:
        return GraphFinding("clock", True, "not compared: relay_board sends no reports")
    text = f"relay_board's clock is {1e3 * graph.skew:+.0f} ms from this computer's"
    if abs(graph.skew) > _MAX_SKEW:
        text += ": synchronise the clocks, such as by chrony; timestamps in logs do not match"
        return GraphFinding("clock", False, text)
    return GraphFinding("clock", True, text)


def _pictures(graph: GraphSnapshot) -> GraphFinding:
    rate = graph.pictures / graph.duration
    text = f"{rate:.1f} pictures a second"
    if rate >= _MIN_FRAME_RATE:
        return GraphFinding("pictures", True, text)
    advice = f"{text} on camera/image_raw/compressed, expected {_MIN_FRAME_RATE:g} or more: check the camera"
    return GraphFinding("pictures", False, advice)
