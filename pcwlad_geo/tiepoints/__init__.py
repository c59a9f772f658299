"""Tie points on the original files, and the formats that they are read and written in.

A package that adds a format makes a `TiePointFormat`. It reads a `PointSource` into a `PointFile`, and writes
a `TiePointTable` of the `PointRasters`.
"""

from pcwlad_geo.tiepoints.format import PointFile as PointFile
from pcwlad_geo.tiepoints.format import PointRasters as PointRasters
from pcwlad_geo.tiepoints.format import PointSource as PointSource
from pcwlad_geo.tiepoints.format import TiePointFormat as TiePointFormat
from pcwlad_geo.tiepoints.table import TiePointTable as TiePointTable
