"""Scanners of other programs."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core


class Geometry(NamedTuple):
    """A scanner of another program in scene units."""

    scanner: _core.Scanner
    angles: NDArray[np.float64]
    """Radians [view], or vectors of poses [view, 12]: what functions take as `angles`."""
    scale: float
    """Scene units per unit of length of the other program. Attenuation per that unit is `scale` times that per scene unit."""


def _list(value: Any) -> Any:
    return np.asarray(value, dtype=float).tolist()


def _reversed(value: Any) -> Any:
    return _list(np.asarray(value, dtype=float)[..., ::-1])


def _geometry(scanner: Mapping[str, Any], angles: Any) -> Geometry:
    return Geometry(*_core.geometry_of(json.dumps({"scanner": scanner}), angles))


def from_tigre(geo: Any, angles: ArrayLike) -> Geometry:
    """The scanner of a geometry of TIGRE, with its offsets, turns and centre of rotation, also of single views.

    TIGRE's arrays have other orders: its `projections` are `np.ascontiguousarray(projections[:, ::-1], dtype=np.float32)` here, its
    volume `np.ascontiguousarray(volume.transpose(2, 1, 0), dtype=np.float32)`, attenuation per its unit of length.

    Parameters
    ----------
    geo : tigre.geometry
        Any object with TIGRE's attributes `DSO`, `DSD`, `nDetector`, `dDetector`, `nVoxel`, `sVoxel` and others; mode "cone" or
        "parallel".
    angles : array [view]
        Radians.

    Returns
    -------
    Geometry

    Raises
    ------
    ValueError
        For attributes that are missing or do not fit each other.
    """
    required = ("nDetector", "dDetector", "nVoxel", "sVoxel")
    mode = getattr(geo, "mode", None) or "cone"
    missing = [name for name in (*required, *(("DSO", "DSD") if mode == "cone" else ())) if getattr(geo, name, None) is None]
    if missing:
        raise ValueError(f"geo: got no {missing[0]}, expected the attributes of tigre.geometry; set geo.{missing[0]}")
    pixels, pitch = np.asarray(geo.nDetector), np.asarray(geo.dDetector, dtype=float)
    scanner = {
        "mode": mode,
        "nDetector": _list(pixels),
        "sDetector": _list(pixels * pitch),
        "nVoxel": _reversed(geo.nVoxel),
        "sVoxel": _reversed(geo.sVoxel),
    }
    if mode == "cone":
        scanner |= {"DSO": _list(geo.DSO), "DSD": _list(geo.DSD)}
    for name, converted in {"offOrigin": _reversed, "offDetector": _reversed, "rotDetector": _list, "COR": _list}.items():
        value = getattr(geo, name, None)
        if value is not None and np.any(np.asarray(value)):
            # Of the detector, TIGRE may add a third number, along the rays.
            scanner[name] = converted(np.asarray(value)[..., :2] if name == "offDetector" else value)
    return _geometry(scanner, angles)


def from_astra(proj_geom: Mapping[str, Any], vol_geom: Mapping[str, Any]) -> Geometry:
    """The scanner of geometries of ASTRA: `cone`, `cone_vec` or `parallel3d`.

    ASTRA's arrays have other orders: its projections [v, view, u] are
    `np.ascontiguousarray(projections.transpose(1, 0, 2)[:, ::-1], dtype=np.float32)` here (without `[:, ::-1]` of a `cone_vec` whose
    u × v points away from the source), its volume `np.ascontiguousarray(volume.transpose(2, 1, 0), dtype=np.float32)`,
    attenuation per its unit of length.

    Parameters
    ----------
    proj_geom, vol_geom : dict
        Of `astra.create_proj_geom` and `astra.create_vol_geom`.

    Returns
    -------
    Geometry

    Raises
    ------
    ValueError
        For another type of geometry, and voxels that the beam does not surround.
    """
    kind = proj_geom.get("type")
    if kind not in ("cone", "cone_vec", "parallel3d"):
        raise ValueError(f'proj_geom: got type {kind!r}, expected "cone", "cone_vec" or "parallel3d"; give one of them')
    counts = [int(vol_geom[name]) for name in ("GridColCount", "GridRowCount", "GridSliceCount")]
    option = vol_geom.get("option", {})
    low = [float(option.get(f"WindowMin{axis}", -n / 2)) for axis, n in zip("XYZ", counts)]
    high = [float(option.get(f"WindowMax{axis}", n / 2)) for axis, n in zip("XYZ", counts)]
    pixels = [int(proj_geom["DetectorRowCount"]), int(proj_geom["DetectorColCount"])]
    scanner: dict[str, Any] = {
        "mode": "parallel" if kind == "parallel3d" else "cone",
        "nDetector": pixels,
        "nVoxel": counts,
        "sVoxel": [b - a for a, b in zip(low, high)],
    }
    centre = [(a + b) / 2 for a, b in zip(low, high)]
    if kind == "cone_vec":
        vectors = np.array(proj_geom["Vectors"], dtype=float).reshape(-1, 12)
        source, middle, u, v = (vectors[:, i : i + 3] for i in (0, 3, 6, 9))
        # Rows are counted along v, so that u × v points away from the source.
        v[np.einsum("ij,ij->i", np.cross(u, v), middle - source) < 0] *= -1
        lengths = [float(np.linalg.norm(axis[0])) for axis in (v, u)]
        # In the frame of the volume's centre.
        vectors[:, :3] -= centre
        vectors[:, 3:6] -= centre
        normal = np.cross(u[0], v[0]) / (lengths[0] * lengths[1])
        scanner |= {
            "sDetector": [n * pitch for n, pitch in zip(pixels, lengths)],
            "DSO": float(-source[0] @ normal),
            "DSD": float((middle[0] - source[0]) @ normal),
            "vectors": vectors.tolist(),
        }
        return _geometry(scanner, np.arctan2(source[:, 1], source[:, 0]))
    pitch = [float(proj_geom["DetectorSpacingY"]), float(proj_geom["DetectorSpacingX"])]
    scanner["sDetector"] = [n * size for n, size in zip(pixels, pitch)]
    if kind == "cone":
        to_axis = float(proj_geom["DistanceOriginSource"])
        scanner |= {"DSO": to_axis, "DSD": to_axis + float(proj_geom["DistanceOriginDetector"])}
    if any(centre):
        scanner["offOrigin"] = centre
    angles: Sequence[float] = proj_geom["ProjectionAngles"]
    # The first view of ASTRA looks along +y, the one at angle 0 here along -x.
    return _geometry(scanner, np.asarray(angles, dtype=float) - np.pi / 2)
