# Copyright 2026 the developers of eldir
# Use of this source code is governed by an MIT-style license that can be found in the LICENSE file or at
# https://opensource.org/licenses/MIT.

"""The example of an SROS 2 policy allows what each node does on a real graph, and nobody else to heat."""

import time
from fnmatch import fnmatch
from pathlib import Path
from xml.etree import ElementTree

import pytest

POLICY = Path(__file__).parents[1] / "sros2" / "policy.xml"
FREE = ("/rosout", "/parameter_events")


def allowed(kind, rule):
    """Names that each enclave's nodes may use, absolute: enclave to node to names."""
    found = {}
    for enclave in ElementTree.parse(POLICY).iter("enclave"):
        for profile in enclave.iter("profile"):
            node = profile.get("node")
            names = [
                name.text.replace("~", f"/{node}") if name.text[0] in "~/" else f"/{name.text}"
                for listed in profile
                if listed.get(rule) == "ALLOW"
                for name in listed.iter(kind)
            ]
            found.setdefault(enclave.get("path"), {})[node] = names
    return found


def test_only_the_sequencer_may_command_the_relay_board():
    publishing = allowed("topic", "publish")
    commanders = [
        (enclave, node)
        for enclave, nodes in publishing.items()
        for node, names in nodes.items()
        if any(fnmatch("/relay_board/commands", name) for name in names)
    ]
    assert commanders == [("/eldir/rig", "actuation_sequencer")]
    assert set(publishing["/eldir/viewer"]["viewer"]) == set(FREE), "who watches publishes nothing"
    assert "/emergency_stop" in allowed("service", "request")["/eldir/viewer"]["viewer"], "everybody may stop"
    assert [e for e, nodes in allowed("action", "call").items() if any(nodes.values())] == ["/eldir/client"]


def test_sros2_reads_every_enclave():
    """It goes through all children of `enclaves` and takes the path of each, a comment's too."""
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    enclaves = ElementTree.parse(POLICY, parser).getroot().find("enclaves")
    assert [enclave.get("path") for enclave in enclaves] == ["/eldir/rig", "/eldir/client", "/eldir/viewer"]


def test_the_policy_allows_what_the_nodes_do(tmp_path):
    pytest.importorskip("rclpy", reason="needs ROS 2 Jazzy")
    pytest.importorskip("eldir_msgs", reason="needs the package eldir_msgs, built by colcon")
    from graph import NODES, Graph, wait_until

    names = (*NODES, "robot_model")
    with Graph(tmp_path, names) as graph:
        graph.ready()
        node = graph.node
        every = (*names, "virtual_bench")

        def done(name):
            """What a node does, as far as it has been discovered: rule, kind and name."""
            return {
                (rule, kind, used)
                for does, kind, rule in (
                    (node.get_publisher_names_and_types_by_node, "topic", "publish"),
                    (node.get_subscriber_names_and_types_by_node, "topic", "subscribe"),
                    (node.get_service_names_and_types_by_node, "service", "reply"),
                )
                for used, _ in does(name, "/")
                if "/_action/" not in used
            }

        wait_until(lambda: set(every) <= set(node.get_node_names()))
        wait_until(lambda: all({r for r, _, _ in done(n)} >= {"publish", "reply"} for n in every))
        found, before = {n: done(n) for n in every}, None
        while found != before:  # nothing more has been discovered for a second
            time.sleep(1.0)
            found, before = {n: done(n) for n in every}, found
        for name in every:
            for rule, kind, used in found[name]:
                may = allowed(kind, rule)["/eldir/rig"][name]
                assert any(fnmatch(used, pattern) for pattern in may), f"{name} may not {rule} {used}"
