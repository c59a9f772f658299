"""Georeference Annotations of IIIF: control points of an image on the web, as Allmaps takes them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from pcwlad_geo.correction.models import AffineCorrection, Correction
from pcwlad_geo.correction.polynomials import PolynomialCorrection
from pcwlad_geo.errors import InputError
from pcwlad_geo.limits import LIMITS, check_count
from pcwlad_geo.raster import WGS84, file_name, transform_xy
from pcwlad_geo.text import joined, parse_json
from pcwlad_geo.tiepoints.format import PointFile, PointSource, TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable


@dataclass(frozen=True, slots=True)
class IiifFile:
    """How the file is written."""

    contexts: tuple[str, ...] = (
        "http://iiif.io/api/extension/georef/1/context.json",
        "http://iiif.io/api/presentation/3/context.json",
    )
    """Of the Georeference Extension, and of the Presentation API that it extends."""
    most_order: int = 3
    """Largest order of a polynomial that it names."""
    service_end: str = "/info.json"
    """End of the address that describes an image service, which its identifier lacks."""


IIIF_FILE: Final = IiifFile()
"""As the extension documents it."""
_PLACES: Final = ("resourceCoords", "pixelCoords")
"""Names of the pixel of a point, the second of drafts of the extension."""


def write_annotation(
    table: TiePointTable,
    path: Path,
    target: str,
    shape: tuple[int, int],
    *,
    source: str | None = None,
    model: Correction | None = None,
) -> None:
    """Write the tie points of a target as a Georeference Annotation; rejected ones are left out.

    Parameters
    ----------
    table : TiePointTable
        Its coordinates become longitude and latitude of WGS 84.
    path : path
        The file.
    target : path or GDAL URI
        The raster, which is named where no `source` is.
    shape : (int, int)
        Its rows and columns.
    source : str, optional
        Identifier of its canvas, or the address of the info.json of its image service.
    model : Correction, optional
        What the transformation is named after.

    Raises
    ------
    InputError
        If the table has no CRS.
    """
    points = table[table.status != "rejected"].placed
    lon_lat = transform_xy(points.xy, table.crs, WGS84)
    features = [
        {
            "type": "Feature",
            "properties": {"resourceCoords": pixel},
            "geometry": {"type": "Point", "coordinates": place},
        }
        for pixel, place in zip(points.target_px.tolist(), lon_lat.tolist(), strict=True)
        if np.isfinite(place).all()
    ]
    named = {} if model is None else {"transformation": _transformation(model)}
    annotation = {
        "@context": list(IIIF_FILE.contexts),
        "type": "Annotation",
        "motivation": "georeferencing",
        "target": _target(source or _uri_of(target), shape),
        "body": {"type": "FeatureCollection", **named, "features": features},
    }
    path.write_text(json.dumps(annotation, indent=1) + "\n", encoding="utf-8", newline="\n")


def _uri_of(name: str) -> str:
    return Path(name).absolute().as_uri() if os.path.exists(name) else name  # noqa: PTH110


def _target(source: str, shape: tuple[int, int]) -> dict[str, object]:
    rows, cols = shape
    service = source.removesuffix(IIIF_FILE.service_end)
    outline = f"0,0 {cols},0 {cols},{rows} 0,{rows}"
    return {
        "type": "SpecificResource",
        "source": {
            "id": service,
            "type": "Canvas" if service == source else "ImageService3",
            "height": rows,
            "width": cols,
        },
        "selector": {
            "type": "SvgSelector",
            "value": f'<svg width="{cols}" height="{rows}"><polygon points="{outline}" /></svg>',
        },
    }


def _transformation(model: Correction) -> dict[str, object]:
    """Return the transformation that is nearest to a correction."""
    order = model.basis.order if isinstance(model, PolynomialCorrection) else 1
    if isinstance(model, AffineCorrection | PolynomialCorrection) and order <= IIIF_FILE.most_order:
        return {"type": "polynomial", "options": {"order": order}}
    return {"type": "thinPlateSpline"}


def _recognises(source: PointSource) -> bool:
    words = [f'"{word}"' for word in (*_PLACES, "georeferencing")]
    is_json = source.head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith((b"{", b"["))
    return is_json and any(word in line for line in source.lines or () for word in words)


def _read(source: PointSource) -> PointFile:
    """Read the points of the only annotation, or of the one whose source is named as the target is."""
    path = source.path
    try:
        content: Any = parse_json("\n".join(source.lines or ()))
    except ValueError as error:
        raise InputError(f"{path} is no JSON, or damaged ({joined(error)[:200]}): get it again") from error
    annotation = _chosen(path, [*_annotations(content)], source.target_name)
    body = annotation.get("body")
    features = body.get("features") if isinstance(body, dict) else None
    if not isinstance(features, list):
        raise InputError(f"{path}: the body of the annotation is no FeatureCollection: get it again")
    check_count(path, len(features), LIMITS.points, "points")
    places = [_point(f"{path}, feature {number}", each) for number, each in enumerate(features, start=1)]
    numbers = np.array(places, dtype=np.float64).reshape(-1, 4)
    enabled = np.ones(len(numbers), bool)
    return PointFile(
        numbers[:, 2:], numbers[:, :2], enabled, "map", "px", WGS84, shape=_shape(_source(annotation))
    )


def _annotations(content: Any) -> Iterator[Mapping[str, Any]]:  # noqa: ANN401  # of any structure
    """Yield the annotations of a file, of an AnnotationPage those in it."""
    items = content.get("items", [content]) if isinstance(content, dict) else content
    for item in items if isinstance(items, list) else ():
        if isinstance(item, dict) and item.get("type") == "Annotation":
            yield item


def _chosen(path: str, annotations: list[Mapping[str, Any]], target: str) -> Mapping[str, Any]:
    stem = Path(file_name(target)).stem
    names = [_name(_source(annotation)) for annotation in annotations]
    alike = [annotation for annotation, name in zip(annotations, names, strict=True) if stem and stem in name]
    candidates = annotations if len(annotations) == 1 else alike
    if len(candidates) != 1:
        held = f"of {', '.join(names[:5])}" if names else "at all"
        raise InputError(
            f"{path} holds {len(annotations)} Georeference Annotations {held}: give a file with one, or name "
            "the target as its source"
        )
    return candidates[0]


def _source(annotation: Mapping[str, Any]) -> Any:  # noqa: ANN401  # of any structure
    """Return the canvas or image that an annotation is about."""
    target = annotation.get("target")
    return target.get("source", target) if isinstance(target, dict) else target


def _name(source: Any) -> str:  # noqa: ANN401  # of any structure
    identity = source.get("id", source.get("@id")) if isinstance(source, dict) else source
    return str(identity)[:200]


def _shape(source: Any) -> tuple[int, int] | None:  # noqa: ANN401  # of any structure
    sizes = [source.get(name) for name in ("height", "width")] if isinstance(source, dict) else []
    whole = [size for size in sizes if type(size) is int and size > 0]
    return (whole[0], whole[1]) if len(whole) == 2 else None


def _point(where: str, feature: Any) -> list[float]:  # noqa: ANN401  # of any structure
    """Return column, row, longitude and latitude of a feature."""
    try:
        properties, place = feature["properties"], feature["geometry"]["coordinates"]
        pixel = next(properties[name] for name in _PLACES if name in properties)
        numbers = [*pixel, *place[:2]]
        is_point = feature["geometry"]["type"] == "Point"
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise InputError(f"{where} is no point with resourceCoords: correct or remove it") from error
    if not is_point or len(numbers) != 4 or not all(type(number) in (int, float) for number in numbers):
        raise InputError(
            f"{where}: give resourceCoords as [column, row] and coordinates as [longitude, latitude], two "
            "numbers each"
        )
    if abs(numbers[3]) > 90:
        raise InputError(f"{where} has the latitude {numbers[3]:.10g}: coordinates are longitude, latitude")
    return [float(number) for number in numbers]


IIIF: Final = TiePointFormat("iiif", _recognises, _read)
"""The format of the Georeference Extension of IIIF, which a job writes on request."""
