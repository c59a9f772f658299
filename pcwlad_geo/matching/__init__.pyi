from .first_pass import match_candidates
from .guidance import FieldGuide, guide_by_field
from .keypoints import Candidates
from .matcher import match_arrays
from .methods import AUTO_FEATURES, Consensus, Keypoints, Method
from .prepare import Image
from .second_pass import rematch_with
from .shift_search import search_shift
from .types import MatchSettings, TiePoints
from .windows import Scales

__all__ = [
    "AUTO_FEATURES",
    "Candidates",
    "Consensus",
    "FieldGuide",
    "Image",
    "Keypoints",
    "MatchSettings",
    "Method",
    "Scales",
    "TiePoints",
    "guide_by_field",
    "match_arrays",
    "match_candidates",
    "rematch_with",
    "search_shift",
]
