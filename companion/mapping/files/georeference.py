"""Where a map lies in surveyed coordinates: the place of its origin, and the coordinate system of that place."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from companion.errors import InputError

if TYPE_CHECKING:
    from pyproj import CRS

Place = tuple[float, float, float]

_EPSG = re.compile(r"EPSG:\d+(\+\d+)?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class CoordinateSystem:
    """A projected coordinate system in m, such as surveyors work in.

    Attributes:
        name: as it was asked for, such as EPSG:25832.
        wkt: its description in well-known text of the first version, which is what LAS 1.4 wants.
    """

    name: str
    wkt: str

    @classmethod
    def of(cls, name: str) -> CoordinateSystem:
        """The system that a number of the EPSG registry names; ``EPSG:25832+7837`` has heights of a second one.

        Raises:
            InputError: there is none, or a map cannot be given in it: it is not east, north and up in m.
            ModuleNotFoundError: pyproj is not installed.
        """
        from pyproj.exceptions import CRSError

        crs = _found(name)
        if not crs.is_projected:
            raise InputError(
                f"{name} ({crs.name}) is no projected system: a map is in m and not in degrees; give one of your "
                "country's, such as EPSG:25832 (UTM zone 32)"
            )
        for axis in crs.axis_info:
            if axis.unit_name != "metre" or axis.direction not in ("east", "north", "up"):
                raise InputError(
                    f"{name} ({crs.name}) counts {axis.direction} in {axis.unit_name}: a map is east, north and up in "
                    "m; give a system that is too"
                )
        try:
            return cls(name.upper(), crs.to_wkt("WKT1_GDAL"))
        except CRSError as error:
            raise InputError(f"{name} ({crs.name}) cannot be said in a LAS file: {error}; give another") from None

    def problem_at(self, place_m: Place) -> str | None:
        """Why a map at ``place_m`` would lie where this system is not used; None: it would not, or nobody knows."""
        from pyproj import Transformer

        crs = _found(self.name)
        area = (crs.sub_crs_list or [crs])[0].area_of_use
        if area is None:
            return None
        to_degrees = Transformer.from_crs(crs, "EPSG:4326", always_xy=True)
        east_deg, north_deg = to_degrees.transform(place_m[0], place_m[1])
        # An area over the date line has its west to the east of its east.
        over = area.west > area.east
        inside = (east_deg >= area.west) | (east_deg <= area.east) if over else area.west <= east_deg <= area.east
        if inside and area.south <= north_deg <= area.north:
            return None
        return (
            f"{self.name} is used from {area.west:g}° to {area.east:g}° east and {area.south:g}° to {area.north:g}° "
            f"north, and the map lies at {east_deg:.2f}° east, {north_deg:.2f}° north: is --offset where its origin "
            "is, first east, then north, then the height?"
        )


@dataclass(frozen=True, slots=True)
class Georeference:
    """Where a map lies.

    Attributes:
        place_m: the map's origin in surveyed coordinates: east, north, up. In double precision, since it may be
            thousands of kilometres.
        system: what these coordinates are; None: not said.
    """

    place_m: Place = (0.0, 0.0, 0.0)
    system: CoordinateSystem | None = None


def _found(name: str) -> CRS:
    from pyproj import CRS
    from pyproj.exceptions import CRSError

    if not _EPSG.fullmatch(name):
        raise InputError(f"{name!r} is no coordinate system: give its number as EPSG:NNNN, such as EPSG:25832")
    try:
        return CRS.from_user_input(name.upper())
    except CRSError:
        raise InputError(f"{name}: the EPSG registry has no such coordinate system; check the number") from None
