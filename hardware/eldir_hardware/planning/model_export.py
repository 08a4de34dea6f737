"""A robot as files that MuJoCo opens: the model, the shapes of its hubs, and the heating of a schedule."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from eldir.built.heat import SpringState, heat
from eldir.core.arguments import require_value
from eldir.core.files import new_folder, require_new, write_bytes, write_text
from eldir.core.records import FloatArray
from eldir.design import Design
from eldir.parameters.springs import SpringParameters
from eldir.parameters.wiring import FACES, Connection
from eldir_cad.checks.strip_law import built_parameters, spring_parameters
from eldir_cad.geometry.assembly import assemble
from eldir_cad.kit.printer import Printer
from eldir_cad.kit.specification import Specification
from eldir_cad.multibody.biplane import Biplane, build_biplane
from eldir_cad.multibody.biplane_mjcf import biplane_mjcf
from eldir_cad.multibody.hubs import hub_name, hub_shapes
from eldir_cad.multibody.mjcf import mjcf_text
from eldir_cad.multibody.model import Multibody, build_multibody
from eldir_hardware.rig.supply import scale_by_shares
from eldir_hardware.schedule import ActuationSchedule

ROW_INTERVAL = 0.05
"""Time between two rows of the table of a schedule [s]."""
_RUNNER_TEMPLATE = Path(__file__).with_name("model_runner.txt")


def export_robot(
    design: Design,
    out: Path,
    spec: Specification,
    printer: Printer,
    schedule: ActuationSchedule | None = None,
    springs: SpringParameters | None = None,
    dimensions: int = 2,
    shares: FloatArray | None = None,
) -> list[Path]:
    """Write the nominal robot of a design as MJCF to `out`, and the shapes of its hubs into a folder beside
    it. In three `dimensions` each face has its own strips, coils and feet.

    `springs`: by default those of `spec`. With a `schedule` also a table of its coils' free lengths and
    stiffnesses, by their `shares` (see `free_lengths`), and a program that runs both. Returns what was
    written. Raises `EldirError` if one of the files exists, `InputError` if the schedule does not fit the
    design.
    """
    stem, body = out.with_suffix(""), design.morphology
    folder = stem.with_name(f"{stem.name}-parts")
    table, runner = stem.with_name(f"{stem.name}-schedule.csv"), stem.with_name(f"{stem.name}-run.py")
    require_new(out, folder, *((table, runner) if schedule else ()))
    build = build_multibody if dimensions == 2 else build_biplane
    springs = springs or spring_parameters(spec)
    robot = built_parameters(spec, printer, springs)
    model = build(body, spec, printer, robot, ballast=design.ballast, terrain=design.printed_terrain)
    rows = None if schedule is None else _table(model, schedule, springs, shares)
    shapes = hub_shapes(assemble(body, spec))
    with new_folder(folder) as draft:
        for hub, data in shapes.items():
            write_bytes(draft / f"{hub_name(hub)}.stl", data)
    names = {hub: f"{folder.name}/{hub_name(hub)}.stl" for hub in shapes}
    if isinstance(model, Multibody):
        write_text(out, mjcf_text(model, stem.name, names))
    else:
        write_text(out, biplane_mjcf(model, stem.name, names))
    if rows is None:
        return [out, folder]
    write_text(table, rows)
    write_text(runner, _RUNNER_TEMPLATE.read_text().replace("ROBOT", stem.name))
    return [out, table, runner, folder]


def free_lengths(
    schedule: ActuationSchedule, springs: SpringParameters, motors: int, shares: FloatArray | None = None
) -> FloatArray:
    """Free lengths of the active springs of the front and the back between centres at instants 0,
    `ROW_INTERVAL`, ... [m], shape (K + 1, A, 2). `shares`: power of a spring while n springs heat, relative
    to its power alone (`eldir_hardware.rig.supply.power_shares`); by default always 1."""
    channels, states = schedule.sampled(ROW_INTERVAL)
    wired = {e.channel: Connection(e.channel, e.spring, e.face) for e in schedule.events}
    heated = 1 + max((c.spring for c in wired.values()), default=-1)
    require_value("number of springs that the schedule heats", heated <= motors, f"at most {motors}", heated)
    cold = SpringState.cold(len(channels), springs)
    on = states.astype(float) if shares is None else scale_by_shares(states.astype(float), shares)
    each = heat(on, ROW_INTERVAL, [springs] * len(channels), cold).length
    lengths = np.full((len(states) + 1, motors, len(FACES)), springs.cold_length)
    for column, channel in enumerate(channels):
        for face in wired[channel].faces:
            lengths[1:, wired[channel].spring, FACES.index(face)] = each[:, column]
    return lengths


def _table(
    model: Multibody | Biplane,
    schedule: ActuationSchedule,
    springs: SpringParameters,
    shares: FloatArray | None,
) -> str:
    """Both faces have one coil in the plane: it follows their mean."""
    if isinstance(model, Multibody):
        coils = [f"coil_{motor}" for motor in range(len(model.coils))]
        free = free_lengths(schedule, springs, len(model.coils), shares).mean(axis=2)
    else:
        coils = [f"coil_{motor}_{face}" for motor in range(len(model.front.coils)) for face in FACES]
        free = free_lengths(schedule, springs, len(model.front.coils), shares).reshape(-1, len(coils))
    lengths, stiffness = model.coil_commands(free, (springs.cold_length, springs.hot_length))
    names = ["t_s", *(f"{coil}_length_m" for coil in coils), *(f"{coil}_n_per_m" for coil in coils)]
    rows = np.hstack([ROW_INTERVAL * np.arange(len(free))[:, None], lengths, stiffness]).tolist()
    return "\n".join([",".join(names), *(",".join(f"{v:.9g}" for v in row) for row in rows)]) + "\n"
