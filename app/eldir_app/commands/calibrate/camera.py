"""The command `eldir calibrate camera`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from eldir_hardware.camera.views import Pattern


def camera(
    source: Annotated[
        str | None, typer.Argument(help="Folder of photographs of the pattern, video, or camera:0.")
    ] = None,
    *,
    out: Annotated[Path | None, typer.Option(help="Lens file to write (JSON).")] = None,
    sheet: Annotated[
        Path | None, typer.Option(help="Write the ChArUco sheet to print (PDF), instead of calibrating.")
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--map", help="Picture to write (PNG): which parts of the image the views cover."),
    ] = None,
    chessboard: Annotated[
        str | None,
        typer.Option(help="The pattern is a chessboard with this many inner corners, such as 8x6."),
    ] = None,
    square_mm: Annotated[
        float, typer.Option(min=0.1, max=1000.0, help="Side of a printed square in millimetres.")
    ] = 25.0,
    seconds: Annotated[
        float, typer.Option(min=1.0, max=86400.0, help="How long to film with a camera, in seconds.")
    ] = 30.0,
) -> None:
    """Calibrate a camera: focal length, centre and distortion from ten or more views of a printed pattern.

    Example: eldir calibrate camera --sheet sheet.pdf; print and photograph it, then
    eldir calibrate camera photos/ --out camera.json --map views.png
    """
    from eldir.core.files import require_ending, require_new, write_bytes
    from eldir_hardware.camera.views import pattern_sheet as make_sheet

    if (sheet is None) == (source is None) or (source is None) != (out is None):
        raise typer.BadParameter("give either --sheet FILE alone, or pictures and --out FILE")
    require_ending("--sheet", sheet, ".pdf")
    require_ending("--map", picture, ".png")
    require_new(out, sheet, picture)
    if sheet is not None and chessboard is not None:
        raise typer.BadParameter("--sheet writes a ChArUco sheet, not a chessboard; remove --chessboard")
    pattern = _parse_pattern(chessboard, square_mm)
    if sheet is not None:
        write_bytes(sheet, make_sheet(pattern))
        print(
            f"wrote {sheet}: print it at 100 %, then check with a ruler that ten squares are "
            f"{10 * square_mm:g} mm wide"
        )
        return
    assert source is not None and out is not None
    print(_calibrate(source, pattern, seconds, out, picture))


def _calibrate(source: str, pattern: Pattern, seconds: float, out: Path, picture: Path | None) -> str:
    """Write the lens file and the picture; return a line about the result."""
    from eldir.core.files import write_bytes
    from eldir_hardware.camera.lens_fit import calibrate_lens, coverage_map
    from eldir_hardware.camera.views import find_views
    from eldir_hardware.vision.sources import CameraDevice, calibration_pictures, open_source

    frames = open_source(source, rate=1.0, seconds=seconds)
    if isinstance(frames, CameraDevice):
        how = "hold the pattern near and far, to all sides, tilted"
        typer.echo(f"filming for {seconds:g} s, one picture a second: {how}", err=True)
    fit = calibrate_lens(find_views(calibration_pictures(frames), pattern), {"source": str(source)})
    lens = fit.lens
    lens.save(out)
    if picture is not None:
        write_bytes(picture, coverage_map(fit))
    low, high = lens.rms_interval_px
    rejected = f"; views left out because of large errors: {', '.join(fit.outliers)}" if fit.outliers else ""
    return (
        f"{out}: focal length {lens.focal_px[0]:.1f} +- {2 * lens.deviation[0]:.1f} px, "
        f"error {lens.rms_px:.2f} px ({low:.2f} to {high:.2f}), {len(fit.views)} views{rejected}"
    )


def _parse_pattern(chessboard: str | None, square_mm: float) -> Pattern:
    from eldir_hardware.camera.views import Pattern

    if chessboard is None:
        return Pattern(square=1e-3 * square_mm)
    columns, _, rows = chessboard.partition("x")
    if not (columns.isdigit() and rows.isdigit() and min(int(columns), int(rows)) > 2):
        raise typer.BadParameter(
            f"expected the number of inner corners, such as 8x6; found {chessboard!r}",
            param_hint="--chessboard",
        )
    return Pattern(int(columns), int(rows), 1e-3 * square_mm, chessboard=True)
