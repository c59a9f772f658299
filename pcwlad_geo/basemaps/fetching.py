"""The part of a web map that a target needs, fetched once into a GeoTIFF, with regard for the server."""

from __future__ import annotations

import http.client
import math
import queue
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from rasterio.enums import ColorInterp
from rasterio.io import MemoryFile
from rasterio.windows import Window as FileWindow

from pcwlad_geo.basemaps.service import Service, public_name
from pcwlad_geo.basemaps.services import find_service
from pcwlad_geo.errors import InputError, TrustError
from pcwlad_geo.events import EventCallback, Progress
from pcwlad_geo.limits import LIMITS
from pcwlad_geo.options import Settings
from pcwlad_geo.raster import Basemap, RasterInfo, Window, jacobian, map_px
from pcwlad_geo.raster.gdal import GDAL_ERRORS
from pcwlad_geo.raster.trust.permissions import current_trust
from pcwlad_geo.raster.writing import sink
from pcwlad_geo.registration import Inputs
from pcwlad_geo.text import joined

T = TypeVar("T")
Pixels = NDArray[np.uint8]
"""A tile, (4, rows, cols): red, green, blue, and 0 where there is nothing."""


class Tile(NamedTuple):
    """The place of a tile."""

    zoom: int
    row: int
    col: int


class FetchingParameters(NamedTuple):
    """How a server is asked."""

    threads: int = 4
    """Most requests at a time."""
    timeout_s: float = 20.0
    """Most seconds without an answer."""
    tries: int = 2
    """Requests for a tile, where the server is busy or slow."""
    most_late: int = 4
    """So many tiles may fail in spite of that; one more ends the work."""
    most_missing: float = 0.5
    """Largest share of tiles that there may not be, or that show nothing."""
    most_coarser: int = 6
    """So many zooms coarser than the target a map may end."""
    margin_px: int = 64
    """Margin around the target besides the search radius."""
    radius_px: int = 64
    """What the search radius counts here where none is given: a georeferencing may err by more."""
    poll_s: float = 0.2
    """Time after which an interrupt is looked for."""


FETCHING: Final = FetchingParameters()
"""Those in use."""
_DRIVERS: Final = ("PNG", "JPEG", "WEBP", "GIF", "GTiff")
"""What tiles may be: formats that name no other files."""
_STATUS: Final = {401: "a login is missing", 403: "it refuses this program", 429: "it was asked too often"}


class _EndedError(Exception):
    """The server gives no more tiles; the message says why."""


class _MissingError(Exception):
    """There is no such tile, or it is no image; the message says which."""


def fetch(name: str, inputs: Inputs, path: Path, on_event: EventCallback) -> Settings:
    """Fetch the part of a web map that a target needs into a GeoTIFF; return the settings to match with it.

    That is the target's footprint, as the settings place it, within their extent, and a margin. A target that
    nothing places is looked for in all of the extent. Raises `TrustError` if a network may not be used, and
    `InputError` if the service or the place is not understood, is refused, or half of its tiles are missing.
    """
    service = _service(name)
    info = inputs.target_beside(_whole(service))
    zoom, window, settings = _part(service, info, inputs.target, inputs.settings)
    Part(service, zoom, window, exact=settings.ref_zoom is not None).fetch(path, on_event)
    return settings


@dataclass(frozen=True, slots=True)
class Part:
    """The part of a web map that is needed."""

    service: Service
    zoom: int
    window: Window
    """Pixels of the zoom."""
    exact: bool
    """Whether the user has chosen the zoom; where there are no tiles of it, a coarser one is taken if not."""

    @classmethod
    def of_all(cls, name: str, infos: Sequence[RasterInfo], settings: Settings) -> Part:
        """Return the part that several images need, at the zoom of the finest.

        Raises `TrustError` and `InputError` as `fetch` does before it fetches.
        """
        service = _service(name)
        parts = [_part(service, info, info.uri, settings)[:2] for info in infos]
        zoom = max(zoom for zoom, _ in parts)
        corners = [np.array(_corners(window)) * 2.0 ** (zoom - level) for level, window in parts]
        window = Window.around(np.min(corners, axis=(0, 1)), np.max(corners, axis=(0, 1)))
        return cls(service, zoom, window, settings.ref_zoom is not None)

    def is_in(self, info: RasterInfo) -> bool:
        """Return whether a raster was fetched from the service and shows the part."""
        if info.basemap is None or info.basemap.name != self.service.name:
            return False
        corners = np.array(_corners(self.window), dtype=np.float64)
        corners_px = info.grid.to_px(self.service.level(self.zoom).to_xy(corners))
        per_px = np.ptp(corners_px, axis=0) / self.window.shape[::-1]
        inside = (corners_px > -0.5) & (corners_px < np.array(info.grid.shape[::-1]) + 0.5)
        return bool(inside.all() and (not self.exact or np.allclose(per_px, 1.0)))

    def fetch(self, path: Path, on_event: EventCallback) -> None:
        """Fetch it into a GeoTIFF; raises `InputError` if the service refuses, or half of it is missing."""
        service, zoom, window = self.service, self.zoom, self.window
        pixels_of: dict[Tile, Pixels] = {}
        if not self.exact:
            zoom, window = _existing(service, zoom, window, pixels_of)
        tiles = _tiles(window, zoom, service.tile_px)
        if len(tiles) > LIMITS.basemap_tiles:
            raise InputError(
                f"{service.name}: {len(tiles)} tiles of zoom {zoom} show the ground of the target, and at "
                f"most {LIMITS.basemap_tiles} are fetched: give --ref-zoom {max(1, zoom - 1)} or less, or an "
                "--extent"
            )
        on_event(Progress("fetching", 0, len(tiles)))
        failures = _write(service, path, tiles, _fetched(service, tiles, pixels_of, on_event))
        if sum(failures.values()) > FETCHING.most_missing * len(tiles):
            said = ", ".join(f"{count} are {reason}" for reason, count in failures.most_common())
            raise InputError(
                f"{service.name} has too little of the ground of the target at zoom {zoom}: of {len(tiles)} "
                f"tiles {said}; give a coarser --ref-zoom, such as {max(1, zoom - 2)}, or another map"
            )


def _service(name: str) -> Service:
    """Return the service of a name; raises `TrustError` if a network may not be used."""
    if not current_trust().remote:
        raise TrustError(
            f"{name.partition('?')[0]} is fetched over a network: give --allow-remote to allow that"
        )
    return find_service(name, _read_text)


def _whole(service: Service) -> RasterInfo:
    """Return a service as a raster, at its first zoom."""
    return RasterInfo(service.name, 1, 4, service.first, True, "uint8", None, None)


def _write(
    service: Service, path: Path, tiles: list[Tile], fetched: Iterator[tuple[Tile, Pixels | str]]
) -> Counter[str]:
    """Write tiles into a GeoTIFF as they come; return the reasons why there are none, and how often."""
    side, first, last = service.tile_px, tiles[0], tiles[-1]
    shape = ((last.row - first.row + 1) * side, (last.col - first.col + 1) * side)
    part = service.level(first.zoom).part((float(first.col) * side, float(first.row) * side), shape)
    profile = {"driver": "GTiff", "count": 4, "dtype": "uint8", "height": shape[0], "width": shape[1]}
    profile |= {"crs": part.crs, "transform": part.transform, "compress": "deflate", "tiled": True}
    failures: Counter[str] = Counter()
    date = datetime.now(timezone.utc).date().isoformat()
    with sink(path, profile | {"blockxsize": 256, "blockysize": 256}) as file:
        file.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
        file.update_tags(**Basemap(service.name, None, None, date, drawn=False).tags())
        for tile, pixels in fetched:
            if isinstance(pixels, str):
                failures[pixels] += 1
                continue
            row, col = (tile.row - first.row) * side, (tile.col - first.col) * side
            file.write(pixels, window=FileWindow(col, row, side, side))
    return failures


def _part(
    service: Service, info: RasterInfo, target: str, settings: Settings
) -> tuple[int, Window, Settings]:
    """Return the zoom and the pixels that a target needs, and the settings of the match with them."""
    extent = settings.extent
    if not info.georeferenced and extent is None:
        raise InputError(
            f"{target} has no georeferencing, so that nothing says which part of {service.name} to fetch: "
            "give --extent XMIN YMIN XMAX YMAX around it, or --place (a GDAL geotransform), both in "
            f"{service.first.crs}"
        )
    corners = np.reshape(extent or (0.0,) * 4, (2, 2))
    if info.georeferenced:
        outline_px = map_px(info.grid.boundary_px(), info.grid, service.first)
        step = jacobian(info.grid.middle_px, info.grid, service.first)[0]
    else:
        outline_px = service.first.to_px(corners)
        step = np.diag(np.ptp(outline_px, axis=0) / max(info.grid.shape))
        settings = replace(settings, extent=None)
    if not np.isfinite(outline_px).all() or not np.isfinite(step).all():
        raise InputError(f"{target} lies where {service.name} has no coordinates: give another map")
    exact_zoom = -math.log2(math.sqrt(abs(np.linalg.det(step)) or 1.0))
    zoom = min(
        settings.ref_zoom if settings.ref_zoom is not None else max(0, round(exact_zoom)), service.finest
    )
    radius_px = settings.search_radius or FETCHING.radius_px
    margin_px = FETCHING.margin_px + radius_px * max(1.0, 2.0 ** (zoom - exact_zoom))
    grid = service.level(zoom)
    px = outline_px * 2.0**zoom
    if extent is not None and info.georeferenced:
        box_px = np.sort(grid.to_px(corners), axis=0)
        px = np.clip(px, box_px[0], box_px[1])
    margin = 0.0 if not info.georeferenced else margin_px
    window = Window.around(px.min(axis=0) - margin, px.max(axis=0) + margin).clipped(grid.shape)
    if window.empty:
        raise InputError(f"{target} lies outside of {service.name}: give a map that shows it")
    return zoom, window, settings


def _existing(
    service: Service, zoom: int, window: Window, pixels_of: dict[Tile, Pixels]
) -> tuple[int, Window]:
    """Return the finest zoom, at most that, at which there is a tile in the middle of a window of it.

    That tile is put into `pixels_of`.
    """
    for coarser in range(min(zoom, FETCHING.most_coarser) + 1):
        low, high = (np.array(corner) / 2**coarser for corner in _corners(window))
        part, middle = Window.around(low, high), ((low + high) / 2 // service.tile_px).astype(int)
        tile = Tile(zoom - coarser, int(middle[1]), int(middle[0]))
        try:
            pixels_of[tile] = _tile(service, tile)
        except _MissingError as error:
            if "HTTP" in str(error):
                continue
        except (_EndedError, TimeoutError) as error:
            raise InputError(f"{service.name} cannot be fetched: {error}") from error
        return zoom - coarser, part
    return zoom, window


def _corners(window: Window) -> tuple[tuple[int, int], tuple[int, int]]:
    return (window.col, window.row), (window.col_stop, window.row_stop)


def _tiles(window: Window, zoom: int, side: int) -> list[Tile]:
    rows = range(window.row // side, -(-window.row_stop // side))
    cols = range(window.col // side, -(-window.col_stop // side))
    return [Tile(zoom, row, col) for row in rows for col in cols]


def _fetched(
    service: Service, tiles: list[Tile], pixels_of: dict[Tile, Pixels], on_event: EventCallback
) -> Iterator[tuple[Tile, Pixels | str]]:
    """Yield each tile with its pixels, or why there are none; a few threads fetch those that are not known.

    Raises `InputError` where the server refuses, or fails too often.
    """
    yield from pixels_of.items()
    waiting: queue.SimpleQueue[Tile] = queue.SimpleQueue()
    answers: queue.SimpleQueue[tuple[Tile, Pixels | str | BaseException]] = queue.SimpleQueue()
    stop = threading.Event()
    for tile in tiles:
        if tile not in pixels_of:
            waiting.put(tile)

    def work() -> None:
        while not stop.is_set():
            try:
                tile = waiting.get_nowait()
            except queue.Empty:
                return
            try:
                answers.put((tile, _tile(service, tile)))
            except _MissingError as error:
                answers.put((tile, str(error)))
            except BaseException as error:  # raised in the thread that consumes the tiles
                answers.put((tile, error))

    late = 0

    def tell(count: int) -> None:
        on_event(Progress("fetching", count, len(tiles)))

    try:
        for _ in range(min(FETCHING.threads, len(tiles))):
            threading.Thread(target=work, daemon=True).start()
        for count in range(len(pixels_of), len(tiles)):
            tell(count)
            tile, pixels = _next(answers, partial(tell, count))
            if isinstance(pixels, TimeoutError) and late < FETCHING.most_late:
                late, pixels = late + 1, "not answered"
            if isinstance(pixels, _EndedError | TimeoutError):
                raise InputError(f"{service.name} cannot be fetched: {pixels}")
            if isinstance(pixels, BaseException):
                raise pixels
            yield tile, pixels
        tell(len(tiles))
    finally:
        stop.set()


def _next(answers: queue.SimpleQueue[T], look: Callable[[], None]) -> T:
    """Return the next item of a queue; while waiting, let the run be cancelled."""
    while True:
        with suppress(queue.Empty):
            return answers.get(timeout=FETCHING.poll_s)
        look()


def _tile(service: Service, tile: Tile) -> Pixels:
    """Fetch a tile; raise `_MissingError` if there is none, and `_EndedError` if the server refuses."""
    content = _read(service.url(*tile))
    try:
        with MemoryFile(content) as memory, memory.open(driver=list(_DRIVERS)) as image:
            values = image.read()
            alpha = image.read_masks(1) if image.count in (1, 3) else values[-1]
            palette = image.colormap(1) if image.colorinterp[0] == ColorInterp.palette else None
    except (*GDAL_ERRORS, ValueError, IndexError) as error:
        begin = content[:40].decode("utf-8", "replace") if content else "nothing"
        raise _MissingError(f"no images (but {joined(begin)!r})") from error
    if palette is not None:
        table = np.zeros((256, 4), np.uint8)
        for index, colour in palette.items():
            table[index] = colour
        values = np.moveaxis(table[values[0]], 2, 0)
        alpha = np.minimum(alpha, values[3])
    if values.dtype != np.uint8 or values.shape[1:] != (service.tile_px,) * 2:
        size = " x ".join(map(str, values.shape[:0:-1]))
        raise _MissingError(f"of another kind ({size} px, {values.dtype})")
    colours = values[:3] if len(values) >= 3 else values[[0, 0, 0]]
    opaque = colours[:, alpha > 0]
    if opaque.size == 0 or (opaque == opaque[:, :1]).all():
        raise _MissingError("of one colour")
    return np.concatenate([colours, np.where(alpha > 0, 255, 0).astype(np.uint8)[None]])


def _read(url: str) -> bytes:
    """Return what a server answers; raise `_MissingError` or `_EndedError` where that is no tile.

    Raises `TimeoutError` if it does not answer in time, or is busy, also when asked again.
    """
    import urllib.error  # slow to load, and rarely needed
    import urllib.request

    from pcwlad_geo import __version__

    agent = {"User-Agent": f"pcwlad-geo/{__version__} (image registration)"}
    reason = ""
    for attempt in range(FETCHING.tries):
        time.sleep(attempt)
        try:
            request = urllib.request.Request(url, headers=agent)
            with urllib.request.urlopen(request, timeout=FETCHING.timeout_s) as answer:
                if answer.status == 204:
                    raise _MissingError("missing (HTTP 204)")
                return bytes(answer.read(LIMITS.tile_bytes))
        except urllib.error.HTTPError as error:
            error.close()
            if error.code in _STATUS:
                raise _EndedError(f"{_STATUS[error.code]} (HTTP {error.code})") from error
            if error.code < 500:
                raise _MissingError(f"missing (HTTP {error.code})") from error
            reason = f"HTTP {error.code}"
        except TimeoutError:
            reason = f"no answer in {FETCHING.timeout_s:.0f} s"
        except (OSError, http.client.HTTPException) as error:
            reason = joined(getattr(error, "reason", error))
    raise TimeoutError(reason)


def _read_text(url: str) -> bytes:
    try:
        return _read(url)
    except (_MissingError, _EndedError, TimeoutError) as error:
        raise InputError(f"{public_name(url)} cannot be fetched: {error}") from error
