"""What is known of springs from one run to the next: the file."""

import json
from dataclasses import replace
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from eldir.built.heat import HeatModel, SpringState
from eldir.errors import EldirError
from eldir_hardware.rig.supply import worst_springs
from eldir_hardware.safety import spring_memory
from eldir_hardware.safety.latch import read_stop, require_unlatched
from eldir_hardware.safety.spring_memory import (
    MAX_AGE,
    SpringHeat,
    load_springs,
    save_springs,
    springs_at_limit,
    start_cooling,
)
from eldir_hardware.safety.state_folder import StateFolder
from tests.hardware.emulated_rigs import emulated
from tests.hardware.rigs_and_schedules import rig_with
from tests.hardware.safety.remembered_springs import COLD, WARM
from tests.paths import SCHEMAS
from tests.raised import raises

pytestmark = pytest.mark.usefixtures("state_folder")
PORT = "/dev/ttyUSB70"  # a file of its name is written; nothing opens it


def written(folder: Path) -> Path:
    [path] = folder.glob("springs-*.json")
    return path


def test_what_was_written_is_read(monkeypatch):
    assert load_springs(PORT) == {}
    begun = spring_memory.uptime()
    save_springs(PORT, WARM)
    assert known() == WARM
    assert 0 <= load_springs(PORT)[1].age_s <= spring_memory.uptime() - begun
    assert load_springs("/dev/ttyUSB71") == {}, "another board"
    monkeypatch.setattr(spring_memory, "uptime", lambda: begun + MAX_AGE + 1)
    assert load_springs(PORT) == {}, "they have cooled"


def known() -> dict[int, SpringHeat]:
    """Without ages."""
    return {channel: replace(heat, age_s=0.0) for channel, heat in load_springs(PORT).items()}


def test_it_is_written_as_its_schema_says(state_folder):
    for springs in (WARM, None):
        save_springs(PORT, springs)
        values = json.loads(written(state_folder).read_text())
        jsonschema.validate(values, json.loads((SCHEMAS / "springs.schema.json").read_text()))
    assert values["boot"] == Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def test_what_is_forgotten_has_cooled_in_the_stillest_air():
    """Of all that a rig file may state, from the ceiling of all rigs: in small steps."""
    slowest = {"fan": False, "convection_still": 0.1 * 2.0, "heat_capacity": 1000.0, "latent_heat": 40_000.0}
    spring = replace(worst_springs(rig_with()), wire_diameter=3e-3, coil_diameter=9e-3, **slowest)
    state = SpringState(np.array([90.0]), np.zeros(1))
    cooled = HeatModel([spring]).run(np.zeros((9000, 1)), MAX_AGE / 9000, state).temperature[-1, 0]
    assert cooled < spring.ambient + 2.0


def test_a_board_is_armed_although_its_springs_are_remembered():
    """The file lies beside the stops, and is none."""
    save_springs(PORT, WARM)
    require_unlatched(PORT)
    assert read_stop(PORT) is None


def test_from_arming_on_they_may_be_hot_however_long_ago_that_was(monkeypatch):
    save_springs(PORT, None)
    later = spring_memory.uptime() + 10 * MAX_AGE
    monkeypatch.setattr(spring_memory, "uptime", lambda: later)
    assert load_springs(PORT) is None


def test_after_a_restart_they_have_cooled_since_then(monkeypatch):
    """Nobody knows how long the computer was off."""
    save_springs(PORT, WARM)
    monkeypatch.setattr(spring_memory, "_boot_id", lambda: "another start")
    monkeypatch.setattr(spring_memory, "uptime", lambda: 40.0)
    assert load_springs(PORT) == {channel: heat.aged_by(40.0) for channel, heat in WARM.items()}


@pytest.mark.parametrize(
    "change",
    [
        lambda values: "{",
        lambda values: "[]",
        lambda values: json.dumps(values | {"format": "eldir-springs/2"}),
        lambda values: json.dumps(values | {"at": 1e12}),
        lambda values: json.dumps(values | {"at": None}),
        lambda values: json.dumps(values | {"springs": {"one": {}}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(temperature_c=[float("nan"), 30.0])}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(temperature_c=[22.0])}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(martensite=[0.5, 1.5])}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(age_s=-1.0)}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(age_s=int("9" * 400))}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(pulses_s=[[1.0, 2.0]])}}),
        lambda values: json.dumps(values | {"springs": {"1": _spring(pulses_s=[[float("inf"), 2.0]])}}),
    ],
)
def test_a_damaged_file_counts_as_hot_springs(state_folder, change):
    """Also one of another version; the next run writes it anew."""
    save_springs(PORT, WARM)
    path = written(state_folder)
    path.write_text(change(json.loads(path.read_text())))
    assert load_springs(PORT) is None
    save_springs(PORT, WARM)
    assert known() == WARM


def _spring(**changes: object) -> dict:
    values = {"temperature_c": [22.0, 30.0], "martensite": [1.0, 1.0], "pulses_s": [], "age_s": 0.0}
    return values | changes


def test_a_folder_that_cannot_be_trusted_counts_as_hot_springs(state_folder):
    save_springs(PORT, WARM)
    state_folder.chmod(0o777)
    assert load_springs(PORT) is None
    with raises(EldirError, "state.not-written", match="other users can write"):
        save_springs(PORT, WARM)


def test_files_of_emulated_boards_do_not_pile_up(state_folder):
    for _ in range(3):
        with emulated("lcus") as board:
            save_springs(board.port, WARM)
    assert len(list(state_folder.glob("springs-*.json"))) == 1


def test_of_several_files_of_one_board_the_worst_counts(state_folder):
    """Such as of another board that was in this socket, or under a mark that this one has no longer."""
    save_springs(PORT, WARM)
    first = written(state_folder)
    values = json.loads(first.read_text())
    other = state_folder / "springs-0123456789abcdef.json"
    springs = {"1": _spring(temperature_c=[30.0, 88.0], martensite=[0.5, 0.5]), "2": _spring()}
    other.write_text(json.dumps(values | {"at": values["at"] - 100.0, "springs": springs}))
    other.chmod(0o600)
    worse = SpringHeat((61.5, 88.0), (0.25, 0.0), ((12.0, 7.0),))  # nobody knows of which spring
    assert known() == WARM | {1: worse, 2: COLD}
    other.write_text(json.dumps(values | {"springs": None}))
    assert load_springs(PORT) is None
    other.write_text(
        json.dumps(values | {"identity": {"name": values["identity"]["name"], "marks": ["usb:another"]}})
    )
    save_springs(PORT, WARM)
    assert other.exists(), "another board's"
    other.write_text(json.dumps(values))
    save_springs(PORT, WARM)
    assert written(state_folder) == first


def test_a_reset_lets_springs_cool_from_the_ceiling():
    """Those of which nobody knows; what is known stays."""
    rig = rig_with()
    save_springs(PORT, None)
    start_cooling(PORT, rig)
    assert known() == springs_at_limit(rig)
    save_springs(PORT, WARM)
    start_cooling(PORT, rig)
    assert known() == WARM


@pytest.mark.parametrize("older_first", [False, True])
def test_two_files_of_one_board_are_merged_whichever_is_read_first(state_folder, monkeypatch, older_first):
    """The pulses of both count, and the lesser age."""
    save_springs(PORT, {1: WARM[1]})
    first = written(state_folder)
    values = json.loads(first.read_text())
    other = state_folder / f"springs-{('0' if older_first else 'f') * 16}.json"
    older = {"1": _spring(temperature_c=[80.0, 85.0], pulses_s=[[40.0, 36.0]], martensite=[0.0, 0.1])}
    other.write_text(json.dumps(values | {"at": values["at"] - 30.0, "springs": older}))
    other.chmod(0o600)
    names = sorted([first.name, other.name], reverse=not older_first)
    monkeypatch.setattr(StateFolder, "names", lambda folder: names)
    found = load_springs(PORT)[1]
    assert found.temperature_c == (80.0, 85.0) and found.martensite == (0.0, 0.0)
    assert sorted(found.pulses_s) == [(12.0, 7.0), (40.0, 36.0)] and found.age_s < 10.0
