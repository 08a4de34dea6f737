"""Who may heat, and which contacts switched: what a node decides by the toolkit's values."""

from eldir_hardware.guardian.bank import PATIENCE, Commander
from eldir_hardware.run.player import ContactEdge, ContactEdges


def test_one_run_heats_at_a_time():
    commander = Commander()
    assert commander.accepts("a") and commander.silence_if_lost(1e9) is None
    commander.record_command("a", 10.0)
    assert commander.accepts("a") and not commander.accepts("b")
    commander.release()
    assert commander.accepts("b") and commander.silence_if_lost(1e9) is None


def test_a_commander_that_is_not_heard_is_lost():
    commander = Commander()
    commander.record_command("a", 10.0)
    assert commander.silence_if_lost(10.0 + PATIENCE - 0.01) is None
    assert commander.silence_if_lost(10.0 + PATIENCE + 0.01) is not None
    commander.record_command("a", 10.5)
    assert commander.silence_if_lost(10.0 + PATIENCE + 0.01) is None


def test_edges_are_what_changed_between_reports():
    edges = ContactEdges()
    reports = ((0.1, (False, False)), (0.5, (True, False)), (0.9, (True, False)), (1.3, (False, True)))
    for t, closed in reports:
        edges.update(t, closed)
    assert edges.found == [
        ContactEdge(0.5, 1, True),
        ContactEdge(1.3, 1, False),
        ContactEdge(1.3, 2, True),
    ]
    assert edges.closed == (False, True)


def test_a_contact_that_is_closed_in_the_first_report_has_closed():
    edges = ContactEdges()
    edges.update(-0.2, (False, True))
    assert edges.found == [ContactEdge(-0.2, 2, True)]
