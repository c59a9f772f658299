"""Templates of pages with the style, scripts and filters that they share."""

from __future__ import annotations

import base64
import hashlib
import io
from functools import cache

import numpy as np
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image

from pcwlad_geo.report.answers import MARKS, percent
from pcwlad_geo.report.charts import data_uri
from pcwlad_geo.report.views import checkered, red_cyan
from pcwlad_geo.text import plain


@cache  # templates are compiled once per process
def page_environment(package: str) -> Environment:
    """Return the templates of a subpackage with the style, script and filters of this page."""
    environment = templates_of(package)
    environment.filters["figure"] = _figure
    environment.filters["percent"] = percent
    environment.filters["pair"] = _pair
    environment.filters["plain"] = plain
    environment.filters["jpeg"] = _jpeg
    environment.filters["lines"] = _lines
    environment.globals |= {
        "style": _source(environment, "style.css"),
        "checkered": checkered,
        "red_cyan": red_cyan,
        "marks": MARKS,
        **page_script(environment, "slider.js"),
    }
    return environment


def page_script(environment: Environment, name: str) -> dict[str, str]:
    """Return the script of a page, and the hash by which the page allows it to run."""
    script = _source(environment, name)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
    return {"script": script, "script_hash": f"sha256-{digest}"}


def _source(environment: Environment, name: str) -> Markup:
    """Return one of the page's own files, which is not escaped."""
    if environment.loader is None:
        raise TypeError("templates have no loader")
    return Markup(environment.loader.get_source(environment, name)[0])


def _jpeg(image: NDArray[np.uint8], quality: int = 82) -> str:
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "jpeg", quality=quality)
    return data_uri("image/jpeg", buffer.getvalue())


def _lines(image: NDArray[np.uint8]) -> str:
    """Return a (rows, cols) picture of lines as a PNG, yellow where it is not 0, transparent elsewhere."""
    buffer, drawn = io.BytesIO(), Image.fromarray((image > 0).astype(np.uint8), "P")
    drawn.putpalette([0, 0, 0, 255, 212, 0])
    drawn.save(buffer, "png", transparency=0, optimize=True)
    return data_uri("image/png", buffer.getvalue())


def _figure(value: object, digits: int = 3) -> str:
    """Return a number with a true minus sign; a dash for None."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.{digits}f}".replace("-", "−")
    return str(value)


def _pair(statistics: object, name: str, digits: int = 3) -> str:
    if statistics is None:
        return "–"
    return ", ".join(_figure(float(value), digits) for value in getattr(statistics, name))


def templates_of(package: str) -> Environment:
    """Return the templates of a subpackage and what pages share; undefined names in them raise errors."""
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("pcwlad_geo.report")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["svg"] = lambda text: data_uri("image/svg+xml", text.encode())
    return environment
