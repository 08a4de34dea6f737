"""The command `eldir calibrate springs`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def springs(
    recording: Annotated[
        Path,
        typer.Argument(
            help="Table (CSV) with columns t_s, current_a, voltage_v, temperature_c, fan (0 or 1) and, where "
            "they were measured, length_mm, and ambient_c of the air."
        ),
    ],
    rig: Annotated[Path, typer.Option(help="Rig file with the spring's geometry and first guesses.")],
    out: Annotated[Path, typer.Option(help="Rig file to write, with the parameters found.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print the estimates as JSON.")] = False,
) -> None:
    """Find resistance, heat capacity, losses and transition temperatures of a spring from one recording.

    Record one spring from cold: heat it above its austenite finish temperature, then let it cool below its
    martensite finish temperature. Do this in still air and again with the fan.

    Example: eldir calibrate springs heating.csv --rig rig.yaml --out measured.yaml
    """
    import json
    from dataclasses import asdict

    from eldir.core.files import require_new
    from eldir_calibration.identification.spring_record import load_spring_recording, write_rig_with_springs
    from eldir_calibration.springs.fit import fit_spring
    from eldir_hardware.rig.configuration import Rig

    require_new(out)
    fit = fit_spring(load_spring_recording(recording), Rig.load(rig).spring_parameters())
    write_rig_with_springs(rig, fit, out)
    if as_json:
        values = {n: asdict(e) for n, e in fit.estimates.items()}
        quality = {"residual_k": fit.residual, "noise_k": fit.noise, "surroundings_c": fit.ambient_range}
        faults = [asdict(f) for f in fit.faults]
        typer.echo(
            json.dumps({"estimates": values, **quality, "faults": faults, "left": fit.unidentified}, indent=1)
        )
        return
    for name, estimate in fit.estimates.items():
        typer.echo(f"{name}: {estimate}")
    typer.echo(f"residual: {fit.residual:.2f} K (root mean square); noise of the samples: {fit.noise:.2f} K")
    for remark in fit.remarks:
        typer.echo(f"note: {remark}")
    if fit.unidentified:
        typer.echo(f"not determined by this recording, so unchanged: {', '.join(fit.unidentified)}")
    typer.echo(f"wrote {out}")
