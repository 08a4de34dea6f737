"""The command `eldir markers`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def markers(
    *,
    out: Annotated[Path, typer.Option(help="New folder for the sheets to print (PDF).")],
    marker: Annotated[
        list[str] | None,
        typer.Option(help="Kind of the markers: discs, aruco, apriltag. May be repeated. Default: all."),
    ] = None,
    tags: Annotated[int, typer.Option(min=4, max=40, help="Number of reference tags.")] = 10,
    tag_side_mm: Annotated[
        float, typer.Option(min=10.0, max=128.0, help="Side of the black square of a reference tag in mm.")
    ] = 60.0,
    dictionary: Annotated[
        str, typer.Option(help="Dictionary of the reference tags: DICT_4X4_50, DICT_APRILTAG_36h11, ...")
    ] = "DICT_4X4_50",
) -> None:
    """Write the sheets to print: markers for m1 to m5, and reference tags, in their true size.

    Each sheet has a scale bar; check it with calipers before you cut.

    Example: eldir markers --out sheets
    """
    from eldir.core.files import require_new, write_bytes
    from eldir.core.pictures import pdf
    from eldir_hardware.camera.tags import require_dictionary
    from eldir_hardware.markers.registration import installed_kinds, load_kind
    from eldir_hardware.markers.sheet import marker_pages, tag_pages

    require_dictionary(dictionary, tags)
    require_new(out)
    sheets = {f"{kind}.pdf": pdf(marker_pages(load_kind(kind))) for kind in marker or installed_kinds()}
    sheets["reference-tags.pdf"] = pdf(tag_pages(dictionary, tags, 1e-3 * tag_side_mm))
    out.mkdir(parents=True)
    for name, data in sheets.items():
        write_bytes(out / name, data)
    print(f"{out}: {', '.join(sheets)}; print at 100 %, and check the scale bars of 100 mm with calipers")
