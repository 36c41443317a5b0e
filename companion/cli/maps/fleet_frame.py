"""Where a vehicle's map lies in the frame that a fleet shares: from the summary of its flight, beside the map."""

from __future__ import annotations

import json
import math
from pathlib import Path

import typer

from companion.cli.maps.sources import map_at
from companion.cli.maps.surveyed import SUMMARY_NAME
from companion.control.sharing import Frame
from companion.errors import InputError
from companion.mapping.journal import JOURNAL_NAME

FLEET_FRAME = "shared by a fleet (fleet.start_pose)"
"""What the header of a journal says of its axes when its maps were put into that frame."""


def fleet_frame(source: Path) -> Frame | None:
    """Where the map of a vehicle of a fleet lies; None where its flight's summary does not say, or there is none.

    Args:
        source: a flight's folder, or the journal in it.

    Raises:
        InputError: the summary says it, and wrongly.
    """
    place = map_at(source)
    if place.name != JOURNAL_NAME:
        return None
    path = place.parent / SUMMARY_NAME
    try:
        fleet = json.loads(path.read_text(encoding="utf-8")).get("fleet")
        said = None if fleet is None else fleet["frame"]
        if said is None:
            return None
        frame = Frame(*(float(said[key]) for key in ("x_m", "y_m", "z_m", "yaw_rad")))
        if not all(map(math.isfinite, (frame.x_m, frame.y_m, frame.z_m, frame.yaw_rad))):
            raise ValueError
    except FileNotFoundError:
        return None
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        why = error.strerror if isinstance(error, OSError) else "fleet.frame has to be x_m, y_m, z_m and yaw_rad"
        raise InputError(f"{path}: does not say where the map of its vehicle lies: {why}") from None
    typer.echo(
        f"{source}: moved by {frame.x_m:.2f} {frame.y_m:.2f} {frame.z_m:.2f} m and turned by "
        f"{math.degrees(frame.yaw_rad):.1f} degrees to the left, as {SUMMARY_NAME} beside it says",
        err=True,
    )
    return frame
