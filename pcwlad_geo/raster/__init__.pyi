from .arrays import georeferencing_of
from .bands import Bands
from .basemap import Basemap
from .crs import WGS84, transform_xy
from .file_tree import FileTree, file_name, is_folder, plain_name
from .grid import Grid, Window, jacobian, map_px, middle_pixel_size_m, pixel_sizes_m
from .identity import FileIdentity, check_unchanged, identify
from .matching_grid import ViewPair, plan_views
from .opening import open_raster
from .output_format import OutputFormat
from .output_grid import GridRequest, output_grids
from .placed import place_by_hand
from .rpc.dem import Dem
from .rpc.files import RpcSource, read_rpc
from .rpc.grid import RpcGrid, at_mean_height
from .rpc.model import RpcModel
from .rpc.placement import RpcPlacement
from .source import RasterInfo, describe
from .trust.permissions import Trust, trusting
from .view import Patch, View, file_px_per_px
from .warping import warp

__all__ = [
    "WGS84",
    "Bands",
    "Basemap",
    "Dem",
    "FileIdentity",
    "FileTree",
    "Grid",
    "GridRequest",
    "OutputFormat",
    "Patch",
    "RasterInfo",
    "RpcGrid",
    "RpcModel",
    "RpcPlacement",
    "RpcSource",
    "Trust",
    "View",
    "ViewPair",
    "Window",
    "at_mean_height",
    "check_unchanged",
    "describe",
    "file_name",
    "file_px_per_px",
    "georeferencing_of",
    "identify",
    "is_folder",
    "jacobian",
    "map_px",
    "middle_pixel_size_m",
    "open_raster",
    "output_grids",
    "pixel_sizes_m",
    "place_by_hand",
    "plain_name",
    "plan_views",
    "read_rpc",
    "transform_xy",
    "trusting",
    "warp",
]
