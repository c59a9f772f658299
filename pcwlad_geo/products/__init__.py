"""Products as delivered, found by their names and metadata.

A package that adds a kind of products makes a `ProductKind`, whose `find` returns a `Product` with its
`ProductBand`s from the files of a `FileTree`.
"""

from pcwlad_geo.products.kind import ProductKind as ProductKind
from pcwlad_geo.products.product import Product as Product
from pcwlad_geo.products.product import ProductBand as ProductBand
from pcwlad_geo.raster import FileTree as FileTree
