# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""What is wrong with the graph of a rig, from what was seen on it for some seconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

TESTED = "rmw_cyclonedds_cpp"
"""The middleware that the nodes were tested on."""
HEATING = ("relay_board", "actuation_sequencer")
OBSERVERS = ("camera", "mass_tracker", "mcap_recorder", "range_of_motion")
_MOST_SKEW = 0.05  # between two clocks: half a picture's interval [s]
_LEAST_PICTURES = 5.0  # rate below which marks get lost between two pictures [1/s]


class Finding(NamedTuple):
    """Result of one check."""

    subject: str
    ok: bool
    text: str


@dataclass
class Seen:
    """What was seen on the graph; names are those within the rig's namespace."""

    domain: int
    reach: str
    """How far nodes look for each other, such as LOCALHOST."""
    middleware: str
    namespace: str
    nodes: tuple[str, ...] = ()
    """Names of the nodes in the namespace, one for each that has it."""
    states: Mapping[str, str] = field(default_factory=dict)
    """State of the lifecycle that each node's heartbeats tell."""
    commanders: tuple[str, ...] = ()
    """Nodes that publish commands to the relay board."""
    foreign: Mapping[str, str] = field(default_factory=dict)
    """Topics that have another type than expected, with both."""
    clocks: int = 0
    """Number of programs that publish /clock."""
    skew: float | None = None
    """By how much the relay board's clock is ahead of this computer's [s]; None without a report."""
    pictures: int = 0
    watched: float = 1.0
    """Time in which the pictures were counted [s]."""
    stopped: str = ""
    """Why the emergency stop is latched."""
    faults: tuple[str, ...] = ()
    """Errors in the diagnostics."""


def examine(seen: Seen) -> list[Finding]:
    """One finding for each check; those that are not ok say what to do."""
    where = f"domain {seen.domain}, {seen.reach.lower()}, namespace {seen.namespace}"
    found = [Finding("graph", True, where), _middleware(seen)]
    for name in (*HEATING, *OBSERVERS):
        found.append(_node(seen, name))
    for topic, types in seen.foreign.items():
        text = f"{topic} has the type {types}: build the same eldir_msgs on all computers"
        found.append(Finding("types", False, text))
    found += [_commands(seen), _clock(seen), _pictures(seen)]
    latched = f"latched: {seen.stopped}; look at the rig, then call reset_emergency_stop"
    found.append(Finding("emergency stop", not seen.stopped, latched if seen.stopped else "not latched"))
    found += [Finding("diagnostics", False, fault) for fault in seen.faults]
    return found


def _middleware(seen: Seen) -> Finding:
    if seen.middleware == TESTED:
        return Finding("middleware", True, seen.middleware)
    text = f"{seen.middleware} was not tested: export RMW_IMPLEMENTATION={TESTED} on all computers"
    return Finding("middleware", False, text)


def _node(seen: Seen, name: str) -> Finding:
    count, state = seen.nodes.count(name), seen.states.get(name, "")
    place = f"{seen.namespace.rstrip('/')}/{name}"
    if count > 1:
        return Finding(name, False, f"{count} nodes have this name: end all but one, or use namespaces")
    if not count and name == "camera" and seen.pictures:
        return Finding(name, True, "another program publishes the pictures")
    if not count:
        return Finding(name, False, "is not there: start it, or compare domain and namespace")
    if not state:
        return Finding(name, False, "sends no heartbeats: it hangs, or messages do not arrive; restart it")
    if state != "active":
        steps = ("configure, then activate") if state == "unconfigured" else "activate"
        return Finding(name, False, f"{state}: ros2 lifecycle set {place} {steps}")
    return Finding(name, True, state)


def _commands(seen: Seen) -> Finding:
    others = [n for n in seen.commanders if n != "actuation_sequencer"]
    if others:
        text = f"also sent by {', '.join(others)}: end it, only the sequencer may heat"
        return Finding("commands", False, text)
    return Finding("commands", True, "sent by the sequencer alone" if seen.commanders else "nobody sends any")


def _clock(seen: Seen) -> Finding:
    if seen.clocks:
        return Finding("clock", True, "/clock is published: with use_sim_time stamps follow it, heat never")
    if seen.skew is None:
        return Finding("clock", True, "not compared: relay_board sends no reports")
    text = f"relay_board's clock is {1e3 * seen.skew:+.0f} ms from this computer's"
    if abs(seen.skew) > _MOST_SKEW:
        text += ": stamps in logs do not fit (heat is not concerned); synchronise them, for example by chrony"
        return Finding("clock", False, text)
    return Finding("clock", True, text)


def _pictures(seen: Seen) -> Finding:
    rate = seen.pictures / seen.watched
    text = f"{rate:.1f} pictures a second"
    if rate >= _LEAST_PICTURES:
        return Finding("pictures", True, text)
    advice = (
        f"{text} on camera/image_raw/compressed, expected {_LEAST_PICTURES:g} or more: look at the camera"
    )
    return Finding("pictures", False, advice)
