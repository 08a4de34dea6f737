"""The command `eldir calibrate springs`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def springs(
    recording: Annotated[
        Path,
        typer.Argument(
            help="Table (CSV) with columns t_s, current_a, voltage_v, temperature_c, fan (0 or 1), and "
            "length_mm where it was measured."
        ),
    ],
    rig: Annotated[Path, typer.Option(help="The rig file: geometry and first guess.")],
    out: Annotated[Path, typer.Option(help="Rig file to write, with what was found.")],
    as_json: Annotated[bool, typer.Option("--json", help="For other programs.")] = False,
) -> None:
    """Find resistance, heat capacity, losses and transition temperatures from a heating and a cooling.

    Record one spring from cold: heat it above its austenite finish and let it cool below its martensite
    finish, in still air and again with the fan.

    Example: eldir calibrate springs heating.csv --rig rig.yaml --out measured.yaml
    """
    import json
    from dataclasses import asdict

    from calibration.springs.fit import fit_springs
    from eldir.core.files import require_new
    from hardware.analysis.spring_record import load_recording, rig_with_springs
    from hardware.rig.configuration import Rig

    require_new(out)
    fit = fit_springs(load_recording(recording), Rig.load(rig).spring_parameters())
    rig_with_springs(rig, fit, out)
    if as_json:
        values = {n: asdict(e) for n, e in fit.estimates.items()}
        typer.echo(json.dumps({"estimates": values, "residual_k": fit.residual, "left": fit.left}, indent=1))
        return
    for name, estimate in fit.estimates.items():
        typer.echo(f"{name}: {estimate}")
    typer.echo(f"temperatures are met within {fit.residual:.2f} K")
    if fit.left:
        typer.echo(f"not determined by this recording, left as they were: {', '.join(fit.left)}")
    typer.echo(f"wrote {out}")
